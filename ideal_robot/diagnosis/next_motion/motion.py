"""The motion of a plan: a sequence of Fourier motions with the best joint separation of causes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import interpolate

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.case import Case, Findings
from ideal_robot.diagnosis.channels.arm import measured_axes, position_regressions
from ideal_robot.diagnosis.channels.motor_torque import in_position_band, torque_regression
from ideal_robot.diagnosis.channels.regression import CUTOFF, MEMORY, Regression
from ideal_robot.effects import MOTOR_TORQUE, Domain
from ideal_robot.errors import IdealRobotError, InputError
from ideal_robot.identification.excitation import FourierMotion, MotionSpace, Workspace, approach
from ideal_robot.identification.program import finite_limits
from ideal_robot.loop.from_model import loop_model
from ideal_robot.loop.simulation import simulate
from ideal_robot.progress import Progress
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording


@dataclass(frozen=True)
class Kind:
    """Properties of a part of the motion.

    Attributes:
        period: of its Fourier series [s].
        repeats: number of periods.
        harmonics: sines and cosines per joint.
        speed, acceleration: shares of the limits that may be used.
    """

    period: float
    repeats: int
    harmonics: int
    speed: float
    acceleration: float

    @property
    def seconds(self) -> float:
        """Duration of the part [s]."""
        return self.period * self.repeats


KINDS = (Kind(1.0, 5, 6, 0.75, 0.8), Kind(2.0, 3, 5, 0.75, 0.8), Kind(6.0, 1, 5, 0.85, 0.8), Kind(12.0, 1, 5, 0.9, 0.8),
         Kind(8.0, 1, 4, 0.2, 0.5), Kind(8.0, 1, 3, 0.06, 0.5))
"""From fast, short strokes, which show gears and delays, to wide and to slow ones, which show springs and friction."""
_DRAWN = 6
"""Parts of each kind to choose from, and draws of each until one lies within limits and workspace."""


@dataclass(frozen=True)
class _Part:
    """One Fourier motion, its commands ``(N, n)`` [rad] with the rests about it, and their information alone."""

    kind: Kind
    motion: FourierMotion
    q: Array
    tells: Any


class MotionSearch:
    """Chooses a sequence of Fourier motions with the largest joint value.

    Args:
        robot, workspace: the arm with its limits, and where tool and links may go.
        start: posture at rest before ``(n,)`` [rad].
        longest: longest duration of the motion [s].
        rng: random generator of the parts.
        told: computes the information of commands ``(N, n)`` [rad].
    """

    def __init__(self, robot: Robot, start: Array, workspace: Workspace, longest: float, rng: np.random.Generator,
                 told: Callable[[Array], Any]) -> None:
        self.robot, self.start, self.longest, self.rng, self.told = robot, start, longest, rng, told
        self.spaces = {kind: MotionSpace(robot, kind.period, kind.harmonics, workspace, kind.speed, kind.acceleration,
                                         0.9) for kind in KINDS if kind.seconds < longest}
        # As long as the memory of the diagnosis's filters.
        self.rest = max(1, round(MEMORY / CUTOFF / robot.t_ipo))

    def best(self, worth: Callable[[Sequence[Any]], float], enough: float, progress: Progress) -> Array:
        """Commands ``(N, n)`` [rad] every interpolation cycle, from rest to rest, with as few parts as needed.

        Args:
            worth: value of the joint information of several parts.
            enough: value at which no more parts are added.
            progress: called with the share done and a word.

        Raises:
            InputError: nothing lies within limits and workspace.
        """
        def worth_of(parts: Sequence[_Part]) -> float:
            return worth([part.tells for part in parts])

        pool: list[_Part] = []
        kinds = [kind for kind in self.spaces for _ in range(_DRAWN)]
        for k, kind in enumerate(kinds):
            progress(0.6 * k / len(kinds), "motions to choose from")
            part = self._drawn(kind)
            if part is not None:
                pool.append(part)
        chosen, value = list[_Part](), -np.inf
        while value < enough:
            longer = [(worth_of([*chosen, part]), i) for i, part in enumerate(pool) if self._fits([*chosen, part])]
            if not longer or max(longer)[0] <= value:
                break
            value, i = max(longer)
            chosen.append(pool[i])
        if not chosen:
            raise InputError("no motion within the limits, the workspace and the time was found; relax the workspace "
                             "or allow more time", field="length", value=self.longest)
        # As many changes of the chosen parts are tried as motions were drawn.
        for k in range(len(kinds) if value < enough else 0):
            progress(0.6 + 0.4 * k / len(kinds), "refining")
            i = int(self.rng.integers(len(chosen)))
            changed = self._changed(chosen[i])
            if changed is None:
                continue
            tried = [*chosen[:i], changed, *chosen[i + 1 :]]
            reached = worth_of(tried)
            if reached > value and self._fits(tried):
                chosen, value = tried, reached
        return self._commands(chosen)

    def _commands(self, parts: Sequence[_Part]) -> Array:
        """The parts one after the other, with the ways between them ``(N, n)`` [rad]."""
        v_max, a_max = finite_limits(self.robot)
        position, rows = self.start, [np.repeat(self.start[None], self.rest, axis=0)]
        for part in parts:
            rows += [approach(position, part.q[0], self.robot.t_ipo, v_max, a_max), part.q]
            position = part.q[-1]
        return np.concatenate(rows)

    def _fits(self, parts: Sequence[_Part]) -> bool:
        return len(self._commands(parts)) * self.robot.t_ipo <= self.longest

    def _drawn(self, kind: Kind) -> _Part | None:
        # Half of them near the arm's place, to save time on the way.
        centre = self.start if self.rng.random() < 0.5 else None
        for _ in range(_DRAWN):
            part = self._made(kind, self.rng.uniform(-1, 1, (2, kind.harmonics, self.robot.n)), centre)
            if part is not None:
                return part
        return None

    def _changed(self, part: _Part) -> _Part | None:
        """The part with coefficients a little different, about the same posture."""
        coefficients = np.stack([part.motion.a, part.motion.b])
        step = self.rng.normal(scale=0.3, size=coefficients.shape) * np.abs(coefficients).max(axis=(0, 1))
        return self._made(part.kind, coefficients + step, part.motion.centre)

    def _made(self, kind: Kind, coefficients: Array, centre: Array | None) -> _Part | None:
        motion = self.spaces[kind].scaled(coefficients, self.rng, centre)
        if motion is None:
            return None
        q = motion.at(self.robot.t_ipo * np.arange(float(round(kind.seconds / self.robot.t_ipo) + 1)))[0]
        q = np.pad(q, ((self.rest, self.rest), (0, 0)), mode="edge")
        return _Part(kind, motion, q, self.told(q))


@dataclass(frozen=True)
class Foresight:
    """Predicts, for motions that have not been run, the regression that a diagnosis would make of them.

    Attributes:
        case: arguments of the diagnosis: arm, known model, units.
        found: its findings before any search: model, filters, widths.
    """

    case: Case
    found: Findings

    def regression(self, q_c: Array, domain: Domain) -> Regression:
        """The rows that a diagnosis would fit if an arm exactly like the model ran these commands.

        Effects can be evaluated on its signals, to predict what they would add to each channel.

        Args:
            q_c: a command for each cycle ``(N, n)`` [rad].
            domain: whose channels are wanted: motor torques, arm angles or the TCP.
        """
        recording = self._recording(q_c)
        torque = self.case.torque_regression(recording, self.found.start, reversal_width=self.found.reversal_width,
                                             cutoff=self.found.problem.regression.filtered.cutoff)
        if domain == MOTOR_TORQUE:
            return torque
        regressions = position_regressions(recording, self.case.robot, in_position_band(torque, recording),
                                           self.case.stiffness)
        return next(regression for regression in regressions if regression.domain == domain)

    def _recording(self, q_c: Array) -> Recording:
        """What a commanded motion ``(N, n)`` [rad] would record, without any effect."""
        robot, measured = self.case.robot, self.case.recording
        t = robot.t_ipo * np.arange(float(len(q_c)))
        spline = interpolate.CubicSpline(t, self._moved(q_c), axis=0)
        # Five samples per period of the position filter's cut-off.
        grid = np.arange(0.0, t[-1], min(1.0 / (5.0 * CUTOFF), robot.t_ipo))
        q, qd, qdd = (spline(grid, k) for k in range(3))
        tau = self.found.start.inverse_dynamics(q, qd, qdd, t=grid) * self._units
        pose = robot.fk()
        tool = np.array([pose(row).translation for row in q])
        behind, axes = measured.having("qa"), measured_axes(measured)
        columns = {"t": grid, **{axis: tool[:, k].copy() for k, axis in enumerate("xyz") if axes[k]}}
        for i in range(robot.n):
            columns |= {f"q_{i + 1}": q[:, i].copy(), f"tau_{i + 1}": tau[:, i].copy()}
            if behind[i]:
                columns[f"qa_{i + 1}"] = q[:, i].copy()
        return Recording(columns, {}, "planned motion")

    def _moved(self, q_c: Array) -> Array:
        """Where the motors go on commands ``(N, n)`` [rad]: the identified loop's answer, where there is one."""
        model = self.case.given
        if model is None or model.controller is None:
            return q_c
        try:
            return np.asarray(simulate(loop_model(model, self.case.robot), q_c).q_m[: len(q_c)])
        except IdealRobotError:
            return q_c

    @property
    def _units(self) -> Array:
        """What a newton metre is in the recording ``(n,)``: amperes without a known gain are taken as they are."""
        if self.case.shared:
            return np.ones(self.case.robot.n)
        plain = torque_regression(self.case.recording, self.case.robot, self.found.start)
        nominal = plain.filtered.decimate(plain.signals.torque)
        return np.asarray((nominal * plain.measured).sum(axis=0) / np.maximum((nominal**2).sum(axis=0), 1e-300))
