"""The simulated world: arm, gears, friction, industrial controller, camera and force sensor."""

from __future__ import annotations

from ideal_robot.errors import IdealRobotError

# What can go wrong in the simulated world while it runs.

class SimError(IdealRobotError):
    """The simulation cannot continue, or something was requested that it does not have."""
