"""What can go wrong between us and a controller."""

from __future__ import annotations

from ideal_robot.errors import IdealRobotError


class RsiError(IdealRobotError):
    """The link to the controller cannot go on; the arm stays where the controller holds it."""


class PacketError(RsiError):
    """A packet that is no message of a controller; it is counted and gets no answer."""
