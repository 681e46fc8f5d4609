"""The motion of a plan: Fourier motions one after the other, chosen out of many for what they tell together."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import interpolate

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.case import Case
from ideal_robot.diagnosis.channels.arm import measured_axes, position_regressions
from ideal_robot.diagnosis.channels.motor_torque import in_position_band, torque_regression
from ideal_robot.diagnosis.channels.regression import CUTOFF, MEMORY, Regression
from ideal_robot.effects import MOTOR_TORQUE, Domain
from ideal_robot.errors import IdealRobotError, InputError
from ideal_robot.identification.excitation import FourierMotion, MotionSpace, Workspace, approach
from ideal_robot.identification.program import finite_limits
from ideal_robot.loop.from_model import loop_model
from ideal_robot.loop.simulation import simulate
from ideal_robot.model.model import Model
from ideal_robot.progress import Progress, silent
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording


@dataclass(frozen=True)
class Kind:
    """What a part of the motion is like.

    Attributes:
        period: of its Fourier series [s].
        repeats: how many periods.
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
        """How long it takes [s]."""
        return self.period * self.repeats


KINDS = (Kind(1.0, 5, 6, 0.75, 0.8), Kind(2.0, 3, 5, 0.75, 0.8), Kind(6.0, 1, 5, 0.85, 0.8), Kind(12.0, 1, 5, 0.9, 0.8),
         Kind(8.0, 1, 4, 0.2, 0.5), Kind(8.0, 1, 3, 0.06, 0.5))
"""From fast, short strokes, which show gears and delays, to wide and to slow ones, which show springs and friction."""
_DRAWN = 6
"""Parts of each kind to choose from, and draws of each until one lies within limits and workspace."""


@dataclass(frozen=True)
class Part:
    """One Fourier motion of the plan."""

    kind: Kind
    motion: FourierMotion


@dataclass(frozen=True)
class Parts:
    """Parts in their order, and where the arm rests before.

    Attributes:
        robot: the arm.
        start: posture at rest ``(n,)`` [rad].
        parts: one after the other.
    """

    robot: Robot
    start: Array
    parts: tuple[Part, ...] = ()

    def commands(self) -> Array:
        """Commands ``(N, n)`` [rad] every interpolation cycle, from rest to rest."""
        v_max, a_max = finite_limits(self.robot)
        here, rows = self.start, [np.repeat(self.start[None], _rest(self.robot.t_ipo), axis=0)]
        for part in self.parts:
            q = played(part, self.robot.t_ipo)
            rows += [approach(here, q[0], self.robot.t_ipo, v_max, a_max), q]
            here = q[-1]
        return np.concatenate(rows)

    @property
    def seconds(self) -> float:
        """How long it takes [s]."""
        return len(self.commands()) * self.robot.t_ipo


def played(part: Part, t_ipo: float) -> Array:
    """Commands ``(N, n)`` [rad] of one part with the rests before and after it."""
    t = np.asarray(t_ipo * np.arange(float(round(part.kind.seconds / t_ipo) + 1)))
    q = part.motion.at(t)[0]
    hold = _rest(t_ipo)
    return np.concatenate([np.repeat(q[:1], hold, axis=0), q, np.repeat(q[-1:], hold, axis=0)])


def _rest(t_ipo: float) -> int:
    """Cycles of rest before and after each part: as long as the filters of a diagnosis remember."""
    return max(1, round(MEMORY / CUTOFF / t_ipo))


class MotionSearch:
    """Chooses parts that together are worth most.

    Args:
        robot: the arm, with its limits.
        start: posture at rest before ``(n,)`` [rad].
        workspace: where tool and links may go.
        longest: the motion may take [s].
        rng: draws the parts.
    """

    def __init__(self, robot: Robot, start: Array, workspace: Workspace, longest: float,
                 rng: np.random.Generator) -> None:
        self.robot, self.start, self.workspace, self.longest, self.rng = robot, start, workspace, longest, rng
        self.spaces = {kind: MotionSpace(robot, kind.period, kind.harmonics, workspace, kind.speed, kind.acceleration,
                                         0.9) for kind in KINDS if kind.seconds < longest}

    def best(self, told: Callable[[Part], Any], worth: Callable[[Sequence[Any]], float], enough: float,
             progress: Progress = silent) -> Parts:
        """The parts whose worth together is largest, no more of them than are needed.

        Args:
            told: what a part tells by itself.
            worth: of what several tell together.
            enough: worth from which on no more parts are added.
            progress: called with the share done and a word.

        Raises:
            InputError: nothing lies within limits and workspace.
        """
        pool: list[tuple[Part, Any]] = []
        kinds = [kind for kind in self.spaces for _ in range(_DRAWN)]
        for k, kind in enumerate(kinds):
            progress(0.6 * k / len(kinds), "motions to choose from")
            part = self._drawn(kind)
            if part is not None:
                pool.append((part, told(part)))
        chosen: list[tuple[Part, Any]] = []
        value = -np.inf
        while value < enough:
            longer = [(worth([told_ for _, told_ in [*chosen, one]]), i) for i, one in enumerate(pool)
                      if self._fits([*chosen, one])]
            if not longer or max(longer)[0] <= value:
                break
            value, i = max(longer)
            chosen.append(pool[i])
        if not chosen:
            raise InputError("no motion within the limits, the workspace and the time was found; relax the workspace "
                             "or allow more time", field="length", value=self.longest)
        # Of the chosen parts as many changes as motions were drawn.
        for k in range(len(kinds) if value < enough else 0):
            progress(0.6 + 0.4 * k / len(kinds), "refining")
            i = int(self.rng.integers(len(chosen)))
            changed = self._changed(chosen[i][0])
            if changed is None:
                continue
            tried = [*chosen[:i], (changed, told(changed)), *chosen[i + 1 :]]
            reached = worth([told_ for _, told_ in tried])
            if reached > value and self._fits(tried):
                chosen, value = tried, reached
        return Parts(self.robot, self.start, tuple(part for part, _ in chosen))

    def _fits(self, chosen: Sequence[tuple[Part, Any]]) -> bool:
        return Parts(self.robot, self.start, tuple(part for part, _ in chosen)).seconds <= self.longest

    def _drawn(self, kind: Kind) -> Part | None:
        # Half of them near where the arm is, so that little time is lost on the way.
        centre = self.start if self.rng.random() < 0.5 else None
        for _ in range(_DRAWN):
            coefficients = self.rng.uniform(-1, 1, (2, kind.harmonics, self.robot.n))
            motion = self.spaces[kind].scaled(coefficients, self.rng, centre)
            if motion is not None:
                return Part(kind, motion)
        return None

    def _changed(self, part: Part) -> Part | None:
        """The part with coefficients a little different, about the same posture."""
        coefficients = np.stack([part.motion.a, part.motion.b])
        step = self.rng.normal(scale=0.3, size=coefficients.shape) * np.abs(coefficients).max(axis=(0, 1))
        motion = self.spaces[part.kind].scaled(coefficients + step, self.rng, part.motion.centre)
        return None if motion is None else Part(part.kind, motion)


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
        # Five samples a period of what the position filter lets through.
        grid = np.arange(0.0, t[-1], min(1.0 / (5.0 * CUTOFF), case.robot.t_ipo))
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
        nominal = plain.filtered.decimate(plain.signals.torque)
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
        made = position_regressions(recording, self.case.robot, in_position_band(torque, recording),
                                    self.case.stiffness)
        return next(one for one in made if one.domain == domain)
