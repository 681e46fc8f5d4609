"""Joint stiffness from recordings with the flange clamped: both methods of [J], over one or several configurations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ideal_robot.arrays import Array
from ideal_robot.elasticity.clamped_signals import DECIMATE_HZ, ClampedSignals
from ideal_robot.errors import InputError
from ideal_robot.robots.robot import Robot


@dataclass(frozen=True)
class LeastSquares:
    """Solution of Y = W χ + ρ.

    Attributes:
        chi: estimate ``(b,)``.
        covariance: [J] (16) ``(b, b)``, for white residuals.
        robust: covariance that holds for correlated residuals too ``(b, b)`` (Newey–West over the given lag).
        std_percent: [J] (17) ``(b,)``.
        relative_residual: ‖W χ − Y‖ / ‖Y‖.
        condition: condition number of W with columns scaled to unit length.
    """

    chi: Array
    covariance: Array
    robust: Array
    std_percent: Array
    relative_residual: float
    condition: float


def least_squares(W: Array, Y: Array, *, lag: int = 0) -> LeastSquares:
    """Solves [J] (14) with (15)–(17).

    Raises InputError for fewer rows than parameters, or parameters that the data cannot distinguish.

    Args:
        W, Y: observations ``(r, b)`` and measurements ``(r,)``.
        lag: number of neighbouring samples whose residuals may be correlated.
    """
    r, b = W.shape
    if r <= b:
        raise InputError(f"{r} samples cannot determine {b} parameters; record longer")
    # Stiffness times angle plus offset: without scaling, W'W of angles varying by a milliradian loses all digits.
    scale = np.linalg.norm(W, axis=0)
    if np.any(scale == 0):
        raise InputError("a parameter has no influence on the recording")
    U, s, Vt = np.linalg.svd(W / scale, full_matrices=False)
    if s[-1] < 1e-12 * s[0]:
        raise InputError("the recording does not excite all parameters; record pushes in more directions and postures")
    chi = Vt.T @ (U.T @ Y / s) / scale
    rho = Y - W @ chi
    inverse = (Vt.T / s**2) @ Vt / np.outer(scale, scale)
    covariance = (rho @ rho) / (r - b) * inverse
    scores = W * rho[:, None]
    meat = scores.T @ scores
    for shift in range(1, min(lag, r - 1) + 1):
        cross = scores[shift:].T @ scores[:-shift]
        meat += (1 - shift / (lag + 1)) * (cross + cross.T)
    robust = inverse @ meat @ inverse * r / (r - b)
    norm = np.linalg.norm(Y)
    return LeastSquares(chi, covariance, robust, 100 * np.sqrt(np.diag(covariance)) / np.abs(chi),
                        float(np.linalg.norm(rho) / norm) if norm > 0 else 0.0, float(s[0] / s[-1]))


Method = Literal["motor", "wrench"]

CORRELATED_SECONDS = 4.0
"""Residuals of a quasi-static recording are alike while a level is held, 2 s with ramps of 0.7 s in the scenes; σ for
intervals allows for that."""
WORST_CONDITION = 60.0
"""A Jacobian (moments divided by 1 m) worse than this makes joint torques from wrenches unreliable, [J] 2.3."""
LOADED_SHARE = 0.08
"""A joint counts as loaded in a recording if its torque varies by this share of the most loaded joint's, each as a part
of its limit …"""
LEAST_CORRELATION = 0.9
"""… and goes with its motor angle at least as well as this."""


@dataclass(frozen=True)
class Tolerances:
    """Relative standard deviations of scale errors common to all torques, which no residual shows.

    Attributes:
        drive_gain: data-sheet drive gains, [J] (9): "a few per cent".
        wrench: calibration of the wrench sensor.
        model: geometry, and elasticity of clamp and links that was not distinguished from the gear's.
    """

    drive_gain: float = 0.03
    wrench: float = 0.003
    model: float = 0.03

    def of(self, method: Method) -> float:
        """Relative standard deviation of a stiffness by one of the methods [1]."""
        return float(np.hypot(self.drive_gain if method == "motor" else self.wrench, self.model))


@dataclass(frozen=True)
class JointStiffness:
    """Stiffness of one joint with its statistics.

    Attributes:
        joint: counted from 1.
        method: ``motor`` ([J] 2.2), ``wrench`` ([J] 2.3) or ``payload``.
        stiffness: k_j [N m/rad].
        offset: Offkm_j or Offkl_j of the first recording used [N m].
        std_percent, offset_std_percent: %σ of both, [J] (17).
        relative_error_percent: ‖W χ − Y‖ / ‖Y‖ [%].
        interval: 95 % interval of the stiffness [N m/rad], with correlated residuals and ``Tolerances``.
        condition: worst condition number of the Jacobians used, moments divided by 1 m.
        recordings: the recordings that loaded the joint.
    """

    joint: int
    method: str
    stiffness: float
    offset: float
    std_percent: float
    offset_std_percent: float
    relative_error_percent: float
    interval: tuple[float, float]
    condition: float
    recordings: tuple[str, ...]


@dataclass(frozen=True)
class JointLoad:
    """Torque of one joint over its motor angle in one recording: a point cloud of [J] figures 4 and 5."""

    source: str
    q_m: Array
    tau: Array
    condition: float


def flange_jacobian(robot: Robot, q: Array) -> Array:
    """J(q_0) of [J] (3) in the tool frame ``(6, n)``."""
    data = robot.pinocchio.createData()
    return np.array(pin.computeFrameJacobian(robot.pinocchio, data, q, robot.tool_id, pin.LOCAL))


def condition_number(robot: Robot, q: Array) -> float:
    """Condition number of the Jacobian, rotations against a length of 1 m."""
    return float(np.linalg.cond(flange_jacobian(robot, q)))


def joint_torque(signals: ClampedSignals, robot: Robot, method: Method) -> tuple[Array, NDArray[np.bool_]]:
    """Torques ``(N, n)`` by one of the methods and the samples ``(N,)`` that can be used.

    Raises InputError where the recording lacks what the method needs.

    Args:
        signals, robot: of a clamped recording with ``N`` samples, and the arm.
        method: ``motor``: τ_m = g I, [J] (9); ``wrench``: τ_l = J(q_0)ᵀ F_e, [J] (12).
    """
    if method == "motor":
        if signals.tau is None:
            raise InputError("method 'motor' needs motor currents or torques", file=signals.source, field="current_i")
        return signals.tau, signals.clamped
    if signals.wrench is None:
        raise InputError("method 'wrench' needs at least fz", file=signals.source, field="fz")
    tau = signals.wrench @ flange_jacobian(robot, signals.q_0)
    return tau, signals.clamped & np.all(np.isfinite(signals.wrench), axis=1)


def joint_loads(signals: Sequence[ClampedSignals], robot: Robot, method: Method, joint: int) -> list[JointLoad]:
    """The recordings in which a joint is loaded, with its torque over its motor angle.

    Args:
        signals, robot, method: of the clamped recordings, see ``joint_torque``.
        joint: from 1.
    """
    loads = []
    for signal in signals:
        tau, use = joint_torque(signal, robot, method)
        if np.count_nonzero(use) < 10:
            continue
        spans = np.ptp(tau[use], axis=0) / (robot.tau_max if np.all(np.isfinite(robot.tau_max)) else 1.0)
        # Also where the torque does not vary at all, as with a wrench that does not reach the joint.
        if spans[joint - 1] <= LOADED_SHARE * np.max(spans):
            continue
        if np.corrcoef(tau[use, joint - 1], signal.q_m[use, joint - 1])[0, 1] < LEAST_CORRELATION:
            continue
        loads.append(JointLoad(signal.source, signal.q_m[use, joint - 1], tau[use, joint - 1],
                               condition_number(robot, signal.q_0)))
    return loads


def identify_joint(loads: Sequence[JointLoad], joint: int, method: Method,
                   tolerances: Tolerances | None = None) -> JointStiffness:
    """[J] (8) or (11) by least squares, one offset per recording; raises InputError where none loads the joint.

        τ_j = [q_mj 1] [k_j Off_j]ᵀ

    Args:
        loads: torque over motor angle, one for each recording.
        joint, method: from 1; ``motor`` or ``wrench``.
        tolerances: scale errors of the torques; the defaults if None.
    """
    if not loads:
        raise InputError(f"no recording loads joint {joint}; clamp the flange in a configuration that does",
                         field="joint", value=joint)
    tolerances = tolerances or Tolerances()
    weights = [1.0] * len(loads)
    for _ in range(2 if len(loads) > 1 else 1):
        W = np.vstack([weight * _rows(load, loads) for weight, load in zip(weights, loads, strict=True)])
        Y = np.concatenate([weight * load.tau for weight, load in zip(weights, loads, strict=True)])
        fit = least_squares(W, Y, lag=round(CORRELATED_SECONDS * 2 * DECIMATE_HZ))
        # Recordings with larger residuals get less weight from the second pass on.
        weights = [1 / np.std(load.tau - fit.chi[0] * load.q_m) for load in loads]
    k = float(fit.chi[0])
    half = 1.96 * float(np.hypot(np.sqrt(fit.robust[0, 0]), k * tolerances.of(method)))
    return JointStiffness(joint, method, k, float(fit.chi[1]), float(fit.std_percent[0]), float(fit.std_percent[1]),
                          100 * fit.relative_residual, (k - half, k + half), max(load.condition for load in loads),
                          tuple(load.source for load in loads))


def _rows(load: JointLoad, loads: Sequence[JointLoad]) -> Array:
    """[q_m, 1 in the column of this recording's offset, 0 in those of the others]."""
    return np.column_stack([load.q_m, *(np.full(len(load.q_m), float(other is load)) for other in loads)])


def identify_stiffness(signals: Sequence[ClampedSignals], robot: Robot, method: Method,
                       tolerances: Tolerances | None = None) -> tuple[JointStiffness, ...]:
    """Stiffness of all joints that the recordings load, each by [J] (8) or (11).

    Args:
        signals, robot, method: of the clamped recordings, see ``joint_torque``.
        tolerances: see ``identify_joint``.
    """
    results = [identify_joint(loads, joint, method, tolerances) for joint in range(1, robot.n + 1)
               if (loads := joint_loads(signals, robot, method, joint))]
    if not results:
        raise InputError("no joint is loaded in any recording", field="recordings")
    return tuple(results)
