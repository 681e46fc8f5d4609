"""Processing of commands before a controller's comparison: delay, lag, moving average, second-order smoothing.

Each is a filter with unit gain at rest, forwards for the fit (``seen``) and inverted for use (``wanted``): the command
for which the controller's input is a given signal.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.command.filters import bilinear
from ideal_robot.command.motion import spline_derivatives


@dataclass(frozen=True)
class Smoothing:
    """A filter of commands with one time [s].

    Attributes:
        name: its key in a model file.
        seen: controller's input for commands ``(N, m)`` at instants ``dt`` apart, for a time [s].
        delay: by how much it delays slow motion, over its time.
        bend: ``(w_1, w_2)``: the inverse is ``r(t + delay) + w_1 T ṙ + w_2 T² r̈`` taken at ``t + late``.
        late: the part of the delay that the inverse looks ahead by, over its time.
        times: time constants that are tried first [s].
        words: its name for readers.
    """

    name: str
    seen: Callable[[Array, float, float], Array]
    late: float
    bend: tuple[float, float]
    times: tuple[float, ...]
    words: str

    @property
    def delay(self) -> float:
        """Delay of slow motion by the filter, over the filter's time constant."""
        return self.late + self.bend[0]

    def before(self, r: Array, dt: float, time: float) -> Array:
        """The command ``(N, m)`` for which the controller's input is ``r``, given ``late * time`` [s] early.

        Args:
            r, dt: the signal ``(N, m)``, and the distance of its rows [s].
            time: of the filter [s].
        """
        if not time or self.bend == (0.0, 0.0):
            return r
        rate, bend = spline_derivatives(r, dt, 2)
        return np.asarray(r + self.bend[0] * time * rate + self.bend[1] * time**2 * bend)


def _recursive(b: list[float], a: list[float], x: Array, dt: float) -> Array:
    """A continuous filter, numerator and denominator from the highest power on, over lines from row to row."""
    from scipy import signal

    num, den = bilinear(np.array([b]), np.array(a), dt)
    return np.asarray(x[0] + signal.lfilter(num[0], den, x - x[0], axis=0))


def _mean(x: Array, dt: float, time: float) -> Array:
    """The mean over the last ``time`` [s] of lines from row to row."""
    area = np.concatenate([np.zeros_like(x[:1]), np.cumsum(0.5 * (x[1:] + x[:-1]), axis=0)]) * dt
    at = dt * np.arange(float(len(x)))
    start = at - time
    whole = np.floor(start / dt).astype(int)
    inside = np.clip(whole, 0, len(x) - 2)
    part = start - inside * dt
    slope = (x[inside + 1] - x[inside]) / dt
    behind = area[inside] + part[:, None] * x[inside] + 0.5 * part[:, None] ** 2 * slope
    behind = np.where((start < 0.0)[:, None], start[:, None] * x[:1], behind)
    return np.asarray((area - behind) / time)


SMOOTHINGS: dict[str, Smoothing] = {smoothing.name: smoothing for smoothing in (
    Smoothing("none", lambda x, dt, time: x, 0.0, (0.0, 0.0), (), ""),
    Smoothing("lag", lambda x, dt, time: _recursive([0.0, 1.0], [time, 1.0], x, dt), 0.0, (1.0, 0.0),
              (0.02, 0.06, 0.15), "lag of"),
    # 1/(1 + sT/2)²: critically damped, as servo interfaces smooth.
    Smoothing("second_order", lambda x, dt, time: _recursive([0.0, 0.0, 1.0], [0.25 * time**2, time, 1.0], x, dt), 0.0,
              (1.0, 0.25), (0.03, 0.08, 0.2), "second-order smoothing of"),
    # (1 - exp(-sT))/(sT) = exp(-sT/2) (1 + s²T²/24 + …).
    Smoothing("moving_average", _mean, 0.5, (0.0, -1.0 / 24.0), (0.04, 0.1, 0.2), "moving average over"),
)}
"""Every filter of commands by its name; a new one is a line here."""
