"""Prior of a given model's parameters for a new recording: of the same arm, or of another arm of its type.

Each arm differs from its model by quantities that change from day to day: friction, its curve over speed, gains,
offsets, gears, the phase of a ripple. These are columns beside the parameters, with a spread of their own,

    cov = diag( cov(model | shapes of its friction) , day² )                                 the same arm
    cov = diag( cov(model | shapes) + G diag(spread of the type)² G' , day² + type² )        another arm of its type

with G the grouping of full into base parameters ([G] 3.1.2). "All parameters differ" is then a set like the others: its
parameters cost by their prior, and a load with one number is preferred to forty free ones.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.channels.regression import Regression, noise_left
from ideal_robot.diagnosis.system import System
from ideal_robot.dynamics.consistent_inertias import BODY, LINK, parameter_scales
from ideal_robot.dynamics.tool_force import felt_at_tool, torques_of_tool_force
from ideal_robot.effects import ARM_POSITION, TCP_POSITION
from ideal_robot.effects.elasticity import turned_arm
from ideal_robot.effects.registry import find
from ideal_robot.estimate.gaussian import root_of
from ideal_robot.estimate.noise import ColouredNoise
from ideal_robot.friction.table import largest_speeds
from ideal_robot.friction.terms import friction_terms
from ideal_robot.model.model import Model
from ideal_robot.model.parametrisation import friction_places, parameter_vector
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording

ROTOR = 0.05
"""By what rotors' inertias of two arms of one type differ; links by ``LINK`` and ``BODY``."""
ANOTHER_ARM = -float(np.log(20.0))
"""Logarithm of how likely another arm of the type is, against the same: who gives a model means it for the arm."""
MISFIT = 0.5
"""Of what a model left where it was identified, the part that is there again on another motion; 0.5 has the largest
evidence of 0.5, 1 and 2 on short motions of four shipped scenes."""
UNKNOWN = 100.0
"""Standard deviation of a parameter of which a model knows nothing, over one and its value [in its unit]."""
FORCE_GAIN = 0.15
"""What the gain of a force sensor is off by, weight and motion of what it carries included."""
FORCE_ZERO = 2.0
"""What the zero of a force sensor is off by along each of its axes [N]: what it carries was weighed, or it was not."""
MEMORY = 0.2
"""Time over which what a model leaves follows itself [s]."""
ENCODER = 30e-6
"""By which the zero of an encoder on the arm's side is off its model [rad]; assumed."""
GEOMETRY = 3e-4
"""By which ``a``, ``d`` [m], ``alpha`` and ``theta`` [rad] of a joint are off the drawing: an arm that nobody
calibrated is right to half a millimetre or one."""
LEAST_BEND, BEND = 5e-6, 0.03
"""What a gear bends by otherwise than a spring does: at least [rad; at the TCP m], and of its deflection's spread."""
FAR = 10.0
"""Standard deviation of where a measuring device stands [m, rad], and of a weight that nothing is known of."""
BEND_MEMORY = 0.05
"""Time over which that follows itself [s]."""
_ORDER = 8
"""Of the autoregression of a known noise: white noise beside what has a memory."""


@dataclass(frozen=True)
class Hypothesis:
    """A hypothesis about a given model's parameters.

    Attributes:
        name: in words.
        root: matrix ``R (P + K, P + K)``, the covariance of the parameters about the model's, and of the daily changes,
            being ``R R'``.
        logarithm: logarithm of its prior odds, against the same arm.
    """

    name: str
    root: Array
    logarithm: float


SAME, TYPE = "the same arm", "another arm of its type"


@dataclass(frozen=True)
class Spread:
    """By how much one quantity of one joint, or of all, differs from day to day and from arm to arm.

    Attributes:
        torque: of the whole quantity along a motion ``(N, n)`` [N m].
        day, type: shares of it by which one arm differs from day to day, and two arms of a type beyond that.
    """

    torque: Array
    day: float
    type: float


def spreads(model: Model, robot: Robot, regression: Regression) -> list[Spread]:
    """The normal differences of an arm from its model, without any fault.

    Args:
        model, robot: the model and robot that were given.
        regression: of the motor torques about it.
    """
    s, n = regression.signals, model.n
    dry = np.maximum(model.friction.dry, 1e-6)
    along = np.column_stack([s.sliding_direction(j + 1) for j in range(n)])
    rubs, rises = dry * along, s.friction - dry * along
    shares = np.ascontiguousarray((s.qd / largest_speeds(robot.v_max)).T)
    bends = find("joint_elasticity", "tau_further")

    def alone(j: int, values: Array) -> Array:
        return np.asarray(s.on_joint(j + 1, values)[:, :, 0])

    found = [Spread(rubs, 0.01, 0.05), Spread(rises, 0.04, 0.10)]
    known = np.zeros(n) if model.known_compliance is None else model.known_compliance
    for j in range(n):
        found += [Spread(alone(j, rubs[:, j]), 0.03, 0.15), Spread(alone(j, rises[:, j]), 0.05, 0.15),
                  Spread(alone(j, s.torque[:, j]), 0.005, 0.02),
                  Spread(alone(j, np.full(len(s.t), dry[j])), 0.02, 0.03)]
        # The terms of friction's curve have the spread of all errors of a law; a third of it changes daily.
        terms = friction_terms(shares[j], np.ascontiguousarray(along[:, j]))
        found += [Spread(alone(j, dry[j] * term), 0.33, 0.0) for term in terms.T[2:]]
        if bends.usable(s, j + 1):
            found.append(Spread(known[j] * bends.columns(s, j + 1, ())[:, :, 0], 0.05, 0.10))
    for effect in model.effects:
        if effect.name == "torque_ripple" and effect.channel.startswith("tau"):
            j, size = effect.joint - 1, float(np.linalg.norm(effect.coefficients)) / np.sqrt(2.0)
            found += [Spread(alone(j, size * wave(effect.theta[0] * s.q[:, j])), 0.15, 1.0)
                      for wave in (np.cos, np.sin)]
    return found


@dataclass(frozen=True)
class Known:
    """The regression of motor torques about a given model, with all normal differences of an arm from it.

    Attributes:
        regression: with daily changes as further parameters.
        differs: those daily changes.
        pushed: whether the force of a sensor at the tool acts along (1) or against its readings (-1), or is not used.
    """

    regression: Regression
    differs: list[Spread]
    pushed: int = 0


def known(model: Model, robot: Robot, regression: Regression, recording: Recording, pushed: int | None = None) -> Known:
    """The regression about a given model, with all normal differences of an arm from it.

    Args:
        model, robot: the model and robot that were given.
        regression: of the motor torques about it.
        recording: its recording; a force sensor in it gives the external force.
        pushed: see ``Known``; estimated from the recording if None.
    """
    differs = spreads(model, robot, regression)
    push = _pushed(recording, robot, regression)
    if push is None:
        return Known(replace(regression, W=_with_spreads(regression, differs)), differs)
    felt, zero = push
    differs += [Spread(along, FORCE_ZERO, 0.0) for along in zero]
    anyway = [*differs, Spread(felt, 1.0, 0.0)]
    W = _with_spreads(regression, anyway)
    if pushed is None:
        # The sign of the sensor is not in the recording, so both are tried.
        root = _root_of_day(model, anyway)
        system = System(regression.y, W, regression.use, root)
        system.take_noise(noise_of(model, _floor(regression), regression.step))
        pushed = 1 if (root @ system.posterior(["W"]).mean)[-1] > 0.0 else -1
    y = regression.y - pushed * W[:, :, -1]
    return Known(replace(regression, y=y, W=W), [*differs, Spread(felt, FORCE_GAIN, 0.0)], pushed)


def _pushed(recording: Recording, robot: Robot, regression: Regression) -> tuple[Array, list[Array]] | None:
    """Torques of the force that a sensor at the tool shows, and of 1 N along each of its axes; None without one.

    Each is ``(N, n)`` [N m].
    """
    s = regression.signals
    force = felt_at_tool(recording, regression.filtered.t)
    if force is None:
        return None
    by_axis = torques_of_tool_force(robot, s.q)
    return np.asarray(np.einsum("nlj,nl->nj", by_axis, force)), list(np.moveaxis(by_axis, 1, 0))


def _with_spreads(regression: Regression, found: list[Spread]) -> Array:
    """Derivatives by the parameters, and by what differs by the day ``(N, n, P + K)``."""
    more = regression.filtered.decimate(np.stack([spread.torque for spread in found], axis=2))
    return np.concatenate([regression.W, more], axis=2)


def hypotheses(model: Model, found: list[Spread]) -> Iterator[Hypothesis]:
    """Two hypotheses of a given model's parameters: the recording is of the same arm, or of another of its type."""
    yield Hypothesis(SAME, _root_of_day(model, found), 0.0)
    other = np.diag([np.hypot(spread.day, spread.type) for spread in found])
    yield Hypothesis(TYPE, linalg.block_diag(root_of(_same(model) + _of_type(model)), other), ANOTHER_ARM)


def _root_of_day(model: Model, found: list[Spread]) -> Array:
    """See ``Hypothesis.root``. Of the same arm."""
    return np.asarray(linalg.block_diag(same_arm(model), np.diag([spread.day for spread in found])))


def same_arm(model: Model) -> Array:
    """Matrix ``R (P, P)`` of the covariance ``R R'`` of a model's parameters, if the arm is the same."""
    return root_of(_same(model))


def _same(model: Model) -> Array:
    """Covariance ``(P, P)`` of the model's parameters, with the shapes of its friction laws fixed."""
    there = np.isfinite(model.covariance)
    finite = np.asarray(there.all(axis=0) & there.all(axis=1))
    C = np.where(np.outer(finite, finite), np.where(there, model.covariance, 0.0), 0.0)
    # A parameter without a finite covariance has no prior.
    values = parameter_vector(model.base_values, model.friction)
    C[np.diag_indices(len(C))] += np.where(finite, 0.0, (UNKNOWN * (1.0 + np.abs(values))) ** 2)
    linear = np.zeros(len(C), dtype=bool)
    linear[: friction_places(model.base, model.friction)[-1].stop] = True
    result = np.zeros_like(C)
    own, across, shapes = C[np.ix_(linear, linear)], C[np.ix_(linear, ~linear)], C[np.ix_(~linear, ~linear)]
    std = np.sqrt(np.maximum(np.diag(shapes), 1e-300))
    inverse = np.linalg.pinv(shapes / np.outer(std, std), rcond=1e-8) / np.outer(std, std)
    result[np.ix_(linear, linear)] = own - across @ inverse @ across.T
    return result


def _of_type(model: Model) -> Array:
    """What the bodies and rotors of two arms of a type differ by, as covariance of base parameters ``(P, P)``."""
    layout, b = model.base.layout, model.base.count
    full = np.asarray(model.consistent)
    scale = parameter_scales(full, layout)
    own = np.zeros(layout.size)
    own[layout.links] = BODY * scale[layout.links]
    own[layout.rotors] = ROTOR * full[layout.rotors]
    spread = np.diag(own**2)
    for i in range(layout.bodies):
        link = np.zeros(layout.size)
        link[layout.link(i)] = LINK * full[layout.link(i)]
        spread += np.outer(link, link)
    P = len(parameter_vector(model.base_values, model.friction))
    result = np.zeros((P, P))
    result[:b, :b] = model.base.grouping @ spread @ model.base.grouping.T
    return result


def noise_of(model: Model, measured: Sequence[ColouredNoise], step: float) -> tuple[ColouredNoise, ...]:
    """Noise of each torque about a model: that of the measurement, and the class's error, which is coloured.

    Args:
        model: model with ``noise_std``, its residual in the identification.
        measured: noise of the recording itself.
        step: from one row to the next [s].
    """
    following = np.exp(-np.arange(_ORDER + 1) * step / MEMORY)
    return tuple(ColouredNoise.of_autocovariance(own.autocovariance(_ORDER) + (MISFIT * left) ** 2 * following)
                 for own, left in zip(measured, np.asarray(model.noise_std).tolist(), strict=True))


def _floor(regression: Regression) -> list[ColouredNoise]:
    """White noise as large as the floor of each torque."""
    return [ColouredNoise.of_autocovariance(np.array([max(floor**2, 1e-30), *np.zeros(_ORDER)]))
            for floor in regression.noise_floor.tolist()]


def _with_memory(white: Array, slow: Array, memory: float, step: float) -> tuple[ColouredNoise, ...]:
    """White noise beside what follows itself, of standard deviations ``(c,)`` each."""
    following = np.exp(-np.arange(_ORDER + 1) * step / memory)
    return tuple(ColouredNoise.of_autocovariance(np.maximum(float(s) ** 2 * following, 1e-30)
                                                 + float(w) ** 2 * (np.arange(_ORDER + 1) == 0))
                 for w, s in zip(white, slow, strict=True))


def positions_known(model: Model, regression: Regression,
                    name: str) -> tuple[Regression, Array, tuple[ColouredNoise, ...]]:
    """The regression of arm angles or of the TCP about a model, the prior of its parameters, and the noise.

    Arm angles differ from the model by encoder zeros, gear compliance, and the division of inertia between rotor and
    load. The TCP differs by the place of the measuring device, without a prior, by gear compliance, and by geometric
    errors.

    Args:
        model: the model that was given.
        regression: about it, with the zeros or the device's place as parameters.
        name: of the hypothesis that the torques decided for.

    Returns:
        Regression with more parameters, the root of their covariance, noise of each channel.
    """
    s, n = regression.signals, model.n
    known = np.zeros(n) if model.known_compliance is None else model.known_compliance
    of_type, at_arm = float(name == TYPE), regression.domain == ARM_POSITION
    columns, std = [], [np.full(regression.W.shape[2], FAR)]
    if at_arm:
        std[0][:n] = ENCODER
    give = np.zeros((len(s.t), regression.y.shape[1]))
    for j in range(n):
        bent = turned_arm(regression.domain, s, j + 1, (-s.load[:, j] * known[j])[:, None])
        rotor = turned_arm(regression.domain, s, j + 1, (s.qdd[:, j] * known[j] * model.rotor_inertia[j])[:, None])
        give += bent[:, :, 0]
        for column, day, further in ((bent, 0.05, 0.10), (rotor, 0.03, 0.05)):
            if np.any(column):
                columns.append(column)
                std.append(np.array([np.hypot(day, further * of_type)]))
        if not at_arm:
            columns.append(find("kinematic_error", TCP_POSITION.prefix).columns(s, j + 1, ()))
            std.append(np.full(4, GEOMETRY))
    W = np.concatenate([regression.W, regression.filtered.decimate(np.concatenate(columns, axis=2))], axis=2) \
        if columns else regression.W
    white, _ = noise_left(regression.y, regression.use)
    slow = LEAST_BEND + BEND * np.std(regression.filtered.decimate(give), axis=0)
    noise = _with_memory(np.where(np.isfinite(white), white, 0.0), slow, BEND_MEMORY, regression.step)
    return replace(regression, W=W), np.diag(np.concatenate(std)), noise
