r"""Whether an arm goes where its commands lead: the measured angles against those that its loop makes of the commands.

The loop is linear enough for that: with its impulse response ``g`` the motor angles expected are

.. math:: \hat q(k) = q_0 + \sum_{i=0}^{L-1} g_i\, (q_c(k - i) - q_c(0)),

and an arm that stands still though it is commanded to move with the speed ``v``, because it is paused or its brakes
have closed, is a distance of :math:`v\, t` beside them after the time ``t``; with an override of 30 % it is
:math:`0.7\, v\, t`. What differs by the loop not being known is a share of the way commanded within ``L``.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.execution.guard import Watch
from ideal_robot.robots.interface import TOLERANCE

SHARE = 0.1
"""Share of the way commanded while the loop answers that an arm may be beside what is expected: of a response of 0.3 s
these are 30 ms, two cycles of a slow controller."""
PATIENCE = 2
"""Cycles in a row after which a deviation counts."""
_STANDS = 0.1
"""Share of the way expected in the last cycles below which an arm counts as standing still."""


class Following(Watch):
    """The arm's following among its watches.

    Args:
        commanded: gives the joint angles in force at the controller ``(n,)`` [rad].
        response: impulse response of the loop of each joint ``(L, n)``, its first row of the instant of the command;
            a cycle ends one cycle behind its command.
        names: of the joints' units, rad or m; see ``Robot.units``.
    """

    def __init__(self, commanded: Callable[[], Array], response: Array, names: tuple[str, ...]) -> None:
        self._commanded, self._response = commanded, response[1:] / response[1:].sum(axis=0)
        self._units = names
        self._given: Array | None = None
        self._measured = np.zeros_like(self._response)
        self._rest = np.zeros(response.shape[1])
        self._beyond, self._astray = 0, False

    def look(self, t: float, q_c: Array, q: Array) -> str | None:
        """See ``Watch.look``."""
        command = self._commanded()
        if self._given is None:
            self._given = np.tile(command, (len(self._response), 1))
            self._measured[:], self._rest = q, q - command
        self._given[1:], self._given[0] = self._given[:-1].copy(), command
        self._measured[1:], self._measured[0] = self._measured[:-1].copy(), q
        off = q - self._rest - np.sum(self._response * self._given, axis=0)
        beyond = np.abs(off) - TOLERANCE - SHARE * np.ptp(self._given, axis=0)
        self._beyond = self._beyond + 1 if (beyond > 0.0).any() else 0
        self._astray = self._astray or self._beyond >= PATIENCE
        return self._said(off, int(np.argmax(beyond))) if self._beyond >= PATIENCE else None

    @property
    def stands(self) -> Array | None:
        """See ``Watch``."""
        return self._measured[0] - self._rest if self._astray else None

    def _said(self, off: Array, joint: int) -> str:
        """What the last cycles look like."""
        given = self._given
        moved = np.ptp(self._measured[: PATIENCE + 1], axis=0)
        expected = np.zeros_like(moved) if given is None else np.ptp(given[: PATIENCE + 1], axis=0)
        still = moved[joint] <= _STANDS * expected[joint]
        unit = self._units[joint]
        size = f"{abs(np.degrees(off[joint])):.2f}°" if unit == "rad" else f"{1e3 * abs(off[joint]):.2f} mm"
        what = "stands still; look whether the controller is paused or stopped" if still else (
            "does not follow it; look at the controller's override, the model, the cycle, and what stands in the way")
        return f"joint {joint + 1} is {size} beside where its command leads and {what}"
