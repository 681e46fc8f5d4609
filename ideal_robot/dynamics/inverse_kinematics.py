r"""Inverse kinematics of a serial arm, compiled: one Newton step, and whole horizons of poses.

With the pose error :math:`e = \log(T(q)^{-1} T_d)`, the Jacobian J in the tool frame and w a desired change in the null
space, one step is

.. math:: q \leftarrow q + w + J^T (J J^T + \Lambda)^{-1} (e - J w)

for any number of joints: the change nearest to w that removes the error, but for what :math:`\Lambda`, the variances of
permitted residuals, lets remain. With six joints that is Newton's step. Redundant arms tend to given joint angles, so
that the solution is a function of the pose and the path is smooth. Arms with fewer joints keep the position, the tool
axis as far as possible, and give up the rotation about that axis. It plans paths (``planning.path.kinematics``) and
corrects paths of arms with geometric errors (``ideal_robot.feedforward.corrected_arm``).

Pinocchio is the reference (a test compares them); this is for the control cycle, which solves a whole horizon: a call
per pose costs more than its arithmetic.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.dynamics.newton_euler import Chain, chain_of, frames_of, joint_frames
from ideal_robot.estimate.cholesky import factor, solve
from ideal_robot.jit import jit
from ideal_robot.tolerances import HALF_TURN, SLIGHT

TILT, TWIST = 1e3, 1e4
"""What may be left of the tool axis' direction and of the rotation about it [rad/m], beside 1 of the place, where there
are fewer than six joints: the place is kept, the tool axis as far as the arm can, the rotation about it is left."""


class Tool(NamedTuple):
    """An arm's kinematics up to its tool.

    Attributes:
        chain: of the arm.
        joints: joints before the tool, the first ones of the chain.
        R, p: the tool's rotation in the last one's frame ``(3, 3)``, and where it is there ``(3,)`` [m].
    """

    chain: Chain
    joints: int
    R: Array
    p: Array

    @classmethod
    def of(cls, model: pin.Model, frame: int) -> Tool:
        """The tool at a frame of a Pinocchio model; raises InputError where the model is no serial chain."""
        tool = model.frames[frame]
        return cls(chain_of(model), int(tool.parentJoint), np.ascontiguousarray(tool.placement.rotation),
                   np.array(tool.placement.translation))


@jit(error_model="numpy")
def log6(R: Array, p: Array, out: Array) -> None:
    """Twist of a motion [m, rad], linear first, written to ``out (6,)``.

    Args:
        R, p: rotation ``(3, 3)`` and translation ``(3,)`` [m] of the motion.
        out: see above.
    """
    cosine = 0.5 * (R[0, 0] + R[1, 1] + R[2, 2] - 1.0)
    x, y, z = 0.5 * (R[2, 1] - R[1, 2]), 0.5 * (R[0, 2] - R[2, 0]), 0.5 * (R[1, 0] - R[0, 1])
    sine = np.sqrt(x * x + y * y + z * z)
    angle = np.arctan2(sine, cosine)
    if angle < 1e-4:
        longer, bend = 1.0 + angle * angle / 6.0, 1.0 / 12.0 + angle * angle / 720.0
    else:
        longer, bend = angle / sine, 1.0 / angle**2 - 1.0 / (2.0 * angle * np.tan(0.5 * angle))
    if cosine < HALF_TURN:
        # R + Rᵀ = 2 cos I + 2 (1 - cos) a aᵀ holds the axis a up to its sign; R - Rᵀ holds the sign.
        k = 0
        for r in range(1, 3):
            if R[r, r] > R[k, k]:
                k = r
        largest = np.sqrt(max(R[k, k] - cosine, 0.0) / (1.0 - cosine))
        a = 0.5 * (R[0, k] + R[k, 0]) / ((1.0 - cosine) * largest) if k != 0 else largest
        b = 0.5 * (R[1, k] + R[k, 1]) / ((1.0 - cosine) * largest) if k != 1 else largest
        c = 0.5 * (R[2, k] + R[k, 2]) / ((1.0 - cosine) * largest) if k != 2 else largest
        longer = -angle if a * x + b * y + c * z < 0.0 else angle
        x, y, z = a, b, c
    x, y, z = longer * x, longer * y, longer * z
    a, b, c = y * p[2] - z * p[1], z * p[0] - x * p[2], x * p[1] - y * p[0]
    out[0] = p[0] - 0.5 * a + bend * (y * c - z * b)
    out[1] = p[1] - 0.5 * b + bend * (z * a - x * c)
    out[2] = p[2] - 0.5 * c + bend * (x * b - y * a)
    out[3], out[4], out[5] = x, y, z


@jit()
def tool_jacobian(tool: Tool, q: Array, J: Array, T_R: Array, T_p: Array) -> None:
    """Writes the Jacobian ``J (6, n)``, linear first, in the tool's frame, and its pose in the base frame.

    From the tool back to the base: with the tool's pose (R, p) in the frame of a joint about z, its column is
    (Rᵀ (z × p), Rᵀ z), of one that slides (Rᵀ z, 0).

    Args:
        tool, q: kinematics, and joint angles ``(n,)`` [rad].
        J, T_R, T_p: written to; the pose's rotation is ``(3, 3)``, its place ``(3,)`` [m].
    """
    chain = tool.chain
    R, p = frames_of(chain)
    joint_frames(chain, q, R, p)
    J[:] = 0.0
    # Element by element, as assignments of whole arrays take seconds to compile.
    for r in range(3):
        T_p[r] = tool.p[r]
        for c in range(3):
            T_R[r, c] = tool.R[r, c]
    turned = np.empty((3, 3))
    for i in range(tool.joints - 1, -1, -1):
        j, ratio = chain.coordinate[i], chain.ratio[i]
        z0, z1, z2 = ratio * chain.axis[i, 0], ratio * chain.axis[i, 1], ratio * chain.axis[i, 2]
        m0, m1, m2 = z1 * T_p[2] - z2 * T_p[1], z2 * T_p[0] - z0 * T_p[2], z0 * T_p[1] - z1 * T_p[0]
        slides = chain.prismatic[i] > 0.5
        for r in range(3):
            along = T_R[0, r] * z0 + T_R[1, r] * z1 + T_R[2, r] * z2
            if slides:
                J[r, j] += along
            else:
                J[r, j] += T_R[0, r] * m0 + T_R[1, r] * m1 + T_R[2, r] * m2
                J[3 + r, j] += along
        E, p0, p1, p2 = R[i], T_p[0], T_p[1], T_p[2]
        for r in range(3):
            for c in range(3):
                turned[r, c] = E[r, 0] * T_R[0, c] + E[r, 1] * T_R[1, c] + E[r, 2] * T_R[2, c]
        for r in range(3):
            T_p[r] = E[r, 0] * p0 + E[r, 1] * p1 + E[r, 2] * p2 + p[i, r]
            for c in range(3):
                T_R[r, c] = turned[r, c]


@jit()
def newton_step(tool: Tool, target_R: Array, target_p: Array, q: Array, wanted: Array, slack: float, error: Array
                ) -> Array:
    """Change of the joint angles ``(n,)`` [rad] towards a pose.

    Args:
        tool: kinematics.
        target_R: desired rotation ``(3, 3)``.
        target_p: desired position ``(3,)`` [m].
        q: joint angles ``(n,)`` [rad].
        wanted: angles that a redundant arm tends to ``(n,)`` [rad].
        slack: variance Λ of the permitted position residual [m²]: above 0, so that a step exists in every posture.
        error: of the pose before the step ``(6,)`` [m, rad], written to.
    """
    T_R, T_p, away_R, away_p = np.empty((3, 3)), np.empty(3), np.empty((3, 3)), np.empty(3)
    n = len(q)
    J, A, rest, change = np.empty((6, n)), np.empty((6, 6)), np.empty(6), np.empty(n)
    tool_jacobian(tool, q, J, T_R, T_p)
    for r in range(3):
        for c in range(3):
            away_R[r, c] = T_R[0, r] * target_R[0, c] + T_R[1, r] * target_R[1, c] + T_R[2, r] * target_R[2, c]
        away_p[r] = (T_R[0, r] * (target_p[0] - T_p[0]) + T_R[1, r] * (target_p[1] - T_p[1])
                     + T_R[2, r] * (target_p[2] - T_p[2]))
    log6(away_R, away_p, error)
    for i in range(n):
        change[i] = wanted[i] - q[i] if n > 6 else 0.0
    for r in range(6):
        rest[r] = error[r]
        for i in range(n):
            rest[r] -= J[r, i] * change[i]
        for c in range(r + 1):
            A[r, c] = 0.0
            for i in range(n):
                A[r, c] += J[r, i] * J[c, i]
        left = 1.0 if n >= 6 or r < 3 else (TILT if r < 5 else TWIST)
        A[r, r] += slack * left * left
    factor(A)
    solve(A, rest)
    for i in range(n):
        for r in range(6):
            change[i] += J[r, i] * rest[r]
    return change


@jit()
def refined(tool: Tool, targets_R: Array, targets_p: Array, q: Array, wanted: Array, tolerance: float, most: int
            ) -> int:
    """Refines approximate joint angles ``q (N, n)`` of poses in place; returns how many are done, from the first on.

    A pose is done with the step whose pose error before it, squared, was below ``tolerance``; of fewer than six joints,
    which cannot remove all of it, with one that changes them by a tenth of that.

    Args:
        tool: kinematics.
        targets_R: desired rotations ``(N, 3, 3)``.
        targets_p: desired positions ``(N, 3)`` [m].
        q: ``(N, n)`` [rad], changed.
        wanted: angles that a redundant arm tends to in each pose ``(N, n)`` [rad].
        tolerance: see above [m², rad²].
        most: steps of a pose at most.
    """
    error, n = np.empty(6), q.shape[1]
    for i in range(q.shape[0]):
        done = False
        for _ in range(most):
            change = newton_step(tool, targets_R[i], targets_p[i], q[i], wanted[i], SLIGHT, error)
            q[i] += change
            remaining = error if n >= 6 else 10.0 * change
            square = 0.0
            for value in remaining:
                square += value * value
            if square < tolerance:
                done = True
                break
        if not done:
            return i
    return q.shape[0]
