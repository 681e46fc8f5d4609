"""The rule by which a change of the model is kept: the measured error falls by more than one standard error.

Both plays follow the same motion, so they are compared piece by piece. What is compared is the logarithm of the ratio
of the errors of the whole motion,

    θ = log(E_after / E_before) ,

and its standard error holds two scatters that have nothing to do with each other:

- along the motion: that of the jackknife over ``PIECES`` pieces of equal length, the ratio with one piece after the
  other left out (Efron & Tibshirani 1993, An Introduction to the Bootstrap, 11). It holds the noise of both plays, and
  how unlike the change acts from place to place;
- from play to play: ``REPEATS``, by which the error of an arm and a model that nobody touched differs.

One standard error is what a simpler model is given up for (Breiman, Friedman, Olshen & Stone 1984, Classification and
Regression Trees, 3.4.3). A change that acts alike everywhere has to do little; one that takes in one piece what it
gives in another has to do much.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ideal_robot.arrays import Array

PIECES = 20
"""10 to 30 give a mean's scatter nearly all the degrees of freedom that it can use, and leave pieces long enough to be
independent (Schmeiser 1982, Batch size effects in the analysis of simulation output, Operations Research 30)."""
REPEATS = 0.03
"""Relative change of a path error with gears that are one kelvin warmer or colder, root mean square over arms of the
random closings (every ninth of seeds 1000 to 1099, nothing undeclared: 4.0 % and 1.7 %)."""


@dataclass(frozen=True)
class Comparison:
    """Measured error of the same motion without and with a change.

    Attributes:
        before, after: root mean square of the deviation [SI]; infinite where nothing was measured.
        t: logarithm of their ratio over its standard error; negative where the error falls.
    """

    before: float
    after: float
    t: float

    @classmethod
    def of(cls, before: Array, after: Array) -> Comparison:
        """Compares two plays.

        Args:
            before: deviations ``(N,)`` or ``(N, c)`` in order of time, as they are measured without the change [SI].
            after: likewise with it ``(M,)`` or ``(M, c)``; the same share of the rows is the same piece of the motion.
        """
        count = min(PIECES, len(before), len(after))
        if count < 2:
            return cls(_rms(before), _rms(after), -np.inf if len(after) else np.inf)
        own = np.array([[_rms(piece) ** 2 * len(piece) / len(rows) for piece in np.array_split(rows, count)]
                        for rows in (before, after)]) + 1e-300
        without = 0.5 * np.diff(np.log(own.sum(axis=1, keepdims=True) - own), axis=0)
        theta = 0.5 * float(np.diff(np.log(own.sum(axis=1)))[0])
        return cls(_rms(before), _rms(after), theta / float(np.hypot(np.sqrt((count - 1) * np.var(without)), REPEATS)))

    @property
    def falls(self) -> bool:
        """Whether the error falls by more than one standard error."""
        return self.t < -1.0

    @property
    def rises(self) -> bool:
        """Whether it rises by more than one."""
        return self.t > 1.0

    def reason(self, scale: float, unit: str) -> str:
        """Why a change with this comparison is taken back.

        Args:
            scale: of the error's unit to SI.
            unit: its name.
        """
        size = f"{scale * self.before:.3g} to {scale * self.after:.3g} {unit}"
        if self.after >= self.before:
            return f"the measured error does not fall: {size}"
        return f"the measured error falls by {-self.t:.1f} standard errors, one is asked for: {size}"


def _rms(deviation: Array) -> float:
    if not len(deviation):
        return float("inf")
    return float(np.sqrt(np.sum(np.square(deviation, dtype=float)) / len(deviation)))
