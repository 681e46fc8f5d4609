"""Arms of other makers and boxes in the cell: what is placed in reach, refused in words, kept off, played."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from ideal_robot.errors import InputError
from ideal_robot.identification.excitation import Workspace, clear_of_obstacles
from ideal_robot.robots.collisions import Obstacle, Shapes
from ideal_robot.robots.robot import Robot, spread_postures
from planning.path.joint_path import JointPath
from planning.path.kinematics import InverseKinematics
from scenes.arms import arm_of
from scenes.force.cell import friction_shown
from scenes.force.cell import set_up as set_up_force
from scenes.identification.plan import plan
from scenes.line.cell import set_up
from scenes.line.result import far_from_line, little_gained
from scenes.line_way import calibration_postures, line_way, shapes_about, shapes_in
from scenes.models import cache_name, identity, model_for
from scenes.online.force_calibration import LEAST, TURNS, postures_to_weigh
from scenes.placing import fits, place_line, resized, scene_text
from scenes.play import run_scene
from scenes.regression.suite import Suite
from scenes.scene_file import library, load_scene
from scenes.scene_files.drawn_line import geometry
from scenes.scene_files.force_scene import ForceScene
from scenes.scene_files.line_scene import LineScene
from scenes.scene_files.path_scene import PathScene, joint_path
from scenes.scene_files.scene import Scene, SceneError, boxes_of
from sim.arm.generic import FOLLOWED, MARGIN, STEP, fastest, generic_world, growth
from sim.arm.world import World
from studies.report import scene_of
from tests.arms import GRIPPER, SCARA, urdf, written
from tests.sources import ROOT


def scene_for(path: Path) -> LineScene:
    scene: Scene = load_scene("line").changed(robot=str(path), model="own")
    assert isinstance(scene, LineScene)
    return scene


def placed(path: Path, folder: Path) -> LineScene:
    """The line where an arm reaches it, as a file says it."""
    place, file = place_line(scene_for(path)), folder / "placed.toml"
    file.write_text(scene_text((library() / "line.toml").read_text(encoding="utf-8"), str(path), place))
    scene = scene_of(LineScene, str(file))
    assert (scene.surface.origin, scene.speed, scene.model) == (place.origin, place.speed, "own")
    return scene


@pytest.mark.parametrize(("joints", "beyond"), [
    (6, GRIPPER), pytest.param(5, "", marks=pytest.mark.slow), pytest.param(7, "", marks=pytest.mark.slow)])
def test_a_line_is_placed_where_a_bare_arm_reaches_it(joints: int, beyond: str, tmp_path: Path) -> None:
    scene = placed(written(tmp_path, urdf(joints, beyond=beyond)), tmp_path)
    assert scene.speed >= 0.1
    assert (fits(scene, scene.arm) or 0.0) >= scene.speed


@pytest.mark.slow
def test_a_line_is_placed_where_the_tool_of_a_scara_is(tmp_path: Path) -> None:
    """Heights were counted from the second joint alone, which is no matter to an arm whose tool slides up and down."""
    limit = '<limit lower="-2.7" upper="2.7" effort="60" velocity="5"/>'
    scene = placed(written(tmp_path, SCARA.format(limit=limit, one=0.3, two=0.25, up=1, roll=0.0)), tmp_path)
    assert 0.05 < scene.surface.origin[2] < 0.25


def drawn_arm(rng: np.random.Generator) -> str:
    """A bare arm of five to seven joints whose lengths, limits and speeds nobody chose."""
    text = urdf(int(rng.integers(5, 8)), limit="")
    size = float(rng.uniform(0.5, 2.5))

    def stretched(found: re.Match[str]) -> str:
        values = [float(word) * size * rng.uniform(0.7, 1.3) for word in found.group(1).split()]
        return f'<origin xyz="{" ".join(f"{value:.4f}" for value in values)}"'

    def limited(_: re.Match[str]) -> str:
        low, high, fast = rng.uniform(1.9, 3.1), rng.uniform(1.9, 3.1), rng.uniform(1.0, 6.0)
        return f'<limit lower="{-low:.3f}" upper="{high:.3f}" effort="0" velocity="{fast:.3f}"'

    return re.sub("<limit ", limited, re.sub(r'<origin xyz="([^"]*)"', stretched, text))


def on_every_surface(scene: LineScene, seeds: Sequence[int]) -> None:
    """The judge of `run` takes a scene on every surface that its displacement allows, at the scene's speed."""
    robot = scene.arm
    assert line_way(scene, robot).travel().top_speed >= 0.98 * scene.speed
    for seed in seeds:
        true = geometry(scene, np.random.default_rng(seed)).plane
        found = line_way(scene, robot, surface=true * scene.surface.pose().inverse())
        assert found.travel().top_speed >= 0.97 * scene.speed


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(1, 13))
def test_what_is_placed_is_taken_wherever_the_line_may_lie(seed: int, tmp_path: Path) -> None:
    """A scene that `new` wrote was refused by `run`: one looked at the assumed surface, the other at a tilted one."""
    path = written(tmp_path, drawn_arm(np.random.default_rng(seed)))
    try:
        scene = placed(path, tmp_path)
    except InputError as error:
        assert "no line fits" in error.message  # noqa: PT017  a drawn arm may be of no use
        return
    on_every_surface(scene, range(4))


def test_paths_in_a_file_are_as_seen_from_its_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "cell").mkdir()
    path, file = written(tmp_path / "cell", urdf(6)), tmp_path / "cell/weld.toml"
    text = (library() / "line.toml").read_text(encoding="utf-8")
    file.write_text(text.replace('robot = "kr6"', f'robot = "{path.name}"\nmodel = "own.json"'))
    monkeypatch.chdir(tmp_path)
    scenes = [load_scene("cell/weld.toml"), load_scene(file)]
    assert [Path(scene.robot).resolve() for scene in scenes] == [path, path]
    assert [Path(scene.model).resolve() for scene in scenes] == [tmp_path / "cell/own.json"] * 2
    assert identity(scenes[0]) == identity(scenes[1])
    suite = tmp_path / "cell/suite.toml"
    suite.write_text('title = "of the cell"\n[[case]]\nscenes = ["weld.toml"]\n')
    (tmp_path / "weld.toml").write_text(text)
    assert [task.scene.folder for task, _ in Suite(suite).work] == [scenes[0].folder]  # type: ignore[union-attr]
    file.unlink()
    with pytest.raises(InputError, match=r"case.0.scenes: no such scene file \(got 'weld.toml'"):
        Suite(suite)


def test_what_is_calibrated_once_for_all_methods_is_of_the_scene_in_its_folder(tmp_path: Path) -> None:
    """The SVG file of a force scene was looked for in the working folder."""
    (tmp_path / "drawn.svg").write_text('<svg xmlns="http://www.w3.org/2000/svg"><path d="M 0 0 L 300 0"/></svg>')
    scene = load_scene("force_wave").changed(line={"formula": None, "length": None, "svg": "drawn.svg"})
    assert friction_shown(scene.beside(tmp_path)) is not None  # type: ignore[arg-type]


def test_a_ready_posture_is_inside_the_limits_and_touches_nothing(tmp_path: Path) -> None:
    path = written(tmp_path, urdf(7, limit='lower="-3.0" upper="-0.05" effort="0" velocity="0"'))
    for file in (path, written(tmp_path, urdf(6), "six")):
        robot = arm_of(str(file))
        assert ((robot.home > robot.q_min) & (robot.home < robot.q_max)).all()
    assert Shapes(robot).first_touch(robot.home[None]) is None
    assert robot.fk()(robot.home).rotation[2, 2] == pytest.approx(-1.0)


def hung(folder: Path, height: float) -> Path:
    """The KR 6 upside down, its base that high above the floor."""
    text = Robot.load("kr6").description
    first = re.findall(r'<link name="([^"]+)"', text)[0]
    mount = (f'<link name="floor"/><joint name="mount" type="fixed"><parent link="floor"/><child link="{first}"/>'
             f'<origin xyz="0 0 {height}" rpy="{np.pi} 0 0"/></joint>')
    return written(folder, re.sub(r"(<robot[^>]*>)", lambda tag: tag.group() + mount, text, count=1))


def test_an_arm_that_hangs_stands_ready_below_its_shoulder_and_not_over_its_head(tmp_path: Path) -> None:
    """The first height at which any posture was found had poor ones only, from which no motion was found."""
    robot = arm_of(str(hung(tmp_path, 2.0)))
    assert abs(robot.home[0]) < 0.1
    assert len(plan(robot, "joint").commands) > 1000


@pytest.mark.slow
@pytest.mark.parametrize("off", [135.0, 180.0])
def test_a_wrist_of_less_than_a_turn_has_its_tool_turned_on_the_flange(off: float, tmp_path: Path) -> None:
    # Public arms whose last joint turns by 90 or 120 degrees to either side were refused: no line fitted.
    whole = scene_for(written(tmp_path, urdf(6)))
    place = place_line(whole)
    where = resized(whole, place.length, place.origin, place.heading).changed(**place.tool)
    middle = float(np.mean(line_way(where, where.arm).path.q[:, -1])) + np.radians(off)
    middle -= 2.0 * np.pi * round(middle / (2.0 * np.pi))
    head, mark, last = urdf(6).rpartition("<limit")
    ends = f' lower="{middle - 0.7:.3f}" upper="{middle + 0.7:.3f}"'
    turned = scene_for(written(tmp_path, head + mark + ends + re.sub(r' (?:lower|upper)="[^"]*"', "", last)))
    found = place_line(turned)
    assert found.tool_turn_deg != 0.0
    scene = resized(turned, found.length, found.origin, found.heading).changed(**found.tool)
    assert (fits(scene, scene.arm) or 0.0) >= found.speed


def test_an_arm_that_hangs_from_the_floor_is_told_what_its_urdf_lacks(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="hangs below z = 0, which is the floor"):
        place_line(scene_for(hung(tmp_path, 0.0)))


def test_an_arm_whose_tool_is_always_below_its_base_is_told_what_its_urdf_lacks(tmp_path: Path) -> None:
    """A SCARA whose description begins where its table is screwed to its column."""
    limit = '<limit lower="-2.3" upper="2.3" effort="100" velocity="4"/>'
    low = SCARA.format(limit=limit, one=0.3, two=0.25, up=1, roll=0.0).replace("0 0 0.2", "0 0 0.02").replace(
        "0.25 0 0.05", "0.25 0 0.0")
    with pytest.raises(InputError, match=r"no higher than 0\.0\d m, thus below z = 0"):
        place_line(scene_for(written(tmp_path, low)))


def test_a_line_out_of_reach_is_refused_with_a_place_where_one_fits(tmp_path: Path) -> None:
    scene = resized(scene_for(written(tmp_path, urdf(6))), 0.5, (3.0, -0.25, 0.2))
    with pytest.raises(InputError, match=r"fits with surface.origin = \[") as refused:
        set_up(scene)
    assert refused.value.field == "surface.origin"


def test_what_the_arm_would_hit_is_said_before_it_moves(tmp_path: Path) -> None:
    """The wrist would be under the base plane; and a line that may lie far beside its reference is beyond the reach."""
    scene = scene_for(written(tmp_path, urdf(6)))
    low = resized(scene, 0.3, (0.44, -0.15, -0.3))
    far = resized(scene, 0.3, (0.82, -0.15, 0.18)).changed(
        displacement={"lateral_mm": 60.0, "turn_deg": 20.0})
    for variant, says in ((low, "base plane"), (far, "beside its reference")):
        with pytest.raises(InputError, match=says):
            line_way(variant, variant.arm)


def test_a_model_that_is_not_shipped_names_the_key_that_helps(tmp_path: Path) -> None:
    scene = scene_for(written(tmp_path, urdf(6))).changed(model="shipped")
    with pytest.raises(InputError, match='model = "own"'):
        model_for(scene, scene.arm)


def test_what_a_run_leaves_is_said_in_words() -> None:
    assert far_from_line(0.9e-3) == far_from_line(float("nan")) == ""
    assert "10.6 mm from the line" in far_from_line(10.6e-3)
    assert little_gained(0.05e-3, 4e-3) == ""
    assert "0.80 mm of 1.00 mm" in little_gained(0.8e-3, 1e-3)


# The world of an arm of which its URDF says kinematics alone.

@pytest.mark.parametrize("joints", [5, 6, 7])
def test_a_bare_arms_world_can_be_played_and_its_cascade_is_stable(joints: int, tmp_path: Path) -> None:
    robot = arm_of(str(written(tmp_path, urdf(joints))))
    world = World(robot=robot.name, **generic_world(robot))
    stiffness, damping, gain, rotor = (world.per_joint(name, joints) for name in (
        "stiffness", "damping", "velocity_gain", "extra_rotor_inertia"))
    assert all((value > 0).all() for value in (stiffness, damping, gain, rotor))
    data = robot.pinocchio.createData()
    links = np.mean([pin.crba(robot.pinocchio, data, q).diagonal()
                     for q in spread_postures(robot.q_min, robot.q_max)], axis=0)
    for j in range(joints):
        assert growth(MARGIN * gain[j], rotor[j], links[j], stiffness[j], damping[j]) <= 0.0


def test_a_slim_link_between_two_axes_that_fall_together_makes_a_gear_rigid(tmp_path: Path) -> None:
    """The step follows no spring of 3000 N m/rad on 3e-4 kg m²; with the gear rigid, its rotor goes with the link."""
    assert fastest(np.array([[0.02]]), np.array([50.0]), np.array([0.1])) == (
        pytest.approx(np.sqrt(50.0 * (1.0 / 0.02 + 1.0 / 0.1)), rel=1e-4), 0)
    slim = '<inertia ixx="0.003" iyy="0.003" izz="0.0003"'
    limit = 'lower="-2.9" upper="2.9" effort="200" velocity="2"'
    text = urdf(7, mass=1.0, limit=limit).replace('<inertia ixx="0.01" iyy="0.01" izz="0.01"', slim)
    robot = arm_of(str(written(tmp_path, text)))
    stiffness, rotor = (np.array(generic_world(robot)[name]) for name in ("stiffness", "extra_rotor_inertia"))
    assert np.isinf(stiffness).any()
    assert not np.isinf(stiffness).all()
    data = robot.pinocchio.createData()
    for q in spread_postures(robot.q_min, robot.q_max):
        mass = pin.crba(robot.pinocchio, data, q)
        mass = np.triu(mass) + np.triu(mass, 1).T
        assert fastest(mass, stiffness, rotor)[0] <= FOLLOWED / STEP


@pytest.mark.parametrize("lighter", [1e-2, 1e-4, 1e-5])
def test_a_gear_whose_damping_the_step_cannot_follow_is_rigid(lighter: float, tmp_path: Path) -> None:
    """The gear of a last link of 25 g, damped as its drive's inertia asks for, made the simulation diverge."""
    across, along = 1e-2 * lighter, 1e-3 * lighter
    light = f'<mass value="{lighter:g}"/><inertia ixx="{across:g}" iyy="{across:g}" izz="{along:g}"'
    limit = 'lower="-2.9" upper="2.9" effort="40" velocity="2"'
    text, heavy = urdf(5, mass=1.0, limit=limit), '<mass value="1.0"/><inertia ixx="0.01" iyy="0.01" izz="0.01"'
    place = text.rindex(heavy)
    robot = Robot.load(written(tmp_path, text[:place] + light + text[place + len(heavy):]))
    world = {name: np.array(values) for name, values in generic_world(robot).items()}
    data, step_rate = robot.pinocchio.createData(), FOLLOWED / STEP
    soft = np.isfinite(world["stiffness"])
    mass = pin.crba(robot.pinocchio, data, robot.home).diagonal()
    assert (world["damping"] / mass <= step_rate)[soft].all()
    assert soft[-1] == (world["damping"][-1] / mass[-1] <= step_rate)


def test_a_gain_that_is_too_high_is_found_unstable() -> None:
    assert growth(60.0, 0.1, 1.0, 9000.0, 13.0) < 0.0
    assert growth(100.0 * 60.0 * MARGIN, 0.1, 1.0, 9000.0, 13.0) > 0.0


@pytest.mark.slow
def test_a_bare_arm_follows_a_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("IDEAL_ROBOT_CACHE", str(tmp_path / "cache"))
    result = run_scene(placed(written(tmp_path, urdf(7)), tmp_path))
    assert result.failure is None
    assert result.control_error.mean < 0.15e-3
    assert len(result.json()["assumed"]) == 3


# Boxes in the cell: no planned motion leads the arm into one, and the report draws them.

BESIDE = {"middle": [0.0, -1.5, 0.5], "size": [0.4, 0.4, 1.0]}
ABOVE_THE_LINE = {"middle": [1.0, 0.2, 0.75], "size": [0.2, 0.2, 0.2], "heading_deg": 30.0}
"""Where the KR 6's wrist passes in the second half of the scene `line`."""


def line(**box: object) -> LineScene:
    return scene_of(LineScene, "line").changed(box=[box])  # type: ignore[return-value]


def test_a_line_whose_wrist_would_hit_a_box_is_refused_and_one_beside_it_is_not() -> None:
    set_up(line(**BESIDE))
    with pytest.raises(InputError, match=r"touches box 1 .* m from the path's begin"):
        set_up(line(**ABOVE_THE_LINE))


def test_poses_of_the_calibration_keep_off_a_box_also_on_their_way() -> None:
    cell = set_up(line(**BESIDE)).known
    path = JointPath.of(cell.robot, cell.reference)
    free = calibration_postures(cell.robot, cell.reference, path, cell.camera, 0.7)
    data = cell.robot.pinocchio.createData()
    wrists = np.array([pin.forwardKinematics(cell.robot.pinocchio, data, q) or data.oMi[4].translation.copy()
                       for q in free])
    outermost = wrists[np.argmax(wrists[:, 1])]
    standing = Obstacle("box 1", pin.SE3(np.eye(3), outermost + np.array([0.0, 0.2, 0.0])), (0.3, 0.3, 0.3))
    shapes = Shapes(cell.robot, boxes=[standing])
    clear = calibration_postures(cell.robot, cell.reference, path, cell.camera, 0.7, shapes=shapes)
    assert len(free) // 2 <= len(clear) < len(free)
    assert shapes.first_touch(np.array(clear)) is None
    assert all(shapes.touch_between(posture, other) is None for posture, other in pairwise(clear))


def test_paths_and_forces_are_checked_as_lines_are() -> None:
    path = scene_of(PathScene, "iso9283_1")
    robot = arm_of(path.robot)
    planned = joint_path(path, robot, robot.t_ipo)
    middle = planned.x_d[len(planned.x_d) // 2].tolist()
    with pytest.raises(InputError, match=r"touches box 2 .* s from the path's begin"):
        joint_path(path.changed(box=[BESIDE, {"middle": middle, "size": [0.1, 0.1, 0.1]}]), robot, robot.t_ipo)
    force = scene_of(ForceScene, "force_wave")
    set_up_force(force.changed(box=[BESIDE]))
    x, y, z = force.surface.origin
    with pytest.raises(InputError, match="touches box 1"):
        set_up_force(force.changed(box=[{"middle": [x, y + 0.3, z + 0.4], "size": [0.3, 0.3, 0.3]}]))


@pytest.mark.parametrize("name", ["line", "corner", *(
    pytest.param(name, marks=pytest.mark.slow) for name in ("cluttered", "gap", "svg"))])
def test_no_pose_of_a_shipped_calibration_is_given_up(name: str) -> None:
    scene = scene_of(LineScene, name)
    known = set_up(scene).known
    path = JointPath.of(known.robot, known.reference)
    free, clear = (calibration_postures(known.robot, known.reference, path, known.camera, 0.7, shapes=shapes)
                   for shapes in (None, shapes_about(scene, known.robot)))
    np.testing.assert_array_equal(free, clear)


def test_the_base_may_stand_in_a_box_and_its_edges_are_where_it_is() -> None:
    robot = Robot.load("kr6")
    pedestal = Obstacle("box 1", pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.1])), (0.8, 0.8, 0.21))
    assert Shapes(robot, boxes=[pedestal]).first_touch(robot.home[None]) is None
    turned = Obstacle("box 1", pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, np.pi / 2), np.array([1.0, 0.0, 0.5])),
                      (0.2, 0.4, 0.6))
    edges = turned.edges()
    np.testing.assert_allclose([edges.min(axis=0), edges.max(axis=0)], [[0.8, -0.1, 0.2], [1.2, 0.1, 0.8]], atol=1e-12)
    lengths = np.linalg.norm(np.diff(edges, axis=0), axis=1)
    assert all(np.abs(length - np.array([0.2, 0.4, 0.6])).min() < 1e-9 for length in lengths)
    assert len({frozenset(map(tuple, ends)) for ends in pairwise(edges.round(6).tolist())}) == 12


def test_a_box_without_a_size_is_refused() -> None:
    with pytest.raises(InputError, match=r"box\.0\.size"):
        line(middle=[0.0, 0.0, 0.0], size=[0.1, 0.0, 0.1])


@pytest.mark.parametrize("method", ["joint", pytest.param("two-step", marks=pytest.mark.slow)])
def test_identification_motions_keep_off_the_cell_also_on_the_way_to_them(method: str) -> None:
    robot = arm_of("kr6")
    free = plan(robot, "joint", seed=1)
    data = robot.pinocchio.createData()
    pin.forwardKinematics(robot.pinocchio, data, free.commands[len(free.commands) // 3])
    box = {"middle": [float(x) for x in data.oMi[5].translation], "size": [0.2, 0.2, 0.2]}
    shapes = shapes_in(load_scene("iso9283_1").changed(box=[box]), robot)
    assert shapes.first_touch(free.commands) is not None
    clear = plan(robot, method, seed=1, workspace=replace(Workspace.of(robot), cell=shapes))
    assert shapes.first_touch(clear.commands) is None


def test_a_joint_that_a_finger_follows_closes_a_gripper_whatever_it_is_called(tmp_path: Path) -> None:
    named = GRIPPER.replace("left_finger", "drive").replace("right_finger", "driven")
    robot = Robot.load(written(tmp_path, urdf(6, beyond=named)))
    assert (robot.n, robot.tool_frame) == (6, "tool0")
    assert sum("is held" in text for text in robot.assumed) == 2


@pytest.mark.parametrize(("name", "seed"), [
    pytest.param("kr6", 8, marks=pytest.mark.slow), ("examples/bare_arm.urdf", 2)])
def test_moves_of_a_single_axis_and_the_ways_between_them_stay_in_the_workspace(name: str, seed: int) -> None:
    robot = Robot.load(name if name == "kr6" else ROOT / name)
    commands = plan(robot, "two-step", seed=seed).commands
    assert clear_of_obstacles(robot, commands, Workspace.of(robot)).all()


@pytest.mark.parametrize(("method", "seed"), [
    ("joint", 2), pytest.param("joint", 15, marks=pytest.mark.slow), ("two-step", 5)])
def test_an_axis_of_five_centimetres_is_not_moved_beyond_its_ends(method: str, seed: int, tmp_path: Path) -> None:
    axis = (ROOT / "examples" / "own_robot.urdf").read_text(encoding="utf-8")
    axis = axis.replace('type="revolute"', 'type="prismatic"').replace("0 0 1", "1 0 0")
    short = re.sub(r'lower="[^"]*" upper="[^"]*"', 'lower="0" upper="0.05"', axis)
    (tmp_path / "axis.urdf").write_text(short, encoding="utf-8")
    commands = plan(Robot.load(tmp_path / "axis.urdf"), method, seed=seed, points=3).commands
    # The steps of the last bit of a number are no motion.
    assert commands.min() >= -1e-12
    assert commands.max() <= 0.05 + 1e-12


def test_an_arm_that_stands_in_a_box_is_told_so_before_a_motion_is_looked_for() -> None:
    robot = arm_of("kr6")
    tip = InverseKinematics(robot).fk(robot.home).translation
    cell = Shapes(robot, boxes=[Obstacle("box 1", pin.SE3(np.eye(3), tip), (0.2, 0.2, 0.2))])
    with pytest.raises(InputError, match=r"home posture, and there .* touches box 1"):
        plan(robot, "joint", workspace=replace(Workspace.of(robot), cell=cell))


@pytest.mark.parametrize("name", ["force_wave", *(
    pytest.param(name, marks=pytest.mark.slow) for name in ("glue", "contour"))])
def test_postures_in_which_the_tool_is_weighed_keep_off_a_box(name: str) -> None:
    scene = scene_of(ForceScene, name)
    known = set_up_force(scene).known
    start = known.q_start()
    free = postures_to_weigh(replace(known, scene=scene.changed(box=[BESIDE])), start)
    assert len(free) == sum(turned_within_limits(known.robot, free[0]))
    tips = known.robot.tool_places(np.array(free))
    farthest = tips[np.argmax(np.linalg.norm(tips - tips[0], axis=1))]
    boxed = scene.changed(box=[{"middle": farthest.tolist(), "size": [0.04, 0.04, 0.04]}])
    shapes = shapes_about(boxed, known.robot)
    assert shapes.first_touch(np.array(free)) is not None
    assert shapes.touch_between(start, free[0]) is None
    clear = postures_to_weigh(replace(known, scene=boxed), start)
    assert LEAST <= len(clear) < len(free)
    assert all(shapes.touch_between(posture, other) is None for posture, other in pairwise([start, *clear, clear[0]]))


def turned_within_limits(robot: Robot, lifted: np.ndarray) -> list[bool]:
    turned = [lifted + np.array([0.0, 0.0, 0.0, turn, bend, 0.0]) for turn, bend in TURNS]
    return [bool(((q > robot.q_min + 0.05) & (q < robot.q_max - 0.05)).all()) for q in turned]


def test_a_tool_that_cannot_be_lifted_for_a_box_is_not_turned() -> None:
    scene = scene_of(ForceScene, "force_wave")
    known = set_up_force(scene).known
    x, y, z = known.reference.frames(np.zeros(1)).position[0]
    boxed = scene.changed(box=[{"middle": [x, y, z + 0.8], "size": [0.3, 0.3, 0.3]}])
    with pytest.raises(SceneError, match=r"cannot be turned 150 mm above the start of the path: .* touches box 1"):
        postures_to_weigh(replace(known, scene=boxed), known.q_start())


def test_an_own_model_of_a_cell_with_boxes_is_another_one() -> None:
    robot, world = arm_of("kr6"), World.default("kr6")
    assert len({cache_name(robot, world, boxes_of(scene)) for scene in (load_scene("line"), line(**BESIDE))}) == 2
    assert cache_name(robot, world, boxes_of(load_scene("line"))) == cache_name(robot, world)


FIVE = (("0 0 1", "0 0 0.3", (-3.0, 3.0), 3, 400, 20.0, 0.2), ("0 1 0", "0.1 0 0.1", (-2.0, 2.2), 3, 400, 18.0, 0.5),
        ("0 1 0", "0 0 0.5", (-2.5, 2.5), 3, 200, 10.0, 0.2), ("0 1 0", "0 0 0.35", (-2.0, 2.0), 5, 40, 3.0, 0.1),
        ("0 0 1", "0 0 0.08", (-6.0, 6.0), 6, 20, 1.0, 0.05))
"""Axis, place [m], limits [rad], speed [rad/s], effort [N m], mass [kg] and length [m] of five joints."""


@pytest.mark.slow
def test_a_motion_is_found_for_an_arm_that_few_can_be_driven_to(tmp_path: Path) -> None:
    """``new`` wrote a scene for it, and ``run`` ended: nine of ten motions lie behind the column or the floor."""
    parts = ['<robot name="five"><link name="l0"/>']
    for j, (axis, place, (low, high), speed, effort, mass, length) in enumerate(FIVE, 1):
        about = mass * length**2 / 12 + 0.005 * mass
        parts.append(f'<link name="l{j}"><inertial><origin xyz="0 0 {length / 2}"/><mass value="{mass}"/><inertia '
                     f'ixx="{about}" iyy="{about}" izz="{0.005 * mass}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
                     f'<joint name="j{j}" type="revolute"><parent link="l{j - 1}"/><child link="l{j}"/><origin '
                     f'xyz="{place}"/><axis xyz="{axis}"/><limit lower="{low}" upper="{high}" velocity="{speed}" '
                     f'effort="{effort}"/></joint>')
    (tmp_path / "five.urdf").write_text("".join([*parts, "</robot>"]), encoding="utf-8")
    assert len(plan(arm_of(str(tmp_path / "five.urdf")), "joint", seed=3, period=8.0).commands) > 1000
