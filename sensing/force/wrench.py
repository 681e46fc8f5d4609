"""Force/torque samples, the seam of the sensors that give them, and deviations from them ([L] (3))."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError


@dataclass(frozen=True)
class WrenchSample:
    """One sample.

    Attributes:
        t: instant of measurement [s].
        t_arrival: instant at which it is available [s].
        wrench: force [N] and moment [N m] of the tool on the sensor, in the tool frame about its origin ``(6,)``: what
            the environment does to the tool, plus the tool's own weight, plus bias.
    """

    t: float
    t_arrival: float
    wrench: Array


class ForceSensor(Protocol):
    """A force/torque sensor as a device.

    It samples on its own clock. Each sample carries the *controller's* time of its measurement as well as the device
    knows it; where the sensor's clock drifts, diagnosis finds it (effect ``clock_drift``).
    """

    def arrived(self, t: float) -> list[WrenchSample]:
        """The samples that have arrived by the controller time ``t`` [s], in order of arrival, each once."""
        ...


class WrenchFilter:
    """Moving average over the last samples, stamped with their mean time: no lag where the force changes evenly.

    Args:
        window: length [s].
    """

    def __init__(self, window: float) -> None:
        if not window >= 0:
            raise InputError("expected zero or a positive number", field="window", value=window)
        self._window = window
        self._samples: deque[WrenchSample] = deque()

    def add(self, sample: WrenchSample) -> WrenchSample:
        """Takes one sample, in whatever order they arrive, and returns the average up to it."""
        self._samples.append(sample)
        newest = max(item.t for item in self._samples)
        # Half open, so that a window of n sampling periods holds n samples whatever the rounding.
        oldest = min(newest - self._window + 1e-9, newest)
        self._samples = deque(item for item in self._samples if item.t >= oldest)
        wrench = np.mean([item.wrench for item in self._samples], axis=0)
        t = float(np.mean([item.t for item in self._samples]))
        return WrenchSample(t, sample.t_arrival, wrench)

    @property
    def count(self) -> int:
        """Samples in the average."""
        return len(self._samples)


@dataclass(frozen=True)
class ForceDeviation:
    """How far the tip has to move for the wanted force.

    Attributes:
        value: along the direction, positive out of the surface [m].
        sigma: its standard deviation [m].
        force: component of the contact force along the direction [N].
    """

    value: float
    sigma: float
    force: float


def force_deviation(force: Array, direction: Array, wanted: float, elasticity: float, *, sigma: float,
                    elasticity_error: float = 0.05, normal: Array | None = None) -> ForceDeviation:
    """Δx_a = (F_r − F) / E, [L] (3), along ``direction``.

    A force that is too small asks to go deeper, against the direction, which points out of the surface.

    Args:
        force: of the environment on the tool ``(3,)`` [N].
        direction: unit vector in which the deviation is wanted, the same frame.
        wanted: F_r [N].
        elasticity: E [N/m].
        sigma: standard deviation of the force [N].
        elasticity_error: relative error of E that the standard deviation allows for.
        normal: of the surface, if it is known better than ``direction``; the force counts along it, and friction does
            not.

    Raises:
        InputError: an elasticity that is not positive.
    """
    if not elasticity > 0:
        raise InputError("expected a positive elasticity [N/m]", field="elasticity", value=elasticity)
    along = direction if normal is None else normal
    pressed = float(force @ along)
    deviation = -(wanted - pressed) / elasticity / float(along @ direction)
    return ForceDeviation(deviation, float(np.hypot(sigma / elasticity, elasticity_error * deviation)), pressed)
