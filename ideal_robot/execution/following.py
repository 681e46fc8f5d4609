r"""Checks whether an arm follows its commands: measured angles against those predicted by its loop.

The loop is approximately linear: with its impulse response ``g`` the expected motor angles are

.. math:: \hat q(k) = q_0 + \sum_{i=0}^{L-1} g_i\, (q_c(k - i) - q_c(0)),

and an arm that stands still though it is commanded to move with the speed ``v``, because it is paused or its brakes
have closed, is a distance of :math:`v\, t` beside them after the time ``t``; with an override of 30 % it is
:math:`0.7\, v\, t`. What differs by the loop not being known is a share of the way commanded within ``L``.

Where no loop was identified yet there is a table of them, each with a dead time and a lag. An arm follows as long as
one of them does that fitted its motion so far about as well as the best.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.execution.guard import PROVED, SEEN, Watch, accelerations, probed
from ideal_robot.jit import jit
from ideal_robot.robots.interface import TOLERANCE
from ideal_robot.robots.robot import Robot
from ideal_robot.tolerances import ROUNDING

SHARE = 0.1
"""Share of the way commanded while the loop answers that an arm may be beside what is expected: of a response of 0.3 s
these are 30 ms, two cycles of a slow controller."""
PATIENCE = 2
"""Cycles in a row after which a deviation counts."""
ANSWERS = 0.4
"""Time after which a loop has answered a command [s]."""
_STANDS = 0.1
"""Share of the way expected in the last cycles below which an arm counts as standing still."""
_DOUBTS = 0.5
"""Share of what is allowed beside what is expected from which on other things are not judged by the motion: a sound arm
hardly comes to it, and one that is paused is there after half of the time in which it is noticed."""
_SHOWS = 0.1
"""Time in which the way of a joint shows where it goes [s]."""
_PAUSED = 1.0 - 0.5 * SHARE * ANSWERS / _SHOWS
"""Share of its way which a joint of an arm that is being braked does not come to. By when a standstill can be noticed
it has lasted for ``SHARE * ANSWERS`` at least, so that such a joint has gone 0.6 of its way at most in ``_SHOWS``, and
one that follows all of it: this is the middle."""
_TURNS = 0.5
"""Share of its way by which a joint may go back that is paused, as a gear springs back: in the middle between one that
stands and one that goes the other way."""
_FOLLOWED = 3.0
"""Ways as large as the tolerance along which an arm that was on them has shown that it follows."""
_MOSTLY = 0.5
"""Share of the way commanded lately that a joint has gone which follows, lag included."""
_LAGS = (0.0, 0.005, 0.01, 0.02, 0.035, 0.055, 0.08, 0.12)
"""Time constants of loops that are not known [s]: position controllers have gains of 8 to 100 1/s, or feed the speed
forward."""
_DRIFTS = (1.2, 1.45)
"""Time constants over the identified lag that a loop may have come to: one maker's goes from 125 to 180 ms by duty."""
_DEAD, _DEADS = 0.05, 7
"""Longest dead time of such loops [s], and how many are tried at most."""
_REMEMBERED = 2.0
"""Time in which loops are compared by how they fit [s]."""
_AS_WELL = 0.1
"""Difference of the mean square of deviations, in units of what is allowed, by which loops fit equally well."""


class Answer(Protocol):
    """Interface of predictions of motor angles from commands, by every candidate loop."""

    def begin(self, command: Array) -> None:
        """Resets to a command ``(n,)`` [rad] that has been constant for long."""

    def step(self, command: Array) -> Array:
        """Predicted motor angles ``(C, n)`` [rad] at the end of a cycle with this command ``(n,)`` [rad]."""


class KnownLoop:
    """The ``Answer`` of an identified loop.

    Args:
        response: its impulse response of each joint ``(L, n)``, the first row of the instant of the command; a cycle
            ends one cycle behind its command.
    """

    def __init__(self, response: Array) -> None:
        self._response = response[1:] / response[1:].sum(axis=0)
        self._given = np.zeros_like(self._response)

    def begin(self, command: Array) -> None:
        """Resets to a command ``(n,)`` [rad] that has been constant for long; see ``Answer``."""
        self._given[:] = command

    def step(self, command: Array) -> Array:
        """Predicted motor angles ``(C, n)`` [rad] at the end of a cycle; see ``Answer``."""
        self._given[1:], self._given[0] = self._given[:-1].copy(), command
        return np.asarray(np.sum(self._response * self._given, axis=0))[None]


class AnyLoop:
    """The ``Answer`` of every loop in a table of dead times and lags.

    Args:
        n: number of joints.
        T: cycle [s].
        slower: further lags [s].
    """

    def __init__(self, n: int, T: float, slower: tuple[float, ...] = ()) -> None:
        self._dead = np.unique(np.round(np.linspace(0.0, _DEAD / T, _DEADS)).astype(int))
        lags = np.array([*_LAGS, *slower])
        self._share = (1.0 - np.where(lags > 0.0, np.exp(-T / np.maximum(lags, ROUNDING)), 0.0))
        self._given = np.zeros((self._dead[-1] + 1, n))
        self._answer = np.zeros((len(self._dead), len(lags), n))

    def begin(self, command: Array) -> None:
        """Resets to a command ``(n,)`` [rad] that has been constant for long; see ``Answer``."""
        self._given[:], self._answer[:] = command, command

    def step(self, command: Array) -> Array:
        """Predicted motor angles ``(C, n)`` [rad] at the end of a cycle; see ``Answer``."""
        return _answered(command, self._dead, self._share, self._given, self._answer)


@jit()
def _answered(command: Array, dead: Array, share: Array, given: Array, answer: Array) -> Array:
    """``AnyLoop.step``: angles expected by dead time and lag ``(D L, n)``.

    Args:
        command: in force ``(n,)``.
        dead, share: dead times in cycles ``(D,)``, and by lag the share of the way that is gone in a cycle ``(L,)``.
        given, answer: commands, newest first ``(m, n)``, and what was expected before ``(D, L, n)``; both go on.
    """
    D, L, n = answer.shape
    expected = np.empty((D * L, n))
    for j in range(n):
        for i in range(len(given) - 1, 0, -1):
            given[i, j] = given[i - 1, j]
        given[0, j] = command[j]
        for d in range(D):
            for i in range(L):
                answer[d, i, j] += share[i] * (given[dead[d], j] - answer[d, i, j])
                expected[d * L + i, j] = answer[d, i, j]
    return expected


@jit()
def _compared(command: Array, q: Array, expected: Array, tolerance: float, forgets: float, given: Array,
              measured: Array, likely: Array, unfit: Array) -> tuple[Array, Array, Array]:
    """How far an arm is beside what is expected, by the likeliest loop that fits best.

    Args:
        command, q: in force and measured ``(n,)``.
        expected: at the end of this cycle by every loop ``(C, n)``.
        tolerance: at rest.
        forgets: share of the past that is forgotten in a cycle.
        given, measured, likely: commands, measured angles and those expected by that loop, newest first ``(m, n)``; all
            go on.
        unfit: mean square of deviations, in units of what is allowed ``(C, n)``; goes on.

    Returns the deviation in units of what is allowed, and the ways of commands and arm that are known ``(n,)`` each.
    """
    C, n = expected.shape
    least, commanded, moved = np.empty(n), np.empty(n), np.empty(n)
    for j in range(n):
        low, high, near, far = command[j], command[j], q[j], q[j]
        for i in range(len(given) - 1, 0, -1):
            given[i, j], measured[i, j], likely[i, j] = given[i - 1, j], measured[i - 1, j], likely[i - 1, j]
            low, high = min(low, given[i, j]), max(high, given[i, j])
            near, far = min(near, measured[i, j]), max(far, measured[i, j])
        given[0, j], measured[0, j] = command[j], q[j]
        commanded[j], moved[j] = high - low, far - near
        allowed = tolerance + SHARE * (high - low)
        best = np.inf
        for c in range(C):
            best = min(best, unfit[c, j])
        least[j] = np.inf
        for c in range(C):
            off = abs(q[j] - expected[c, j]) / allowed
            if unfit[c, j] <= best + _AS_WELL and off < least[j]:
                least[j], likely[0, j] = off, expected[c, j]
            # A fault must not change which loop is the likeliest, so its influence is bounded.
            unfit[c, j] += forgets * (min(off, 1.0)**2 - unfit[c, j])
    return least, commanded, moved


class Both:
    """Predictions of several loops at once: of the identified one, and of every loop of the table.

    Args:
        known, table: the two predictions; their rows are stacked.
    """

    def __init__(self, known: KnownLoop, table: AnyLoop) -> None:
        self._both = known, table

    def begin(self, command: Array) -> None:
        """Resets to a command ``(n,)`` [rad] that has been constant for long; see ``Answer``."""
        for one in self._both:
            one.begin(command)

    def step(self, command: Array) -> Array:
        """Predicted motor angles ``(C, n)`` [rad] at the end of a cycle; see ``Answer``."""
        return np.concatenate([one.step(command) for one in self._both])


def _slower(response: Array, T: float) -> tuple[float, ...]:
    """Lags [s] beyond the table's to which an identified loop may drift.

    Args:
        response: impulse response of each joint ``(L, n)``.
        T: cycle [s].
    """
    lag = T * float(np.max(np.arange(float(len(response))) @ response / response.sum(axis=0)))
    return tuple(factor * lag for factor in _DRIFTS if factor * lag > _LAGS[-1])


class Following(Watch):
    """The watch that checks whether the arm follows its commands.

    Args:
        commanded: gives the joint angles in force at the controller ``(n,)`` [rad].
        robot: units, limits and cycle.
        response: impulse response of its loop, see ``KnownLoop``; None where none was identified.
        sure: whether that is the loop of this arm, as it is now, and not of one of its type.
        tolerance: largest deviation from the prediction at rest [rad].
        cause: describes the motion of a joint, counted from 0, that does not follow and does not stand still.
        paused: whether the controller itself reports that it does not execute commands; then the arm stands still.

    Without a reliable loop only joints are checked that have followed once.

    Attributes:
        unread: readings further from the last than an arm can move, which were not used.
    """

    def __init__(self, commanded: Callable[[], Array], robot: Robot, response: Array | None, *,
                 sure: bool = True, tolerance: float = TOLERANCE, cause: Callable[[int], str] | None = None,
                 paused: Callable[[], bool] = lambda: False) -> None:
        self._T = T = robot.t_ipo
        self._commanded, self._units, self._cause, self._paused = commanded, robot.units("rad"), cause, paused
        self._answer: Answer = AnyLoop(robot.n, T) if response is None else (
            KnownLoop(response) if sure else Both(KnownLoop(response), AnyLoop(robot.n, T, _slower(response, T))))
        v_max = np.where(np.isfinite(robot.v_max), robot.v_max, np.inf)
        self._a_max = accelerations(robot)
        self._brakes = 0.0
        self._jump, self._usual = np.maximum(3.0 * v_max * T, np.radians(1.0)), tolerance
        self._probed = min(probed(np.where(np.isfinite(robot.a_max), robot.a_max, np.inf), T), tolerance)
        self._forgets, self._unfit = T / _REMEMBERED, np.zeros((1, robot.n))
        rows = max(round(ANSWERS / T), 4)
        self._given, self._expected, self._measured = (np.zeros((rows, robot.n)) for _ in range(3))
        self._rest: Array | None = None
        self._beyond = self.unread = self._jumped = self._braked = 0
        self._pace: Array = np.zeros(robot.n)
        self._said_of = 0, ""
        self._doubt = 0.0
        self._followed = np.full(robot.n, response is not None and sure)
        self._proved = np.zeros(robot.n, dtype=bool)
        self._noticed = self._astray = self._still = self._trying = self._lost = False
        # A first call loads compiled code before an arm waits for it: compiling within a cycle takes a second.
        self._begin(rest := np.zeros(robot.n))
        expected = self._answer.step(rest) + rest
        _compared(rest, rest, expected, self._tolerance, self._forgets, self._given, self._measured, self._expected,
                  np.zeros_like(expected))

    def look(self, t: float, q_c: Array, q: Array) -> str | None:
        """Why a motion has to end after this cycle; None where it may continue; see ``Watch.look``."""
        command = self._commanded()
        if self._rest is None:
            self._rest = q - command
            self._begin(command)
        if self._lost:
            return None
        if self._paused():
            self._measured[1:], self._measured[0] = self._measured[:-1].copy(), q
            self._noticed = self._astray = self._still = True
            return None
        leap = np.abs(q - self._measured[0])
        if (leap > self._jump * (1 + self._jumped)).any():
            # One such reading is treated as missing; a second means that the encoder, or the arm, is elsewhere.
            self.unread, self._jumped = self.unread + 1, self._jumped + 1
            joint = int(np.argmax(leap / self._jump))
            # Commands do not move to an impossible measured position.
            self._lost, self._astray = self._jumped >= PATIENCE, False
            return None if not self._lost else (
                f"the measured position of joint {joint + 1} jumped by {self._size(leap[joint], joint)}")
        self._jumped = 0
        expected = self._answer.step(command) + self._rest
        if len(self._unfit) != len(expected):
            self._unfit = np.zeros_like(expected)
        beside, *ways = _compared(command, q, expected, self._tolerance, self._forgets, self._given, self._measured,
                                  self._expected, self._unfit)
        least = np.where(self._followed, beside, 0.0)
        self._doubt = float(least.max())
        if (reason := self._goes_on()) is not None:
            return reason
        self._beyond = self._beyond + 1 if (least > 1.0).any() else 0
        if self._beyond < PATIENCE:
            self._moved(beside, *ways)
            return None
        return self._said(int(np.argmax(least)), q)

    def _goes_on(self) -> str | None:
        """The message about an arm that seemed to be braked and moves on; None for any other."""
        # During the trial of the path a joint may start late because of friction: the trial is then repeated.
        if self._trying or not (self._noticed and self._still and self._braked * self._T < self._brakes):
            return None
        self._braked += 1
        joint, text = self._said_of
        rows = self._rows
        moves = float(np.ptp(self._measured[: rows + 1, joint]))
        if self._braked * self._T < self._brakes or moves <= max(_STANDS * self._pace[joint] * rows * self._T, SEEN):
            return None
        self._still = False
        return text

    def _moved(self, least: Array, given: Array, measured: Array) -> None:
        """Takes note of joints that are where they are expected, and of how far commands and arm have moved."""
        enough = (given > _FOLLOWED * self._usual) & (measured > _MOSTLY * given)
        self._proved |= enough & (least < 1.0)
        self._followed |= self._proved
        if self._trying and (np.abs(self._expected[0] - self._expected[-1]) > PROVED * self._probed).any():
            self._trying = False

    @property
    def _tolerance(self) -> float:
        return self._probed if self._trying else self._usual

    @property
    def stands(self) -> Array | None:
        """Command ``(n,)`` [rad] of the place where an arm stands that has left its commands; see ``Watch``."""
        return self._measured[0] - self._rest if self._astray and self._rest is not None else None

    @property
    def unsure(self) -> bool:
        """Whether the motion may differ from its commands, so that other checks cannot rely on them; see ``Watch``."""
        return self._doubt > _DOUBTS

    @property
    def passes(self) -> bool:
        """Whether the finding may pass by itself, as an arm that stands still may only be paused; see ``Watch``."""
        return self._still

    def begin_again(self) -> None:
        """Restarts the check with the arm at rest at its commands, after a finding that may pass; see ``Watch``."""
        if self._rest is not None:
            self._begin(self._commanded())
            self._trying = self._still

    def _begin(self, command: Array) -> None:
        """The arm rests where it is commanded to."""
        rest = np.zeros_like(command) if self._rest is None else self._rest
        self._answer.begin(command)
        self._given[:], self._measured[:], self._expected[:] = command, command + rest, command + rest
        self._beyond, self._noticed, self._astray = 0, False, False

    def _said(self, joint: int, q: Array) -> str:
        """What the last cycles look like."""
        if not self._noticed:
            self._pace = np.ptp(self._expected[: PATIENCE + 1], axis=0) / (PATIENCE * self._T)
            # Time to brake with full acceleration, after which it is known whether the arm stands still.
            self._brakes = float(np.max(self._pace / self._a_max)) + _SHOWS
            self._astray = self._behind(joint)
            # A joint that still moves may be coming to rest. During the trial of the path, one that starts late because
            # of friction gets another trial.
            followed = bool(self._proved[joint] or self._trying or (self._proved.any() and self._all_behind()))
            self._noticed, self._still, self._braked = True, followed and self._astray, 0
            off = abs(q[joint] - self._expected[0, joint])
            self._said_of = joint, self._other(joint, off)
        off = abs(q[joint] - self._expected[0, joint])
        if not self._still:
            return self._other(joint, off)
        return (f"joint {joint + 1} is {self._size(off, joint)} beside where its command leads and stands still; look "
                "whether the controller is paused or stopped")

    def _other(self, joint: int, off: float) -> str:
        """The message about a joint that moves, and is ``off`` [rad] from where it should be."""
        if self._cause is not None:
            return self._cause(joint)
        return (f"joint {joint + 1} is {self._size(off, joint)} beside where its command leads and does not follow it; "
                "look at the controller's override, the model, the cycle, and what stands in the way")

    def _all_behind(self) -> bool:
        """Whether no joint that is to move goes as far as it should: the arm as a whole is paused."""
        moved, expected = (np.abs(known[0] - known[: self._rows + 1][-1])
                           for known in (self._measured, self._expected))
        return bool((moved[expected > SEEN] < _PAUSED * expected[expected > SEEN]).all())

    @property
    def _rows(self) -> int:
        """Cycles in which the way of a joint shows."""
        return max(round(_SHOWS / self._T), PATIENCE + 1)

    def _behind(self, joint: int) -> bool:
        """Whether a joint stands, or goes where its command leads, less far.

        The command of one that goes the other way, or further, would be led astray by where that joint is.
        """
        moved, expected = (float(known[0, joint] - known[: self._rows + 1][-1, joint])
                           for known in (self._measured, self._expected))
        # The displacement of a joint that was to reverse in that time does not show yet whether it follows.
        return abs(moved) <= SEEN or -_TURNS * expected**2 <= moved * expected <= expected**2

    def _size(self, value: float, joint: int) -> str:
        return f"{np.degrees(value):.2f}°" if self._units[joint] == "rad" else f"{1e3 * value:.2f} mm"
