"""Signs of life of a sensor: it changes, has noise, does not leap, fits and answers the arm's motion, stamps evenly.

One check for whatever tells a vector of numbers again and again. It knows nothing of what the numbers mean; who asks
says by how much they may change from one reading to the next, and what the sensor showed while nothing happened.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from statistics import median

import numpy as np
from scipy.special import chdtri, ndtr, stdtrit

from ideal_robot.arrays import Array

STUCK = 25
"""Readings in a row without the least change after which a sensor counts as stuck: a sound one has noise."""
QUIET, HEARD = 0.001, 8
"""Share of its noise's power at rest below which a channel is dead, and changes from reading to reading of which that
is the mean. Of a live one it is so small once in 10¹¹ times (χ² with 8 degrees of freedom)."""
FAR = 8.0
"""Standard deviations of its noise that a sensor leaps by in addition to what it may change by."""
BY_CHANCE, REFUSED = 1e-7, 10.0
"""Probability with which readings contradict the motion by noise alone, and the normalised innovation squared that
counts for readings that a filter refused."""
TOGETHER = 16
"""Innovations whose sum is looked at: χ² of all their values, where noise alone is in them."""
ASKED_FOR, ANSWERED, ERRORS = 0.2, 0.5, 4.0
"""Time over which a sensor is asked [s], share of what is asked that a live one answers at least, and standard errors
by which an answer has to be less: one that answers all of it is twice as far away by chance."""
_CUBIC, _RESTS = 4, 0.02
"""Coefficients of what a surface takes away, and how fast a tip at rest goes on along its way [m/s]: slower than any
that travels."""
REDDEST = 0.98
"""Largest colour: the 80 readings at rest in which noise is heard tell no slower one from a bias."""
STAMPS, FEWEST = 50, 20
"""Messages from which it is judged how even their stamps are, at most and at least."""
UNEVEN, SURELY = 0.001, 4.0
"""Standard deviation that stamps may have [s], a millimetre at 1 m/s, and standard errors that it has to be beyond."""
STRETCHES = 5
"""Stretches of those messages: what happens once falls into two of them at most."""
LEAPS = 3
"""Readings in a row behind a leap after which it is none that passes."""


class LifeSigns:
    """Looks at every reading of one sensor, whose ``channels`` have names; readings that cannot be count as missing.

    None of them can be ``largest`` or more.

    Attributes:
        noise: standard deviation of each channel while nothing happens ``(n,)``; None while it is not known.
        colour: correlation of a reading's noise with that of the reading before, mean of the channels: one device
            filters them all alike.
        stuck, impossible, leapt, quiet: readings that count as missing, by cause.
        fault: why what comes is not to be trusted any more; None while it is.
        answered: least share of what it was asked that it answered, ``ERRORS`` standard errors above.
    """

    def __init__(self, largest: float, channels: Sequence[str]) -> None:
        self.noise: Array | None = None
        self.colour = 0.0
        self.stuck = self.impossible = self.leapt = self.quiet = 0
        self.fault: str | None = None
        self.answered = np.inf
        self._largest, self._channels = largest, channels
        self._times, self._stamps = np.zeros((STAMPS, 2)), 0
        self.begin()

    def begin(self) -> None:
        """What came before has nothing to do with what comes."""
        self._alike = self._leaps = 0
        self._last: Array | None = None
        self._sound: Array | None = None
        self._changes: deque[Array] = deque(maxlen=HEARD)
        self._innovations: deque[tuple[float, int]] = deque(maxlen=TOGETHER)
        self._asked = np.zeros((0, 4))

    def learn(self, rests: list[Array]) -> None:
        """Takes the noise and its colour from readings ``(N, n)`` of stretches in which nothing happened."""
        steps = np.concatenate([np.diff(rows, axis=0) for rows in rests])
        self.noise = np.sqrt(np.mean(steps**2, axis=0) / 2.0)
        apart = [rows - rows.mean(axis=0) for rows in rests]
        alike = sum(np.sum(rows[1:] * rows[:-1], axis=0) for rows in apart)
        power = sum(np.sum(rows**2, axis=0) for rows in apart)
        self.colour = float(np.clip(np.mean(alike / np.maximum(power, 1e-300)), 0.0, REDDEST))

    def check(self, values: Array, reach: Array | float = np.inf) -> bool:
        """Whether a reading ``(n,)`` can be.

        ``reach``: by how much each channel may change from the last sound reading ``(n,)``; inf where nobody knows.
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
                self.fault = (f"{self._channels[int(np.argmax(dead))]} has lost the noise that it has at rest; "
                              "it does not feel any more")
                return False
        return self._near(values, reach)

    def departs(self, innovation: float, most: float) -> None:
        """Takes by how much the first channel differs from what was expected of it, and by how much it may.

        Finds the fault where ``LEAPS`` readings in a row differ by more.
        """
        self._leaps = self._leaps + 1 if abs(innovation) > most else 0
        if self._leaps >= LEAPS:
            self.fault = self.fault or (f"{self._channels[0]} leaps by {abs(innovation):.3g} from where it should be, "
                                        f"where {most:.3g} is possible")

    def fits(self, innovation: float, values: int) -> None:
        """Takes how well a reading fits what the arm's motion lets expect, and finds the fault where many do not.

        ``innovation`` is normalised and squared, the mean of so many independent ``values``; NaN where it was refused.
        """
        size = REFUSED if np.isnan(innovation) else min(innovation, REFUSED)
        self._innovations.append((size * values, values))
        total, count = np.sum(self._innovations, axis=0)
        if len(self._innovations) == TOGETHER and total > chdtri(count, BY_CHANCE):
            self.fault = self.fault or ("what it reports does not change as the arm moves (innovations "
                                        f"{total / count:.1f} times as large as their variance)")

    def loudness(self, noise: float, frequency: float, pace: float) -> float:
        r"""Amplitude of a swing that is told from noise, of which ``noise`` was learned, within ``ASKED_FOR``.

        Of white noise σ, N samples tell an amplitude within :math:`\sigma \sqrt{2/N}`; of coloured noise the share that
        lies about the frequency counts,

        .. math:: \sigma_\omega^2 = \sigma^2 \frac{1 - \varphi^2}{1 - 2 \varphi \cos \omega T + \varphi^2}

        Args:
            noise: see ``noise``, in which differences leave out what successive readings have in common.
            frequency: ω/2π, at which it swings [Hz].
            pace: T, from reading to reading [s].
        """
        colour, turn = self.colour, 2.0 * np.pi * frequency * pace
        variance = noise**2 / (1.0 - colour) * (1.0 - colour**2) / (1.0 - 2.0 * colour * np.cos(turn) + colour**2)
        return float(ERRORS / ANSWERED * np.sqrt(variance * 2.0 * pace / ASKED_FOR))

    def swings(self, felt: Array) -> None:
        """Takes what a tip that swings on a surface felt, for ``answers``.

        Args:
            felt: instant [s], arc length [m], height [m] and force [N] of the last samples ``(m, 4)``.
        """
        samples = np.concatenate([self._asked, felt])
        self._asked = samples[samples[:, 0] > samples[-1, 0] - ASKED_FOR]

    def answers(self, stiffness: float, frequency: float) -> None:
        r"""Finds the fault where what was felt does not go with the height of the tip that swings.

        A surface is a matter of the place, so a cubic along the path takes it away, also where cycles are lost and the
        arm leaps in the path's time; while the tip rests it is one over time. What is left of the heights h shows in
        the forces f but for the stiffness E, by the share κ that the sensor answers:

        .. math:: f = \sum_{i=0}^{3} c_i w^i - \kappa E h + \nu, \qquad w = s + v_0 t, \qquad
                  \nu_k = \varphi \nu_{k-1} + \epsilon_k

        by least squares of what each sample adds to φ times the one before. Where the noise at rest has a colour, that
        is what tells a swing from chance.

        Args:
            stiffness: E of the contact [N/m].
            frequency: at which the tip swings [Hz].
        """
        t, s, height, force = self._asked.T
        if len(t) < 2 * (_CUBIC + 1):
            return
        w = s + _RESTS * t
        u = (w - w[-1]) / max(float(np.ptp(w)), 1e-9)
        rows = np.column_stack([u[:, None] ** np.arange(_CUBIC), -stiffness * height, force])
        step = np.maximum(np.diff(t), 1e-9)
        kept = self.colour ** (step / median(step.tolist()))
        rows[1:] = (rows[1:] - kept[:, None] * rows[:-1]) / np.sqrt(1.0 - kept[:, None] ** 2)
        known, _ = np.linalg.qr(rows[:, :_CUBIC])
        swing, felt = (rows[:, _CUBIC:] - known @ (known.T @ rows[:, _CUBIC:])).T
        power = max(float(swing @ swing), 1e-12)
        share = float(swing @ felt) / power
        freedom = len(t) - _CUBIC - 1
        error = float(np.linalg.norm(felt - share * swing)) / np.sqrt(power * freedom)
        # Student's t: of few samples the noise itself is not well known.
        self.answered = min(self.answered, share + float(stdtrit(freedom, ndtr(ERRORS))) * error)
        if self.answered < ANSWERED:
            self.fault = self.fault or (f"it answers {100.0 * max(share, 0.0):.0f} % of what the tip's swing on the "
                                        "surface makes; look whether it is alive, and what its filter leaves of "
                                        f"{frequency:.0f} Hz")

    def stamped(self, stamp: float, arrived: float) -> None:
        r"""Takes the stamp of a message and when it came [s], and finds the fault where stamps wander more than can be.

        What differs between the steps of both is their own noise, and of that the stamps' share

        .. math:: \sigma_s^2 = \tfrac12 \mathrm{cov}(\Delta s, \Delta s - \Delta a)

        whatever the sensor's own pace is. Messages that are delayed, and those lost behind them, move both for a while;
        stamps that wander do so all the time. So what counts is the median of stretches.
        """
        self._times[:-1] = self._times[1:]
        self._times[-1] = stamp, arrived
        self._stamps = min(self._stamps + 1, STAMPS)
        if self._stamps < FEWEST:
            return
        times = self._times[-self._stamps :]
        s, a = (times[1:] - times[:-1]).T
        own, pace = s - a, max(median(s.tolist()), 1e-6)
        own -= own.mean()
        # Where messages are lost steps are longer by whole ones: that is nothing uneven.
        s = s - pace * np.maximum(np.round(s / pace) - 1.0, 0.0)
        s = s - s.mean()
        begins = len(s) * np.arange(STRETCHES + 1) // STRETCHES
        variance = median((np.add.reduceat(s * own, begins[:-1]) / np.diff(begins)).tolist()) / 2.0
        # What both have in common, as where the sensor has a pace of its own, goes with their own noise by chance.
        common = max(float(s @ s) / len(s) - 2.0 * variance, 0.0)
        error = 0.5 * float(np.sqrt(common * (own @ own))) / len(s)
        if variance > UNEVEN**2 + SURELY * error:
            self.fault = self.fault or (f"its time stamps wander by {1e3 * np.sqrt(variance):.1f} ms, which its "
                                        "messages do not; look whose clock they are of")

    def _near(self, values: Array, reach: Array | float) -> bool:
        """Whether a reading is near the last sound one; one that leaps and comes back is missing, no more."""
        if self._sound is not None and self.noise is not None:
            leap = np.abs(values - self._sound)
            if (leap > reach + FAR * self.noise).any():
                channel = int(np.argmax(leap - reach))
                self.leapt, self._leaps = self.leapt + 1, self._leaps + 1
                if self._leaps >= LEAPS:
                    possible = np.broadcast_to(reach, leap.shape)[channel]
                    self.fault = self.fault or (f"{self._channels[channel]} leaps by {leap[channel]:.3g} from one "
                                                f"reading to the next, where {possible:.3g} is possible")
                return False
        self._leaps, self._sound = 0, values
        return True

    @property
    def missing(self) -> list[str]:
        """What was left out, in words."""
        counts = ((self.stuck, "stuck"), (self.impossible, "impossible"), (self.leapt, "leapt"),
                  (self.quiet, "without noise"))
        return [f"{number} {what}" for number, what in counts if number]
