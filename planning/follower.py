"""The seam of followers: from what sensors deliver to the desired path over a horizon."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from ideal_robot.arrays import Array
from planning.force.contact import Phase
from planning.line.measurement import Fused
from planning.path.pose_history import PoseHistory


class Follower(Protocol):
    """Sensor-based path planning ([L] Fig. 1): knows sensors and reference, and nothing of the robot's dynamics.

    Attributes:
        history: where the tool was, from ``observe``.
        q_start: joint angles at which the arm has to rest before the first cycle ``(n,)`` [rad].
    """

    history: PoseHistory

    @property
    def q_start(self) -> Array:
        """Where the arm has to rest at first ``(n,)`` [rad]."""
        ...

    def observe(self, t: float, q: Array, /) -> None:
        """Takes the arm's joint angles ``q (n,)`` [rad] at ``t`` [s]; every cycle, before measurements."""
        ...

    def horizon(self, t: float) -> Array:
        """Desired joint positions ``q_d(k) … q_d(k + n_d - 1)`` from ``t`` [s] on, ``(n_d, n)`` [rad]."""
        ...


class ContactGoal(Protocol):
    """What is wanted and assumed of a contact."""

    @property
    def elasticity(self) -> float:
        """Of tip and surface, as assumed [N/m]."""
        ...

    @property
    def reach(self) -> float:
        """Longest way of the approach [m]."""
        ...


class ForceFollower(Follower, Protocol):
    """A follower that keeps a contact force; it comes down, travels, and lifts again.

    Attributes:
        force: the normal force felt last [N].
        sideways: the force along the surface felt last [N].
        last_touch: when there was contact last [s].
    """

    force: float
    sideways: float
    last_touch: float

    @property
    def settings(self) -> ContactGoal:
        """What is wanted and assumed of the contact."""
        ...

    @property
    def normal(self) -> Array:
        """Out of the surface ``(3,)`` [base frame]."""
        ...

    @property
    def phase(self) -> Phase:
        """What the arm is about."""
        ...

    @property
    def descended(self) -> float:
        """How far the approach has come [m]."""
        ...

    def press_as(self, elasticity: float) -> None:
        """Assumes this elasticity of tip and surface [N/m] from now on."""
        ...

    def update_force(self, t: Array, contact: Array) -> Fused | None:
        """Takes contact forces ``contact (m, 3)`` [N] in the tool frame, measured at ``t (m,)`` [s]."""
        ...

    def contact_torque(self, q_d: Array) -> Array:
        """Joint torques of the wanted force over a horizon ``(n_d, n)`` [N m]."""
        ...

    def s_at(self, t: float) -> float:
        """Arc length at ``t`` [m]."""
        ...

    def speed_at(self, t: float) -> float:
        """Path speed at ``t`` [m/s]."""
        ...

    def planned(self) -> np.ndarray:
        """Planned deviation from the reference [m]."""
        ...
