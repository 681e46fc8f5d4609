"""A sample of a force/torque sensor at the flange."""

from __future__ import annotations

from dataclasses import dataclass

from ideal_robot.arrays import Array


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
