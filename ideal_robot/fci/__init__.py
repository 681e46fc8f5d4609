"""An arm behind Franka's Control Interface: joint positions every millisecond over UDP, by libfranka."""

from ideal_robot.fci.robot import FciError, FciRobot

__all__ = ["FciError", "FciRobot"]
