"""Corrects joint paths for an arm whose geometry differs from its drawings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array, eased, interpolated
from ideal_robot.dynamics.inverse_kinematics import Tool, newton_step
from ideal_robot.effects import FittedEffect
from ideal_robot.effects.loop_change import LoopChange
from ideal_robot.feedforward.base import SETTLE, Feedforward
from ideal_robot.model.arm_with_effects import changes_of
from ideal_robot.robots.interface import RobotState
from ideal_robot.robots.joints import joint_motions, own_joints
from ideal_robot.robots.robot import Robot, common_normals
from ideal_robot.tolerances import CORRECTION_SPACING, CORRECTION_STEPS, DAMPING


class CorrectedArm:
    """Kinematics with the geometric errors of a model's effects, and their inverse for paths.

    Paths were planned with the kinematics of ``robot``, as drawn.
    """

    def __init__(self, robot: Robot, effects: tuple[FittedEffect, ...]) -> None:
        self._robot = robot
        changes = [(effect.joint, change) for effect, change in changes_of(effects)
                   if change.zero or change.geometry is not None]
        self.differs = bool(changes)
        """Whether any effect changes the geometry."""
        if not self.differs:
            return
        self._model, normals = robot.pinocchio.copy(), common_normals(robot)
        self._drawn, self._data = robot.pinocchio.createData(), self._model.createData()
        for joint, change in changes:
            _displace(self._model, robot, joint, normals[joint - 1], change)
        self._tool = Tool.of(self._model, robot.tool_id)

    def tool(self, q: Array) -> pin.SE3:
        """Pose of the TCP in the base frame at joint angles ``(n,)`` [rad]."""
        if not self.differs:
            return self._robot.fk()(q)
        pin.framesForwardKinematics(self._model, self._data, np.asarray(q, dtype=float))
        return self._data.oMf[self._robot.tool_id].copy()

    def joints(self, q_d: Array) -> Array:
        """Joint angles ``(N, n)`` [rad] that bring this arm's tool to where the drawn arm's is at ``q_d (N, n)``.

        Near a singular posture the tool deviates by micrometres, so that no joint moves far.
        """
        if not self.differs:
            return q_d
        result, error = np.array(q_d, dtype=float), np.empty(6)
        for row in result:
            pin.framesForwardKinematics(self._robot.pinocchio, self._drawn, row)
            wanted = self._drawn.oMf[self._robot.tool_id]
            pose = np.ascontiguousarray(wanted.rotation), np.array(wanted.translation)
            for _ in range(CORRECTION_STEPS):
                row += newton_step(self._tool, *pose, row, row, DAMPING, error)
        return result

    def as_drawn(self, q: Array) -> Array:
        """Angles ``(n,)`` [rad] at which the drawn arm's tool is where this arm's is at ``q (n,)``; undoes ``joints``.

        A follower with the kinematics of the drawn arm then has the true tool pose.
        """
        if not self.differs:
            return q
        drawn = np.asarray(q, dtype=float)
        for _ in range(CORRECTION_STEPS):
            drawn = q - (self.joints(drawn[None])[0] - drawn)
        return np.asarray(drawn)

    def from_rest(self, q_d: Array, t_ipo: float) -> Array:
        """``joints`` along a path ``(N, n)`` [rad] from the drawn arm's rest: the correction begins smoothly."""
        if not self.differs:
            return q_d
        return np.asarray(q_d + taken_up(t_ipo * np.arange(float(len(q_d))))[:, None] * (self.joints(q_d) - q_d))


def taken_up(t: Array) -> Array:
    """Share of the correction at times ``(N,)`` [s] after the start: smoothly from 0 to 1."""
    return eased(np.minimum(t / SETTLE, 1.0))


def _displace(model: pin.Model, robot: Robot, joint: int, normal: Array, change: LoopChange) -> None:
    """Moves all that is behind a joint (from 1) in the joint's own frame, as a change of its geometry says."""
    a, d, alpha, theta = change.geometry or (0.0, 0.0, 0.0, 0.0)
    number = own_joints(robot.pinocchio)[joint - 1]
    axis = joint_motions(robot.pinocchio).axis[number - 1]
    moved = pin.SE3(pin.exp3(alpha * normal + (theta + change.zero) * axis), a * normal + d * axis)
    if number < model.njoints - 1:
        model.jointPlacements[number + 1] = moved * model.jointPlacements[number + 1]
    for frame in model.frames:
        if frame.parentJoint == number:
            frame.placement = moved * frame.placement


@dataclass(frozen=True)
class CorrectedState:
    """State of the corrected feedforward, and the number of cycles since the start."""

    inner: Any
    cycle: int


class ForCorrectedArm(Feedforward):
    """A feedforward whose desired path is corrected by the inverse kinematics of the corrected arm."""

    def __init__(self, feedforward: Feedforward, arm: CorrectedArm) -> None:
        self.feedforward, self.arm = feedforward, arm
        self.n_d, self.t_ipo, self.extends = feedforward.n_d, feedforward.t_ipo, feedforward.extends

    def init(self, q0: Array) -> CorrectedState:
        """State for an arm at rest at ``q0 (n,)`` [rad]; see ``Feedforward.init``."""
        return CorrectedState(self.feedforward.init(q0), 0)

    def step(self, state: CorrectedState, q_d: Array, tau_ext_d: Array | None = None) -> tuple[Array, CorrectedState]:
        """The command of one interpolation cycle; see ``Feedforward.step``."""
        share = taken_up(self.t_ipo * (state.cycle + np.arange(float(len(q_d)))))[:, None]
        path = np.asarray(q_d, dtype=float)
        # The correction changes slowly, so every few rows of the horizon suffice.
        every = max(1, round(CORRECTION_SPACING / self.t_ipo))
        rows = np.unique(np.append(np.arange(0, len(path), every), len(path) - 1))
        off = self.arm.joints(path[rows]) - path[rows]
        path = path + share * interpolated(np.arange(len(path)), rows, off)
        q_c, inner = self.feedforward.step(state.inner, path, tau_ext_d)
        return q_c, CorrectedState(inner, state.cycle + 1)

    @property
    def observes(self) -> bool:
        """Whether the corrected feedforward observes; see ``Feedforward.observes``."""
        return self.feedforward.observes

    def observe(self, state: CorrectedState, measured: RobotState) -> CorrectedState:
        """The next state, given the controller's report at the end of a cycle; see ``Feedforward.observe``."""
        return CorrectedState(self.feedforward.observe(state.inner, measured), state.cycle)


def for_arm(feedforward: Feedforward, robot: Robot, effects: tuple[FittedEffect, ...]) -> Feedforward:
    """The feedforward for an arm with the effects' geometric errors; unchanged if there are none.

    Args:
        feedforward, robot: made for the drawn arm, and that arm.
        effects: of the model.
    """
    arm = CorrectedArm(robot, effects)
    return ForCorrectedArm(feedforward, arm) if arm.differs else feedforward
