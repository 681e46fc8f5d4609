"""What goes wrong in sensing while running."""

from __future__ import annotations

from ideal_robot.errors import IdealRobotError


class SensingError(IdealRobotError):
    """A sensor's data cannot be evaluated; the message says which and why."""
