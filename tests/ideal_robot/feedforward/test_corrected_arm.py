"""An arm whose geometry is not the drawn one: its tool where the path wants it, and where a follower believes it."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from ideal_robot.effects import FittedEffect
from ideal_robot.execution.precorrect import precorrect
from ideal_robot.feedforward.corrected_arm import CorrectedArm
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from scenes.models import shipped_model

EFFECTS = (FittedEffect("kinematic_error", 2, "tcp_2", (1e-3, 5e-4, 1e-3, -7e-4)),
           FittedEffect("kinematic_error", 6, "tcp_6", (2e-4, -3e-4, 2e-3, 0.0)),
           FittedEffect("zero_error", 3, "tau_3", (4e-3,)))


@pytest.mark.parametrize("name", ["kr15", "kr6", "manutec_r15"])
def test_tool_is_where_the_drawn_arm_would_have_it(name):
    robot = Robot.load(name)
    arm, drawn = CorrectedArm(robot, EFFECTS), robot.fk()
    q = robot.home + 0.2 * np.random.default_rng(3).normal(size=(6, robot.n))
    for wanted, moved in zip(q, arm.joints(q), strict=True):
        here, there = arm.tool(moved), drawn(wanted)
        assert np.linalg.norm(here.translation - there.translation) < 1e-8
        assert np.linalg.norm(pin.log3(here.rotation.T @ there.rotation)) < 1e-7
        assert np.linalg.norm(arm.tool(wanted).translation - there.translation) > 1e-3
        # What a follower that knows the drawn arm makes of the arm's angles is where the tool is.
        assert np.linalg.norm(drawn(arm.as_drawn(moved)).translation - there.translation) < 1e-7


def test_no_geometry_changes_nothing():
    robot = Robot.load("kr15")
    arm = CorrectedArm(robot, (FittedEffect("viscous", 2, "tau_2", (3.0,)),))
    q = np.tile(robot.home, (3, 1))
    assert not arm.differs
    assert arm.joints(q) is q
    np.testing.assert_array_equal(arm.as_drawn(q[0]), q[0])


def test_expected_error_of_a_corrected_path_is_that_of_the_tool():
    """The corrected joint path differs from the drawn one by milliradians; the error that is expected does not."""
    robot, model = Robot.load("kr15"), Model.load(shipped_model("kr15"))
    t = np.arange(0.0, 1.5, 0.012)
    q = robot.home + 0.05 * np.sin(np.pi * t / 1.5)[:, None] ** 2 * np.ones(robot.n)
    plain, moved = (precorrect(t, q, known, robot) for known in (model, model.with_effects(EFFECTS[:2])))
    assert np.max(np.abs(moved.q_c - plain.q_c)) > 5e-4
    assert np.all(moved.expected_rms[0] < plain.expected_rms[0] + 2e-4)
