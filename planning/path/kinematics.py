"""Inverse kinematics of single poses and of whole horizons, by Newton's method from a warm start."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.linalg.lapack import dgesv

from ideal_robot.arrays import Array
from ideal_robot.dynamics.newton_euler import Chain, chain_of, joint_frames
from ideal_robot.jit import jit
from ideal_robot.robots.robot import Robot
from planning import OutOfReachError

# Newton's method on many poses of a serial arm in one call, compiled.
#
# Pinocchio is the reference (a test compares them); this is for the control cycle, which solves a whole horizon: a call
# per pose costs more than its arithmetic.

DAMPING = 1e-6
"""Of the least-squares inverse where there are more or fewer than six joints."""
HALF_TURN = -0.99
"""Cosine of a rotation beyond which its axis is not told well enough."""


@jit(error_model="numpy")
def log6(R: Array, p: Array, out: Array) -> bool:
    """Twist of a motion, linear before angular, written to ``out (6,)``; whether it turns by less than half a turn.

    Args:
        R: rotation ``(3, 3)``.
        p: translation ``(3,)`` [m].
        out: result [m, rad], written to.
    """
    cosine = 0.5 * (R[0, 0] + R[1, 1] + R[2, 2] - 1.0)
    x, y, z = 0.5 * (R[2, 1] - R[1, 2]), 0.5 * (R[0, 2] - R[2, 0]), 0.5 * (R[1, 0] - R[0, 1])
    sine = np.sqrt(x * x + y * y + z * z)
    angle = np.arctan2(sine, cosine)
    if angle < 1e-4:
        longer, bend = 1.0 + angle * angle / 6.0, 1.0 / 12.0 + angle * angle / 720.0
    else:
        longer, bend = angle / sine, 1.0 / angle**2 - (1.0 + cosine) / (2.0 * angle * sine)
    x, y, z = longer * x, longer * y, longer * z
    a, b, c = y * p[2] - z * p[1], z * p[0] - x * p[2], x * p[1] - y * p[0]
    out[0] = p[0] - 0.5 * a + bend * (y * c - z * b)
    out[1] = p[1] - 0.5 * b + bend * (z * a - x * c)
    out[2] = p[2] - 0.5 * c + bend * (x * b - y * a)
    out[3], out[4], out[5] = x, y, z
    return cosine > HALF_TURN


@jit()
def tool_jacobian(chain: Chain, joints: int, tool_R: Array, tool_p: Array, q: Array, J: Array, T_R: Array, T_p: Array
                  ) -> None:
    """Jacobian in the tool's frame, and its pose in the base frame; written to ``J``, ``T_R``, ``T_p``.

    From the tool back to the base: with the tool's pose (R, p) in the frame of a joint about z, its column is
    (Rᵀ (z × p), Rᵀ z), of one that slides (Rᵀ z, 0).

    Args:
        chain: kinematics.
        joints: that carry the tool, the first ones of the chain.
        tool_R: the tool's rotation in the last one's frame ``(3, 3)``.
        tool_p: where it is there ``(3,)`` [m].
        q: joint angles ``(n,)`` [rad].
        J: ``(6, n)``, linear before angular, written to.
        T_R: rotation ``(3, 3)``, written to.
        T_p: place ``(3,)`` [m], written to.
    """
    n = len(q)
    R, p = np.empty((n, 3, 3)), np.empty((n, 3))
    joint_frames(chain, q, R, p)
    J[:] = 0.0
    T_R[:], T_p[:] = tool_R, tool_p
    turned = np.empty((3, 3))
    for i in range(joints - 1, -1, -1):
        z0, z1, z2 = chain.axis[i, 0], chain.axis[i, 1], chain.axis[i, 2]
        m0, m1, m2 = z1 * T_p[2] - z2 * T_p[1], z2 * T_p[0] - z0 * T_p[2], z0 * T_p[1] - z1 * T_p[0]
        slides = chain.prismatic[i] > 0.5
        for r in range(3):
            along = T_R[0, r] * z0 + T_R[1, r] * z1 + T_R[2, r] * z2
            if slides:
                J[r, i] = along
            else:
                J[r, i] = T_R[0, r] * m0 + T_R[1, r] * m1 + T_R[2, r] * m2
                J[3 + r, i] = along
        E, p0, p1, p2 = R[i], T_p[0], T_p[1], T_p[2]
        for r in range(3):
            for c in range(3):
                turned[r, c] = E[r, 0] * T_R[0, c] + E[r, 1] * T_R[1, c] + E[r, 2] * T_R[2, c]
        for r in range(3):
            T_p[r] = E[r, 0] * p0 + E[r, 1] * p1 + E[r, 2] * p2 + p[i, r]
        T_R[:] = turned


@jit()
def newton_step(chain: Chain, joints: int, tool_R: Array, tool_p: Array, target_R: Array, target_p: Array, q: Array,
                J: Array, error: Array) -> tuple[NDArray[np.floating[Any]], bool]:
    """Change of the joint angles ``(n,)`` towards a pose, and whether its error is less than half a turn.

    Args:
        chain: as for ``tool_jacobian``, like the next three.
        joints: see there.
        tool_R: see there.
        tool_p: see there.
        target_R: rotation wanted ``(3, 3)``.
        target_p: place wanted ``(3,)`` [m].
        q: joint angles ``(n,)`` [rad].
        J: room for the Jacobian ``(6, n)``.
        error: pose error before the step ``(6,)`` [m, rad], written to.
    """
    T_R, T_p, away_R, away_p = np.empty((3, 3)), np.empty(3), np.empty((3, 3)), np.empty(3)
    tool_jacobian(chain, joints, tool_R, tool_p, q, J, T_R, T_p)
    for r in range(3):
        for c in range(3):
            away_R[r, c] = T_R[0, r] * target_R[0, c] + T_R[1, r] * target_R[1, c] + T_R[2, r] * target_R[2, c]
        away_p[r] = (T_R[0, r] * (target_p[0] - T_p[0]) + T_R[1, r] * (target_p[1] - T_p[1])
                     + T_R[2, r] * (target_p[2] - T_p[2]))
    near = log6(away_R, away_p, error)
    if len(q) == 6:
        return np.linalg.solve(J, error), near
    return J.T @ np.linalg.solve(J @ J.T + DAMPING * np.eye(6), error), near


@jit()
def refined(chain: Chain, joints: int, tool_R: Array, tool_p: Array, targets_R: Array, targets_p: Array, q: Array,
            tolerance: float, most: int) -> int:
    """Nearly right joint angles ``q (N, n)`` of poses are made right in place; how many of them, from the first on.

    A pose is done with the step whose pose error before it, squared, was below ``tolerance``.

    Args:
        chain: as for ``tool_jacobian``, like the next three.
        joints: see there.
        tool_R: see there.
        tool_p: see there.
        targets_R: rotations wanted ``(N, 3, 3)``.
        targets_p: places wanted ``(N, 3)`` [m].
        q: ``(N, n)`` [rad], changed.
        tolerance: see above [m², rad²].
        most: steps of a pose at most.

    Raises:
        LinAlgError: a posture from which one cannot move in all directions.
    """
    J, error = np.empty((6, q.shape[1])), np.empty(6)
    for i in range(q.shape[0]):
        found = q[i].copy()
        done = False
        for _ in range(most):
            change, near = newton_step(chain, joints, tool_R, tool_p, targets_R[i], targets_p[i], found, J, error)
            if not near:
                return i
            found += change
            if np.sum(error * error) < tolerance:
                done = True
                break
        if not done:
            return i
        q[i] = found
    return q.shape[0]


TOLERANCE = 1e-9
"""Pose error that counts as solved [m and rad]."""
REFINED_IN = 10
"""Newton steps in which a nearly right solution has to become right."""


class InverseKinematics:
    r"""Joint angles of TCP poses.

    One Newton step is :math:`q \leftarrow q + J(q)^{-1} \log(T(q)^{-1} T_d)` with the Jacobian in the tool frame;
    with more or fewer than six joints the damped least-squares inverse takes the place of :math:`J^{-1}`.
    """

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self._model, self._data, self._tool = robot.pinocchio, robot.pinocchio.createData(), robot.tool_id
        self._square = robot.n == 6
        # computeFrameJacobian leaves the tool's pose in iMf[0]; holding the vector saves a third of the call's time.
        self._poses = self._data.iMf
        tool = self._model.frames[self._tool]
        self._chain = (chain_of(self._model), int(tool.parentJoint), np.ascontiguousarray(tool.placement.rotation),
                       np.array(tool.placement.translation))

    def fk(self, q: Array) -> pin.SE3:
        """TCP pose in the base frame at ``q (n,)`` [rad]."""
        pin.framesForwardKinematics(self._model, self._data, q)
        return self._data.oMf[self._tool].copy()

    def step(self, target: pin.SE3, q: Array) -> tuple[Array, Array]:
        """One Newton step: the next joint angles ``(n,)`` and the pose error ``(6,)`` before it [m, rad]."""
        jacobian = pin.computeFrameJacobian(self._model, self._data, q, self._tool, pin.LOCAL)
        error = pin.log6(self._poses[0].actInv(target)).vector
        if self._square:
            _, _, dq, info = dgesv(jacobian, error)
            if info == 0:
                return q + dq, error
        damping = DAMPING * np.eye(6)
        return q + jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + damping, error), error

    def torque(self, q: Array, force: Array) -> Array:
        """Joint torques Jᵀ F ``(n,)`` [N m] of a force ``(3,)`` [N, base frame] at the TCP, for ``q (n,)`` [rad]."""
        jacobian = pin.computeFrameJacobian(self._model, self._data, q, self._tool, pin.LOCAL_WORLD_ALIGNED)
        return np.asarray(jacobian[:3].T @ force)

    def solve(self, target: pin.SE3, q: Array, iterations: int = 50) -> Array:
        """Joint angles ``(n,)`` [rad] of one pose, from the guess ``q (n,)``; steps are cut to 0.3 rad.

        Args:
            target: pose of the TCP in the base frame.
            q: guess ``(n,)`` [rad].
            iterations: Newton steps at most.

        Raises:
            OutOfReachError: no solution within the joint limits near the guess.
        """
        error = np.full(6, np.inf)
        for _ in range(iterations):
            q_next, error = self.step(target, q)
            if np.max(np.abs(error)) < TOLERANCE:
                return self._within(target.translation, q)
            dq = q_next - q
            q = q + dq * min(1.0, 0.3 / max(float(np.max(np.abs(dq))), 1e-12))
        raise OutOfReachError(_position(target.translation), float(np.linalg.norm(error[:3])))

    def search(self, target: pin.SE3, home: Array, attempts: int = 40) -> Array:
        """Joint angles ``(n,)`` of one pose without a good guess: the solution nearest to ``home`` that was found.

        Newton's method starts from ``home`` and from postures scattered evenly over the joint ranges around it.

        Args:
            target: pose of the TCP in the base frame.
            home: preferred joint angles ``(n,)`` [rad].
            attempts: starts at most.

        Raises:
            OutOfReachError: no start leads to a solution within the joint limits.
        """
        lower, upper = np.maximum(self.robot.q_min, home - np.pi), np.minimum(self.robot.q_max, home + np.pi)
        failures: list[OutOfReachError] = []
        found: list[Array] = []
        for attempt in range(attempts):
            # Additive recurrence with the generalised golden ratio: even, and the same at each run.
            scatter = (0.5 + attempt * _golden(self.robot.n)) % 1.0
            guess = home if attempt == 0 else home + 0.5 * (lower + scatter * (upper - lower) - home)
            try:
                found.append(self.solve(target, self._wrapped(guess)))
            except OutOfReachError as error:
                failures.append(error)
                continue
            if attempt == 0 or len(found) > 4:
                break
        if not found:
            raise failures[0]
        return min(found, key=lambda q: float(np.max(np.abs(q - home))))

    def path(self, targets: Sequence[pin.SE3], q_start: Array) -> Array:
        """Joint angles ``(N, n)`` along a path of near poses; each starts from the linear continuation of the last two.

        Raises:
            OutOfReachError: the path leaves the reach or the joint limits, or jumps to another posture of the arm.
        """
        q = np.empty((len(targets), self.robot.n))
        for i, target in enumerate(targets):
            guess = q_start if i == 0 else (q[i - 1] if i == 1 else 2.0 * q[i - 1] - q[i - 2])
            q[i] = self.solve(target, guess)
        return q

    def refine(self, targets: Sequence[pin.SE3], q: Array, tolerance: float = 1e-6) -> Array:
        """``refine_rows`` of poses given as such.

        Args:
            targets: poses of the TCP in the base frame, ``N`` of them.
            q: as for ``refine_rows``.
            tolerance: as for ``refine_rows``.
        """
        return self.refine_rows(*rows_of(targets), q, tolerance)

    def refine_rows(self, rotations: Array, positions: Array, q: Array, tolerance: float = 1e-6) -> Array:
        """Joint angles ``(N, n)`` of poses whose nearly right solutions ``q (N, n)`` are known, for the real-time path.

        The error after a step is of the order of the square of the error before, so a pose is done as soon as the
        error *before* a step was below ``sqrt(tolerance)`` [m, rad].

        Args:
            rotations: of the TCP in the base frame ``(N, 3, 3)``.
            positions: of the TCP ``(N, 3)`` [m].
            q: nearly right joint angles ``(N, n)`` [rad].
            tolerance: square of the pose error before the last step [m², rad²].

        Raises:
            OutOfReachError: not solved in ten steps, or outside the joint limits.
        """
        solved = np.array(q, dtype=float)
        try:
            done = refined(*self._chain, rotations, positions, solved, tolerance, REFINED_IN)
        except np.linalg.LinAlgError:
            done = 0
        for i in range(done, len(solved)):
            solved[i] = self._refined(pin.SE3(rotations[i], positions[i]), solved[i], tolerance)
        if (solved > self.robot.q_max).any() or (solved < self.robot.q_min).any():
            worst = int(np.argmax(np.max(np.maximum(solved - self.robot.q_max, self.robot.q_min - solved), axis=1)))
            self._within(positions[worst], solved[worst])
        return solved

    def _refined(self, target: pin.SE3, q: Array, tolerance: float) -> Array:
        for _ in range(REFINED_IN):
            q, error = self.step(target, q)
            if error @ error < tolerance:
                return q
        raise OutOfReachError(_position(target.translation), float(np.linalg.norm(error[:3])))

    def _within(self, position: Array, q: Array) -> Array:
        """``q`` itself if it is within the joint limits."""
        beyond = np.maximum(q - self.robot.q_max, self.robot.q_min - q)
        joint = int(np.argmax(beyond))
        if beyond[joint] > 0:
            limit = self.robot.q_max[joint] if q[joint] > self.robot.q_max[joint] else self.robot.q_min[joint]
            raise OutOfReachError(_position(position), 0.0, joint + 1, float(q[joint]), float(limit))
        return q

    def _wrapped(self, q: Array) -> Array:
        return np.clip(q, self.robot.q_min, self.robot.q_max)


def _golden(n: int) -> Array:
    root = 2.0
    for _ in range(40):
        root = (1.0 + root) ** (1.0 / (n + 1))
    return np.asarray((1.0 / root) ** np.arange(1, n + 1), dtype=float)


def _position(place: Array) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in place)
    return x, y, z


def rows_of(targets: Sequence[pin.SE3]) -> tuple[Array, Array]:
    """Rotations ``(N, 3, 3)`` and positions ``(N, 3)`` [m] of poses."""
    return (np.array([target.rotation for target in targets]).reshape(-1, 3, 3),
            np.array([target.translation for target in targets]).reshape(-1, 3))
