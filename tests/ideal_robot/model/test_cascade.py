"""Controllers of a file or of a class, and how far a corrected path misses within their spread."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from ideal_robot.errors import InputError
from ideal_robot.execution.precorrect import DRAWS, precorrect
from ideal_robot.loop.from_model import cascade_gains
from ideal_robot.model.cascade import CLASS, POSITION_GAIN, SPREAD, Cascade, given_controller
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from tests.sources import MODELS

ROBOT = Robot.load("kr6")
MODEL = Model.load(MODELS / "kr6.json")


def test_gains_of_a_file_are_taken_and_the_class_fills_in_the_rest(tmp_path: Path) -> None:
    file = tmp_path / "gains.toml"
    file.write_text("position_gain = 30\nvelocity_gain = [3000, 2800, 1100, 80, 78, 20]\nintegral_time = 0\n"
                    "[spread]\nposition_gain = 0.1\n", encoding="utf-8")
    controller = given_controller(file, MODEL, ROBOT)
    k_v, k_ff, k_p, k_i = cascade_gains(controller)
    np.testing.assert_allclose(k_v, 30.0)
    np.testing.assert_allclose(k_p, [3000, 2800, 1100, 80, 78, 20])
    np.testing.assert_array_equal(k_i, 0.0)
    np.testing.assert_allclose(k_ff, 0.9)
    assert controller.spread["position_gain"] == 6 * [0.1]
    assert "velocity_gain" not in controller.spread
    assert controller.spread["velocity_feedforward"] == 6 * [SPREAD["velocity_feedforward"]]


def test_a_cascade_survives_the_form_of_the_model_file() -> None:
    model = dataclasses.replace(MODEL, controller=given_controller(CLASS, MODEL, ROBOT))
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
        given_controller(file, MODEL, ROBOT)


def test_precorrection_says_how_far_its_error_reaches() -> None:
    t = ROBOT.t_ipo * np.arange(120)
    q_d = ROBOT.home + 0.2 * (1.0 - np.cos(np.pi * t[:, None] / t[-1])) * np.ones(6)
    known = precorrect(t, q_d, MODEL, ROBOT)
    assert known.reach is None
    assert known.beyond_uncorrected == ()
    given = given_controller(CLASS, MODEL, ROBOT)
    path = precorrect(t, q_d, dataclasses.replace(MODEL, controller=given), ROBOT)
    assert path.reach is not None
    assert path.reach.shape == (DRAWS, 6)
    # One controller of the spread is another one's model: the error is larger than with the very one.
    assert np.all(path.reach.max(axis=0) > 3.0 * path.expected_rms[0])
    told = path.to_dict()["expected_rms_error_mrad"]
    np.testing.assert_allclose(told["corrected_to"], 1e3 * path.reach.max(axis=0))
    none = {name: 6 * [0.0] for name in given.spread}
    exact = precorrect(t, q_d, dataclasses.replace(MODEL, controller=dataclasses.replace(given, spread=none)), ROBOT)
    np.testing.assert_allclose(exact.reach, np.tile(exact.expected_rms[0], (DRAWS, 1)), rtol=1e-6)
