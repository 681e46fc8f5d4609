"""Path errors, always given three ways: time-matched, aligned and geometric.

*Time-matched* compares with the desired position of the same instant, [G] (14), (21). *Aligned* does so after removing
the one constant delay that fits best. *Geometric* is the distance to the desired path, whenever it is reached (ISO 9283
path accuracy AT).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline, make_interp_spline
from scipy.optimize import minimize_scalar

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.row_log import let_go
from scenes.result import step

_DELAY_MIN, _DELAY_MAX = -0.1, 0.3
"""Delays looked for [s]."""
PIECE, OVERLAP = 100_000, 64
"""Samples of a motion to which one spline is laid, and by how many it reaches further at both ends."""
_NEIGHBOURHOOD = 0.4
"""How far in time from its own instant a point of the path may be the nearest one [s]; keeps crossings apart."""


@dataclass(frozen=True)
class Error:
    """One error measure of a path.

    Attributes:
        E_car: root mean square of the deviation, [G] (14) [m].
        E_max: largest deviation, [G] (21) [m].
        deviation: per instant ``(N,)`` [m].
    """

    E_car: float
    E_max: float
    deviation: Array

    @classmethod
    def of(cls, deviation: Array) -> Error:
        """Figures of deviations ``(N,)`` [m]."""
        return cls(float(np.sqrt(np.mean(deviation**2))), float(np.max(deviation)), deviation)

    def json_mm(self) -> dict[str, float]:
        """``E_car`` and ``E_max`` in millimetres."""
        return {"E_car": 1e3 * self.E_car, "E_max": 1e3 * self.E_max}


@dataclass(frozen=True)
class PathErrors:
    """The three error measures of a motion; ``delay`` is what *aligned* removed [s], positive for a late arm."""

    time_matched: Error
    aligned: Error
    geometric: Error
    delay: float

    def json_mm(self) -> dict[str, Any]:
        """The three measures, each ``{E_car, E_max}`` in millimetres, and the delay in milliseconds."""
        return {"time_matched": self.time_matched.json_mm(), "aligned": self.aligned.json_mm(),
                "geometric": self.geometric.json_mm(), "delay_ms": 1e3 * self.delay}


def path_errors(t: Array, x_d: Array, t_actual: Array, x_actual: Array) -> PathErrors:
    """Errors of a motion against its desired path; InputError for fewer than four samples, or shapes that do not fit.

    Args:
        t: instants at which the errors are computed ``(N,)`` [s].
        x_d: desired positions at ``t``, shape ``(N, 3)`` [m].
        t_actual: instants of the motion ``(M,)`` [s]; may begin earlier and end later than ``t``. Where they do not,
            the first and last position hold.
        x_actual: positions at them ``(M, 3)`` [m].
    """
    if len(t) < 4 or len(t_actual) < 4 or x_d.shape != (len(t), 3) or x_actual.shape != (len(t_actual), 3):
        raise InputError("expected at least four instants and positions (N, 3) at each", field="path",
                         value=(x_d.shape, x_actual.shape))
    motion = _Motion(t_actual, x_actual)
    at = motion.at

    def squared(delay: float) -> float:
        return float(motion.squared(t, x_d, np.array([delay]))[0])

    # The squared error is smooth in the delay, but has several minima on paths that repeat: scan, then refine.
    coarse = np.arange(_DELAY_MIN, _DELAY_MAX + 1e-9, 0.004)
    best = float(coarse[int(np.argmin(motion.squared(t, x_d, coarse)))])
    refined = minimize_scalar(squared, bounds=(best - 0.004, best + 0.004), method="bounded",
                              options={"xatol": 1e-7})
    # Removing a delay must never make the error larger; equal minima count as no delay.
    delay = float(refined.x) if refined.fun < squared(0.0) else 0.0
    actual = at(t)
    return PathErrors(
        time_matched=Error.of(np.linalg.norm(actual - x_d, axis=1)),
        aligned=Error.of(np.linalg.norm(at(t + delay) - x_d, axis=1)),
        geometric=Error.of(_distance_to_path(t + delay, at(t + delay), t, x_d)),
        delay=delay,
    )


class _Motion:
    """Positions ``(M, 3)`` [m] between samples ``(M,)`` [s], by a cubic spline; of a long motion piece by piece."""

    def __init__(self, t: Array, x: Array) -> None:
        self._t, self._x = t, x
        self._span = float(t[0]), float(t[-1])
        self._whole = make_interp_spline(t, x, k=3) if len(t) <= PIECE else None

    def at(self, times: Array) -> Array:
        """Positions ``(m, 3)`` [m] at rising times ``(m,)`` [s]; the first and the last one hold beyond the ends."""
        times = np.clip(times, *self._span)
        if self._whole is not None:
            return np.asarray(self._whole(times))
        positions = np.empty((len(times), 3))
        for begin, end, spline in self._pieces():
            rows = slice(*np.searchsorted(times, (begin, end)))
            positions[rows] = spline(times[rows])
        return positions

    def squared(self, t: Array, x_d: Array, delays: Array) -> Array:
        """Mean squared distance ``(k,)`` [m²] from positions ``(m, 3)`` at rising ``t`` for each delay ``(k,)`` [s]."""
        if self._whole is not None:
            return np.array([np.mean(np.sum((self.at(t + delay) - x_d) ** 2, axis=1)) for delay in delays])
        total = np.zeros(len(delays))
        for begin, end, spline in self._pieces():
            for k, delay in enumerate(delays):
                rows = slice(*np.searchsorted(t, (begin - delay, end - delay)))
                total[k] += np.sum((spline(np.clip(t[rows] + delay, *self._span)) - x_d[rows]) ** 2)
        return total / len(t)

    def _pieces(self) -> Iterator[tuple[float, float, BSpline]]:
        """Begin, end [s] and spline of pieces; what is beyond its overlap does not reach into one: 0.27**64."""
        for first in range(0, len(self._t), PIECE):
            end, beyond = first + PIECE, slice(max(first - OVERLAP, 0), first + PIECE + OVERLAP)
            yield (float(self._t[first]) if first else -np.inf, float(self._t[end]) if end < len(self._t) else np.inf,
                   make_interp_spline(self._t[beyond], self._x[beyond], k=3))
            let_go(self._t, self._x)


def _distance_to_path(t: Array, x: Array, t_path: Array, x_path: Array) -> Array:
    """Distance ``(N,)`` [m] of points ``(N, 3)`` from a polyline with corners ``(M, 3)`` near the same instants.

    Only the part of the path within 0.4 s of the point's own instant is looked at, so a path that crosses itself does
    not flatter the error.
    """
    starts, steps = x_path[:-1], np.diff(x_path, axis=0)
    lengths = np.maximum(np.sum(steps**2, axis=1), 1e-24)
    first = np.clip(np.searchsorted(t_path, t - _NEIGHBOURHOOD) - 1, 0, len(steps) - 1)
    last = np.clip(np.searchsorted(t_path, t + _NEIGHBOURHOOD), first + 1, len(steps))
    distance = np.empty(len(x))
    for k, point in enumerate(x):
        part = slice(first[k], last[k])
        offset = point - starts[part]
        along = np.clip(np.sum(offset * steps[part], axis=1) / lengths[part], 0.0, 1.0)
        distance[k] = np.sqrt(np.min(np.sum((offset - along[:, None] * steps[part]) ** 2, axis=1)))
    return distance


def reduction_percent(before: float, after: float) -> float:
    """Reduction of an error [%]; negative where it grew."""
    return 100.0 * (1.0 - after / before) if before > 0 else float("nan")


@dataclass(frozen=True)
class ControlError:
    """Distance of the true TCP from the drawn line, in the surface, while the line is followed.

    Attributes:
        mean, p95, max: of its absolute value [m].
        t, s: instants ``(N,)`` [s], of a long run at a stride, and arc length of the drawn line at them ``(N,)`` [m].
        lateral: signed distance, positive to the left of the line ``(N,)`` [m].
    """

    mean: float
    p95: float
    max: float
    t: Array
    s: Array
    lateral: Array

    @classmethod
    def of(cls, t: Array, s: Array, lateral: Array, counts: NDArray[np.bool_]) -> ControlError:
        """Figures of signed distances; all are NaN where none is used.

        Args:
            t, s, lateral: as the attributes.
            counts: which samples are used ``(N,)``.
        """
        size = np.abs(lateral[counts])
        rows = np.flatnonzero(counts)[:: step(len(size))]
        series = t[rows], s[rows], lateral[rows]
        let_go(t, s, lateral)
        if len(size) == 0:
            return cls(np.nan, np.nan, np.nan, *series)
        return cls(float(size.mean()), float(np.quantile(size, 0.95)), float(size.max()), *series)

    def json_mm(self) -> dict[str, float]:
        """``mean``, ``p95`` and ``max`` of the absolute distance in millimetres."""
        return {"mean": 1e3 * self.mean, "p95": 1e3 * self.p95, "max": 1e3 * self.max}


def spread_ms(seconds: Array) -> dict[str, float]:
    """Median, 99th percentile and maximum of times ``(N,)`` [s], in milliseconds; NaN where there are none."""
    values = 1e3 * seconds if len(seconds) else np.array([np.nan])
    return {"median": float(np.median(values)), "p99": float(np.percentile(values, 99)), "max": float(np.max(values))}
