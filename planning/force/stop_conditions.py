"""When to stop: force too large, contact or line lost, or a command that would leave what the joints may do."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.robots.robot import Robot
from planning.planning_error import PlanningError


class EmergencyStopError(PlanningError):
    """The arm has to stop on its path.

    Args:
        cause: ``force``, ``contact``, ``line``, ``reach``, ``position``, ``velocity`` or ``acceleration``.
        t: controller time [s].
        text: what was found, with value, limit and remedy.
    """

    def __init__(self, cause: str, t: float, text: str) -> None:
        self.cause, self.t = cause, t
        super().__init__(f"stopped at t = {t:.3f} s: {text}")


@dataclass(frozen=True)
class StopLimits:
    """What must not happen.

    Attributes:
        force: largest contact force [N].
        lost: longest time without contact during the travel [s].
        share: of the joints' velocity and acceleration limits that a desired path may use.
    """

    force: float = 80.0
    lost: float = 0.1
    share: float = 1.0

    def __post_init__(self) -> None:
        for key in ("force", "lost", "share"):
            if not getattr(self, key) > 0:
                raise InputError("expected a positive number", field=key, value=getattr(self, key))


class StopConditions:
    """Looks at every sample and at every horizon; raises before the arm does what it must not.

    Args:
        robot: whose joint limits count.
        limits: what must not happen.
    """

    def __init__(self, robot: Robot, limits: StopLimits) -> None:
        self._robot, self._limits, self._T = robot, limits, robot.t_ipo

    def force(self, t: float, force: float) -> None:
        """A contact force [N]. Raises ``EmergencyStopError`` above the limit, and where it is no number."""
        if not force <= self._limits.force:
            raise EmergencyStopError(
                "force",
                t,
                f"contact force {force:.1f} N is above the limit "
                f"{self._limits.force:.1f} N; look for an obstacle, or lower the speed",
            )

    def contact(self, t: float, last_touch: float) -> None:
        """The last instant of contact. Raises ``EmergencyStopError`` if it is too long ago."""
        if t - last_touch > self._limits.lost:
            raise EmergencyStopError(
                "contact",
                t,
                f"contact lost {1e3 * (t - last_touch):.0f} ms ago, allowed are "
                f"{1e3 * self._limits.lost:.0f} ms; look for an edge, or lower the speed",
            )

    def approach(self, t: float, descended: float, reach: float) -> None:
        """How far the approach has come [m]. Raises ``EmergencyStopError`` if there should have been contact.

        Args:
            t: controller time [s].
            descended: way of the approach so far [m].
            reach: largest allowed way [m].
        """
        if descended > reach:
            raise EmergencyStopError(
                "contact",
                t,
                f"no contact within {1e3 * reach:.0f} mm of the approach; look "
                "whether the surface is where it should be",
            )

    def command(self, t: float, q_d: Array) -> None:
        """A horizon ``(n_d, n)`` [rad]. Raises ``EmergencyStopError`` naming joint, value and limit."""
        robot, share = self._robot, self._limits.share
        self._within(t, "position", q_d, robot.q_min, robot.q_max, "rad; move the path")
        v = np.diff(q_d, axis=0) / self._T
        self._within(t, "velocity", v, -share * robot.v_max, share * robot.v_max, "rad/s; lower the speed")
        # Two cycles: a single one would take the rounding of the inverse kinematics for acceleration.
        if len(v) > 2:
            a = (v[2:] - v[:-2]) / (2 * self._T)
            self._within(t, "acceleration", a, -share * robot.a_max, share * robot.a_max, "rad/s²; lower the speed")

    def _within(self, t: float, cause: str, values: Array, low: Array, high: Array, remedy: str) -> None:
        beyond = np.maximum(values - high, low - values)
        if beyond.max(initial=-1.0) > 0:
            row, joint = np.unravel_index(int(np.argmax(beyond)), beyond.shape)
            value = float(values[row, joint])
            limit = float(high[joint] if value > high[joint] else low[joint])
            raise EmergencyStopError(
                cause, t, f"joint {joint + 1} would need {cause} {value:.3f}, its limit is {limit:.3f} {remedy}"
            )
