"""Causes in the whole arm's dynamics: what they add is what the changed arm does; laws of the torques' derivatives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.channels.motor_torque import in_own_units, torque_regression
from ideal_robot.diagnosis.channels.regression import Regression
from ideal_robot.effects import FittedEffect, Signals, signals
from ideal_robot.effects.registry import find
from ideal_robot.effects.signals import RigidDerivatives
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording


def of_a_moved_arm() -> tuple[Robot, Regression]:
    robot = Robot.load("kr6")
    t = np.arange(0.0, 6.0, 0.005)
    q = 0.4 * np.sin(np.outer(t, np.linspace(1.0, 2.0, robot.n)) + np.arange(robot.n))
    tau = np.zeros_like(q)
    tau[300, 2] = 1e6
    recording = Recording.from_arrays(t, q=q, tau=tau)
    return robot, torque_regression(recording, robot, Model.nominal(robot), payload=True)


def torques(model: pin.Model, signals: Signals) -> Array:
    data = model.createData()
    return np.array([pin.rnea(model, data, *row) for row in zip(signals.q, signals.qd, signals.qdd, strict=True)])


def test_they_are_what_the_changed_arm_does():
    robot, regression = of_a_moved_arm()
    signals = regression.signals
    before = torques(robot.pinocchio, signals)

    tilted = robot.pinocchio.copy()
    tilted.gravity.linear = tilted.gravity.linear + np.array([0.2, -0.1, 0.0])
    columns = find("base_tilt", "tau").columns(signals, 0, ())
    np.testing.assert_allclose(columns @ [0.2, -0.1, 0.0, 0.0], torques(tilted, signals) - before, atol=1e-6)

    angle = 1e-4
    signals_ahead = signals.q.copy()
    signals_ahead[:, 2] += angle
    column = find("zero_error", "tau").columns(signals, 3, ())[:, :, 0]
    np.testing.assert_allclose(
        angle * column, signals.rigid(signals_ahead, signals.qd, signals.qdd) - signals.load, atol=1e-4)

    loaded = robot.pinocchio.copy()
    # Away from the axis, so that it has an inertia about it.
    body = pin.Inertia(2.0, np.array([0.1, -0.2, 0.15]), 0.01 * np.eye(3))
    loaded.inertias[3] = loaded.inertias[3] + body
    columns = find("link_load", "tau").columns(signals, 3, ())
    np.testing.assert_allclose(columns @ body.toDynamicParameters(), torques(loaded, signals) - before, atol=1e-6)


def test_a_leaning_base_shows_moments_of_an_upright_first_axis_that_the_urdf_has_wrong():
    robot, regression = of_a_moved_arm()
    signals, tilt = regression.signals, find("base_tilt", "tau")
    true = robot.pinocchio.copy()
    true.inertias[1] = true.inertias[1] + pin.Inertia(6.0, np.array([0.08, -0.05, 0.0]), np.zeros((3, 3)))
    upright = torques(true, signals)
    true.gravity.linear = true.gravity.linear + np.array([0.2, -0.1, 0.0])
    leaning = torques(true, signals) - upright
    columns = tilt.columns(signals, 0, ())
    found = np.linalg.lstsq(columns.reshape(-1, 4), leaning.ravel(), rcond=None)[0]
    np.testing.assert_allclose(columns @ found, leaning, atol=1e-6)
    np.testing.assert_allclose(found[:2], [0.2, -0.1], atol=1e-6)
    assert tilt.plausible(found, (), signals, 0)
    # As large as all of the arm's own they are no error of a URDF, nor do they turn anything where nothing leans.
    assert not tilt.plausible(found * [1.0, 1.0, 1000.0, 1000.0], (), signals, 0)
    assert not tilt.plausible(found * [0.0, 0.0, 1.0, 1.0], (), signals, 0)
    # The file of an earlier version has two coefficients.
    before = FittedEffect("base_tilt", 0, "tau", (0.2, -0.1)).contribution(signals)
    np.testing.assert_allclose(before, columns[:, :, :2] @ [0.2, -0.1])


@pytest.mark.parametrize("unit", ["N m", "A"])
def test_a_spring_balances_gravity_where_there_is_some_in_any_unit(unit):
    _, regression = of_a_moved_arm()
    if unit == "A":
        amperes = 0.1 * regression.decimate(regression.signals.torque)
        regression = in_own_units(replace(regression, measured=amperes))
    usable = [find("gravity_spring", "tau").usable(regression.signals, joint) for joint in (1, 2, 3)]
    assert usable == [False, True, True]


def test_a_single_sample_that_stands_out_costs_nothing():
    _, regression = of_a_moved_arm()
    assert np.max(np.abs(regression.measured[:, 2])) == 0.0


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
    # The mass matrix is kept.
    assert len(calls) == count + (count - 1 - ROBOT.n) // 2 * 3 + 1 + ROBOT.n
    np.testing.assert_array_equal(other, [first[0], first[1], first[1], first[0]])
