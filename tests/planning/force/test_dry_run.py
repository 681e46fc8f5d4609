"""The motion above a path before the job: it keeps away, rests at both ends, and keeps the joints' speeds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.robots.robot import Robot
from planning.force.dry_run import CLEAR, LONGEST, SHARE, dry_run
from planning.path.kinematics import InverseKinematics
from planning.path.reference import ReferencePath

ROBOT = Robot.load("kr6")
REFERENCE = ReferencePath(np.column_stack([np.full(60, 0.95), np.linspace(-0.3, 0.3, 60), np.full(60, 0.4)]),
                          turning=1.0)


def planned(speed: float, robot: Robot = ROBOT) -> Array:
    return dry_run(robot, REFERENCE, speed, InverseKinematics(robot).search(REFERENCE.pose(0.0), robot.home))


def places(q: Array) -> Array:
    fk = ROBOT.fk()
    return np.array([fk(one).translation.copy() for one in q])


def test_it_goes_along_the_path_and_back_without_coming_near_the_surface() -> None:
    q = planned(0.2)
    where = places(q)
    assert where[:, 2].min() > 0.4 + CLEAR - 1e-6
    np.testing.assert_allclose(where[0], where[-1], atol=1e-6)
    assert np.ptp(where[:, 1]) > 0.55
    # Slow at both ends, at the speed of the job in between.
    along = np.abs(np.diff(where[:, 1])) / ROBOT.t_ipo
    assert along[0] < 0.01
    assert along[-1] < 0.01
    np.testing.assert_allclose(along.max(), 0.2, rtol=0.02)


def test_joints_that_carry_the_height_turn_round_again_and_again() -> None:
    v = np.diff(planned(0.2), axis=0)
    assert np.all(np.sum(np.diff(np.sign(v[:, [1, 2, 4]]), axis=0) != 0, axis=0) >= 3)


def test_a_long_path_takes_no_longer_and_slow_joints_take_their_time() -> None:
    assert len(planned(0.02)) * ROBOT.t_ipo <= LONGEST + ROBOT.t_ipo
    slow = replace(ROBOT, v_max=ROBOT.v_max / 20.0)
    v = np.abs(np.diff(planned(0.2, slow), axis=0)) / ROBOT.t_ipo
    assert np.all(v <= SHARE * slow.v_max * (1.0 + 1e-9))
