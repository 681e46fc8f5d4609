"""Known truths behind the gear and at the force sensor are found with their numbers; nothing is where there is none."""

from __future__ import annotations

import dataclasses
from functools import cache
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from ideal_robot.diagnosis import Diagnosis, diagnose
from ideal_robot.diagnosis.channels.line import line_regression
from ideal_robot.diagnosis.channels.motor_torque import torque_regression
from ideal_robot.diagnosis.validation.refit import named_sensor_effects
from ideal_robot.dynamics import torques
from ideal_robot.effects import SENSOR, TCP_POSITION, FittedEffect, library
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from studies.sensors.force import draw_force_trial
from studies.sensors.scene import AXIS, SIZES, draw_line_trial, gantry
from studies.strangers.arm import written
from tests.arms import written as urdf_file

NOISE = 2e-5


ROBOT = Robot.load("kr15")


@cache
def motion() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, positions, loads."""
    t = np.arange(0.0, 16.0, 0.01)
    w = 2 * np.pi * np.array([0.25, 0.3, 0.35, 0.4, 0.45, 0.5])
    phase = np.arange(6) * 1.1
    q = ROBOT.home + 0.4 * np.sin(np.outer(t, w) + phase) + 0.1 * np.sin(np.outer(t, 2.7 * w))
    qd = np.gradient(q, t, axis=0)
    return t, q, torques(ROBOT.pinocchio, q, qd, np.gradient(qd, t, axis=0))


def recorded(xyz_at: np.ndarray | None, **more: np.ndarray) -> Recording:
    rng = np.random.default_rng(5)
    t, q, load = motion()
    tau = load + np.sign(np.gradient(q, axis=0)) * 5.0
    columns = {"q": q, "tau": tau + rng.normal(size=tau.shape) * 0.01 * np.std(tau, axis=0)}
    xyz = {} if xyz_at is None else dict(zip("xyz", (xyz_at + NOISE * rng.normal(size=xyz_at.shape)).T, strict=True))
    return Recording.from_arrays(t, **columns, **xyz, **more)


def tcp(model: pin.Model, q: np.ndarray) -> np.ndarray:
    return dataclasses.replace(ROBOT, pinocchio=model).tool_places(q)


def within(found: Diagnosis, name: str, joint: int, **truth: float) -> None:
    effect = next(e.fitted for e in found.effects if (e.fitted.name, e.fitted.joint) == (name, joint))
    for parameter in effect.parameters:
        if parameter.name in truth:
            assert abs(parameter.value - truth.pop(parameter.name)) < 3.0 * parameter.std, parameter
    assert not truth


def test_a_soft_gear_at_the_tool():
    _, q, load = motion()
    soft = q.copy()
    soft[:, 2] -= load[:, 2] / 4e5
    diagnosis = diagnose(recorded(tcp(ROBOT.pinocchio, soft)), ROBOT, only=(("joint_elasticity", 3), ("backlash", 3)))
    within(diagnosis, "joint_elasticity", 3, stiffness=4e5)
    assert next(p.unit for e in diagnosis.effects for p in e.fitted.parameters if p.name == "stiffness") == "N m/rad"


def test_an_uneven_gear_at_the_tool_with_its_order():
    _, q, _ = motion()
    uneven = q.copy()
    uneven[:, 1] += 8e-5 * np.sin(40.0 * q[:, 1] + 0.3)
    diagnosis = diagnose(recorded(tcp(ROBOT.pinocchio, uneven)), ROBOT, only=(("transmission_error", 2),))
    within(diagnosis, "transmission_error", 2, amplitude=8e-5, order=40.0)


def test_a_wrong_length_and_what_is_the_same():
    model = ROBOT.pinocchio.copy()
    model.jointPlacements[4].translation += np.array([0.0, 4e-4, 0.0])
    _, q, _ = motion()
    diagnosis = diagnose(recorded(tcp(model, q)), ROBOT,
                         only=tuple(("kinematic_error", j) for j in range(1, 7)))
    assert {e.fitted.name for e in diagnosis.effects} == {"kinematic_error"}
    first = diagnosis.effects[0]
    # Axes 2 and 3 are parallel: a shift along them is the same at either.
    joints = {first.fitted.joint, *(int(r.split()[-1]) for r in first.indistinguishable_from if " of joint " in r)}
    assert {2, 3} <= joints
    assert first.rms_after < 0.5 * first.rms_before


@pytest.mark.slow
def test_a_late_device_and_a_good_one():
    t, q, _ = motion()
    late = np.column_stack([np.interp(t - 3e-4, t, x) for x in tcp(ROBOT.pinocchio, q).T])
    within(diagnose(recorded(late), ROBOT, only=(("dead_time", 0),)), "dead_time", 0, delay=3e-4)
    every = tuple((e.name, joint) for e in library() if e.domain == TCP_POSITION for joint in range(7))
    good = diagnose(recorded(tcp(ROBOT.pinocchio, q)), ROBOT, only=every)
    assert not [e for e in good.effects if e.fitted.channel.startswith("tcp")]
    floors = [c.noise_floor for c in good.channels if c.channel in "xyz"]
    # White noise of the device fills the whole band of a recording that is not decimated.
    np.testing.assert_allclose(floors, NOISE, rtol=0.2)


@pytest.mark.slow
def test_the_tool_is_not_early_beside_arm_angles_that_are_late():
    t, q, _ = motion()
    late = {f"qa_{j + 1}": np.interp(t - 4e-4, t, x) for j, x in enumerate(q.T)}
    diagnosis = diagnose(recorded(tcp(ROBOT.pinocchio, q), **late), ROBOT, only=(("dead_time", 0),))
    assert [e.fitted.channel for e in diagnosis.effects] == ["qa_all"]
    within(diagnosis, "dead_time", 0, delay=4e-4)


def trial(seed: int, kind: str, folder: Path, begun: float = 0.0) -> tuple[Diagnosis, np.ndarray]:
    """What is found, and its true size; the sensor is read from a share of the recording on."""
    drawn = draw_force_trial(seed, kind)
    columns = dict(drawn.recording.columns)
    later = np.arange(len(columns["t"])) >= begun * len(columns["t"])
    columns |= {name: np.where(later, columns[name], np.nan) for name in ("fx", "fy", "fz", "mx", "my", "mz")
                if name in columns}
    return diagnose(dataclasses.replace(drawn.recording, columns=columns), written(drawn.urdf, folder / "arm.urdf"),
                    only=(("force_bias", 0), ("force_compliance", 0))), drawn.size


@pytest.mark.parametrize(("seed", "name", "begun"), [
    (3, "force_bias", 0.0), (4, "force_compliance", 0.0),
    pytest.param(3, "force_bias", 0.3, marks=pytest.mark.slow,
                 id="on devices the arm comes to its start without the sensor")])
def test_force_effects_have_their_size(seed, name, begun, tmp_path):
    diagnosis, truth = trial(seed, "inside", tmp_path, begun)
    assert [e.fitted.name for e in diagnosis.effects] == [name]
    effect = diagnosis.effects[0].fitted
    for value, std, true in zip(effect.coefficients, effect.std, truth, strict=False):
        assert abs(value - true) < 3.0 * std


@pytest.mark.slow
@pytest.mark.parametrize("seed", [4, 5])
def test_a_good_force_sensor_is_left_alone(seed, tmp_path):
    diagnosis, _ = trial(seed, "none", tmp_path)
    assert not diagnosis.effects
    assert any(c.channel in ("fx", "contact") for c in diagnosis.channels)


def test_a_wrench_without_columns_or_numbers_is_not_looked_at():
    t, _, _ = motion()
    gaps = np.full(len(t), np.nan)
    for columns in ({"fx": gaps, "fy": gaps, "fz": gaps}, {"fx": gaps * 0 + 1.0}):
        diagnosis = diagnose(recorded(None, **columns), ROBOT, only=(("force_bias", 0),))
        assert not [c for c in diagnosis.channels if c.channel.startswith("f")]


@pytest.mark.slow
def test_a_late_device_that_measures_two_axes_only():
    t, q, _ = motion()
    whole = recorded(np.column_stack([np.interp(t - 3e-4, t, x) for x in tcp(ROBOT.pinocchio, q).T]))
    flat = Recording({name: values for name, values in whole.columns.items() if name != "z"})
    diagnosis = diagnose(flat, ROBOT, only=(("dead_time", 0), ("kinematic_error", 1)))
    within(diagnosis, "dead_time", 0, delay=3e-4)
    assert [c.channel for c in diagnosis.channels if c.channel in "xyz"] == ["x", "y"]
    # A tool elsewhere than thought is the arm's geometry, of which two axes say nothing.
    shifted = Recording({**flat.columns, "x": flat.columns["x"] + 0.02 * np.sin(flat.columns["q_5"])})
    diagnosis = diagnose(shifted, ROBOT, only=())
    assert diagnosis.channels[-2].loud
    assert (diagnosis.verdict, diagnosis.unexplained) == ("none", ())


# Effects of a camera that sees a line: found with their numbers, nothing found where there is none.

@pytest.fixture(scope="module")
def gantry_robot(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return Robot.load(urdf_file(tmp_path_factory.mktemp("gantry"), gantry()))


@pytest.mark.parametrize("name", SIZES)
def test_told_its_name_the_number_is_right(gantry_robot: Robot, name: str) -> None:
    # Small, so that the columns, which are derivatives, hold for all of it.
    kind, size, recording = draw_line_trial(31, name, share=0.2)
    (fitted,) = named_sensor_effects(recording, gantry_robot, Model.nominal(gantry_robot), (kind,))
    expected = 0.5 * size if name == "camera_offset" else size
    assert abs(fitted.coefficients[0] - expected) < 3.0 * fitted.std[0]
    assert fitted.domain == SENSOR


@pytest.mark.parametrize(("name", "expected"), [("camera_latency", ["camera_latency"]),
                                                pytest.param("none", [], marks=pytest.mark.slow)])
def test_latency_is_found_and_nothing_where_there_is_none(name: str, expected: list[str], gantry_robot: Robot) -> None:
    recording = draw_line_trial(32, name)[2]
    names = [e.fitted.name for e in diagnose(recording, gantry_robot).effects if e.fitted.channel == "line"]
    assert names == expected


@pytest.mark.slow
def test_a_sloping_surface_is_no_error_of_the_camera(gantry_robot: Robot) -> None:
    """Points come nearer along the line by 1 % a second, which no one told the camera: its stamps do not drift."""
    _, size, recording = draw_line_trial(36, "camera_latency")
    columns = dict(recording.columns)
    factor = 1.0 + 0.01 * (columns["cam_t"] - np.nanmean(columns["cam_t"]))
    for i in range(1, 6):
        for axis, middle in zip("xy", AXIS, strict=False):
            name = f"line_{axis}_{i}"
            columns[name] = middle + factor * (columns[name] - middle)
    effects = [e.fitted for e in diagnose(Recording(columns, recording.meta), gantry_robot).effects
               if e.fitted.channel == "line"]
    assert [e.name for e in effects] == ["camera_latency"]
    np.testing.assert_allclose(effects[0].coefficients[0], size, atol=3.0 * effects[0].std[0])


def test_a_run_in_which_no_joint_moves_enough_still_tells_of_the_camera(gantry_robot: Robot) -> None:
    """The first 1.8 s: too little for friction and bodies, and the model that was known stays as it is."""
    kind, size, recording = draw_line_trial(35, "camera_latency")
    short = recording.t < 1.8
    run = Recording({name: values[short] for name, values in recording.columns.items()}, recording.meta)
    diagnosis = diagnose(run, gantry_robot, model=Model.nominal(gantry_robot))
    assert (diagnosis.verdict, [e.fitted.name for e in diagnosis.effects]) == ("effects", [kind])
    np.testing.assert_allclose(diagnosis.effects[0].fitted.coefficients[0], size, rtol=0.1)
    assert sorted(diagnosis.undecided) == list(range(1, gantry_robot.n + 1))
    assert diagnosis.model is not None
    assert [e.name for e in diagnosis.model.effects] == [kind]
    assert all(c.rms_after <= 1.01 * c.rms_before for c in diagnosis.channels if c.channel.startswith("tau"))
    assert ("line",) in [names for names, _ in diagnosis.traces]
    assert "cam_t, line_x_i, line_y_i, line_z_i" not in diagnosis.unused


def test_columns_are_what_moved_points_do(gantry_robot: Robot) -> None:
    """Finite differences: the residual of the recording with its points (or stamps) moved by a little.

    The curve's knots move along with the outermost points, which changes a little how it follows the noise.
    """
    recording = draw_line_trial(33, "none")[2]

    def made(points: float = 0.0, cubic: float = 0.0, late: float = 0.0) -> Recording:
        columns = dict(recording.columns)
        columns["cam_t"] = columns["cam_t"] - late
        for i in range(1, 6):
            x, y = columns[f"line_x_{i}"] - AXIS[0], columns[f"line_y_{i}"] - AXIS[1]
            factor = 1.0 + points + cubic * (x**2 + y**2)
            columns[f"line_x_{i}"], columns[f"line_y_{i}"] = AXIS[0] + factor * x, AXIS[1] + factor * y
        return Recording(columns, recording.meta)

    def lines(changed: Recording) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        torque = torque_regression(changed, gantry_robot, Model.nominal(gantry_robot))
        regression = line_regression(changed, gantry_robot, torque, None)
        assert regression is not None
        return regression.y[:, 0], dict(regression.signals.extra)

    extra = lines(recording)[1]
    for name, key, step in (("line_scale", "points", 2e-3), ("line_cubic", "cubic", 0.5), ("line_speed", "late", 5e-4)):
        high, low = lines(made(**{key: step}))[0], lines(made(**{key: -step}))[0]
        slope, column = (high - low) / (2.0 * step), extra[name]
        assert np.linalg.norm(slope - column) < 0.1 * np.linalg.norm(column), name


def test_model_file_keeps_them_and_torques_do_not_change(gantry_robot: Robot, tmp_path: Path) -> None:
    model = Model.nominal(gantry_robot)
    own = tuple(FittedEffect(name, 0, "line", (0.5, 0.1) if name == "camera_offset" else (0.5,)) for name in SIZES)
    loaded = Model.load(dataclasses.replace(model, effects=own).save(tmp_path / "model.json"))
    assert [(e.name, e.coefficients) for e in loaded.effects] == [(e.name, e.coefficients) for e in own]
    assert all(e.domain == SENSOR for e in loaded.effects)
    assert [e.effect.name for e in loaded.effects] == list(SIZES)
    q = np.linspace(0.0, 0.5, 30).reshape(5, 6)
    np.testing.assert_allclose(loaded.inverse_dynamics(q, q, q), model.inverse_dynamics(q, q, q), rtol=1e-10)


def test_recording_without_a_line_has_no_line_channel(gantry_robot: Robot) -> None:
    recording = draw_line_trial(34, "none")[2]
    plain = Recording({k: v for k, v in recording.columns.items() if k != "cam_t" and not k.startswith("line_")})
    torque = torque_regression(plain, gantry_robot, Model.nominal(gantry_robot))
    assert line_regression(plain, gantry_robot, torque, None) is None
