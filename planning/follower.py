"""The interface of followers, which turn fused deviations into the desired path of the coming cycles."""

from __future__ import annotations

from enum import Enum
from typing import Protocol

from ideal_robot.arrays import Array
from ideal_robot.robots.robot import Robot
from planning.path.pose_history import PoseHistory


class Phase(Enum):
    """Phases of a motion in their order; one that touches nothing travels from its begin to its end."""

    APPROACH = "approach"
    SETTLE = "settle"
    TRAVEL = "travel"
    LIFT = "lift"
    DONE = "done"


class Follower(Protocol):
    """Reference path plus deviation: the desired joint positions over a horizon.

    Attributes:
        robot: the arm.
        n_d: desired positions of a horizon, the current one included.
        history: past poses of the tool.
    """

    robot: Robot
    n_d: int
    history: PoseHistory

    @property
    def phase(self) -> Phase:
        """The present phase of the motion."""

    @property
    def q_start(self) -> Array:
        """Joint angles at which the arm has to rest before the start ``(n,)`` [rad]."""

    def observe(self, t: float, q_a: Array) -> None:
        """Stores the arm angles ``(n,)`` [rad] measured at ``t`` [s]; call it before each cycle's sensor data."""

    def horizon(self, t: float, anew: bool = True) -> Array:
        """Desired joint positions ``(n_d, n)`` [rad] from ``t`` [s] on.

        ``anew``: whether there is time for a new plan; otherwise the last plan is continued.

        Raises:
            PlanningError, LimitError: the path cannot go on.
        """

    def desired_deviation(self, t: float) -> Array:
        """Desired deviation from the reference in the cycle at ``t`` [s], in the sensed directions [m]."""

    def s_at(self, t: float) -> float:
        """Arc length of the travel at ``t`` [m]."""

    def speed_at(self, t: float) -> float:
        """Speed of the travel at ``t`` [m/s]."""

    def contact_torque(self, q_d: Array) -> Array | None:
        """Expected joint torques of a contact over the horizon ``(n_d, n)`` [N m]; None without contact."""

    def done(self, t: float) -> bool:
        """Whether the cycle that began at ``t`` [s] is the last one."""
