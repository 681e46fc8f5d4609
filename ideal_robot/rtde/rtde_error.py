"""What can go wrong between us and a controller that speaks RTDE."""

from __future__ import annotations

from ideal_robot.errors import IdealRobotError


class RtdeError(IdealRobotError):
    """The connection cannot go on; the controller's own program decides what the arm does then."""
