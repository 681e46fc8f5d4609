"""An arm behind FANUC's Stream Motion: joint angles over UDP, one packet each interpolation cycle."""

from ideal_robot.stream_motion.robot import StreamMotionError, StreamMotionRobot

__all__ = ["StreamMotionError", "StreamMotionRobot"]
