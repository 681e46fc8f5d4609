"""An arm behind KUKA's Robot Sensor Interface: XML messages over UDP, one each interpolation cycle."""

from ideal_robot.rsi.robot import RsiRobot
from ideal_robot.rsi.rsi_error import PacketError, RsiError

__all__ = ["PacketError", "RsiError", "RsiRobot"]
