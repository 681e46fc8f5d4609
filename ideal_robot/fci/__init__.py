"""An arm behind Franka's Control Interface: joint positions every millisecond over UDP, by libfranka."""

from ideal_robot.fci.milliseconds import FciError
from ideal_robot.fci.robot import FciRobot

__all__ = ["FciError", "FciRobot"]
