"""Friction of the load that the motor drives: its number is found, and it is none of its neighbours."""

from __future__ import annotations

import numpy as np
import pytest

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.channels.blocks import time_blocks
from ideal_robot.diagnosis.channels.motor_torque import torque_regression
from ideal_robot.diagnosis.search.choice import Options
from ideal_robot.diagnosis.search.forward_selection import Search
from ideal_robot.diagnosis.statistics.problem import Problem
from ideal_robot.dynamics.regressor import regressor
from ideal_robot.effects import library
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from tests.ideal_robot.diagnosis.known_arm import harmonics, point_mass

JOINT = 2
NEIGHBOURS = ("load_direction_friction", "load_dependent_friction", "drive_gain", "payload", "coulomb",
              "gravity_spring", "asymmetric_friction")


def added(name: str, qd: Array, load: Array, body: Array) -> Array:
    """Torques of one cause by a formula of its own, with a number of 0.15.

    Args:
        name: of the cause.
        qd: velocities ``(N, n)`` [rad/s].
        load: torques at the gears ``(N, n)`` [N m].
        body: torques of a kilogram at the flange ``(N, n)`` [N m].
    """
    j, result = JOINT - 1, np.zeros_like(load)
    power = load[:, j] * qd[:, j]
    if name == "load_direction_friction":
        result[:, j] = np.where(power > 0.0, 0.15 * load[:, j], 0.0)
    elif name == "load_dependent_friction":
        result[:, j] = 0.15 * np.sign(power) * load[:, j]
    elif name == "drive_gain":
        result[:, j] = 0.15 * load[:, j]
    else:
        result = 2.0 * body
    return result


def problem_of(*names: str) -> Problem:
    """An arm whose parameters are known, with the causes of these names."""
    robot, rng, t = Robot.load("kr6"), np.random.default_rng(4), np.arange(0.0, 24.0, 0.004)
    q, qd, qdd = harmonics(rng, t, robot.home, 0.3, (0.5, 3.0), 3)
    model = Model.nominal(robot)
    load = model.inverse_dynamics(q, qd, qdd) - robot.rotor_inertia * qdd
    at = robot.tool_place
    body = regressor(robot.pinocchio, q, qd, qdd)[:, :, -10:] @ point_mass(1.0, at)
    tau = model.inverse_dynamics(q, qd, qdd) + sum(added(name, qd, load, body) for name in names)
    tau = tau + 0.005 * np.std(tau, axis=0) * rng.normal(size=q.shape)
    made = torque_regression(Recording.from_arrays(t, q=q, tau=tau), robot, model, payload=True)
    problem = Problem(made, time_blocks(len(made.t), float(made.t[1] - made.t[0]), held_out=True))
    return problem.with_prior(1e6 * np.eye(made.W.shape[2]))


def found(problem: Problem, absorbed: bool = True) -> dict[tuple[str, int], float]:
    """Names and joints that a search takes among the neighbours, with their first coefficients."""
    only = tuple((name, joint) for name in NEIGHBOURS for joint in range(7))
    choices = Search(problem, library(), Options(), np.random.default_rng(0), absorbed=absorbed, only=only).run()
    fit = problem.fit([choice.candidate for choice in choices])
    return {(c.candidate.effect.name, c.candidate.joint): float(own[0])
            for c, own in zip(choices, fit.coefficients, strict=True)}


@pytest.mark.parametrize("name", ["load_direction_friction", "load_dependent_friction", "drive_gain"])
def test_what_loses_with_the_load_is_told_by_when_it_does(name: str) -> None:
    said = found(problem_of(name))
    assert list(said) == [(name, JOINT)]
    assert said[name, JOINT] == pytest.approx(0.15, rel=0.03)


def test_a_payload_is_no_friction_of_its_load() -> None:
    assert list(found(problem_of("payload"))) == [("payload", 0)]


def test_masses_that_other_joints_show_tell_the_load_that_is_driven_without_a_model() -> None:
    said = found(problem_of("load_direction_friction").with_prior(None), absorbed=False)
    assert list(said) == [("load_direction_friction", JOINT)]
    assert said["load_direction_friction", JOINT] == pytest.approx(0.15, rel=0.1)


def test_a_gear_that_loses_both_ways_but_more_driving_has_both() -> None:
    said = found(problem_of("load_direction_friction", "load_dependent_friction"))
    assert set(said) == {("load_direction_friction", JOINT), ("load_dependent_friction", JOINT)}
    for value in said.values():
        assert value == pytest.approx(0.15, rel=0.1)
