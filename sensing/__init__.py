"""From raw sensor values to a positional deviation with its covariance."""

from __future__ import annotations

from ideal_robot.errors import IdealRobotError

# What goes wrong in sensing while running.

class SensingError(IdealRobotError):
    """A sensor's data cannot be evaluated; the message says which and why."""
