"""Why a cause is in the best set: its score against everything in its place."""

from __future__ import annotations

import numpy as np
import pytest

from ideal_robot.diagnosis import diagnose
from ideal_robot.diagnosis.best_set import BestSet
from ideal_robot.diagnosis.channels.motor_torque import torque_regression
from ideal_robot.diagnosis.statistics.problem import Problem
from ideal_robot.diagnosis.validation.result import Argument, WeighedSet, probability
from ideal_robot.effects import MOTOR_TORQUE, library
from ideal_robot.model.model import Model
from scenes.diagnosis.page import diagnosis_page
from studies.strangers.arm import robot_of
from studies.strangers.score import score
from tests.ideal_robot.diagnosis.test_diagnose import arm, rippled, stranger


@pytest.mark.slow
def test_each_cause_is_weighed_against_all_others(tmp_path) -> None:
    trial = stranger(770017, "inside")
    with robot_of(trial.urdf) as robot:
        argued = diagnose(trial.recording, robot)
    assert score(trial, argued).right, (trial.causes, argued.effects)
    why = argued.to_dict()["explained"]
    assert sorted((row["effect"], row["joint"]) for row in why) == sorted(
        (e.fitted.name, e.fitted.joint) for e in (*argued.effects, *argued.unknown))
    for argument in argued.arguments:
        # What was named is worth something on blocks that had no part in fitting it.
        assert argument.nats > 3.0
        assert argument.nothing.rejected
        assert all(a.nats <= b.nats for a, b in zip(argument.sets, argument.sets[1:], strict=False))
    page = tmp_path / "page.html"
    diagnosis_page(argued, "why").write(page)
    assert "Why each was named" in page.read_text(encoding="utf-8")


def test_the_difference_of_two_sets_vanishes_for_the_same_and_changes_sign(tmp_path) -> None:
    robot = arm(tmp_path)
    problem = Problem(torque_regression(rippled(robot, 0.0, 1), robot, Model.nominal(robot)))
    best = BestSet(problem, [e for e in library() if e.domain == MOTOR_TORQUE], absorbed=False)
    choices = best.run()
    assert [c.effect.name for c in choices] == ["torque_ripple"]
    assert best.better(choices, choices) == pytest.approx(0.0)
    assert best.better(choices, []) == pytest.approx(-best.better([], choices), abs=1e-6)
    assert best.better(choices, []) > 10.0


@pytest.mark.parametrize(("nats", "words"), [(0.5, "do not reject"), (30.0, "30 ± 3 nats worse")])
def test_the_argument_says_what_is_rejected(nats: float, words: str) -> None:
    sets = (WeighedSet("viscous", 2, nats, 3.0), WeighedSet("", 0, 310.0, 40.0))
    argument = Argument("stribeck", 2, "tau_2", "joint 2", sets, "from 0.0 to 5.0 s", 0.4,
                        probability(sets, "stribeck"))
    assert words in argument.text
    assert "With nothing in its place the score is 310 ± 40 nats worse" in argument.text
    assert argument.not_distinguished == (("viscous",) if nats < 3.0 else ())


def test_a_probability_is_one_of_odds_averaged_over_their_standard_error() -> None:
    assert probability([WeighedSet("", 0, 0.0, 1.0)], "a") == pytest.approx(0.5)
    certain, doubtful = (probability([WeighedSet("", 0, 5.0, std)], "a") for std in (0.1, 10.0))
    assert 0.5 < doubtful < 0.8 < certain
    # A form of the same cause in its place speaks for it.
    assert probability([WeighedSet("a", 1, 0.0, 1.0), WeighedSet("", 0, 50.0, 1.0)], "a") == pytest.approx(1.0)
    assert np.isfinite(probability([WeighedSet("", 0, 1e6, 1.0)], "a"))
