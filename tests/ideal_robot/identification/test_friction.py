"""One joint's friction with everything else eliminated: the same as fitting everything at once."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy import optimize

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.feedforward.inverse import Inverse
from ideal_robot.friction import LAWS, Arctan, CubeRoot, FrictionModel, ViscousCoulomb
from ideal_robot.identification.friction_choice import fit_warm_up
from ideal_robot.identification.friction_runs import FoldEquations, FrictionProjection, choose_law, fit_law, fit_ripple
from ideal_robot.loop.from_model import loop_model
from ideal_robot.loop.simulation import simulate
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from tests.arms import commands, motion, plant, rms
from tests.ideal_robot.feedforward.test_laws import nominal_model

RNG = np.random.default_rng(3)
ROWS = [slice(0, 40), slice(40, 90), slice(90, 120)]
OWN = RNG.standard_normal((120, 5))
OWN[:, 1] = 0.0
"""Rows of the joint: of the five rigid parameters it does not feel the second."""
OTHER = RNG.standard_normal((120, 8))
"""Rows of another joint: the rigid parameters and three of its friction."""
Y, OTHER_Y = RNG.standard_normal(120), RNG.standard_normal(120)
KNOWN = np.diag([0.5, 2.0, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0])
F = RNG.standard_normal((120, 3))
FREE = np.zeros(3, dtype=bool)


def projection() -> FrictionProjection:
    folds = []
    for rows in ROWS:
        W = np.vstack([np.column_stack([OWN[rows], np.zeros((len(OWN[rows]), 3))]), OTHER[rows]])
        y = np.concatenate([Y[rows], OTHER_Y[rows]])
        folds.append(FoldEquations(W.T @ W, W.T @ y, float(y @ y)))
    return FrictionProjection(folds, ROWS, KNOWN, OWN, Y)


def stacked(keep: np.ndarray) -> tuple[Array, Array]:
    """All rows with all parameters, and what is known beforehand as rows of its own."""
    W = np.vstack([np.column_stack([OWN, np.zeros((120, 3)), F])[keep],
                   np.column_stack([OTHER, np.zeros((120, 3))])[keep],
                   np.column_stack([np.sqrt(KNOWN), np.zeros((8, 3))])])
    return W, np.concatenate([Y[keep], OTHER_Y[keep], np.zeros(8)])


def test_as_all_at_once() -> None:
    W, y = stacked(np.ones(120, dtype=bool))
    p = np.linalg.lstsq(W, y, rcond=None)[0]
    np.testing.assert_allclose(projection().coefficients(F, FREE), p[8:], rtol=1e-6)
    np.testing.assert_allclose(projection().error(F, FREE), np.sum((y - W @ p) ** 2), rtol=1e-6)


def test_held_out_stretches_are_not_seen() -> None:
    total = 0.0
    for rows in ROWS:
        keep = np.ones(120, dtype=bool)
        keep[rows] = False
        p = np.linalg.lstsq(*stacked(keep), rcond=None)[0]
        total += float(np.sum((Y[rows] - OWN[rows] @ p[:5] - F[rows] @ p[8:]) ** 2))
    np.testing.assert_allclose(projection().held_out(F, FREE), np.sqrt(total / 120), rtol=1e-6)


def test_a_coefficient_that_may_not_be_negative() -> None:
    W, y = stacked(np.ones(120, dtype=bool))
    p = projection().coefficients(F, FREE)
    bounded = p == p.min()
    assert p.min() < 0.0
    lower = np.concatenate([np.full(8, -np.inf), np.where(bounded, 0.0, -np.inf)])
    expected = optimize.lsq_linear(W, y, (lower, np.full(11, np.inf)), tol=1e-14).x
    np.testing.assert_allclose(projection().coefficients(F, bounded), expected[8:], rtol=1e-5, atol=1e-7)


# Friction from constant-velocity runs, and friction that falls while the gear warms up.

SPEEDS = np.concatenate([s * np.geomspace(0.02, 2.0, 15) for s in (-1.0, 1.0)])


def example(law: type[FrictionModel]) -> FrictionModel:
    shape = {"arctan": [[6.0]], "stribeck": [[20.0]], "bell_stribeck": [[20.0]]}.get(law.key)
    return law(np.array([[4.0], [10.0], [5.0], [9.0]])[: len(law.coefficient_names)], shape)


@pytest.mark.parametrize("law", [law for _, law in LAWS], ids=LAWS.names())
def test_every_law_is_found_again_within_its_deviations(law: type[FrictionModel]) -> None:
    rng = np.random.default_rng(3)
    what = example(law)
    fit = fit_law(law, SPEEDS, what.torque(SPEEDS[:, None])[:, 0] + 0.05 * rng.normal(size=len(SPEEDS)))
    estimate = np.concatenate([fit.law.coefficients[:, 0], fit.law.shape[:, 0]])
    exact = np.concatenate([what.coefficients[:, 0], what.shape[:, 0]])
    assert np.all(np.abs(estimate - exact) < 4.0 * fit.std)
    assert fit.rms == pytest.approx(0.05, rel=0.5)


@pytest.mark.parametrize("law", [CubeRoot, Arctan])
def test_choice_between_cube_root_and_arctan(law: type[FrictionModel]) -> None:
    rng = np.random.default_rng(4)
    tau = example(law).torque(SPEEDS[:, None])[:, 0] + 0.03 * rng.normal(size=len(SPEEDS))
    assert isinstance(choose_law(SPEEDS, tau).law, law)


def test_too_few_speeds_are_refused() -> None:
    with pytest.raises(InputError, match="more speeds"):
        fit_law(CubeRoot, np.array([0.1, 0.2, 0.3]), np.ones(3))


def warming(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Time, velocity, temperature and torque of a joint going back and forth while its gear warms up."""
    t = np.arange(0.0, 3000.0, 12.0)
    qd = np.where(np.arange(len(t)) % 2, 0.5, -0.5) * np.where(np.arange(len(t)) % 4 < 2, 1.0, 0.3)
    temperature = 45.0 - 20.0 * np.exp(-t / 700.0)
    law = ViscousCoulomb([[20.0], [30.0]])
    scale = 1.0 + 0.15 * (45.0 - temperature) / 10.0
    return t, qd, temperature, law.torque(qd[:, None])[:, 0] * scale + 0.2 * rng.normal(size=len(t))


def test_warm_up_is_found_again() -> None:
    _, qd, temperature, tau = warming(np.random.default_rng(5))
    fit = fit_warm_up(ViscousCoulomb, qd, tau, temperature)
    at_reference = 0.15 / (1.0 + 0.15 * (45.0 - fit.reference) / 10.0)
    assert abs(fit.surplus - at_reference) < 4.0 * fit.surplus_std
    assert fit.rms < 0.2 * fit.rms_constant
    scale = 1.0 + fit.surplus * (fit.reference - temperature) / 10.0
    np.testing.assert_allclose(fit.law.torque(qd[:, None])[:, 0] * scale, tau, atol=1.0)


def test_warm_up_needs_something_that_warms() -> None:
    with pytest.raises(InputError, match="hardly changes"):
        fit_warm_up(ViscousCoulomb, np.ones(50), np.ones(50), np.full(50, 30.0))
    with pytest.raises(InputError, match="without shape"):
        fit_warm_up(Arctan, np.ones(50), np.ones(50), np.arange(50.0))


# Ripple of the motors found in slow motion, and carried by the ideal robot.

ROBOT = Robot.load("kr15")


def recording(model: Model, amplitude: float, seed: int = 0) -> Recording:
    """Slow motion whose torque is the model's, a ripple of joint 1, and noise of 13 N m."""
    rng = np.random.default_rng(seed)
    t = 0.002 * np.arange(6000)
    q = ROBOT.home + 0.05 * np.sin(np.outer(t, 2 * np.pi * np.array([0.2, 0.25, 0.3, 0.35, 0.4, 0.45])))
    qd = np.gradient(q, 0.002, axis=0)
    tau = model.inverse_dynamics(q, qd, np.gradient(qd, 0.002, axis=0), t=t)
    tau[:, 0] += amplitude * np.cos(2 * ROBOT.gear_ratio[0] * q[:, 0] - 0.5)
    return Recording.from_arrays(t, q=q + rng.normal(scale=1e-6, size=q.shape),
                                 tau=tau + rng.normal(scale=13.0, size=q.shape))


def test_finds_amplitude_and_order_and_nothing_else():
    model = Model.nominal(ROBOT)
    ripples = fit_ripple([recording(model, 10.0)], model, ROBOT)
    assert [(effect.joint, effect.theta) for effect in ripples] == [(1, (2 * ROBOT.gear_ratio[0],))]
    assert ripples[0].parameters[0].value == pytest.approx(10.0, rel=0.1)
    again = fit_ripple([recording(model, 10.0, seed=1)], model.with_effects(ripples), ROBOT)
    assert again == ()


def test_finds_nothing_where_there_is_nothing():
    model = Model.nominal(ROBOT)
    assert fit_ripple([recording(model, 0.0)], model, ROBOT) == ()


def test_the_ideal_robot_carries_it():
    model = nominal_model()
    effects = fit_ripple([recording(Model.nominal(ROBOT), 10.0)], Model.nominal(ROBOT), ROBOT)
    ripple = loop_model(dataclasses.replace(model, effects=effects), ROBOT).drives.ripple
    # Slow enough that the arm can answer: 0.3 rad/s make 12 Hz of two periods per motor turn.
    q_d = motion(amplitude=0.05)
    arm = plant().changed(ripple=ripple)
    error = {known: rms(simulate(arm, commands(Inverse(loop), q_d)).q_a[40:-1, 0] - q_d[40:, 0])
             for known, loop in ((True, arm), (False, plant()))}
    assert error[True] < 0.6 * error[False]
