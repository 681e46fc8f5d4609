"""What can go wrong in the simulated world while it runs."""

from __future__ import annotations

from ideal_robot.errors import IdealRobotError


class SimError(IdealRobotError):
    """The simulated world cannot go on, or was asked for something it does not have."""
