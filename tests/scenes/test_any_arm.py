"""Arms of other makers in a line scene: placed in their reach, refused in words, played."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from ideal_robot.errors import InputError
from ideal_robot.robots.collisions import Shapes
from ideal_robot.robots.robot import spread_postures
from scenes.arms import arm_of
from scenes.line.result import far_from_line, little_gained
from scenes.models import model_for
from scenes.placing import check_way, fits, place_line, resized, scene_text
from scenes.scene_file import library, load_scene
from scenes.scene_files.line_scene import LineScene
from scenes.scene_files.scene import Scene
from sim.arm.generic import FOLLOWED, MARGIN, STEP, fastest, generic_world, growth
from sim.arm.world import World
from tests.arms import GRIPPER, urdf, written


def scene_for(path: Path) -> LineScene:
    scene: Scene = load_scene("line").changed(robot=str(path), model="own")
    assert isinstance(scene, LineScene)
    return scene


@pytest.mark.parametrize(("joints", "beyond"), [
    (6, GRIPPER), pytest.param(5, "", marks=pytest.mark.slow), pytest.param(7, "", marks=pytest.mark.slow)])
def test_a_line_is_placed_where_a_bare_arm_reaches_it(joints: int, beyond: str, tmp_path: Path) -> None:
    path = written(tmp_path, urdf(joints, beyond=beyond))
    place = place_line(scene_for(path))
    file = tmp_path / "placed.toml"
    file.write_text(scene_text((library() / "line.toml").read_text(encoding="utf-8"), str(path), place))
    scene = load_scene(str(file))
    assert isinstance(scene, LineScene)
    assert (scene.surface.origin, scene.speed, scene.model) == (place.origin, place.speed, "own")
    assert scene.speed >= 0.1
    assert fits(scene, scene.arm) == pytest.approx(place.speed)


def test_a_ready_posture_is_inside_the_limits_and_touches_nothing(tmp_path: Path) -> None:
    path = written(tmp_path, urdf(7, limit='lower="-3.0" upper="-0.05" effort="0" velocity="0"'))
    for one in (path, written(tmp_path, urdf(6), "six")):
        robot = arm_of(str(one))
        assert ((robot.home > robot.q_min) & (robot.home < robot.q_max)).all()
    assert Shapes(robot).first_touch(robot.home[None]) is None
    assert robot.fk()(robot.home).rotation[2, 2] == pytest.approx(-1.0)


def test_a_line_out_of_reach_is_refused_with_a_place_where_one_fits(tmp_path: Path) -> None:
    from scenes.line.cell import set_up

    scene = resized(scene_for(written(tmp_path, urdf(6))), 0.5, (3.0, -0.25, 0.2))
    with pytest.raises(InputError, match=r"fits with surface.origin = \[") as refused:
        set_up(scene)
    assert refused.value.field == "surface.origin"


def test_what_the_arm_would_hit_is_said_before_it_moves(tmp_path: Path) -> None:
    """The wrist would be under the base plane; and a line that may lie far beside its reference is beyond the reach."""
    from planning.path.reference import ReferencePath
    from planning.path.speed_profile import JointPath
    from scenes.scene_files.drawn_line import reference_points

    scene = scene_for(written(tmp_path, urdf(6)))
    place = place_line(scene)
    low = resized(scene, 0.3, (place.origin[0], -0.15, -0.3))
    far = resized(scene, 0.3, (0.82, -0.15, place.origin[2])).changed(
        displacement={"lateral_mm": 60.0, "turn_deg": 20.0})
    for one, says in ((low, "base plane"), (far, "beside its reference")):
        reference = ReferencePath(reference_points(one), up=np.array([0.0, 0.0, 1.0]), turning=1.0)
        with pytest.raises(InputError, match=says):
            check_way(one, one.arm, reference, JointPath.of(one.arm, reference))


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


def test_a_gain_that_is_too_high_is_found_unstable() -> None:
    assert growth(60.0, 0.1, 1.0, 9000.0, 13.0) < 0.0
    assert growth(100.0 * 60.0 * MARGIN, 0.1, 1.0, 9000.0, 13.0) > 0.0


@pytest.mark.slow
def test_a_bare_arm_follows_a_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from scenes.play import run_scene

    monkeypatch.setenv("IDEAL_ROBOT_CACHE", str(tmp_path / "cache"))
    path = written(tmp_path, urdf(7))
    place = place_line(scene_for(path))
    file = tmp_path / "placed.toml"
    file.write_text(scene_text((library() / "line.toml").read_text(encoding="utf-8"), str(path), place))
    result = run_scene(load_scene(str(file)))
    assert result.failure is None
    assert result.control_error.mean < 0.15e-3
    assert len(result.json()["assumed"]) == 3
