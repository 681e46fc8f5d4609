"""Inverse kinematics of single poses and of whole horizons, by Newton's method from a warm start."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.dynamics.inverse_kinematics import Tool, newton_step, refined
from ideal_robot.robots.joints import own_joints
from ideal_robot.robots.robot import Robot
from ideal_robot.tolerances import DAMPING, NEWTON_STEPS, ROUNDING, SETTLED, SLIGHT
from planning import OutOfReachError

TILTED = 0.2
"""How far the tool axis of an arm of fewer than six joints may be from the one wanted [rad]."""
DRAWN_BACK = 0.02
"""Share of the way to the first posture that more than six joints are drawn back with each pose of a path."""


class InverseKinematics:
    """Joint angles of TCP poses, by the Newton steps of ``ideal_robot.dynamics.inverse_kinematics``."""

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self._model, self._data, self._tool = robot.pinocchio, robot.pinocchio.createData(), robot.tool_id
        self._carried = Tool.of(self._model, self._tool)

    def fk(self, q: Array) -> pin.SE3:
        """TCP pose in the base frame at ``q (n,)`` [rad]."""
        pin.framesForwardKinematics(self._model, self._data, q)
        return self._data.oMf[self._tool].copy()

    def last_axis(self) -> Array:
        """Direction of the last joint's axis in the tool frame ``(3,)``; zero for a prismatic joint."""
        jacobian = pin.computeFrameJacobian(self._model, self._data, pin.neutral(self._model), self._tool, pin.LOCAL)
        return np.array(jacobian[3:, -1])

    def elbow(self, q: Array) -> float:
        """How high the joint in the middle of the arm is above the base at ``q (n,)`` [m]."""
        pin.forwardKinematics(self._model, self._data, q)
        middle = own_joints(self._model)[(self.robot.n - 1) // 2]
        return float(self._data.oMi[middle].translation[2])

    def step(self, target: pin.SE3, q: Array, wanted: Array | None = None) -> tuple[Array, Array]:
        """One Newton step: the next joint angles ``(n,)`` and the pose error ``(6,)`` before it [m, rad].

        Args:
            target: pose of the TCP in the base frame.
            q: joint angles at its start ``(n,)`` [rad].
            wanted: angles that a redundant arm tends to ``(n,)`` [rad]; the start if None.
        """
        error, q = np.empty(6), np.ascontiguousarray(q, dtype=float)
        pose = np.ascontiguousarray(target.rotation), np.array(target.translation)
        near = q if wanted is None else np.ascontiguousarray(wanted, dtype=float)
        return q + newton_step(self._carried, *pose, q, near, SLIGHT, error), error

    def _solved(self, error: Array, dq: Array) -> bool:
        """Whether a pose is reached: all of the error is gone, or what fewer than six joints can remove of it."""
        if self.robot.n == 6:
            return bool(np.max(np.abs(error)) < ROUNDING)
        if self.robot.n > 6:
            return bool(np.max(np.abs(error)) < ROUNDING and np.max(np.abs(dq)) < SETTLED)
        return bool(np.max(np.abs(dq)) < ROUNDING and np.max(np.abs(error[:3])) < SETTLED
                    and np.linalg.norm(error[3:5]) < TILTED)

    def torque(self, q: Array, force: Array) -> Array:
        """Joint torques Jᵀ F ``(n,)`` [N m] of a force ``(3,)`` [N, base frame] at the TCP, for ``q (n,)`` [rad]."""
        jacobian = pin.computeFrameJacobian(self._model, self._data, q, self._tool, pin.LOCAL_WORLD_ALIGNED)
        return np.asarray(jacobian[:3].T @ force)

    def away(self, q: Array, way: Array) -> Array:
        """Change of the joint angles ``(n,)`` [rad] that translates the TCP by ``way (3,)`` [m, base frame].

        To first order about ``q (n,)`` [rad]: for some centimetres, where a failure of the inverse kinematics is not
        acceptable.
        """
        jacobian = pin.computeFrameJacobian(self._model, self._data, q, self._tool, pin.LOCAL_WORLD_ALIGNED)
        damped = jacobian @ jacobian.T + DAMPING * np.eye(6)
        return np.asarray(jacobian.T @ np.linalg.solve(damped, np.append(way, np.zeros(3))))

    def solve(self, target: pin.SE3, q: Array, iterations: int = 50, wanted: Array | None = None) -> Array:
        """Joint angles ``(n,)`` [rad] of one pose, from the guess ``q (n,)``; steps are cut to 0.3 rad.

        Raises ``OutOfReachError`` where no solution lies within the joint limits near the guess.

        Args:
            target: pose of the TCP in the base frame.
            q: guess ``(n,)`` [rad].
            iterations: Newton steps at most.
            wanted: as for ``step``.
        """
        error = np.full(6, np.inf)
        for _ in range(iterations):
            q_next, error = self.step(target, q, wanted)
            dq = q_next - q
            if self._solved(error, dq):
                return self._within(target.translation, q)
            q = q + dq * min(1.0, 0.3 / max(float(np.max(np.abs(dq))), 1e-12))
        raise OutOfReachError(target.translation, float(np.linalg.norm(error[:3])))

    def search(self, target: pin.SE3, home: Array, attempts: int = 40) -> Array:
        """Joint angles ``(n,)`` of one pose without a good guess: the solution nearest to ``home`` that was found.

        Newton's method starts from ``home`` and from postures scattered evenly over the joint ranges around it.
        Raises ``OutOfReachError`` where no start leads to a solution within the joint limits.

        Args:
            target: pose of the TCP in the base frame.
            home: preferred joint angles ``(n,)`` [rad].
            attempts: starts at most.
        """
        lower, upper = np.maximum(self.robot.q_min, home - np.pi), np.minimum(self.robot.q_max, home + np.pi)
        failures: list[OutOfReachError] = []
        solutions: list[Array] = []
        for attempt in range(attempts):
            # Additive recurrence with the generalised golden ratio: even, and the same at each run.
            scatter = (0.5 + attempt * _golden(self.robot.n)) % 1.0
            guess = home if attempt == 0 else home + 0.5 * (lower + scatter * (upper - lower) - home)
            try:
                solutions.append(self.solve(target, np.clip(guess, self.robot.q_min, self.robot.q_max)))
            except OutOfReachError as error:
                failures.append(error)
                continue
            if attempt == 0 or len(solutions) > 4:
                break
        if not solutions:
            raise failures[0]
        return min(solutions, key=lambda q: float(np.max(np.abs(q - home))))

    def path(self, targets: Sequence[pin.SE3], q_start: Array) -> Array:
        """Joint angles ``(N, n)`` along a path of near poses; each starts from the linear continuation of the last two.

        A redundant arm stays as near to ``q_start`` as the poses permit. Raises ``OutOfReachError`` where the path
        leaves the reach or the joint limits, or jumps to another posture of the arm.
        """
        q = np.empty((len(targets), self.robot.n))
        for i, target in enumerate(targets):
            guess = q_start if i == 0 else (q[i - 1] if i == 1 else 2.0 * q[i - 1] - q[i - 2])
            # The angles return step by step, as with a far target Newton's method overshoots.
            q[i] = self.solve(target, guess, wanted=guess + DRAWN_BACK * (q_start - guess))
        return q

    def refine(self, targets: Sequence[pin.SE3], q: Array, tolerance: float = 1e-6) -> Array:
        """Joint angles ``(N, n)`` of SE3 poses near known solutions; see ``InverseKinematics.refine_rows``.

        See ``InverseKinematics.refine_rows``.
        """
        rotations = np.array([target.rotation for target in targets]).reshape(-1, 3, 3)
        positions = np.array([target.translation for target in targets]).reshape(-1, 3)
        return self.refine_rows(rotations, positions, q, tolerance)

    def refine_rows(self, rotations: Array, positions: Array, q: Array, tolerance: float = 1e-6,
                    wanted: Array | None = None) -> Array:
        """Joint angles ``(N, n)`` of poses whose approximate solutions ``q (N, n)`` are known, for the real-time path.

        The error after a step is of the order of the square of the error before, so a pose is done as soon as the
        error *before* a step was below ``sqrt(tolerance)`` [m, rad].
        Raises ``OutOfReachError`` where that takes more than ten steps, or leads outside the joint limits.

        Args:
            rotations: of the TCP in the base frame ``(N, 3, 3)``.
            positions: of the TCP ``(N, 3)`` [m].
            q: nearly right joint angles ``(N, n)`` [rad].
            tolerance: square of the pose error before the last step [m², rad²].
            wanted: as for ``step``, of each pose ``(N, n)`` [rad]; ``q`` if None.
        """
        solved = np.array(q, dtype=float)
        near = solved.copy() if wanted is None else np.ascontiguousarray(wanted)
        done = refined(self._carried, np.ascontiguousarray(rotations), np.ascontiguousarray(positions), solved, near,
                       tolerance, NEWTON_STEPS)
        if done < len(solved):
            _, error = self.step(pin.SE3(rotations[done], positions[done]), solved[done], near[done])
            raise OutOfReachError(positions[done], float(np.linalg.norm(error[:3])))
        if (solved > self.robot.q_max).any() or (solved < self.robot.q_min).any():
            worst = int(np.argmax(np.max(np.maximum(solved - self.robot.q_max, self.robot.q_min - solved), axis=1)))
            self._within(positions[worst], solved[worst])
        return solved

    def _within(self, position: Array, q: Array) -> Array:
        """``q`` itself if it is within the joint limits."""
        beyond = np.maximum(q - self.robot.q_max, self.robot.q_min - q)
        joint = int(np.argmax(beyond))
        if beyond[joint] > 0:
            limit = self.robot.q_max[joint] if q[joint] > self.robot.q_max[joint] else self.robot.q_min[joint]
            raise OutOfReachError(position, 0.0, joint + 1, float(q[joint]), float(limit))
        return q


def _golden(n: int) -> Array:
    root = 2.0
    for _ in range(40):
        root = (1.0 + root) ** (1.0 / (n + 1))
    return np.asarray((1.0 / root) ** np.arange(1, n + 1), dtype=float)
