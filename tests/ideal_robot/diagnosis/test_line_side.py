"""Effects of a camera that sees a line: found with their numbers, nothing found where there is none."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from ideal_robot.diagnosis import diagnose
from ideal_robot.diagnosis.channels.line import line_regression
from ideal_robot.diagnosis.channels.motor_torque import torque_regression
from ideal_robot.diagnosis.validation.oracle import named_camera_effect
from ideal_robot.effects import SENSOR, FittedEffect, effect_of
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from trials.line import AXIS, SIZES, draw_line_trial, gantry


@pytest.fixture(scope="module")
def gantry_robot(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    file: Path = tmp_path_factory.mktemp("gantry") / "gantry.urdf"
    file.write_text(gantry(), encoding="utf-8")
    return Robot.load(file)


@pytest.mark.parametrize("name", SIZES)
def test_told_its_name_the_number_is_right(gantry_robot: Robot, name: str) -> None:
    # Small, so that the columns, which are derivatives, hold for all of it.
    kind, size, recording = draw_line_trial(31, name, share=0.2)
    fitted = named_camera_effect(recording, gantry_robot, Model.nominal(gantry_robot), kind)
    expected = 0.5 * size if name == "camera_offset" else size
    assert abs(fitted.coefficients[0] - expected) < 3.0 * fitted.std[0]
    assert fitted.domain == SENSOR


def test_latency_is_found_and_nothing_where_there_is_none(gantry_robot: Robot) -> None:
    for name, expected in (("camera_latency", ["camera_latency"]), ("none", [])):
        recording = draw_line_trial(32, name)[2]
        found = [e.fitted.name for e in diagnose(recording, gantry_robot).effects if e.fitted.channel == "line"]
        assert found == expected


def test_a_run_in_which_no_joint_moves_enough_still_tells_of_the_camera(gantry_robot: Robot) -> None:
    """The first 1.8 s: too little for friction and bodies, and the model that was known stays as it is."""
    kind, size, recording = draw_line_trial(35, "camera_latency")
    short = recording.t < 1.8
    run = Recording({name: values[short] for name, values in recording.columns.items()}, recording.meta)
    model = Model.nominal(gantry_robot)
    found = diagnose(run, gantry_robot, model=model)
    assert (found.verdict, [e.fitted.name for e in found.effects]) == ("effects", [kind])
    np.testing.assert_allclose(found.effects[0].fitted.coefficients[0], size, rtol=0.1)
    assert sorted(found.undecided) == list(range(1, gantry_robot.n + 1))
    assert found.model is not None
    assert [e.name for e in found.model.effects] == [kind]
    assert all(c.rms_after == c.rms_before for c in found.channels if c.channel.startswith("tau"))
    assert found.traces[0][0] == ("line",)
    assert "cam_t, line_x_i, line_y_i, line_z_i" not in found.unused


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
        seen = line_regression(changed, gantry_robot, torque, None)
        assert seen is not None
        return seen.y[:, 0], dict(seen.signals.extra)

    extra = lines(recording)[1]
    for name, key, step in (("line_scale", "points", 2e-3), ("line_cubic", "cubic", 0.5), ("line_speed", "late", 5e-4)):
        high, low = lines(made(**{key: step}))[0], lines(made(**{key: -step}))[0]
        slope, column = (high - low) / (2.0 * step), extra[name]
        assert np.linalg.norm(slope - column) < 0.1 * np.linalg.norm(column), name


def test_model_file_keeps_them_and_torques_do_not_change(gantry_robot: Robot, tmp_path: Path) -> None:
    model = Model.nominal(gantry_robot)
    own = tuple(FittedEffect(name, 0, "line", (0.5, 0.1) if name == "camera_offset" else (0.5,)) for name in SIZES)
    file = dataclasses.replace(model, effects=own).save(tmp_path / "model.json")
    loaded = Model.load(file)
    assert [(e.name, e.coefficients) for e in loaded.effects] == [(e.name, e.coefficients) for e in own]
    assert all(e.domain == SENSOR for e in loaded.effects)
    assert [effect_of(e).name for e in loaded.effects] == list(SIZES)
    q = np.linspace(0.0, 0.5, 30).reshape(5, 6)
    np.testing.assert_allclose(loaded.inverse_dynamics(q, q, q), model.inverse_dynamics(q, q, q), rtol=1e-10)


def test_recording_without_a_line_has_no_line_channel(gantry_robot: Robot) -> None:
    recording = draw_line_trial(34, "none")[2]
    plain = Recording({k: v for k, v in recording.columns.items() if k != "cam_t" and not k.startswith("line_")})
    torque = torque_regression(plain, gantry_robot, Model.nominal(gantry_robot))
    assert line_regression(plain, gantry_robot, torque, None) is None
