"""Estimates the arm angles behind elastic gears from motor angles and a model."""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.elasticity.observer import ArmObserver, GearDeflection
from ideal_robot.feedforward.corrected_arm import CorrectedArm
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from planning.force.surface_forecast import FeltArm
from planning.path.kinematics import InverseKinematics
from planning.path.pose_history import PoseHistory


class FreeArm:
    """Arm angles of an arm without contact: its gears deflect under weight and inertia of the desired motion.

    Args:
        robot: the arm as drawn.
        model: None where the gears are not known: the gears are then taken as rigid.
    """

    def __init__(self, robot: Robot, model: Model | None) -> None:
        self._deflection = None if model is None else GearDeflection(model, robot.t_ipo)
        self._geometry = CorrectedArm(robot, () if model is None else model.effects)

    def at(self, t: float, q: Array, q_d: Array, torque: Array | None, steps: int) -> Array:
        """Arm angles ``(n,)`` [rad] of the arm as drawn at the begin of a cycle; see ``ArmAngles.at``."""
        return self._geometry.as_drawn(q if self._deflection is None else q - self._deflection.at(q_d))


class PressingArm:
    """Arm angles of an arm in contact: its gears also deflect under contact forces, which arrive late.

    Args:
        robot: the arm as drawn.
        model: None where the gears are not known: the gears are then taken as rigid.
        q_start: motor angles at rest before the first cycle ``(n,)`` [rad].
    """

    def __init__(self, robot: Robot, model: Model | None, q_start: Array) -> None:
        self._geometry = CorrectedArm(robot, () if model is None else model.effects)
        self._arm = None if model is None else FeltArm(ArmObserver(model, robot.t_ipo), q_start,
                                                       InverseKinematics(robot).torque)

    def at(self, t: float, q: Array, q_d: Array, torque: Array | None, steps: int) -> Array:
        """Arm angles ``(n,)`` [rad] of the arm as drawn at the begin of a cycle; see ``ArmAngles.at``."""
        if self._arm is None:
            return q
        expected = np.zeros_like(q) if torque is None else torque[0]
        return self._geometry.as_drawn(self._arm.step(t, q, expected, steps))

    def feel(self, t: Array, contact: Array, history: PoseHistory) -> None:
        """Adds contact forces, and revises the arm angles at their instants.

        Args:
            t: instants ``(m,)`` [s].
            contact: forces then ``(m, 3)`` [N, tool frame].
            history: estimated arm angles over time; they are revised.
        """
        if self._arm is None:
            return
        force = np.array([history.pose(max(at, history.first)).rotation @ f for at, f in zip(t, contact, strict=True)])
        for at, q_a in self._arm.feel(t, force):
            history.revise(at, self._geometry.as_drawn(q_a))
