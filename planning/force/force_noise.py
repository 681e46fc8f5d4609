r"""Estimates the noise of a force sensor, in the air and on the surface; no setting is needed.

White noise of variance σ² shows in the differences of successive innovations, which contain neither bias nor weight nor
slow changes of the surface:

.. math:: \hat\sigma^2 = \frac{\nu_0 \sigma_0^2 + \sum_k \frac{1}{2} (e_k - e_{k-1})^2}{\nu_0 + n}

In the air the force is known, zero, and e are the forces themselves; along a surface e are the innovations of the
filter, as forces. It is the mean under an inverse gamma prior of ν₀ samples; old samples are forgotten.
"""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array

PRIOR = 10.0
"""Samples that the assumed noise is worth: a tenth of a second in the air outweighs it."""
MEMORY = 400.0
"""Samples that are remembered: the estimate is then within 5 %, and follows a change in two seconds at 250 Hz."""
OUTLIER = 3.0
"""Standard deviations beyond which a difference is taken for that much: a knock is no noise."""
APART = 0.05
"""Time between samples beyond which their difference is no noise [s]."""
LEAST = 0.01
"""Smallest standard deviation that is believed [N]: sensors of this size resolve no more."""


class ForceNoise:
    """Standard deviation of a force sample [N], estimated from successive samples.

    Args:
        assumed: standard deviation assumed before any sample [N].
    """

    def __init__(self, assumed: float) -> None:
        self._weight, self._sum = PRIOR, PRIOR * assumed**2
        self._last: tuple[float, Array] | None = None

    @property
    def std(self) -> float:
        """The noise's present estimate, standard deviation [N]."""
        return max(float(np.sqrt(self._sum / self._weight)), LEAST)

    def hear(self, t: Array, error: Array) -> None:
        """Adds errors of the predicted force, measured less expected, at instants ``t`` [s].

        Args:
            t: instants ``(m,)`` [s], rising.
            error: ``(m, k)`` [N], k directions of equal noise.
        """
        for instant, row in zip(t, error, strict=True):
            if self._last is not None and 0.0 < instant - self._last[0] < APART and len(row) == len(self._last[1]):
                half = 0.5 * (row - self._last[1]) ** 2
                most = (OUTLIER * self.std) ** 2
                keep = 1.0 - min(len(row) / MEMORY, 1.0)
                self._weight = keep * self._weight + len(row)
                self._sum = keep * self._sum + float(np.minimum(half, most).sum())
            self._last = (float(instant), row)
