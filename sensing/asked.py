r"""Whether a sensor answers what it is asked, with whatever noise it has: the probability that noise hides an answer.

A tip on a surface swings with ω, by which a live sensor feels a force of the amplitude A more and less, at least. In a
window m of whole periods, from which a cubic along the path takes what the surface does, the force shows the phasor

.. math:: F_m = a_m + n_m, \qquad |a_m| \ge A, \qquad n_m \sim \mathcal{CN}(0, S_m)

Only the noise's spectral density at ω counts, which neither the rest of the same window tells nor how a sensor
scatters at rest: surfaces are rough, arms swing. So no density is supposed. Whatever it is, the noise takes so much of
the answer away in M windows that not more than a share ε of its power is left,

.. math:: \sum_m |F_m|^2 \le \varepsilon M A^2, \qquad
          P \le \sup_S P(\varepsilon \,|\, S) = \frac{(\varepsilon M)^M}{e^M M!} (1 + O(\varepsilon))

less often than this: weak noise hardly ever comes so far, and strong noise hardly ever there. (Chernoff's bound
:math:`\varepsilon^M` holds for any :math:`\varepsilon \le 1` and any sequence of densities.)
"""

from __future__ import annotations

import numpy as np
from scipy.special import gammaln

from ideal_robot.arrays import Array

PERIODS, WINDOWS = 2, 16
"""Periods of a window: in one, a cubic is hardly another thing than a swing. Windows that are looked at together at
most: 3.2 s at 10 Hz."""
_FEWEST = 12
"""Samples of a window at least, twice as many as are fitted to them."""
_COVERED = 0.8
"""Share of a window between its first and its last sample at least."""
LEAST = 0.7
"""Share of its swing that a live sensor shows at least: a contact may be softer than where it was pressed by 30 %, the
standard deviation with which the follower begins, and a filter with a corner of 10 Hz leaves as much."""
HIDES = 1e-6
"""Probability with which noise hides the answer of a live sensor at one look."""

_LOOKS = float(np.log(WINDOWS))
_M = np.arange(1.0, WINDOWS + 1.0)
_CONSTANT = -_M + _M * np.log(_M) - gammaln(_M + 1.0)


def hidden(share: Array) -> Array:
    """Logarithms of the probabilities with which noise of any strength leaves no more than so little ``(N,)``.

    Args:
        share: mean power of the answers in the last 1, 2, … N windows over that of the least answer ``(N,)``.
    """
    m = len(share)
    with np.errstate(divide="ignore"):
        return np.asarray(np.minimum(_M[:m] * np.log(np.minimum(share, 1.0)) + _CONSTANT[:m], 0.0))


class Asked:
    """Takes what a swinging tip felt, and says how probable it is that a live sensor felt so little of its swing.

    Attributes:
        chance: logarithm of that probability, the least of all numbers of windows back from the last sample, each of
            which counts as a look.
        share: share of the amplitude that was shown in those windows, noise included.
    """

    def __init__(self) -> None:
        self._samples = np.zeros((0, 4))
        self._looks = np.zeros((0, 3), dtype=complex)
        self.chance, self.share = 0.0, np.inf

    def add(self, felt: Array, stiffness: float, frequency: float, amplitude: float) -> None:
        """Looks at the last windows.

        The tip has been asked as far as it has swung, which is seen over all windows together; by what it follows of
        the surface, and by what it swings otherwise, no sensor is asked.

        Args:
            felt: instant [s], arc length [m], height [m] and force [N] of the last samples ``(m, 4)``.
            stiffness: of the contact [N/m].
            frequency: ω/2π, at which it swings [Hz].
            amplitude: of the height's swing as commanded [m].
        """
        lasts = PERIODS / frequency
        samples = np.concatenate([self._samples, felt])
        self._samples = samples = samples[samples[:, 0] > samples[-1, 0] - lasts]
        now = float(samples[-1, 0])
        if len(samples) < _FEWEST or now - samples[0, 0] < _COVERED * lasts:
            return
        s, turned = samples[:, 1] - samples[-1, 1], 2.0 * np.pi * frequency * samples[:, 0]
        u = s / max(float(np.max(np.abs(s))), 1e-6)
        rows = np.column_stack([np.cos(turned), np.sin(turned), np.ones(len(u)), u, u**2, u**3])
        cos, sin = np.linalg.lstsq(rows, samples[:, 2:] * [stiffness, 1.0], rcond=None)[0][:2]
        looks = np.concatenate([self._looks, [[now, *(cos - 1j * sin)]]])
        self._looks = looks[looks[:, 0].real > now - (WINDOWS + 1) * lasts]
        self._judge(lasts, stiffness * amplitude)

    def _judge(self, lasts: float, asked: float) -> None:
        """Looks back through windows of a length [s], none of which overlaps the next; ``asked``: as commanded [N]."""
        t, swung, answered = self._looks[:, 0].real, self._looks[:, 1], self._looks[:, 2]
        ends = t[-1] - lasts * np.arange(WINDOWS)
        last = np.searchsorted(t, ends + 1e-6 * lasts, side="right") - 1
        last = last[(last >= 0) & (t[last] > ends - 0.25 * lasts)]
        count = np.arange(1.0, len(last) + 1.0)
        amplitude = np.minimum(np.abs(np.cumsum(swung[last])) / count, asked)
        power = np.cumsum(np.abs(answered[last]) ** 2) / count
        share = power / np.maximum(LEAST * amplitude, 1e-12) ** 2
        chance = hidden(share)
        best = int(np.argmin(chance))
        self.chance, self.share = min(float(chance[best]) + _LOOKS, 0.0), LEAST * float(np.sqrt(share[best]))
