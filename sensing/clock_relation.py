r"""Relates a device's clock to this computer's, from time stamps and arrival times alone.

A message with stamp ``s`` of the device's clock arrives at ``h`` of this computer's clock after a delay that is seldom
below its usual least. The differences ``h - s`` so lie above a line

.. math:: h - s \approx o + d\, s ,

whose slope ``d`` is the drift and whose height ``o`` the offset, the least delay included. The least difference of each
quarter of a second gives a point; the slope is their regression line's, held near zero by what quartz clocks do (a
prior of 100 ppm) while the points determine it poorly. The height is what the least difference of a second is on
average. The lowest of all falls while messages jitter on: at the end of a run it is another one than where a sensor was
calibrated.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ideal_robot.arrays import Array

SLOT = 0.25
"""Length of the pieces of time of which the least difference counts [s]."""
SLOTS = 240
"""Pieces that are remembered."""
PRIOR = 1e-4
"""Drift of clocks before anything is known, standard deviation."""
FINEST = 2e-5
"""What is taken at least for the standard deviation of a piece's least difference [s]."""
TOGETHER = 4
"""Pieces whose least difference on average is the height of the line: a second's."""
STEP = 0.005
"""A difference so far below the line, and by what pieces usually are beside it, is not believed alone [s]."""
LATEST = 1.0
"""A message so much later than usual is not believed alone [s]."""
BESIDE = 4
"""Pieces in a row whose least difference lies equally far beside the line: the clock stood still, or was set anew."""
CONFIRMED = 3
"""Differences in a row that agree with each other and not with the line: the clock was set, or the device restarted."""


@dataclass(frozen=True)
class ClockReport:
    """Offset, drift and delays of a device's clock.

    Attributes:
        offset_s: this computer's clock minus the device's when it was last heard, least delay taken away [s].
        drift_ppm: by how much the device's second is too short for this computer's.
        drift_std_ppm: its standard deviation.
        late_ms: median delay of messages beyond the least delay [ms].
        stamps: number of stamps.
        refused: stamps that could not be.
        restarts: number of times the clock was found to have been reset.
    """

    offset_s: float
    drift_ppm: float
    drift_std_ppm: float
    late_ms: float
    stamps: int
    refused: int
    restarts: int

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON; unknown values are None."""
        return {key: None if isinstance(value, float) and not math.isfinite(value) else value
                for key, value in asdict(self).items()}


class ClockRelation:
    """Translates between a device's clock and this computer's.

    Args:
        least_delay: usual shortest time of a second between the instant that a stamp names and the arrival of its
            message, which cannot be estimated from stamps and arrivals [s].
    """

    def __init__(self, least_delay: float = 0.0) -> None:
        self.least_delay = least_delay
        self.stamps = self.refused = self.restarts = 0
        self._offset = self._drift = self._drift_std = self._newest = self._x0 = self._y0 = 0.0
        self._slot = -1
        self._aside: list[tuple[float, float]] = []
        self._late = np.full(256, np.nan)
        self._begin(0.0, 0.0)
        self.known = False
        """Whether there has been a stamp."""

    def add(self, stamp: float, arrived: float) -> bool:
        """Adds a message's stamp by the device's clock and its arrival by this computer's [s]; false if implausible."""
        if not (math.isfinite(stamp) and math.isfinite(arrived)):
            self.refused += 1
            return False
        if not self.known:
            self._begin(stamp, arrived)
        x, y = stamp - self._x0, (arrived - self._y0) - (stamp - self._x0)
        beyond = y - self._offset - self._drift * x
        if self.known and not -STEP - self._usual < beyond < LATEST:
            return self._doubted(stamp, arrived)
        self._aside.clear()
        self.known = True
        self._late[self.stamps % len(self._late)] = max(beyond, 0.0)
        self.stamps += 1
        self._newest = max(self._newest, x)
        slot = math.floor(x / SLOT)
        if slot > self._slot:
            self._slot = slot
            self._points.append((x, y))
            del self._points[:-SLOTS]
            self._fit()
        elif self._points and y < self._points[-1][1] and slot == self._slot:
            self._points[-1] = (x, y)
        if len(self._points) <= TOGETHER:
            self._offset = min(self._offset, y - self._drift * x)
        return True

    def host(self, stamp: float) -> float:
        """This computer's time at which the device's clock showed ``stamp`` [s]."""
        x = stamp - self._x0
        return self._y0 + x + self._offset + self._drift * x - self.least_delay

    def stamp(self, host: float) -> float:
        """What the device's clock shows at this computer's time ``host`` [s]."""
        return self._x0 + (host + self.least_delay - self._y0 - self._offset) / (1.0 + self._drift)

    def report(self) -> ClockReport:
        """The clock's offset, drift and delays as estimated so far."""
        last = self._x0 + self._newest
        late = self._late[np.isfinite(self._late)]
        return ClockReport(self.host(last) - last if self.known else math.nan, 1e6 * self._drift, 1e6 * self._drift_std,
                           1e3 * float(np.median(late)) if len(late) else math.nan, self.stamps, self.refused,
                           self.restarts)

    def _begin(self, stamp: float, arrived: float) -> None:
        self._x0, self._y0 = stamp, arrived
        self._offset, self._drift, self._drift_std, self._usual = 0.0, 0.0, PRIOR, 0.0
        self._points: list[tuple[float, float]] = []
        self._slot, self._newest = -1, 0.0

    def _doubted(self, stamp: float, arrived: float) -> bool:
        """A stamp beside the line: refused, unless it is the third in a row that says the same."""
        if self._aside and abs((arrived - stamp) - (self._aside[-1][1] - self._aside[-1][0])) > 10 * STEP:
            self._aside.clear()
        self._aside.append((stamp, arrived))
        self.refused += 1
        if len(self._aside) < CONFIRMED:
            return False
        pairs, self._aside = self._aside, []
        self.restarts += 1
        self.known = False
        for pair in pairs:
            self.add(*pair)
        return True

    def _fit(self) -> None:
        # The newest interval has only just begun: its least difference is not known yet.
        points = np.array(self._points[:-1])
        if len(points) < 2:
            return
        beside = points[:, 1] - self._offset - self._drift * points[:, 0]
        # With jitter, the least delay of one interval is usually above that of several: this is no step of the clock.
        usual = float(np.median(np.abs(beside[:-BESIDE]))) if len(points) >= 2 * BESIDE else np.inf
        recent = beside[-BESIDE:]
        # A clock that was reset keeps the same step; messages that are delayed do not.
        if np.ptp(recent) < STEP + usual < min(np.abs(recent)):
            self.restarts += 1
            self._points = self._points[-BESIDE - 1 :]
            points = points[-BESIDE:]
        points = _sound(points)
        x, y = points.T
        x = x - x.mean()
        spread = float(x @ x)
        residual = y - y.mean() - x * float(x @ y) / spread
        variance = max(float(residual @ residual) / max(len(x) - 2, 1), FINEST**2)
        weight = spread + variance / PRIOR**2
        self._drift, self._drift_std = float(x @ y) / weight, math.sqrt(variance / weight)
        heights = points[:, 1] - self._drift * points[:, 0]
        self._offset = _least_of(heights, TOGETHER)
        self._usual = float(np.median(np.abs(heights - self._offset)))


def _least_of(values: Array, few: int) -> float:
    """What the least of a few values that are drawn from these is on average; of fewer, the least.

    Every set of so many is as likely: the mean over all of them (Hoeffding's U-statistic), from the values in order.

    Args:
        values: ``(N,)``.
        few: how many are drawn.
    """
    values, n = np.sort(values), len(values)
    if n < few:
        return float(values[0])
    sets = np.array([math.comb(n - 1 - i, few - 1) for i in range(n)], dtype=float)
    return float(values @ sets / math.comb(n, few))


def _sound(points: Array) -> Array:
    """The points without those that lie high above the others: pieces of time in which the network stood still."""
    above = points[:, 1] - np.min(points[:, 1])
    return points[above <= 4.0 * float(np.median(above)) + FINEST]
