"""What a user's own simulated sensor may look at in a line scene: the true tool, and the line where it really is."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from planning.line.deviation_sensor import DeviationSensor
from sim.arm.arm import SimulatedArm
from sim.camera.surface import DrawnLine


class LineWorld:
    """The truth of a play, for sensors that are simulated; nothing of the controller's sees it."""

    def __init__(self, arm: SimulatedArm, line: DrawnLine) -> None:
        self._arm, self._line = arm, line

    def tool(self, t: float) -> pin.SE3:
        """True pose of the tool in the base frame at ``t`` [s], which has to lie in the past."""
        return self._arm.tcp_at(max(t, 0.0))

    def distance(self, t: float, at: Sequence[float] | Array = (0.0, 0.0, 0.0)) -> float:
        """How far the line is to the left of a point, in the surface [m]; NaN before its begin and behind its end.

        Args:
            t: when [s].
            at: the point in the tool frame ``(3,)`` [m].
        """
        pose = self.tool(t)
        place = pose.rotation @ np.asarray(at, dtype=float) + pose.translation
        plane = self._line.plane
        up = plane.rotation[:, 2]
        nearest = self._line.nearest((place - up * (up @ (place - plane.translation)))[None])
        beside = 1e-6 < nearest.s[0] < self._line.length - 1e-6
        return -float(nearest.lateral[0]) if beside else float("nan")


def mounted(sensors: Sequence[DeviationSensor], world: LineWorld) -> None:
    """Shows the world to those sensors that are simulated: they have a method ``mount(world)``."""
    for sensor in sensors:
        mount = getattr(sensor, "mount", None)
        if mount is not None:
            mount(world)
