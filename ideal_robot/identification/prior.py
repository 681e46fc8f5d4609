"""What is known of an arm's parameters before any data: each link's are nominal to their own size.

A motion that excites is not moved by it. What a motion leaves open stays near what a body of that size can have,
instead of being filled with noise that no other motion would show.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.dynamics import BaseParameters, link_parameters, torques
from ideal_robot.dynamics.consistency import parameter_scales
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.preprocess import FilteredSignals

_OFFSET = 0.2
"""Standard deviation of a torque offset, relative to that of the torque."""
_GRAVITY = 9.81


@dataclass(frozen=True)
class Prior:
    """Full nominal parameters and how well they are known.

    Attributes:
        nominal: links, rotor inertias, offsets ``(p,)``, in units of the recorded torque.
        start: base parameters ``(b,)``.
        information: inverse covariance of the base parameters about ``start`` ``(b, b)``.
    """

    nominal: Array
    start: Array
    information: Array

    def padded(self, size: int) -> Array:
        """The information among ``size`` parameters of which nothing is known of those that follow."""
        padded = np.zeros((size, size))
        padded[: len(self.start), : len(self.start)] = self.information
        return padded


def prior_of(robot: Robot, base: BaseParameters, signals: Sequence[FilteredSignals], *, amperes: bool) -> Prior:
    """What is known of a robot before its recordings are looked at, but for the size of its torque.

    Rotor inertias behind gears have nothing to do with the size of a link: they are known to the inertia that would
    take all of the torque. Offsets are known to a fifth of it, those of sliding joints, whose gravity is constant and
    often balanced, to the weight.

    Args:
        robot: nominal inertias.
        base: grouping of its parameters.
        signals: one per recording.
        amperes: torques are currents with unknown gains: the nominal parameters are brought to their size.
    """
    n = robot.n
    y, acceleration = (np.concatenate([s.decimate(getattr(s, name)) for s in signals]) for name in ("tau", "qdd"))
    torque = np.maximum(np.nan_to_num(np.std(y, axis=0)), 1e-9)
    nominal = np.concatenate([link_parameters(robot.pinocchio), robot.rotor_inertia, np.zeros(n)])
    unit = _gain(robot, signals) if amperes else 1.0
    scale = unit * parameter_scales(nominal, n)
    at = slice(10 * n, 11 * n)
    scale[at] = np.maximum(scale[at], torque / np.maximum(np.std(acceleration, axis=0), 1e-6))
    weight = unit * _GRAVITY * np.cumsum(nominal[: 10 * n : 10][::-1])[::-1]
    scale[11 * n :] = np.where(robot.prismatic, np.maximum(weight, torque), _OFFSET * torque)
    covariance = (base.grouping * scale**2) @ base.grouping.T
    size = np.sqrt(np.diag(covariance))
    inverse = np.linalg.pinv(covariance / np.outer(size, size), hermitian=True) / np.outer(size, size)
    return Prior(unit * nominal, base.of(unit * nominal), np.asarray(inverse))


def _gain(robot: Robot, signals: Sequence[FilteredSignals]) -> float:
    """Recorded torque per newton metre of the nominal arm: the median over joints that gravity or inertia load."""
    parts = [tuple(s.decimate(values) for values in (torques(robot.pinocchio, s.q, s.qd, s.qdd), s.tau, s.qd,
                                                     np.sign(s.qd))) for s in signals]
    gains = []
    for j in range(robot.n):
        W = np.concatenate([np.column_stack([m[:, j], np.ones(len(m)), v[:, j], d[:, j]]) for m, _, v, d in parts])
        y = np.concatenate([t[:, j] for _, t, _, _ in parts])
        if np.isnan(y).any():
            continue
        gain = float(np.linalg.lstsq(W, y, rcond=None)[0][0])
        if gain > 0.0 and np.std(gain * W[:, 0]) > 0.2 * np.std(y):
            gains.append(gain)
    return float(np.median(gains)) if gains else 1.0
