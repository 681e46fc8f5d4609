"""An arm behind UR's Real-Time Data Exchange: binary packages over TCP, one each cycle."""

from ideal_robot.rtde.robot import RtdeRobot
from ideal_robot.rtde.wire import RtdeError

__all__ = ["RtdeError", "RtdeRobot"]
