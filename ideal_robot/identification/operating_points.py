"""Step 1 of the two-step identification, [G] 3.1.2: what single-axis moves measure at an operating point.

The gravitational torque is the mean of forward and backward motion at constant velocity. The moment of inertia comes
from motion with high acceleration, gravity compensated, with a simple friction model. Each is a linear form of the base
parameters.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.dynamics import BaseParameters, full_regressor
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.preprocess import FilteredSignals, lowpass
from ideal_robot.signals.segments import alone, runs


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
    """Stretches within ``start … stop`` in which the joint moves at constant velocity, the ends cut off.

    Args:
        s: filtered signals of a recording.
        joint: from 0.
        start: first sample.
        stop: sample behind the last one.
    """
    qd, qdd = s.qd[start:stop, joint], s.qdd[start:stop, joint]
    margin = int(np.ceil(0.5 / s.cutoff / s.dt))
    found = []
    # Steady: at this acceleration the velocity would take more than a second to change by its own size.
    steady = np.abs(qdd) < np.abs(qd)
    for a, b in runs(steady.astype(int)):
        if steady[a] and b - a > 2 * margin + 5 and np.ptp(qd[a + margin: b - margin]) < 0.1 * abs(np.mean(qd[a:b])):
            found.append((start + a + margin, start + b - margin))
    return found


def rows_of(s: FilteredSignals, robot: Robot, base: BaseParameters, index: np.ndarray,
            with_acceleration: bool) -> Array:
    """Regressor ``(k, n, b)`` of the base parameters at some samples, with or without the measured acceleration.

    Args:
        s: filtered signals of a recording.
        robot: the arm.
        base: base parameters of the rigid body.
        index: the ``k`` samples.
        with_acceleration: otherwise it counts as zero.
    """
    qdd = s.qdd[index] if with_acceleration else np.zeros_like(s.qdd[index])
    return full_regressor(robot.pinocchio, s.q[index], s.qd[index], qdd, base.independent)


def gravity_measurements(s: FilteredSignals, robot: Robot, base: BaseParameters) -> list[Measurement]:
    """Mean of the averaged torques of forward and backward motion, for each pair of stretches of the same speed.

    Args:
        s: filtered signals of a recording.
        robot: the arm.
        base: base parameters of the rigid body.
    """
    found = []
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
                found.append(_both_directions(s, robot, base, j, stretches[i], stretches[match[0]]))
    return found


def _both_directions(s: FilteredSignals, robot: Robot, base: BaseParameters, joint: int, first: tuple[int, int],
                     second: tuple[int, int]) -> Measurement:
    rows, values, errors, postures = [], [], [], []
    for a, b in (first, second):
        index = np.linspace(a, b - 1, min(b - a, 40)).astype(int)
        rows.append(rows_of(s, robot, base, index, with_acceleration=False)[:, joint].mean(axis=0))
        tau = s.tau[a:b, joint]
        values.append(float(np.mean(tau)))
        # Neighbouring samples of a torque with ripple are not news; blocks of 50 ms are.
        block = max(1, round(0.05 / s.dt))
        means = [np.mean(tau[i: i + block]) for i in range(0, max(1, len(tau) - block + 1), block)]
        errors.append(np.std(means) / np.sqrt(len(means)) if len(means) > 1 else np.std(tau))
        postures.append(s.q[a:b].mean(axis=0))
    std = 0.5 * float(np.hypot(errors[0], errors[1]))
    # Friction of both directions is never quite alike: it sets the floor.
    std = float(np.hypot(std, 0.005 * abs(values[0] - values[1])))
    return Measurement(joint, "gravity", np.mean(postures, axis=0), np.mean(rows, axis=0), float(np.mean(values)),
                       max(std, 1e-9))


def inertia_measurements(s: FilteredSignals, robot: Robot, base: BaseParameters, p_g: Array) -> list[Measurement]:
    """Moment of inertia of one axis from its motion with high acceleration, gravity compensated.

    Args:
        s: filtered signals of a recording.
        robot: the arm.
        base: base parameters of the rigid body.
        p_g: values of the base parameters from the gravity measurements ``(b,)``.
    """
    found = []
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
            found.append(Measurement(j, "inertia", s.q[index].mean(axis=0), weight @ moment, float(p[0]),
                                     max(std, 1e-3 * abs(float(p[0])), 1e-9)))
    return found
