"""A camera whose time stamps are wrong by a constant."""

from ideal_robot.effects.loop_change import LoopChange
from ideal_robot.effects.sensor.seen_line import SPEED, SeenLineEffect


class CameraLatency(SeenLineEffect):
    """The points stamped ``t`` were seen from the pose at ``t + delta``: ``dX = -delta (v + omega × R u)``.

    What is undeclared in the age of a picture. Along a straight line at constant attitude it moves points along the
    line only and cannot be seen; where curvature or attitude change it can.
    """

    name = "camera_latency"
    needs = (SPEED,)
    coefficient_names = ("latency",)
    coefficient_units = ("s",)
    source = "[L] (4), (5): the pose of the exposure"

    def loop_change(self, coefficients: tuple[float, ...], theta: tuple[float, ...]) -> LoopChange:
        """The pose of the exposure."""
        return LoopChange(latency=coefficients[0])
