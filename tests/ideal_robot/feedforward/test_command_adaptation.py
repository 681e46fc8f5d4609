"""The command's law follows a controller that changes, and never ends worse than the plain path."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest

from ideal_robot.arrays import Array, held
from ideal_robot.command.law import PARTS, Column, CommandLaw, JointLaw, Shape
from ideal_robot.feedforward.base import Feedforward, PassThrough
from ideal_robot.feedforward.command_adaptation import AdaptedCommand
from ideal_robot.feedforward.command_inverse import CommandInverse
from ideal_robot.model.model import Model
from ideal_robot.robots.interface import RobotState
from ideal_robot.robots.robot import Robot

T, FINE = 0.012, 12
ARM = dataclasses.replace(Robot.load("kr6"), t_ipo=T)
GAIN, LATE = 20.0, 0.03


def law(late: float = LATE, cycle: float = T) -> Model:
    """A model whose law is a position loop of ``GAIN`` [1/s], commands ``late`` [s] late in a log of that cycle [s]."""
    joint = JointLaw(Shape(late=late), (Column("offset"), Column("velocity")), np.array([0.0, 1.0 / GAIN]),
                     1e-8 * np.eye(2), np.full(PARTS, 1e-12), 0.02, 2e-5, "lag")
    still, width = np.full(6, 0.02), np.ones(6)
    return dataclasses.replace(Model.nominal(ARM), command=CommandLaw((joint,) * 6, cycle, still, ARM.home, width))


def path(seed: int, seconds: float) -> Array:
    rng, t = np.random.default_rng(seed), np.arange(0.0, seconds, T)
    swell = np.clip(np.minimum(t - 1.0, t[-1] - t) / 1.5, 0.0, 1.0)[:, None]
    way = sum(rng.uniform(0.05, 0.2, 6) * np.sin(2 * np.pi * rng.uniform(0.1, 0.5, 6) * t[:, None]
                                                 + rng.uniform(0, 6, 6)) for _ in range(3))
    return np.asarray(ARM.home + swell**3 * (10.0 - 15.0 * swell + 6.0 * swell**2) * way)


Controller = Callable[[float], tuple[float, float, float]]
"""Lateness [s], gain [1/s] and share of the velocity that is fed forward, at a time [s]."""


def errors(feedforward: Feedforward, q_d: Array, controller: Controller, stuck: float = 0.0) -> Array:
    """Path minus angle ``(N, 6)`` [rad] of joints that follow as ``controller`` says, encoders with steps.

    At rest friction holds them ``stuck`` [rad] from where their commands would have them; that is not counted.
    """
    state, ahead = feedforward.init(q_d[0]), held(q_d, after=feedforward.n_d)
    nodes, q, missed = [q_d[0]], q_d[0].copy(), np.empty_like(q_d)
    before = q_d[0]
    for k in range(len(q_d)):
        missed[k] = q_d[k] - q
        q_c, state = feedforward.step(state, ahead[k : k + feedforward.n_d])
        nodes.append(q_c)
        for i in range(FINE):
            t = k * T + i * T / FINE
            late, gain, share = controller(t)
            # Command k stands at k T: lines between commands, the newest one a cycle ahead of what is asked for.
            at = max((t - late) / T, 0.0)
            m = min(int(at), len(nodes) - 3) if len(nodes) > 2 else 0
            r = nodes[m + 1] + (at - m) * (nodes[min(m + 2, len(nodes) - 1)] - nodes[m + 1]) if at > 0.0 else q_d[0]
            q = q + T / FINE * (gain * (r - q) + share * (r - before) * FINE / T)
            before = r
        held_by = stuck * np.exp(-(np.abs(q_d[k] - q_d[max(k - 1, 0)]) / T / 0.02) ** 2)
        state = feedforward.observe(state, RobotState((k + 1) * T, 1e-5 * np.round((q + held_by) / 1e-5), np.zeros(6)))
    return missed


def rms(x: Array) -> float:
    return float(np.sqrt(np.mean(x**2)))


def compared(seed: int, seconds: float, controller: Controller) -> tuple[float, float, float]:
    """Errors of the plain path, the law, and the law adapted over the second half [rad]."""
    q_d, inverse = path(seed, seconds), CommandInverse(law(), ARM)
    half = slice(len(q_d) // 2, None)
    plain, ideal, adapted = (rms(errors(feedforward, q_d, controller)[half])
                             for feedforward in (PassThrough(T), inverse, AdaptedCommand(inverse)))
    return plain, ideal, adapted


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
@pytest.mark.slow
def test_on_the_identified_controller_nothing_is_lost(seed: int) -> None:
    plain, ideal, adapted = compared(seed, 12.0, lambda t: (LATE, GAIN, 0.0))
    assert ideal < 0.05 * plain
    assert adapted < max(1.5 * ideal, 0.02 * plain)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, 4])
def test_a_lag_that_grows_is_followed(seed: int) -> None:
    """From 80 to 176 ms in all, as was measured of a controller with duty."""
    plain, ideal, adapted = compared(seed, 30.0, lambda t: (LATE + 0.096 * t / 30.0, GAIN, 0.0))
    assert ideal > 0.2 * plain
    assert adapted < 0.15 * ideal


@pytest.mark.parametrize("gain", [0.6, pytest.param(1.5, marks=pytest.mark.slow)])
@pytest.mark.slow
def test_gains_that_are_changed_are_found(gain: float) -> None:
    _, ideal, adapted = compared(5, 16.0, lambda t: (LATE, gain * GAIN, 0.0))
    assert adapted < 0.2 * ideal


@pytest.mark.parametrize("controller", [(0.0, 60.0, 0.95), *(pytest.param(other, marks=pytest.mark.slow) for other in (
    (0.0, 15.0, 1.0), (0.1, 8.0, 0.5)))])
def test_behind_another_controller_it_does_not_end_worse_than_the_plain_path(
        controller: tuple[float, float, float]) -> None:
    plain, _, adapted = compared(6, 16.0, lambda t: controller)
    assert adapted < 1.05 * plain


@pytest.mark.parametrize("stuck", [-4e-3, pytest.param(2e-3, marks=pytest.mark.slow)])
def test_how_friction_holds_a_joint_at_rest_teaches_no_offset(stuck: float) -> None:
    """Friction at rest is anywhere within its size; once a joint moves it is what the law says."""
    q_d, inverse = path(10, 6.0), CommandInverse(law(), ARM)
    moving = slice(int(1.3 / T), int(3.0 / T))
    ideal, adapted = (rms(errors(feedforward, q_d, lambda t: (LATE, GAIN, 0.0), stuck)[moving])
                      for feedforward in (inverse, AdaptedCommand(inverse)))
    assert adapted < ideal + 0.2 * abs(stuck)


@pytest.mark.parametrize("short", [1, 3, 8])
def test_a_horizon_that_is_too_short_is_continued_as_it_ends(short: int) -> None:
    """Followers know their path over so many cycles; a law that looks ahead one more is no reason to refuse them."""
    ramp = ARM.home + T * np.arange(120.0)[:, None] * np.array([0.1, -0.05, 0.08, 0.2, -0.1, 0.15])
    for feedforward in (CommandInverse(law(), ARM), AdaptedCommand(CommandInverse(law(), ARM))):
        assert feedforward.extends
        states = [feedforward.init(ramp[0]), feedforward.init(ramp[0])]
        for k in range(60):
            commands = []
            for i, rows in enumerate((feedforward.n_d, feedforward.n_d - short)):
                q_c, states[i] = feedforward.step(states[i], ramp[k : k + rows])
                commands.append(q_c)
            # At the start a horizon of one row does not show that the arm is to move.
            if k >= 10:
                np.testing.assert_allclose(*commands, atol=1e-9)


@pytest.mark.parametrize("seed", [7, 8])
def test_what_others_lead_teaches_nothing(seed: int) -> None:
    """A calibration moves the arm by commands that this layer does not give, and stops where the path begins."""
    adapted, q_d = AdaptedCommand(CommandInverse(law(), ARM)), path(seed, 2.0)
    state = adapted.init(q_d[0])
    for k, q in enumerate(path(seed + 10, 8.0)):
        state = adapted.observe(state, RobotState(k * T, q, np.zeros(6)))
    changed = adapted.changed(state)
    assert not np.any(changed.late)
    assert not np.any(changed.offset)
    fresh, ahead = adapted.init(q_d[0]), held(q_d, after=adapted.n_d)
    for k, q in enumerate(q_d):
        (after, state), (alone, fresh) = (adapted.step(own, ahead[k : k + adapted.n_d]) for own in (state, fresh))
        np.testing.assert_array_equal(after, alone)
        state, fresh = (adapted.observe(own, RobotState(k * T, q, np.zeros(6))) for own in (state, fresh))


@pytest.mark.parametrize("finer", [2, 6, 12])
def test_a_law_from_set_points_in_force_leads_commands_that_are_reached_a_cycle_later(finer: int) -> None:
    """A log that is finer than the cycle holds lines between commands, so that nothing of their cycle is in its law."""
    q_d = path(9, 6.0)

    def reached_later(_: float) -> tuple[float, float, float]:
        return T, GAIN, 0.0

    plain, left = (rms(errors(feedforward, q_d, reached_later))
                   for feedforward in (PassThrough(T), CommandInverse(law(0.0, T / finer), ARM)))
    assert left < 0.02 * plain
