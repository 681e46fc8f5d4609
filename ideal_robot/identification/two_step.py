"""Two-step identification, [G] 3.1.2: from recordings of the program in ``program.py``.

Step 1 "measures" at each operating point the gravitational torque (mean of forward and backward motion at constant
velocity) and the moment of inertia (motion with high acceleration, gravity compensated, with a simple friction model)
of one axis at a time. Step 2 estimates the base parameters from all of them by weighted least squares. Friction comes
from the motions at constant velocity, gravity removed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.dynamics import BaseParameters, base_parameters, full_regressor, link_parameters
from ideal_robot.dynamics.consistent_inertias import consistent_parameters, parameter_scales
from ideal_robot.errors import InputError
from ideal_robot.friction import FrictionModel, PerJointFriction, law_of
from ideal_robot.identification.against_urdf import contradicting
from ideal_robot.identification.checks import checked, excitation_warnings, require_distinct
from ideal_robot.identification.friction_runs import FrictionFit, choose_law, fit_law
from ideal_robot.identification.idim import Identification, with_errors
from ideal_robot.identification.weighted_least_squares import Solution
from ideal_robot.model.described_arm import DescribedArm
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.channels import alone, runs
from ideal_robot.signals.filters import lowpass
from ideal_robot.signals.preprocess import FilteredSignals, preprocess
from ideal_robot.signals.recording import Recording


@dataclass(frozen=True)
class Measurement:
    """One number measured at one operating point.

    Attributes:
        joint: from 0.
        quantity: ``gravity`` [N m] or ``inertia`` [kg m²].
        q: posture ``(n,)``.
        row: the quantity as a linear form of the base parameters ``(b,)``.
        value, std: measured value and its standard deviation.
    """

    joint: int
    quantity: str
    q: Array
    row: Array
    value: float
    std: float


def constant_stretches(s: FilteredSignals, joint: int, start: int, stop: int) -> list[tuple[int, int]]:
    """Index ranges within ``start … stop`` of motion at constant velocity, without their ends.

    Args:
        s, joint: filtered signals of a recording, and from 0.
        start, stop: first sample, and the one behind the last.
    """
    qd, qdd = s.qd[start:stop, joint], s.qdd[start:stop, joint]
    margin = int(np.ceil(0.5 / s.cutoff / s.dt))
    stretches = []
    # Steady: at this acceleration the velocity would take more than a second to change by its own size.
    steady = np.abs(qdd) < np.abs(qd)
    for a, b in runs(steady.astype(int)):
        if steady[a] and b - a > 2 * margin + 5 and np.ptp(qd[a + margin: b - margin]) < 0.1 * abs(np.mean(qd[a:b])):
            stretches.append((start + a + margin, start + b - margin))
    return stretches


def rows_of(s: FilteredSignals, robot: Robot, base: BaseParameters, index: np.ndarray,
            with_acceleration: bool) -> Array:
    """Regressor ``(k, n, b)`` of the base parameters at some samples, with or without the measured acceleration.

    Args:
        s, index: filtered signals of a recording, and the ``k`` samples.
        robot, base: the arm, and base parameters of the rigid body.
        with_acceleration: otherwise it is set to zero.
    """
    qdd = s.qdd[index] if with_acceleration else np.zeros_like(s.qdd[index])
    return full_regressor(robot.pinocchio, s.q[index], s.qd[index], qdd, base.independent)


def gravity_measurements(s: FilteredSignals, robot: Robot, base: BaseParameters) -> list[Measurement]:
    """Gravity torques from the mean of forward and backward torques at the same speed.

    See ``inertia_measurements``.
    """
    measurements = []
    for j in range(robot.n):
        for start, stop in alone(s, j):
            stretches = constant_stretches(s, j, start, stop)
            speeds = [float(np.mean(s.qd[a:b, j])) for a, b in stretches]
            used: set[int] = set()
            for i, v in enumerate(speeds):
                if i in used:
                    continue
                match = [k for k in range(i + 1, len(speeds)) if k not in used and abs(speeds[k] + v) < 0.05 * abs(v)]
                if not match:
                    continue
                used |= {i, match[0]}
                measurements.append(_both_directions(s, robot, base, j, stretches[i], stretches[match[0]]))
    return measurements


def _both_directions(s: FilteredSignals, robot: Robot, base: BaseParameters, joint: int, first: tuple[int, int],
                     second: tuple[int, int]) -> Measurement:
    rows, values, errors, postures = [], [], [], []
    for a, b in (first, second):
        index = np.linspace(a, b - 1, min(b - a, 40)).astype(int)
        rows.append(rows_of(s, robot, base, index, with_acceleration=False)[:, joint].mean(axis=0))
        tau = s.tau[a:b, joint]
        values.append(float(np.mean(tau)))
        # Neighbouring samples of a torque with ripple are correlated; blocks of 50 ms are independent.
        block = max(1, round(0.05 / s.dt))
        means = [np.mean(tau[i: i + block]) for i in range(0, max(1, len(tau) - block + 1), block)]
        errors.append(np.std(means) / np.sqrt(len(means)) if len(means) > 1 else np.std(tau))
        postures.append(s.q[a:b].mean(axis=0))
    std = 0.5 * float(np.hypot(errors[0], errors[1]))
    # Friction differs slightly between the directions, which gives a lower bound.
    std = float(np.hypot(std, 0.005 * abs(values[0] - values[1])))
    return Measurement(joint, "gravity", np.mean(postures, axis=0), np.mean(rows, axis=0), float(np.mean(values)),
                       max(std, 1e-9))


def inertia_measurements(s: FilteredSignals, robot: Robot, base: BaseParameters, p_g: Array) -> list[Measurement]:
    """Moment of inertia of one axis from its motion with high acceleration, gravity compensated.

    Args:
        s: filtered signals of a recording.
        robot, base: the arm, and base parameters of the rigid body.
        p_g: values of the base parameters from the gravity measurements ``(b,)``.
    """
    measurements = []
    smooth = lowpass(s.tau, s.dt, s.cutoff)
    for j in range(robot.n):
        strongest = float(np.max(np.abs(s.qdd[:, j])))
        for start, stop in alone(s, j):
            if (stop - start) * s.dt < 0.5 or np.max(np.abs(s.qdd[start:stop, j])) < 0.3 * strongest:
                continue
            index = np.arange(start, stop, max(1, int(0.25 / s.cutoff / s.dt)))
            qd, qdd = s.qd[index, j], s.qdd[index, j]
            still = np.zeros((len(index), robot.n))
            gravity = full_regressor(robot.pinocchio, s.q[index], still, still)[:, j][:, list(base.independent)]
            unit = still.copy()
            unit[:, j] = 1.0
            moment = full_regressor(robot.pinocchio, s.q[index], still, unit)[:, j][:, list(base.independent)] - gravity
            y = smooth[index, j] - gravity @ p_g
            W = np.column_stack([qdd, qd, np.tanh(qd / 0.02), np.ones_like(qd)])
            p, *_ = np.linalg.lstsq(W, y, rcond=None)
            sigma2 = float(np.sum((y - W @ p) ** 2)) / max(1, len(y) - 4)
            std = float(np.sqrt(np.linalg.pinv(W.T @ W)[0, 0] * sigma2))
            weight = qdd**2 / np.sum(qdd**2)
            measurements.append(Measurement(j, "inertia", s.q[index].mean(axis=0), weight @ moment, float(p[0]),
                                            max(std, 1e-3 * abs(float(p[0])), 1e-9)))
    return measurements


_CUTOFF = 15.0
"""Position filter [Hz]: corners of trapezoids reach far up in frequency, but nothing that is measured here does."""


_DISTANCES = np.geomspace(2e-5, 5e-3, 12)
"""Presliding distances tried [rad or m]."""


@dataclass(frozen=True)
class TwoStep:
    """Gravity torques and inertias measured at operating points, and the duration of the motions [s]."""

    measurements: tuple[Measurement, ...]
    duration: float


def identify_two_step(recordings: Sequence[Recording], robot: Robot, *, validation: Sequence[Recording] = (),
                      friction: str = "auto") -> tuple[Identification, TwoStep]:
    """Identifies a model by the two-step method.

    Args:
        recordings: of single-axis trapezoidal motions at several operating points; the segments are found from the
            motion itself.
        robot: kinematics, nominal inertias, limits, drive gains.
        validation: recordings the model is compared with and never fitted to.
        friction: key of a law, or ``auto``: (2) or (3), whichever is better at held-out speeds.

    Raises:
        InputError: recordings that cannot be used, or in which no joint moves alone at constant velocity.
    """
    require_distinct([*recordings, *validation])
    usable, warnings = checked(recordings, robot, commands=True)
    unseen, more = checked(validation, robot) if validation else ([], [])
    signals = [preprocess(r, cutoff=_CUTOFF) for r in usable]
    base = base_parameters(robot.pinocchio)
    nominal = np.concatenate([link_parameters(robot.pinocchio), robot.rotor_inertia, np.zeros(robot.n)])
    gravity = [m for s in signals for m in gravity_measurements(s, robot, base)]
    if not gravity:
        raise InputError("no joint moves alone, forwards and backwards at constant velocity; play the program of "
                         "plan-identification", file=usable[0].source, field="q_i")
    prior = _prior(base, nominal, robot)
    p_g = _weighted(gravity, base.of(nominal), prior)[0]
    measurements = [*gravity, *(m for s in signals for m in inertia_measurements(s, robot, base, p_g))]
    values, covariance, residual, unexcited = _weighted(measurements, base.of(nominal), prior)
    amperes = any("unknown-drive-gain" in text for text in warnings)
    points = tuple(_friction_points(signals, robot, base, values, j) for j in range(robot.n))
    fits = tuple(choose_law(*p) if friction == "auto" else fit_law(law_of(friction), *p) for p in points)
    laws = [_with_presliding(fit.law, signals, robot, base, values, j) for j, fit in enumerate(fits)]
    joint_covariance = _joined(covariance, fits, laws)
    consistency = consistent_parameters(base, values, covariance, nominal)
    model = Model(
        DescribedArm.of(robot), base, values, PerJointFriction(laws),
        joint_covariance, consistency.full, np.zeros(robot.n),
        provenance={"method": "two-step", "recordings": [{"source": r.source, "hash": r.hash} for r in usable],
                    "filters": {"cutoff": _CUTOFF, "cutoff_decimation": signals[0].cutoff_decimation},
                    **({"amperes": robot.without_gain} if amperes else {})})
    estimation = tuple(model.predict(r) for r in usable)
    noise = np.sqrt(np.mean(np.concatenate([p.measured - p.tau for p in estimation]) ** 2, axis=0))
    model = replace(model, noise_std=noise)
    solution = _statistics(measurements, values, joint_covariance, unexcited, residual, noise)
    warnings += [f"{text} (validation)" for text in more]
    warnings += excitation_warnings(model, solution)
    contradictions, said = contradicting(usable, robot, amperes=amperes)
    warnings += said
    held_out = tuple(model.predict(r) for r in unseen)
    model = with_errors(model, estimation, held_out, warnings)
    scores = tuple({fit.law.label: fit.held_out_rms} for fit in fits)
    return (Identification(model, solution, estimation, held_out, scores, consistency, tuple(warnings), tuple(usable),
                           tuple(unseen), contradictions),
            TwoStep(tuple(measurements), float(sum(r.t[-1] - r.t[0] for r in usable))))


def _statistics(measurements: Sequence[Measurement], values: Array, covariance: Array, unexcited: np.ndarray,
                residual: Array, noise: Array) -> Solution:
    """The solution of the second step; its condition numbers leave out what no measurement shows."""
    W = np.array([m.row / m.std for m in measurements])[:, ~unexcited]
    s = np.linalg.svd(W, compute_uv=False)
    scaled = np.linalg.svd(W / np.maximum(np.linalg.norm(W, axis=0), 1e-12), compute_uv=False)
    friction = len(covariance) - len(values)
    return Solution(np.concatenate([values, np.zeros(friction)]), covariance, np.sqrt(np.diag(covariance)), noise,
                    float(s[0] / max(s[-1], 1e-300)), float(scaled[0] / max(scaled[-1], 1e-300)),
                    np.concatenate([unexcited, np.zeros(friction, dtype=bool)]), residual[:, None])


def _joined(covariance: Array, fits: Sequence[FrictionFit], laws: Sequence[FrictionModel]) -> Array:
    """Covariance in the order of the parameter vector: base parameters, all coefficients, all shapes."""
    b, c = len(covariance), sum(len(law.coefficients) for law in laws)
    joined = np.zeros((b + c + sum(len(law.shape) for law in laws),) * 2)
    joined[:b, :b] = covariance
    column, shape_column = b, b + c
    for fit, law in zip(fits, laws, strict=True):
        m, s = len(law.coefficients), len(law.shape)
        rows = [*range(column, column + m), *range(shape_column, shape_column + s - 1)]
        joined[np.ix_(rows, rows)] = fit.covariance
        # The presliding distance, last in the shape, is from a grid with steps wider than its uncertainty.
        joined[shape_column + s - 1, shape_column + s - 1] = (0.5 * law.shape[-1, 0]) ** 2
        column, shape_column = column + m, shape_column + s
    return joined


def _prior(base: BaseParameters, nominal: Array, robot: Robot) -> Array:
    """What is known before: nominal parameters to the size of a link's own, offsets to 2 % of the torque limit.

    Returns the covariance of the base parameters ``(b, b)``. Single-axis moves at a few operating points leave
    combinations of small parameters open; without this the fit would fill them with noise.
    """
    scale = parameter_scales(nominal, base.layout)
    limit = np.where(np.isfinite(robot.tau_max), robot.tau_max, 100.0)
    scale[base.layout.offsets] = 0.02 * limit
    return np.asarray((base.grouping * scale**2) @ base.grouping.T)


def _weighted(measurements: Sequence[Measurement], start: Array, prior: Array,
              ) -> tuple[Array, Array, Array, np.ndarray]:
    """Weighted least squares about ``start``, known to ``prior (b, b)``.

    The scatter of the measurements about the model widens their standard deviations.
    """
    std = np.array([m.std for m in measurements])
    kinds = np.array([f"{m.quantity} {m.joint}" for m in measurements])
    rows = np.array([m.row for m in measurements])
    y = np.array([m.value for m in measurements]) - rows @ start
    known = np.linalg.pinv(prior, hermitian=True)
    for _ in range(4):
        W, z = rows / std[:, None], y / std
        covariance = np.linalg.inv(W.T @ W + known)
        step = covariance @ (W.T @ z)
        residual = z - W @ step
        # Parameters determined by the measurements, not by the prior, use up degrees of freedom.
        used = float(np.trace(covariance @ W.T @ W))
        for kind in np.unique(kinds):
            mask = kinds == kind
            freedom = max(1.0, mask.sum() * (1.0 - used / len(z)))
            std[mask] *= max(1.0, float(np.sqrt(np.sum(residual[mask] ** 2) / freedom)))
    unexcited = np.diag(covariance) > 0.9 * np.diag(prior)
    return start + step, covariance, residual, unexcited


def _with_presliding(law: FrictionModel, signals: Sequence[FilteredSignals], robot: Robot, base: BaseParameters,
                     p: Array, joint: int) -> FrictionModel:
    """The law with the presliding distance that describes the joint's reversals best, out of a grid.

    Runs at constant velocity do not show it, but without it the law would not know a direction at rest.
    """
    pieces = []
    for s in signals:
        smooth = lowpass(s.tau[:, [joint]], s.dt, s.cutoff)[:, 0]
        for start, stop in alone(s, joint):
            if (stop - start) * s.dt > 0.5:
                index = np.arange(start, stop, max(1, int(0.1 / s.cutoff / s.dt)))
                rigid = rows_of(s, robot, base, index, with_acceleration=True)[:, joint] @ p
                pieces.append((s.q[index][:, [joint]], s.qd[index][:, [joint]], smooth[index] - rigid))

    def refined(distance: float) -> FrictionModel:
        return type(law)(law.coefficients, np.vstack([law.shape, [[distance]]]), presliding=True)

    def cost(distance: float) -> float:
        return sum(float(np.sum((y - refined(distance).torque(qd, q=q)[:, 0]) ** 2)) for q, qd, y in pieces)

    return refined(min(_DISTANCES.tolist(), key=cost))


def _friction_points(signals: Sequence[FilteredSignals], robot: Robot, base: BaseParameters, p: Array,
                     joint: int) -> tuple[Array, Array]:
    """Speeds and friction torques of all stretches at constant velocity, the rest of the model removed."""
    speeds, torques = [], []
    for s in signals:
        for start, stop in alone(s, joint):
            for a, b in constant_stretches(s, joint, start, stop):
                index = np.linspace(a, b - 1, min(b - a, 40)).astype(int)
                rows = rows_of(s, robot, base, index, with_acceleration=False)[:, joint]
                speeds.append(float(np.mean(s.qd[a:b, joint])))
                torques.append(float(np.mean(s.tau[a:b, joint]) - np.mean(rows @ p)))
    return np.array(speeds), np.array(torques)
