"""Signs of life of a sensor: what it tells changes, has the noise it has at rest, and does not leap.

One check for whatever tells a vector of numbers again and again. It knows nothing of what the numbers mean; who asks
says by how much they may change from one reading to the next, and what the sensor showed while nothing happened.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from ideal_robot.arrays import Array

STUCK = 25
"""Readings in a row without the least change after which a sensor counts as stuck: a sound one has noise."""
QUIET, HEARD = 0.001, 8
"""Share of its noise's power at rest below which a channel is dead, and changes from reading to reading of which that
is the mean. Of a live one it is so small once in 10¹¹ times (χ² with 8 degrees of freedom)."""
FAR = 8.0
"""Standard deviations of its noise that a sensor leaps by in addition to what it may change by."""
CONTRADICTS, REFUSED = 2.5, 10.0
"""Mean normalised innovation squared for each value above which readings contradict the motion, and what counts for
readings that a filter refused. With 40 values noise alone comes so far once in 10⁶ times (χ²)."""
TOGETHER = 16
"""Innovations whose mean that is."""
LEAPS = 3
"""Readings in a row behind a leap after which it is none that passes."""


class LifeSigns:
    """Looks at every reading of one sensor; readings that cannot be count as missing.

    Args:
        largest: largest absolute value that a reading can have.

    Attributes:
        noise: standard deviation of each channel while nothing happens ``(n,)``; None while it is not known.
        stuck, impossible, leapt, quiet: readings that count as missing, by cause.
        fault: why what comes is not to be trusted any more; None while it is.
    """

    def __init__(self, largest: float) -> None:
        self.noise: Array | None = None
        self.stuck = self.impossible = self.leapt = self.quiet = 0
        self.fault: str | None = None
        self._largest = largest
        self.begin()

    def begin(self) -> None:
        """What came before has nothing to do with what comes."""
        self._alike = self._leaps = 0
        self._last: Array | None = None
        self._sound: Array | None = None
        self._changes: deque[Array] = deque(maxlen=HEARD)
        self._innovations: deque[float] = deque(maxlen=TOGETHER)

    def learn(self, rests: list[Array]) -> None:
        """Takes the noise from readings ``(N, n)`` of stretches in which nothing happened."""
        steps = np.concatenate([np.diff(rows, axis=0) for rows in rests])
        self.noise = np.sqrt(np.mean(steps**2, axis=0) / 2.0)

    def check(self, values: Array, reach: Array | float = np.inf) -> bool:
        """Whether a reading can be.

        Args:
            values: of each channel ``(n,)``.
            reach: by how much each may change from the last sound reading to this ``(n,)``; inf where nobody knows.
        """
        if not (np.abs(values) < self._largest).all():
            self.impossible += 1
            return False
        change = np.full(len(values), np.nan) if self._last is None else values - self._last
        self._last = values
        self._alike = 0 if change.any() else self._alike + 1
        if self._alike >= STUCK:
            self.stuck += 1
            return False
        if self.noise is None:
            return True
        self._changes.append(change)
        if len(self._changes) == self._changes.maxlen:
            dead = np.mean(np.square(self._changes), axis=0) < 2.0 * QUIET * self.noise**2
            if dead.any():
                self.quiet += 1
                self.fault = (f"channel {int(np.argmax(dead)) + 1} has lost the noise that it has at rest; "
                              "it does not feel any more")
                return False
        return self._near(values, reach)

    def fits(self, innovation: float) -> None:
        """Takes how well a reading fits what the arm's motion lets expect, and finds the fault where many do not.

        Args:
            innovation: normalised and squared, for each value; 1 on average; NaN where it was refused.
        """
        self._innovations.append(REFUSED if np.isnan(innovation) else min(innovation, REFUSED))
        mean = float(np.mean(self._innovations))
        if len(self._innovations) == TOGETHER and mean > CONTRADICTS:
            self.fault = self.fault or ("what it tells does not change as the arm moves (innovations "
                                        f"{mean:.1f} times as large as their variance)")

    def _near(self, values: Array, reach: Array | float) -> bool:
        """Whether a reading is near the last sound one; one that leaps and comes back is missing, no more."""
        if self._sound is not None and self.noise is not None:
            leap = np.abs(values - self._sound)
            if (leap > reach + FAR * self.noise).any():
                channel = int(np.argmax(leap - reach))
                self.leapt, self._leaps = self.leapt + 1, self._leaps + 1
                if self._leaps >= LEAPS:
                    possible = np.broadcast_to(reach, leap.shape)[channel]
                    self.fault = self.fault or (f"channel {channel + 1} leaps by {leap[channel]:.3g} from one reading "
                                                f"to the next, where {possible:.3g} is possible")
                return False
        self._leaps, self._sound = 0, values
        return True

    @property
    def missing(self) -> list[str]:
        """What was left out, in words."""
        counts = ((self.stuck, "stuck"), (self.impossible, "impossible"), (self.leapt, "leapt"),
                  (self.quiet, "without noise"))
        return [f"{number} {what}" for number, what in counts if number]
