"""Interpolates where the arm was between the controller's samples, for sensor values that come late ([L] 4.3)."""

from __future__ import annotations

from collections import deque

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.robots.robot import Robot
from ideal_robot.tolerances import ROUNDING
from planning import PlanningError

AHEAD = 0.05
"""How far ahead of the last sample one can ask [s]."""
_KEPT = 2.5
"""How far back one can ask [s]; what sensors see may be known 2 s later."""
_ROWS = 0.05
"""How far from a picture's middle row another row's exposure may be at most [s]."""


def check_cycle(robot: Robot) -> None:
    """Raises ``InputError`` where a cycle is too long to forecast the arm at every exposure in it."""
    if robot.t_ipo > AHEAD:
        raise InputError("a camera gets its search windows before the cycle of its field, and the arm's motion can "
                         "be predicted over "
                         f"{AHEAD:g} s: expected a cycle of at most that (world.t_ipo, or t_ipo in the arm's TOML)",
                         field="t_ipo", value=robot.t_ipo)


class PoseHistory:
    """The last joint angles that the controller reported, and poses interpolated between them.

    "We compute the camera position of the time instant of sensing and then evaluate the measured sensor data for this
    time instant" ([L] 4.3). Between samples the joint angles follow the cubic through the four nearest ones.
    """

    def __init__(self, robot: Robot) -> None:
        self._robot, self._data, self._tool = robot, robot.pinocchio.createData(), robot.tool_id
        self._t: deque[float] = deque()
        self._q: deque[Array] = deque()
        self._asked: dict[float, pin.SE3] = {}

    @property
    def first(self) -> float:
        """Earliest instant for which a pose is available [s]."""
        return self._t[0]

    def add(self, t: float, q: Array) -> None:
        """Adds one sample ``q (n,)`` [rad] valid at ``t`` [s]; samples come in the order of time."""
        if self._t and t <= self._t[-1]:
            raise PlanningError(f"samples have to come in the order of time: joint angles at t = {t:.4f} s came after "
                                f"those at t = {self._t[-1]:.4f} s")
        self._asked.clear()
        self._t.append(t)
        self._q.append(np.array(q, dtype=float))
        while self._t[0] < t - _KEPT and len(self._t) > 4:
            self._t.popleft()
            self._q.popleft()

    def revise(self, t: float, q: Array) -> None:
        """Replaces the sample at ``t`` [s] by the better estimate ``q (n,)`` [rad]."""
        for i in range(len(self._t) - 1, -1, -1):
            if abs(self._t[i] - t) < ROUNDING:
                self._asked.clear()
                self._q[i] = np.array(q, dtype=float)
                return

    def q(self, t: float) -> Array:
        """Joint angles ``(n,)`` [rad] at ``t`` [s]; raises ``PlanningError`` before the history or too far after it."""
        times = self._t
        if not times or t < times[0] - ROUNDING or t > times[-1] + AHEAD:
            span = f"{times[0]:.3f} to {times[-1]:.3f} s" if times else "nothing"
            raise PlanningError(f"no pose at t = {t:.3f} s: the history holds {span}; is a time stamp wrong?")
        if len(times) < 4:
            return np.array([np.interp(t, times, column) for column in np.transpose(self._q)])
        last = len(times) - 1
        while last > 3 and times[last - 2] > t:
            last -= 1
        t0, t1, t2, t3 = (times[last - i] - t for i in (3, 2, 1, 0))
        # Lagrange's polynomial at t, which is 0 here.
        w0 = -t1 * t2 * t3 / ((t0 - t1) * (t0 - t2) * (t0 - t3))
        w1 = -t0 * t2 * t3 / ((t1 - t0) * (t1 - t2) * (t1 - t3))
        w2 = -t0 * t1 * t3 / ((t2 - t0) * (t2 - t1) * (t2 - t3))
        w3 = -t0 * t1 * t2 / ((t3 - t0) * (t3 - t1) * (t3 - t2))
        q = self._q
        return np.asarray(w0 * q[last - 3] + w1 * q[last - 2] + w2 * q[last - 1] + w3 * q[last])

    def pose(self, t: float) -> pin.SE3:
        """TCP pose in the base frame at ``t`` [s], not to be written to; raises as ``q``."""
        # The pose of an exposure is requested several times, so it is cached.
        if (pose := self._asked.get(t)) is None:
            pin.framesForwardKinematics(self._robot.pinocchio, self._data, self.q(t))
            pose = self._asked[t] = self._data.oMf[self._tool].copy()
        return pose

    def row_pose(self, t: float) -> pin.SE3:
        """TCP pose in the base frame at ``t`` [s], shared and read-only; raises as ``q``."""
        return self.pose(self._row(t))

    def row_q(self, t: float) -> Array:
        """Joint angles for a picture or one of its rows; see ``row_pose`` for instants before the first sample."""
        return self.q(self._row(t))

    def _row(self, t: float) -> float:
        return max(t, self._t[0]) if self._t and t > self._t[0] - _ROWS else t

    def velocity(self, t: float) -> tuple[Array, Array]:
        """Velocity of the TCP [m/s] and angular velocity [rad/s] in the base frame at ``t``, each ``(3,)``.

        Zero where the joint angles about ``t`` are not known.
        """
        step, model, data = 1e-3, self._robot.pinocchio, self._data
        try:
            rate = (self.q(t + step) - self.q(t - step)) / (2 * step)
        except PlanningError:
            return np.zeros(3), np.zeros(3)
        pin.forwardKinematics(model, data, self.q(t), rate)
        motion = pin.getFrameVelocity(model, data, self._tool, pin.LOCAL_WORLD_ALIGNED)
        return motion.linear.copy(), motion.angular.copy()
