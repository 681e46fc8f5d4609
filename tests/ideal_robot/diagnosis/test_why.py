"""Why a cause was named: the score against everything in its place, and that asking for it changes nothing."""

from __future__ import annotations

import json

import numpy as np
import pytest

from ideal_robot.diagnosis import Diagnosis, Options, diagnose
from ideal_robot.diagnosis.channels.motor_torque import torque_regression
from ideal_robot.diagnosis.search.choice import PresentModel
from ideal_robot.diagnosis.search.scoring import Scoring
from ideal_robot.diagnosis.statistics.problem import Candidate, Problem
from ideal_robot.diagnosis.validation.result import Argument, Weighed
from ideal_robot.diagnosis.validation.weighing import _Weighing
from ideal_robot.effects.registry import find
from ideal_robot.model.model import Model
from scenes.diagnosis.page import diagnosis_page
from studies.sensors.scene import draw_line_trial, gantry
from studies.strangers.arm import robot_of
from tests.ideal_robot.diagnosis.test_diagnose import stranger


def of_a_stranger(*, explain: bool) -> Diagnosis:
    trial = stranger(770017, "inside")
    with robot_of(trial.urdf) as robot:
        return diagnose(trial.recording, robot, explain=explain)


def test_each_cause_is_weighed_against_all_others_and_nothing_else_changes(tmp_path) -> None:
    plain, argued = (of_a_stranger(explain=explain) for explain in (False, True))
    values = argued.to_dict()
    why = values.pop("explained")
    assert json.dumps(values) == json.dumps(plain.to_dict())
    assert [(row["effect"], row["joint"]) for row in why] == [(e.fitted.name, e.fitted.joint) for e in argued.effects]
    for argument in argued.arguments:
        nothing = next(weighed for weighed in argument.sets if not weighed.name)
        # What was named is worth something on blocks that had no part in fitting it.
        assert nothing.nats > 0.0
        assert nothing.told
        assert len(argument.rivals) > 5
        assert all(a.nats <= b.nats for a, b in zip(argument.sets, argument.sets[1:], strict=False))
    page = tmp_path / "page.html"
    diagnosis_page(argued, "why").write(page)
    assert "Why each was named" in page.read_text(encoding="utf-8")


def test_the_score_is_that_of_blocks_left_out_and_vanishes_for_the_same_set() -> None:
    trial = stranger(770017, "inside")
    with robot_of(trial.urdf) as robot:
        regression = torque_regression(trial.recording, robot, Model.nominal(robot))
    problem = Problem.of(regression, held_out=True)
    model = PresentModel(problem)
    cause = Candidate(find("cable_spring", "tau"), 1, p_value=0.0)
    model.replace([cause])
    fit, selecting = model.fit(), problem.blocks.selecting
    squares = np.add.reduceat(model.left_out(fit) ** 2, problem.blocks.edges[:-1])[selecting]
    np.testing.assert_allclose(squares, fit.held_out_squares[selecting], rtol=1e-6, atol=1e-9 * squares.max())
    argument = _Weighing(Scoring(model, Options()), cause).argument([cause])
    same = next(weighed for weighed in argument.sets if weighed.name)
    assert same.nats == pytest.approx(0.0, abs=1e-6)
    nothing = next(weighed for weighed in argument.sets if not weighed.name)
    without = model.fit(cause).held_out_squares[selecting]
    expected = float(((without - squares) @ model.weights).sum()) / (2.0 * fit.inflation)
    assert nothing.nats == pytest.approx(expected, rel=1e-6)


def test_a_camera_error_is_argued_for_though_many_points_have_one_time() -> None:
    kind, _, recording = draw_line_trial(9000)
    with robot_of(gantry()) as robot:
        diagnosis = diagnose(recording, robot, explain=True)
    assert kind == "lens_distortion"
    assert [argument.name for argument in diagnosis.arguments] == [kind]
    assert diagnosis.arguments[0].sets[0].nats > 0.0


@pytest.mark.parametrize(("nats", "words"), [(14.0, "Next best is joint_elasticity, 14 ± 3 nats worse"),
                                             (2.0, "Not told from joint_elasticity, 2 ± 3 nats worse"),
                                             (-9.0, "With joint_elasticity it is 9 ± 3 nats better")])
def test_the_argument_says_no_more_than_its_standard_error_allows(nats: float, words: str) -> None:
    argument = Argument("stribeck", 3, "tau_3", "joint 3", (Weighed("joint_elasticity", 3, nats, 3.0),
                                                            Weighed("", 0, 310.0, 40.0)), (2.0, 4.0),
                        "near reversals and rest", 0.6)
    assert words in argument.text
    assert ("between 2 and 4 Hz" in argument.text) is (abs(nats) > 6.0)
    assert "With nothing in its place 310 ± 40 nats worse" in argument.text
