"""The filters with which an arm's recordings predict each other best, for identification and diagnosis alike."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.dynamics import BaseParameters, base_parameters, full_regressor
from ideal_robot.identification.prior import prior_of
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.cutoff import CutoffChoice, choose_cutoff
from ideal_robot.signals.preprocess import FilteredSignals, decimated, evenly_sampled
from ideal_robot.signals.recording import Recording

_PROBE = 8.0
"""Cut-off at which the size of the torque and of the acceleration is looked at beforehand [Hz]."""
_TURNS = 0.003
"""Dry friction turns over within this share of a joint's top speed."""


def chosen_filters(recordings: Sequence[Recording], robot: Robot, *, amperes: bool = False,
                   base: BaseParameters | None = None) -> CutoffChoice:
    """Cut-offs by held-out error of the rigid body with dry and viscous friction.

    Args:
        recordings: checked ones, with ``tau_i``; a dead channel's torque is NaN.
        robot: kinematics and nominal inertias.
        amperes: torques are currents with unknown gains.
        base: grouping of the robot's parameters, where the caller has it already.
    """
    base = base_parameters(robot.pinocchio) if base is None else base
    n = robot.n

    def columns(s: FilteredSignals, stride: int) -> Array:
        q, qd, qdd = s.q[::stride], s.qd[::stride], s.qdd[::stride]
        W = full_regressor(robot.pinocchio, q, qd, qdd, [*base.independent, *range(12 * n, 14 * n)])
        joints = np.arange(n)
        W[:, joints, base.count + joints] = qd
        # Its jumps have all frequencies, unlike the rest.
        slow = _TURNS * np.maximum(np.max(np.abs(s.qd), axis=0), 1e-9)
        W[:, joints, base.count + n + joints] = decimated(np.tanh((s.qd / slow).astype(np.float32)), stride)
        return W

    probes = [evenly_sampled(r, columns=False).filtered(min(_PROBE, 0.1 * len(r.t) / float(r.t[-1] - r.t[0])))
              for r in recordings]
    prior = prior_of(robot, base, probes, amperes=amperes)
    return choose_cutoff(recordings, columns, start=np.concatenate([prior.start, np.zeros(2 * n)]),
                         information=prior.padded(base.count + 2 * n))
