"""Checks that a sensor works: it changes, has noise, does not jump, agrees with the arm's motion, stamps evenly.

One check serves every sensor that delivers a vector of numbers. It does not use their meaning; the caller gives the
largest change between readings and readings at rest.
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
    """Checks every reading of one sensor with named ``channels``; implausible readings are treated as missing.

    A value of ``largest`` or more is implausible.

    Attributes:
        noise: standard deviation of each channel while nothing happens ``(n,)``; None while it is not known.
        colour: correlation of a reading's noise with that of the reading before, mean of the channels: one device
            filters them all alike.
        stuck, impossible, leapt, quiet: numbers of readings that are treated as missing, by cause.
        fault: why the sensor's readings are not trusted any more; None while they are.
        answered: smallest share of the test motion that the sensor has shown, plus ``ERRORS`` standard errors.
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
        """Forgets the last readings, so that the next one is not compared with them."""
        self._alike = self._leaps = 0
        self._last: Array | None = None
        self._sound: Array | None = None
        self._changes: deque[Array] = deque(maxlen=HEARD)
        self._innovations: deque[tuple[float, int]] = deque(maxlen=TOGETHER)
        self._asked = np.zeros((0, 4))

    def learn(self, rests: list[Array]) -> None:
        """Learns the noise and its correlation from readings ``(N, n)`` of intervals at rest."""
        steps = np.concatenate([np.diff(rows, axis=0) for rows in rests])
        self.noise = np.sqrt(np.mean(steps**2, axis=0) / 2.0)
        apart = [rows - rows.mean(axis=0) for rows in rests]
        alike = sum(np.sum(rows[1:] * rows[:-1], axis=0) for rows in apart)
        power = sum(np.sum(rows**2, axis=0) for rows in apart)
        self.colour = float(np.clip(np.mean(alike / np.maximum(power, 1e-300)), 0.0, REDDEST))

    def check(self, values: Array, reach: Array | float = np.inf) -> bool:
        """Whether a reading ``(n,)`` is plausible.

        ``reach``: largest change of each channel from the last plausible reading ``(n,)``; inf where it is not known.
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
        """Adds the first channel's difference from its prediction and the largest one that is plausible.

        Finds the fault where ``LEAPS`` readings in a row differ by more.
        """
        self._leaps = self._leaps + 1 if abs(innovation) > most else 0
        if self._leaps >= LEAPS:
            self.fault = self.fault or (f"{self._channels[0]} leaps by {abs(innovation):.3g} from where it should be, "
                                        f"where {most:.3g} is possible")

    def fits(self, innovation: float, values: int) -> None:
        """Adds the normalised squared innovation of a reading, and finds the fault where many are too large.

        ``innovation`` is the mean of ``values`` independent ones; NaN where the reading was refused.
        """
        size = REFUSED if np.isnan(innovation) else min(innovation, REFUSED)
        self._innovations.append((size * values, values))
        total, count = np.sum(self._innovations, axis=0)
        if len(self._innovations) == TOGETHER and total > chdtri(count, BY_CHANCE):
            self.fault = self.fault or ("what it reports does not change as the arm moves (innovations "
                                        f"{total / count:.1f} times as large as their variance)")

    def loudness(self, noise: float, frequency: float, pace: float) -> float:
        r"""Least amplitude of an oscillation that shows above the learned noise within ``ASKED_FOR`` samples.

        Of white noise σ, N samples determine an amplitude within :math:`\sigma \sqrt{2/N}`; of coloured noise only the
        power about the frequency matters,

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
        """Stores the forces measured while the tip oscillates on a surface, for ``answers``.

        Args:
            felt: instant [s], arc length [m], height [m] and force [N] of the last samples ``(m, 4)``.
        """
        samples = np.concatenate([self._asked, felt])
        self._asked = samples[samples[:, 0] > samples[-1, 0] - ASKED_FOR]

    def answers(self, stiffness: float, frequency: float) -> None:
        r"""Finds the fault where the measured force does not follow the height of a tip that oscillates.

        The surface's shape depends on the place, so a cubic along the path removes it, also where cycles are lost and
        the arm leaps in the path's time; while the tip rests it is one over time. The residual heights h appear in the
        forces f with the stiffness E and the share κ that the sensor shows:

        .. math:: f = \sum_{i=0}^{3} c_i w^i - \kappa E h + \nu, \qquad w = s + v_0 t, \qquad
                  \nu_k = \varphi \nu_{k-1} + \epsilon_k

        by least squares of each sample less φ times the one before. The correlation of the noise at rest is used where
        it is known.

        Args:
            stiffness: E of the contact [N/m].
            frequency: frequency at which the tip oscillates [Hz].
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
        # Student's t is used because few samples determine the noise poorly.
        self.answered = min(self.answered, share + float(stdtrit(freedom, ndtr(ERRORS))) * error)
        if self.answered < ANSWERED:
            self.fault = self.fault or (f"it answers {100.0 * max(share, 0.0):.0f} % of what the tip's swing on the "
                                        "surface makes; look whether it is alive, and what its filter leaves of "
                                        f"{frequency:.0f} Hz")

    def stamped(self, stamp: float, arrived: float) -> None:
        r"""Adds a message's stamp and arrival time [s], and finds the fault where stamps jitter too much.

        What differs between the steps of both is their own noise, and of that the stamps' share

        .. math:: \sigma_s^2 = \tfrac12 \mathrm{cov}(\Delta s, \Delta s - \Delta a)

        whatever the sensor's own pace is. Messages that are delayed, and those lost behind them, move both for a while;
        stamps that wander do so all the time. So the median over intervals is tested.
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
        # Lost messages make steps longer by whole periods; those periods are removed.
        s = s - pace * np.maximum(np.round(s / pace) - 1.0, 0.0)
        s = s - s.mean()
        begins = len(s) * np.arange(STRETCHES + 1) // STRETCHES
        variance = median((np.add.reduceat(s * own, begins[:-1]) / np.diff(begins)).tolist()) / 2.0
        # The noise that stamps and arrivals have in common correlates with their own noise by chance.
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
        """Which readings were treated as missing, and why, in words."""
        counts = ((self.stuck, "stuck"), (self.impossible, "impossible"), (self.leapt, "leapt"),
                  (self.quiet, "without noise"))
        return [f"{number} {what}" for number, what in counts if number]
