"""What is named is estimated beside a model that stays as it is: nothing else moves, and it has its true size."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from ideal_robot.diagnosis.channels.motor_torque import torque_regression
from ideal_robot.diagnosis.validation.held_fit import beside_held_model
from ideal_robot.diagnosis.validation.oracle import with_named_effects
from ideal_robot.effects import FittedEffect
from ideal_robot.robots.robot import Robot
from tests.ideal_robot.diagnosis.test_adoption import STICKS, recorded, with_coulomb

OFFSET = FittedEffect("current_offset", 3, "tau_3", (8.0,))


@pytest.fixture(scope="module")
def known_kr15():
    robot = Robot.load("kr15")
    known = with_coulomb(robot, [100.0] * robot.n)
    # What the model does not say well: without its being held, it would move with the effects.
    known = dataclasses.replace(known, covariance=np.diag(np.full(len(known.covariance), 1e2)))
    return robot, known, recorded(known.with_effects((STICKS, OFFSET)))


def test_oracle_finds_sizes_and_leaves_the_model_as_it_was(known_kr15):
    robot, known, recording = known_kr15
    told = with_named_effects(recording, robot, known, (("stribeck", 2), ("current_offset", 3)))
    np.testing.assert_array_equal(told.base_values, known.base_values)
    assert [law.coefficients.tolist() for law in told.friction.laws] == [
        law.coefficients.tolist() for law in known.friction.laws]
    assert [effect.name for effect in told.effects] == ["stribeck", "current_offset"]
    assert told.effects[1].coefficients[0] == pytest.approx(8.0, rel=0.1)
    before, after = (model.predict(recording).relative_error_percent for model in (known, told))
    assert np.all(after[1:3] < 0.6 * before[1:3])


def test_an_effect_of_a_joint_fit_has_its_own_size_beside_the_model(known_kr15):
    """A joint fit had given half of it to friction."""
    robot, known, recording = known_kr15
    half = dataclasses.replace(STICKS, coefficients=(30.0,))
    regression = torque_regression(recording, robot, known, payload=True)
    own = beside_held_model(regression, known, (half, dataclasses.replace(OFFSET, coefficients=(1.0,))))
    assert own[0].coefficients[0] == pytest.approx(60.0, rel=0.1)
    assert own[1].coefficients[0] == pytest.approx(8.0, rel=0.1)


def test_errors_of_several_joints_kinematics_are_estimated_together(known_kr15):
    """Each alone takes all that the others make as well: together they would count it several times."""
    robot, known, recording = known_kr15
    q = recording.joints("q")
    pose = robot.fk()
    x = np.array([pose(row).translation for row in q])
    columns = {**recording.columns, **dict(zip("xyz", (x + 2e-4 * np.sin(3.0 * q[:, 1:2])).T.copy(), strict=True))}
    seen = dataclasses.replace(recording, columns=columns)
    every = tuple(("kinematic_error", joint) for joint in range(1, 7))
    told = with_named_effects(seen, robot, known, every)
    alone = [with_named_effects(seen, robot, known, (one,)).effects[0] for one in every]
    size = [np.linalg.norm([effect.coefficients for effect in effects], axis=1) for effects in (told.effects, alone)]
    assert not np.allclose(size[0], size[1], rtol=0.1)
