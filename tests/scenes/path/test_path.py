"""Path scenes on the simulated arm: bounds on the errors, and what the JSON holds."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pinocchio as pin
import pytest

from ideal_robot.arrays import interpolated
from ideal_robot.elasticity.stiffness_analysis import analyse_stiffness
from ideal_robot.errors import InputError, LimitError
from ideal_robot.execution.command_limits import check_limits
from ideal_robot.execution.precorrect import precorrect
from ideal_robot.feedforward.base import Feedforward
from ideal_robot.feedforward.friction_adaptation import AdaptedIdeal, FrictionAdaptation
from ideal_robot.feedforward.inverse import Inverse, Options
from ideal_robot.feedforward.method import Setting
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from scenes import load_scene
from scenes.clamped import configurations, record
from scenes.methods import ADAPTED, IDEAL
from scenes.models import shipped_model
from scenes.path.cell import measured_errors, set_up
from scenes.path.kind import compare, run
from scenes.path.precorrect import played, precorrected_path, table
from scenes.report.page import write_json
from scenes.scene_files.clamped_scene import ClampedScene
from scenes.scene_files.scene import chosen
from scenes.scene_files.tool_path import Arc, Line, Shape, duration, shape_of, tool_path, travel
from sim.contact.clamp_world import ClampWorld
from tests.arms import ROBOT, T, motion
from tests.sources import MODELS


def short(name: str):
    """The scene, small and quick: what is tested is the way through, not the figures of the full paths."""
    return load_scene(name).changed(path={"size_mm": 60.0}, speed=0.3)


@pytest.mark.parametrize(("name", "at_least"), [("iso9283_3", 85.0), ("iso9283_2", 85.0)])
def test_the_ideal_robot_leaves_little_of_the_error(name, at_least):
    """The bound of 85 % on E_car (60 % on E_max) without delay, of the weaker of time-matched and aligned."""
    scene = load_scene(name)
    before, after = (run(scene, method=method).errors for method in ("none", "ideal"))
    for kind in ("time_matched", "aligned"):
        b, a = getattr(before, kind), getattr(after, kind)
        assert 100 * (1 - a.E_car / b.E_car) >= at_least
        assert 100 * (1 - a.E_max / b.E_max) >= 60.0


def test_the_planners_delay_hardly_matters_to_the_ideal_robot():
    scene = load_scene("iso9283_3")
    without, with_delay = (run(scene, method=method).errors.time_matched.E_car for method in ("ideal", "ideal-delay"))
    assert with_delay == pytest.approx(without, rel=0.1)


def test_the_json_names_all_that_is_promised(tmp_path):
    result = run(short("iso9283_3"), method="ideal", out=tmp_path)
    written = json.loads(write_json(tmp_path / "run.json", result.json()).read_text())
    promised = {"scene", "speed_m_s", "seed", "method", "path_error_mm", "recording", "urdf", "cycle_time_ms"}
    assert promised <= set(written)
    assert set(written["path_error_mm"]) >= {"time_matched", "aligned", "geometric"}
    assert (tmp_path / "report.html").stat().st_size > 20_000
    recording = result.recording
    assert all(recording.has(prefix) for prefix in ("q_c", "q_d", "qa"))
    assert recording.meta["method"] == "ideal"


def test_the_recording_tells_the_error_of_the_report():
    """Held from cycle to cycle, the desired positions of the rows between were up to 7 mm behind the path."""
    result = run(short("iso9283_3"), method="ideal")
    recording = result.recording
    desired = Robot.load("kr15").tool_places(recording.joints("q_d"))
    off = np.linalg.norm(np.column_stack([recording.columns[axis] for axis in "xyz"]) - desired, axis=1)
    assert off[recording.t > 0.5].max() < result.json()["path_error_mm"]["time_matched"]["E_max"] / 1e3 + 1e-4


def test_the_same_seed_gives_the_same_recording():
    first, second = (run(short("iso9283_3"), method="ideal").recording.hash for _ in range(2))
    assert first == second
    assert run(short("iso9283_3").changed(seed=2), method="ideal").recording.hash != first


@pytest.mark.parametrize("source", ["arm", "tcp"])
def test_what_learning_measures_is_what_happened(source):
    cell = set_up(short("iso9283_3"), delay=False)
    played = cell.play(cell.feedforward("none"))
    measured = measured_errors(cell.robot, cell.path, played.recording, source)
    true = cell.path.q_d - played.q_a[: len(cell.path.q_d)]
    # The device's noise, 20 µm and 20 µrad, shows as up to a tenth of a milliradian in the wrist.
    assert np.sqrt(np.mean((measured - true) ** 2)) < 1e-4


def test_two_degrees_of_freedom_are_enough_to_learn_from():
    cell = set_up(short("iso9283_3").changed(learn_from="two_dof"), delay=False)
    errors = [cell.play(cell.feedforward(method)).errors.time_matched.E_car for method in ("none", "learned-3")]
    assert errors[1] < 0.5 * errors[0]


@pytest.mark.parametrize("name", ["iso9283_1", "iso9283_2", "iso9283_3", "vertical_circle", "edge"])
def test_what_the_paper_reaches_stands_beside_the_method_as_printed(name):
    """It stood beside our extensions, of which the paper has no figure."""
    paper = load_scene(name).paper
    beside = {*paper.E_car_reduction_percent, *paper.E_max_reduction_percent}
    assert {key.removesuffix("-delay") for key in beside} <= {"precorrected-printed", "trained-printed", "learned"}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["iso9283_1", "vertical_circle", "edge"])
def test_whole_comparisons(name, tmp_path):
    """The table of targets; what each row asks for stands beside it."""
    comparison = compare(load_scene(name), out=tmp_path)
    written = json.loads(write_json(tmp_path / "compare.json", comparison.json()).read_text())
    less = {method: values["reduction_percent"]["E_car"]["weaker"] for method, values in written["methods"].items()}
    bounds = {"ideal": 85.0, "ideal-delay": 80.0}
    if name != "iso9283_1":
        bounds = {"precorrected": 80.0, "learned": 95.0, "trained": 60.0, "ideal": 85.0}
    assert {method: less[method] for method, bound in bounds.items() if less[method] < bound} == {}


def test_bad_scenes_are_refused():
    for method, changes, says in (("ideal", {"path": {"centre": [3.0, 0.0, 0.9]}}, "out of reach"),
                                  ("ideal", {"speed": 6.0, "path": {"acceleration": 100.0}}, "velocity"),
                                  ("ideal", {"path": {"corner": 1.0}}, "unknown key"),
                                  ("magic", {}, "expected one of")):
        with pytest.raises(InputError, match=says):
            run(load_scene("iso9283_3").changed(**changes), method=method)


# Tool paths: figures, timing and orientation.

CYCLE = 0.012


@pytest.mark.parametrize("name", ["iso9283", "triangle", "circle", "edge"])
def test_speed_and_acceleration_stay_within_what_was_asked(name):
    path = tool_path(shape_of(name, 0.3), pin.SE3.Identity(), 0.4, 3.0, CYCLE)
    speed = np.linalg.norm(np.diff(path.positions, axis=0), axis=1) / CYCLE
    assert speed.max() <= 0.4 + 1e-9
    assert path.speed.max() <= 0.4 + 1e-9
    # Along the path 3 m/s²; on arcs the centripetal part comes on top (smallest radius 30 mm of the edge).
    along = np.abs(np.diff(path.speed)) / CYCLE
    assert along.max() <= 3.0 + 1e-6


def test_figures_close_and_have_their_size():
    for name in ("iso9283", "triangle", "circle"):
        x = tool_path(shape_of(name, 0.4), pin.SE3.Identity(), 0.5, 3.0, CYCLE).positions
        assert np.linalg.norm(x[0] - x[-1]) < 1e-5
    circle = tool_path(shape_of("circle", 0.32), pin.SE3.Identity(), 0.63, 3.0, CYCLE).positions
    np.testing.assert_allclose(np.linalg.norm(circle, axis=1), 0.16, atol=1e-9)
    iso = tool_path(shape_of("iso9283", 0.4), pin.SE3.Identity(), 0.5, 3.0, CYCLE).positions
    np.testing.assert_allclose(np.ptp(iso, axis=0)[:2], 0.4, atol=1e-4)


def test_the_tool_stops_at_corners_and_nowhere_else():
    slow = tool_path(shape_of("triangle", 0.3), pin.SE3.Identity(), 0.4, 3.0, CYCLE).speed < 0.02
    starts = np.flatnonzero(np.diff(slow.astype(int)) == -1)
    assert len(starts) == 3
    circle = tool_path(shape_of("circle", 0.3), pin.SE3.Identity(), 0.4, 3.0, CYCLE)
    assert np.all(circle.speed[10:-10] > 0.1)


@pytest.mark.parametrize("degrees", [0.2, 2.0, 15.0, 90.0])
def test_no_corner_is_too_flat_to_stop_at(degrees):
    """Driven through, a corner asks for any acceleration; where pieces meet in a tangent it is that of the curve."""
    turn = np.radians(degrees)
    line, angle = Line((0.3, 0.0)), Line((0.3 + 0.3 * np.cos(turn), 0.3 * np.sin(turn)))
    arc = Arc((0.3, 0.5), turn)
    sharp, smooth = (tool_path(Shape((0.0, 0.0), (line, last)), pin.SE3.Identity(), 0.4, 3.0, CYCLE)
                     for last in (angle, arc))
    at_corner = [path.speed[np.argmin(np.linalg.norm(path.positions[:, :2] - (0.3, 0.0), axis=1))]
                 for path in (sharp, smooth)]
    assert at_corner[0] < 0.05
    if 0.5 * turn > 0.05:
        assert at_corner[1] > 0.3


@pytest.mark.parametrize(("length", "speed"), [(0.4, 0.5), (0.02, 0.5), (0.1, 0.02)])
def test_travel_gets_there_in_its_time(length, speed):
    time = duration(length, speed, 3.0)
    t = np.linspace(0, time, 40001)
    s, v = travel(length, speed, 3.0, t)
    assert s[0] == 0.0
    assert s[-1] == pytest.approx(length, abs=1e-9)
    np.testing.assert_allclose(np.gradient(s, t)[2:-2], v[2:-2], atol=2e-3 * speed)


def test_orientation_turns_by_the_angle():
    path = tool_path(shape_of("edge", 0.02), pin.SE3.Identity(), 0.02, 0.1, CYCLE, turn=((0.0, 0.0, 1.0), np.pi / 2))
    turned = path.poses[-1].rotation @ path.poses[0].rotation.T
    np.testing.assert_allclose(pin.log3(turned), [0, 0, np.pi / 2], atol=1e-4)


@pytest.mark.parametrize(("shape", "speed", "acceleration", "says"), [
    (Shape((0.0, 0.0), (Line((0.0, 0.0)),)), 0.1, 1.0, "no length"),
    (shape_of("circle", 0.3), 5.0, 3.0, "too short for this speed"),
    pytest.param(shape_of("circle", 0.06), 3e-10, 3.0, "would last", id="for years, before it is made")])
def test_a_path_that_cannot_be_is_refused(shape, speed, acceleration, says):
    with pytest.raises(InputError, match=says):
        tool_path(shape, pin.SE3.Identity(), speed, acceleration, CYCLE)


# Method `adapted` on known paths: friction and inertia, learned from the motors' following errors besides torques.

def torques_alone(setting: Setting) -> Feedforward:
    """What `adapted` would be without what it learns from following errors."""
    ideal = Inverse(setting.loop(), setting.horizon(30))
    start = AdaptedIdeal(ideal, FrictionAdaptation(ideal.loop, tool=setting.robot.tool_place))
    practice = setting.plays()
    known = practice.play(start, practice.motion(setting.path())).state
    return AdaptedIdeal(ideal, start.adaptation, known.factors)


@pytest.mark.parametrize(("name", "bound"), [
    ("iso9283_1", 0.85), pytest.param("vertical_circle", 0.95, marks=pytest.mark.slow),
    pytest.param("edge", 1.03, marks=pytest.mark.slow)])
@pytest.mark.slow
def test_following_errors_tell_more_than_torques_on_known_paths(name: str, bound: float) -> None:
    scene = load_scene(name)
    both, torques = (run(scene, method=method).errors.time_matched.E_car for method in (ADAPTED, torques_alone))
    assert both < bound * torques


@pytest.mark.slow
def test_what_another_motion_tells_is_kept_where_the_path_is_followed_better() -> None:
    """Joints 2, 3 and 5 creep round in the edge, where the practice tells friction wrong: 1.22 times the error."""
    learned, fixed = (run(load_scene("edge"), method=method).errors.aligned.E_car for method in (ADAPTED, IDEAL))
    assert learned < fixed


@pytest.mark.slow
def test_with_another_arms_model_it_learns_what_this_arm_weighs_and_how_its_torques_ripple() -> None:
    scene = chosen(load_scene("iso9283_1"), individual=2).changed(model=str(MODELS / "kr15.json"))
    learned, fixed = (run(scene, method=method).errors.aligned.E_car for method in (ADAPTED, IDEAL))
    assert learned < 0.6 * fixed


@pytest.mark.slow
def test_an_arm_without_friction_is_identified_too() -> None:
    """0.48 mm where the search for the controllers' gains ended beside them; encoders and ripple leave 0.02 mm."""
    arm = chosen(load_scene("iso9283_1"), individual=2)
    assert run(arm.changed(world={**arm.world, "friction": False}), method=IDEAL).errors.aligned.E_car < 5e-5


# What knowing the gears is worth on the arm side ([L] 3.3), stiffness from the clamped procedure.

@pytest.mark.slow
def test_arm_error_of_the_kr15_with_clamped_stiffness() -> None:
    """≤ 40 % of the same precorrection on motor angles alone, on the ISO 9283 path, measured at the arm."""
    robot = Robot.load("kr15")
    clamped = ClampedScene(name="kr15", kind="clamped", title="KR 15 clamped", robot="kr15", clamp={"hold": 0.8})
    rng = np.random.default_rng(5)
    recordings, _ = record(clamped, robot, ClampWorld.from_table(robot, {}), configurations(clamped, robot, rng), rng)
    by_joint = analyse_stiffness(recordings, robot, "wrench").by("wrench")
    stiffness = np.array([by_joint[joint].stiffness for joint in range(1, robot.n + 1)])
    place = set_up(load_scene("iso9283_1"), delay=False)
    loop = place.loop().changed(stiffness=stiffness)
    motors_only = place.play(Inverse(loop, 30, Options(elastic=False))).errors
    with_gears = place.play(Inverse(loop, 30)).errors
    assert with_gears.time_matched.E_car <= 0.4 * motors_only.time_matched.E_car
    assert with_gears.geometric.E_car <= 0.4 * motors_only.geometric.E_car


# ``ideal-robot precorrect``: a path in, a corrected path out, limits checked.

MODEL = shipped_model("kr15")


def write(folder: Path, q: np.ndarray, t: np.ndarray | None = None, prefix: str = "q_d") -> Path:
    t = T * np.arange(len(q)) if t is None else t
    path = folder / "path.csv"
    pd.DataFrame({"t": t, **{f"{prefix}_{i + 1}": q[:, i] for i in range(q.shape[1])}}).to_csv(path, index=False)
    return path


@pytest.mark.parametrize("method", ["ideal", "precorrected", "learned-model"])
def test_the_model_expects_the_corrected_path_to_be_followed(tmp_path, method):
    result = precorrected_path(write(tmp_path, motion(lead=2)), MODEL, method=method)
    after, before = result.expected
    assert np.sqrt(np.mean(after**2)) < 0.1 * np.sqrt(np.mean(before**2))
    back = Recording.read(result.recording.write(tmp_path / "out.csv"))
    commanded = np.column_stack([back.columns[f"q_c_{i + 1}"] for i in range(ROBOT.n)])
    np.testing.assert_allclose(commanded, result.q_c, atol=1e-12)
    np.testing.assert_allclose(np.diff(back.t), T, atol=1e-9)


def test_other_sampling_is_brought_to_the_cycle(tmp_path):
    q = motion(lead=2)
    t = T * np.arange(len(q))
    fine = np.arange(0, t[-1], 0.002)
    dense = interpolated(fine, t, q)
    result = precorrected_path(write(tmp_path, dense, fine, prefix="q"), MODEL)
    assert result.t[1] == pytest.approx(T)
    rest = round(0.6 / T)
    np.testing.assert_allclose(result.q_d[rest : rest + len(q) - 2], q[:-2], atol=1e-3)


def test_paths_outside_the_limits_are_refused_with_joint_and_time(tmp_path):
    fast = motion(lead=2)[::8]
    with pytest.raises(InputError, match=r"joint \d: (velocity|acceleration)"):
        precorrected_path(write(tmp_path, fast), MODEL)
    far = np.tile(ROBOT.q_max + 0.1, (20, 1))
    with pytest.raises(InputError, match="position"):
        precorrected_path(write(tmp_path, far), MODEL)
    with pytest.raises(LimitError, match="velocity"):
        check_limits(fast, ROBOT, T)


def test_bad_input_names_file_and_field(tmp_path):
    broken = motion().copy()
    broken[10, 2] = np.nan
    for q, t, method, says in ((motion()[:, :3], None, "ideal", "q_d_1 to q_d_6"),
                               (broken, None, "ideal", "not finite"),
                               (motion(), np.zeros(len(motion())), "ideal", "are both at t"),
                               (motion(), None, "magic", "expected one of")):
        with pytest.raises(InputError, match=says):
            precorrected_path(write(tmp_path, q, t), MODEL, method=method)
    path = write(tmp_path, motion(), prefix="q_c")
    pd.read_csv(path).drop(columns="q_c_3").to_csv(path, index=False)
    for file, says in ((path, r"q_c_3: column is missing"), (tmp_path / "missing.csv", "no such")):
        with pytest.raises(InputError, match=says):
            precorrected_path(file, MODEL)


def test_a_planned_motion_is_a_path_too(tmp_path):
    """What plan-identification writes has commands only; it was refused."""
    q = motion(lead=2)
    result = precorrected_path(write(tmp_path, q, prefix="q_c"), MODEL)
    rest = round(0.6 / T)
    np.testing.assert_allclose(result.q_d[rest : rest + len(q)], q, atol=1e-9)


def test_limits_that_nobody_knows_are_said_not_to_be_checked():
    q, model = motion(lead=2), Model.load(MODEL)
    result = precorrect(T * np.arange(len(q)), q, model, ROBOT)
    assert (result.warnings, result.units) == ((), ("mrad",) * 6)
    assert table(replace(result, units=("mm",) * 6))[0][1] == "largest correction mm"
    a_max = ROBOT.a_max.copy()
    a_max[1:3] = np.inf
    (warning,) = precorrect(T * np.arange(len(q)), q, model, replace(ROBOT, a_max=a_max)).to_dict()["warnings"]
    assert "acceleration of joint 2, 3 was not checked" in warning
    assert "a_max" in warning


def test_played_on_the_simulated_arm_the_corrected_path_is_the_better_one(tmp_path):
    result = precorrected_path(write(tmp_path, motion(lead=2)), MODEL)
    after, before = played(result, ROBOT, 1)
    assert np.all(np.sqrt(np.mean(after**2, axis=0)) < 0.1 * np.sqrt(np.mean(before**2, axis=0)))
    columns, rows = table(result, (after, before))
    assert len(columns) == len(rows[0]) == 6
