"""An arm behind ABB's Externally Guided Motion: protobuf messages over UDP, one each interpolation cycle."""

from ideal_robot.egm.robot import EgmError, EgmRobot

__all__ = ["EgmError", "EgmRobot"]
