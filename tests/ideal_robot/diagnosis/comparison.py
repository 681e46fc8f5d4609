"""Two causes held against each other on one recording: by how much one explains it better."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.diagnosis import stages
from ideal_robot.diagnosis.case import Case
from ideal_robot.diagnosis.next_motion.questions import Causes
from ideal_robot.diagnosis.search.choice import Options, Scored
from ideal_robot.diagnosis.search.forward_selection import silent
from ideal_robot.effects import MOTOR_TORQUE, library
from ideal_robot.identification.checks import checked
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording

_AHEAD = 2.0
"""Standard errors of the difference over blocks of time from which one is ahead, as the diagnosis itself has it."""
_RIVAL, _NEARLY = 0.8, 0.9
"""Share of the better one's reduction from which another that is not clearly behind, and any other, stays its rival."""


@dataclass(frozen=True)
class Comparison:
    """One cause against another.

    Attributes:
        ahead: difference of what they take away from blocks left out of the fit, in standard errors; negative where the
            second takes away more.
        reached: share of the better one's reduction that the other reaches.
    """

    ahead: float
    reached: float

    @property
    def open(self) -> bool:
        """Whether the recording does not say which of the two it is: the diagnosis would name the other as a rival."""
        return self.reached > _NEARLY or (self.reached >= _RIVAL and abs(self.ahead) < _AHEAD)

    @property
    def told_apart(self) -> bool:
        """Whether the first is ahead, and the second no rival of it."""
        return self.ahead > 0.0 and not self.open


def compared(recording: Recording, robot: Robot, first: tuple[str, int],
             seconds: Sequence[tuple[str, int]]) -> dict[tuple[str, int], Comparison]:
    """Holds a cause of the motor torque against others, each fitted alone together with the model's parameters.

    Args:
        recording: what was measured.
        robot: the arm it was measured on.
        first: name and joint (from 1; 0 for the whole arm) of the one.
        seconds: of the others; those that do not show at all are left out.
    """
    (recording,), _ = checked([recording], robot)
    case = Case(recording, robot, None, None, Options(), np.random.default_rng(0), silent, shared=True, only=None)
    causes = Causes(stages.baseline(case, stages.prepared(case, ())).problem, case.options)
    own = _scored(causes, first)
    result = {}
    for second in seconds:
        other = _scored(causes, second)
        if other is not None:
            result[second] = _against(own, other)
    return result


def _scored(causes: Causes, cause: tuple[str, int]) -> Scored | None:
    effects = [e for e in library() if e.name == cause[0] and e.domain == MOTOR_TORQUE]
    return causes.best(causes.pool(effects, cause[1]))


def _against(own: Scored | None, other: Scored) -> Comparison:
    nothing: Array = np.zeros_like(other.test.reduction)
    mine, theirs = nothing if own is None else own.test.reduction, other.test.reduction
    difference = mine - theirs
    difference = difference[np.isfinite(difference)]
    error = float(np.std(difference, ddof=1)) * np.sqrt(len(difference)) + 1e-300
    totals = sorted(max(float(np.nansum(values)), 0.0) for values in (mine, theirs))
    return Comparison(float(difference.sum()) / error, totals[0] / max(totals[1], 1e-300))
