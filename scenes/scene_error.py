"""Failures while a scene is played."""

from __future__ import annotations

from ideal_robot.errors import IdealRobotError


class SceneError(IdealRobotError):
    """Root of the failures of this package; bad input is ``ideal_robot.errors.InputError``."""
