"""An arm behind KUKA's Robot Sensor Interface: XML messages over UDP, one each interpolation cycle."""

from ideal_robot.rsi.message import PacketError, RsiError
from ideal_robot.rsi.robot import RsiRobot

__all__ = ["PacketError", "RsiError", "RsiRobot"]
