"""Model files of others: what does not fit together is refused with its key."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ideal_robot.errors import InputError
from ideal_robot.execution.precorrect import DRAWS, precorrect
from ideal_robot.feedforward.inverse import Inverse
from ideal_robot.feedforward.registry import feedforward
from ideal_robot.identification.friction_runs import fit_ripple
from ideal_robot.loop.from_model import cascade_gains, loop_model
from ideal_robot.model.cascade import CLASS, POSITION_GAIN, SPREAD, Cascade, given_controller
from ideal_robot.model.described_arm import Gears
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from tests.sources import MODELS

SHIPPED = MODELS / "kr6.json"


def _set(values: Any, path: str, new: Any) -> None:
    *parts, last = (int(part) if part.isdigit() else part for part in path.split("/"))
    for part in parts:
        values = values[part]
    values[last] = new


@pytest.mark.parametrize(("path", "new"), [
    ("controller/delay", None), ("controller/delay", "soon"), ("controller/k_p", [1.0]), ("controller/k_p", 3.0),
    ("controller/filter_order", 2.5), ("controller/t_cycle", 0.0), ("controller/k_i/0", None), ("controller", [1]),
    ("base/values/0", None), ("base/values", [1.0]), ("base/grouping", [[1.0]]), ("base/grouping/0/0", None),
    ("base/independent/0", 9999), ("base/independent/0", "a"), ("base/full_names", ["a"]), ("base/gravitational", [1]),
    ("friction", []), ("friction/0/coefficients/0", [None]), ("friction/0/law", "magic"), ("friction/0/law", [1]),
    ("friction/0/shape", "x"), ("covariance", [[0.0]]), ("covariance", None), ("noise_std", [1.0] * 7),
    ("covariance/14/14", -1.0), ("covariance/0/1", 1e9), ("covariance/0/0", 0.0),
    ("consistent", "text"), ("stiffness", [0.0] * 6), ("stiffness", [1.0]), ("robot/urdf", "<robot/>"),
    ("robot/urdf", None), ("robot/name", "[/red]\x1b"), ("effects", [{}]), ("effects", 3), ("effects", [3]),
    ("effects", [{"name": "unknown", "joint": 1, "coefficients": [1.0], "data": {}}]),
    ("effects", [{"name": "torque_ripple", "joint": 1, "channel": "tau_1", "coefficients": [1.0], "theta": [250.0]}]),
    ("effects", [{"name": "gear_elasticity", "joint": 99, "coefficients": [1.0], "channel": "qa_99"}]),
    ("provenance", 3), ("schema", "1"), ("schema", 99), ("schema", True),
])
def test_a_model_that_does_not_fit_together_is_refused(path: str, new: Any, tmp_path: Path) -> None:
    values = json.loads(SHIPPED.read_text())
    _set(values, path, new)
    file = tmp_path / "model.json"
    file.write_text(json.dumps(values))
    with pytest.raises(InputError) as refused:
        Model.load(file)
    assert "\n" not in str(refused.value)
    assert len(str(refused.value)) < 1000


@pytest.mark.parametrize("text", ["", "[" * 100_000, '{"a":' * 100_000, "nan", "3", "[]", "{}", '{"schema": 1}', "\0",
                                  '{"schema": 1e999}', '{"schema": NaN}', '{"schema": ' + "9" * 5000 + "}"])
def test_what_is_no_model_is_refused(text: str, tmp_path: Path) -> None:
    file = tmp_path / "model.json"
    file.write_text(text)
    with pytest.raises(InputError) as refused:
        Model.load(file)
    assert refused.value.file == file


# A model of another arm is refused wherever a model meets a robot.

KR15, MODEL, ROBOT = Model.load(MODELS / "kr15.json"), Model.load(SHIPPED), Robot.load("kr6")
RECORDING = Recording.from_arrays(np.arange(200) * 0.012, q=np.zeros((200, 6)), x=np.zeros(200))


@pytest.mark.parametrize("meet", [
    Inverse.of, loop_model, lambda model, robot: feedforward("ideal", model, robot),
    lambda model, robot: fit_ripple([RECORDING], model, robot),
], ids=["inverse", "loop", "registry", "ripple"])
def test_a_model_of_another_arm_is_refused(meet: Callable[[Model, Robot], object]) -> None:
    with pytest.raises(InputError, match="sits elsewhere than that of") as caught:
        meet(KR15, ROBOT)
    assert caught.value.field == "model"


def test_another_arm_whose_axes_differ_is_not_said_to_have_joints_that_follow() -> None:
    manutec = Model.load(MODELS / "manutec_r15.json")
    with pytest.raises(InputError, match="joint 1 of the model of manutec_r15 sits elsewhere"):
        manutec.require_arm(Robot.load("kr15"))


def test_the_file_is_named() -> None:
    with pytest.raises(InputError, match=r"kr15\.json: model: "):
        KR15.require_arm(ROBOT, file="kr15.json")


def test_a_calibrated_arm_is_still_the_same() -> None:
    calibrated = ROBOT.pinocchio.copy()
    calibrated.jointPlacements[2].translation += 0.003
    MODEL.require_arm(dataclasses.replace(ROBOT, pinocchio=calibrated))


# Controllers of a file or of a class, and how far a corrected path misses within their spread.

def test_gains_of_a_file_are_taken_and_the_class_fills_in_the_rest(tmp_path: Path) -> None:
    file = tmp_path / "gains.toml"
    file.write_text("position_gain = 30\nvelocity_gain = [3000, 2800, 1100, 80, 78, 20]\nintegral_time = 0\n"
                    "[spread]\nposition_gain = 0.1\n", encoding="utf-8")
    controller = given_controller(file, MODEL.dynamics, ROBOT)
    k_v, k_ff, k_p, k_i = cascade_gains(controller)
    np.testing.assert_allclose(k_v, 30.0)
    np.testing.assert_allclose(k_p, [3000, 2800, 1100, 80, 78, 20])
    np.testing.assert_array_equal(k_i, 0.0)
    np.testing.assert_allclose(k_ff, 0.9)
    assert controller.spread["position_gain"] == 6 * [0.1]
    assert "velocity_gain" not in controller.spread
    assert controller.spread["velocity_feedforward"] == 6 * [SPREAD["velocity_feedforward"]]


def test_a_cascade_survives_the_form_of_the_model_file() -> None:
    model = dataclasses.replace(MODEL, controller=given_controller(CLASS, MODEL.dynamics, ROBOT))
    again = type(model.controller).from_dict(model.controller.to_dict())
    assert again.spread == model.controller.spread
    cascade = Cascade.of(again)
    np.testing.assert_allclose(cascade.position_gain, POSITION_GAIN)
    np.testing.assert_allclose(cascade.integral_time * cascade.velocity_gain,
                               Cascade.of(model.controller).integral_time * cascade.velocity_gain)


@pytest.mark.parametrize(("text", "match"), [
    ("gain = 3", "unknown key"), ("position_gain = [1, 2]", "one number or 6"), ("position_gain = -1", "none below 0"),
    ("velocity_gain = 0", "must be positive"), ("spread = 1", "standard deviations"),
    ("[spread]\ncolour = 1", r"spread\.colour")])
def test_wrong_gains_are_refused(text: str, match: str, tmp_path: Path) -> None:
    file = tmp_path / "gains.toml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=match):
        given_controller(file, MODEL.dynamics, ROBOT)


def test_precorrection_says_how_far_its_error_reaches() -> None:
    t = ROBOT.t_ipo * np.arange(120)
    q_d = ROBOT.home + 0.2 * (1.0 - np.cos(np.pi * t[:, None] / t[-1])) * np.ones(6)
    known = precorrect(t, q_d, MODEL, ROBOT)
    assert known.reach is None
    assert known.beyond_uncorrected == ()
    cascade = given_controller(CLASS, MODEL.dynamics, ROBOT)
    path = precorrect(t, q_d, dataclasses.replace(MODEL, controller=cascade), ROBOT)
    assert path.reach is not None
    assert path.reach.shape == (DRAWS, 6)
    # One controller of the spread is another one's model: the error is larger than with the very one.
    assert np.all(path.reach.max(axis=0) > 3.0 * path.expected_rms[0])
    errors = path.to_dict()["expected_rms_error_mrad"]
    np.testing.assert_allclose(errors["corrected_to"], 1e3 * path.reach.max(axis=0))
    none = {name: 6 * [0.0] for name in cascade.spread}
    exact = precorrect(t, q_d, dataclasses.replace(MODEL, controller=dataclasses.replace(cascade, spread=none)), ROBOT)
    np.testing.assert_allclose(exact.reach, np.tile(exact.expected_rms[0], (DRAWS, 1)), rtol=1e-6)


def test_a_rigid_gear_is_rigid_and_an_unknown_one_unknown_after_a_round_trip(tmp_path: Path) -> None:
    k = np.array([np.inf, 3.5e5, np.nan, 3e4, 3e4, 1.3e4])
    again = Model.load(dataclasses.replace(MODEL, gears=Gears(k)).save(tmp_path / "model.json"))
    np.testing.assert_array_equal(again.gears.stiffness, k)
    # A gear that nobody knows counts as rigid.
    np.testing.assert_array_equal(np.isinf(loop_model(again, ROBOT).drives.stiffness[:4]), [True, False, True, False])
