"""The regression of a motion that has not been played: everything but what would be measured."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import interpolate

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.case import Case
from ideal_robot.diagnosis.channels.arm_angle import arm_angle_regression
from ideal_robot.diagnosis.channels.motor_torque import in_position_band, torque_regression
from ideal_robot.diagnosis.channels.regression import Regression
from ideal_robot.diagnosis.channels.tool_position import measured_axes, tool_regression
from ideal_robot.effects import ARM_POSITION, MOTOR_TORQUE, Domain
from ideal_robot.errors import IdealRobotError
from ideal_robot.loop.from_model import loop_model
from ideal_robot.loop.simulation import simulate
from ideal_robot.model.model import Model
from ideal_robot.signals.recording import Recording

_STEP = 0.01
"""Sampling of what is foreseen [s]: twice what the band that is looked at needs."""


@dataclass(frozen=True)
class Foresight:
    """Makes regressions of motions that have not been played.

    Attributes:
        case: what the diagnosis was asked: arm, known model, units.
        start: the model that predicts.
        own: the regression of the recording, for filters and widths.
        reversal_width: speed over which dry friction changes sign ``(n,)`` [rad/s], or None.
    """

    case: Case
    start: Model
    own: Regression
    reversal_width: Array | None

    def moved(self, q_c: Array) -> Array:
        """Where the motors go on commands ``(N, n)`` [rad]: the identified loop's answer, where there is one."""
        if self.case.given is None or self.case.given.controller is None:
            return q_c
        try:
            return np.asarray(simulate(loop_model(self.case.given, self.case.robot), q_c).q_m[: len(q_c)])
        except IdealRobotError:
            return q_c

    def recording(self, q_c: Array) -> Recording:
        """What a motion commanded every interpolation cycle ``(N, n)`` [rad] would record, without any effect."""
        case, start = self.case, self.start
        t = case.robot.t_ipo * np.arange(float(len(q_c)))
        spline = interpolate.CubicSpline(t, self.moved(q_c), axis=0)
        grid = np.arange(0.0, t[-1], min(_STEP, case.robot.t_ipo))
        q, qd, qdd = (spline(grid, k) for k in range(3))
        tau = start.inverse_dynamics(q, qd, qdd, t=grid) * self._units
        pose = case.robot.fk()
        tool = np.array([pose(row).translation for row in q])
        behind, axes = case.recording.having("qa"), measured_axes(case.recording)
        columns = {"t": grid, **{axis: tool[:, k].copy() for k, axis in enumerate("xyz") if axes[k]}}
        for i in range(case.robot.n):
            columns |= {f"q_{i + 1}": q[:, i].copy(), f"tau_{i + 1}": tau[:, i].copy()}
            if behind[i]:
                columns[f"qa_{i + 1}"] = q[:, i].copy()
        return Recording(columns, {}, "planned motion")

    @property
    def _units(self) -> Array:
        """What a newton metre is in the recording ``(n,)``: amperes without a known gain are taken as they are."""
        if self.case.shared:
            return np.ones(self.case.robot.n)
        plain = torque_regression(self.case.recording, self.case.robot, self.start)
        nominal = plain.decimate(plain.signals.torque)
        return np.asarray((nominal * plain.measured).sum(axis=0) / np.maximum((nominal**2).sum(axis=0), 1e-300))

    def regression(self, q_c: Array, domain: Domain) -> Regression:
        """The regression of a domain over a commanded motion.

        Args:
            q_c: commands every interpolation cycle ``(N, n)`` [rad].
            domain: motor torque, arm angle or TCP.
        """
        recording = self.recording(q_c)
        torque = self.case.torque_regression(recording, self.start, cutoff=self.own.filtered.cutoff,
                                             reversal_width=self.reversal_width)
        if domain == MOTOR_TORQUE:
            return torque
        build = _BUILD[domain == ARM_POSITION]
        made = build(recording, self.case.robot, in_position_band(torque, recording), self.case.stiffness)
        return torque if made is None else made


_BUILD: dict[bool, Callable[..., Regression | None]] = {True: arm_angle_regression, False: tool_regression}
