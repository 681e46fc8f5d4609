"""From raw sensor values to a positional deviation with its covariance."""

from __future__ import annotations

from ideal_robot.errors import IdealRobotError


class SensingError(IdealRobotError):
    """A sensor's data cannot be evaluated; the message says which and why."""
