"""What a sensor measured of the deviation from the reference, and what became of it in the filter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError


@dataclass(frozen=True)
class Measurement:
    """Deviations from the reference that one sensor measured at one instant, whatever the sensor.

    Attributes:
        t: instant of measurement, not of arrival [s].
        s: arc lengths of the reference that were looked at ``(m,)`` [m].
        value: deviations ``(m,)`` [m]: components of Δx_r along ``direction``; or ``(k,)`` combinations of them.
        covariance: of the values ``(m, m)`` [m²], or ``(k, k)``.
        direction: sensed directions as components along the path's normal and up, ``(m, directions)``; they need not be
            orthogonal to each other. None for purely lateral.
        sensor: name of the sensor, for its own errors and statistics.
        bias: how much each error of the sensor adds to the values, ``(m, b)``; see ``DeviationFilter``.
        combination: how the values follow from the deviations at ``s``, ``(k, m)``, such as value and slope of a
            polynomial through them; they then count as one, all or none. None where each deviation is a value.
        origin: where the sensor was along the directions ``(m,)`` [m], if its first error makes the distances from
            there wrong by a ratio; what that adds depends on the deviation itself, so ``bias`` says nothing of it.
        at: arc length at which the tool was [m]; None where it does not matter.
    """

    t: float
    s: Array
    value: Array
    covariance: Array
    direction: Array | None = None
    sensor: str = "camera"
    bias: Array | None = None
    combination: Array | None = None
    origin: Array | None = None
    at: float | None = None


@dataclass(frozen=True)
class Fused:
    """What became of a measurement.

    Attributes:
        used: which values went in ``(m,)``, or ``(k,)`` where they are combinations.
        innovation: values minus their predictions ``(m,)`` or ``(k,)`` [m].
        nis: normalised innovation squared of the values that went in; ``dof`` on average if all is consistent.
        dof: number of values that went in.
        reason: why values were left out; empty if none were.
        likelihood: logarithm of the measurement's likelihood before it went in, but for a constant.
    """

    used: Array
    innovation: Array
    nis: float
    dof: int
    reason: str = ""
    likelihood: float = 0.0

def check(measurement: Measurement, directions: int) -> None:
    """Raises ``InputError`` where shapes do not fit each other, or the model, or values are not finite."""
    m = k = len(measurement.s)
    shapes: dict[str, tuple[tuple[int, ...], tuple[int, ...]]] = {}
    if measurement.combination is not None:
        k = len(measurement.value)
        shapes["combination"] = (measurement.combination.shape, (k, m))
    shapes |= {"value": (measurement.value.shape, (k,)), "covariance": (measurement.covariance.shape, (k, k))}
    if measurement.direction is not None:
        shapes["direction"] = (measurement.direction.shape, (m, directions))
    for key, (given, expected) in shapes.items():
        if given != expected:
            raise InputError(f"expected shape {expected}", field=f"measurement.{key}", value=given)
    if not (np.isfinite(measurement.value).all() and np.isfinite(measurement.covariance).all()):
        raise InputError("expected finite numbers", field=f"measurement of {measurement.sensor}")
