"""Path errors, always given three ways: time-matched, aligned and geometric.

*Time-matched* compares with the desired position of the same instant, [G] (14), (21). *Aligned* does so after removing
the one constant delay that fits best. *Geometric* is the distance to the desired path, whenever it is reached (ISO 9283
path accuracy AT).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.optimize import minimize_scalar

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError

_DELAY_MIN, _DELAY_MAX = -0.1, 0.3
"""Delays looked for [s]."""
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
        """From deviations ``(N,)`` [m]."""
        return cls(float(np.sqrt(np.mean(deviation**2))), float(np.max(deviation)), deviation)

    def json_mm(self) -> dict[str, float]:
        """``E_car`` and ``E_max`` in millimetres."""
        return {"E_car": 1e3 * self.E_car, "E_max": 1e3 * self.E_max}


@dataclass(frozen=True)
class PathErrors:
    """The three measures of one motion; ``delay`` is what *aligned* removed [s], positive where the arm is late."""

    time_matched: Error
    aligned: Error
    geometric: Error
    delay: float

    def json_mm(self) -> dict[str, Any]:
        """The three measures, each ``{E_car, E_max}`` in millimetres, and the delay in milliseconds."""
        return {"time_matched": self.time_matched.json_mm(), "aligned": self.aligned.json_mm(),
                "geometric": self.geometric.json_mm(), "delay_ms": 1e3 * self.delay}


def path_errors(t: Array, x_d: Array, t_actual: Array, x_actual: Array) -> PathErrors:
    """Errors of a motion against its desired path.

    Args:
        t: instants at which the path counts ``(N,)`` [s].
        x_d: desired positions at ``t``, shape ``(N, 3)`` [m].
        t_actual: instants of the motion ``(M,)`` [s]; may begin earlier and end later than ``t``. Where they do not,
            the first and last position hold.
        x_actual: positions at them ``(M, 3)`` [m].

    Raises:
        InputError: fewer than four samples of either, or shapes that do not fit.
    """
    if len(t) < 4 or len(t_actual) < 4 or x_d.shape != (len(t), 3) or x_actual.shape != (len(t_actual), 3):
        raise InputError("expected at least four instants and positions (N, 3) at each", field="path",
                         value=(x_d.shape, x_actual.shape))
    motion = make_interp_spline(t_actual, x_actual, k=3)

    def at(times: Array) -> Array:
        return np.asarray(motion(np.clip(times, t_actual[0], t_actual[-1])))

    def squared(delay: float) -> float:
        return float(np.mean(np.sum((at(t + delay) - x_d) ** 2, axis=1)))

    # The squared error is smooth in the delay, but has several minima on paths that repeat: scan, then refine.
    coarse = np.arange(_DELAY_MIN, _DELAY_MAX + 1e-9, 0.004)
    best = float(coarse[int(np.argmin([squared(delay) for delay in coarse]))])
    refined = minimize_scalar(squared, bounds=(best - 0.004, best + 0.004), method="bounded",
                              options={"xatol": 1e-7})
    # Removing a delay must never make the error larger; ties at the start of the search count as none.
    delay = float(refined.x) if refined.fun < squared(0.0) else 0.0
    actual = at(t)
    return PathErrors(
        time_matched=Error.of(np.linalg.norm(actual - x_d, axis=1)),
        aligned=Error.of(np.linalg.norm(at(t + delay) - x_d, axis=1)),
        geometric=Error.of(distance_to_path(t + delay, at(t + delay), t, x_d)),
        delay=delay,
    )


def distance_to_path(t: Array, x: Array, t_path: Array, x_path: Array) -> Array:
    """Distance ``(N,)`` [m] of points from a polyline near the same instants.

    Only the part of the path within 0.4 s of the point's own instant is looked at, so a path that crosses itself does
    not flatter the error.

    Args:
        t: instants of the points ``(N,)`` [s].
        x: points ``(N, 3)`` [m].
        t_path: instants of the corners of the polyline ``(M,)`` [s], rising.
        x_path: its corners ``(M, 3)`` [m].
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
    """By how much an error became smaller [%]; negative where it grew."""
    return 100.0 * (1.0 - after / before) if before > 0 else float("nan")
