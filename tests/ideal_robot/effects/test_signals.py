"""Laws of the derivatives of a rigid body's torques by the motion of one joint."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.effects import signals
from ideal_robot.effects.signals import RigidDerivatives
from ideal_robot.robots.robot import Robot

ROBOT = Robot.load("kr6")
RNG = np.random.default_rng(5)
Q, QD, QDD = (RNG.uniform(-1.0, 1.0, (7, ROBOT.n)) for _ in range(3))


def _rigid(q: Array, qd: Array, qdd: Array) -> Array:
    data = ROBOT.pinocchio.createData()
    return np.array([pin.rnea(ROBOT.pinocchio, data, *row) for row in zip(q, qd, qdd, strict=True)])


def test_they_are_those_that_pinocchio_has_in_closed_form() -> None:
    data = ROBOT.pinocchio.createData()
    known = [tuple(np.array(one) for one in pin.computeRNEADerivatives(ROBOT.pinocchio, data, *row))
             for row in zip(Q, QD, QDD, strict=True)]
    ours = RigidDerivatives(_rigid, Q, QD, QDD)
    for joint in range(1, ROBOT.n + 1):
        for k, found in enumerate(ours.by(joint)):
            expected = np.array([row[k][:, joint - 1] for row in known])
            if k == 2:  # of the mass matrix it gives the upper triangle
                M = np.array([np.triu(row[2]) + np.triu(row[2], 1).T for row in known])
                expected = M[:, :, joint - 1]
            np.testing.assert_allclose(found, expected, atol=1e-5 * np.max(np.abs(expected)))


def test_a_small_motion_changes_torques_by_them() -> None:
    step = 1e-5
    motion = [step * RNG.uniform(-1.0, 1.0, len(Q)) for _ in range(3)]
    moved = [given.copy() for given in (Q, QD, QDD)]
    for values, change in zip(moved, motion, strict=True):
        values[:, 1] += change
    change = RigidDerivatives(_rigid, Q, QD, QDD).along(2, *motion)
    np.testing.assert_allclose(change, _rigid(*moved) - _rigid(Q, QD, QDD), atol=1e-3 * np.max(np.abs(change)))


def test_what_memory_does_not_hold_is_computed_anew(monkeypatch) -> None:
    calls: list[int] = []

    def counted(q: Array, qd: Array, qdd: Array) -> Array:
        calls.append(1)
        return _rigid(q, qd, qdd)

    kept, dropped = RigidDerivatives(counted, Q, QD, QDD), RigidDerivatives(counted, Q, QD, QDD)
    first = [kept.by(joint) for joint in (1, 2)]
    count = len(calls)
    again = [kept.by(joint) for joint in (1, 2, 2)]
    assert len(calls) == count
    np.testing.assert_array_equal(again[:2], first)
    monkeypatch.setattr(signals, "_KEPT", 1.0)
    other = [dropped.by(joint) for joint in (1, 2, 2, 1)]
    assert len(calls) == count + 3 * count // 2
    np.testing.assert_array_equal(other, [first[0], first[1], first[1], first[0]])
