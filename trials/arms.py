"""Arms, motions and measurements for blind trials: serial chains of any kind, drawn at random."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.robots.robot import Robot, prismatic_joints

SHIPPED = ("kr6", "kr15", "manutec_r15")


@dataclass(frozen=True)
class Arm:
    """An arm as drawn.

    Attributes:
        urdf: what the diagnosis is given.
        model: the true rigid body; its inertias differ from those of the URDF.
        rotor: true rotor inertias on the joint side ``(n,)``.
        viscous, coulomb: true friction ``(n,)``.
        offset: torque offsets ``(n,)``.
        low, high: range of the motion ``(n,)``.
        fast, quick: velocity and acceleration the motion stays within ``(n,)``.
    """

    urdf: str
    model: pin.Model
    rotor: Array
    viscous: Array
    coulomb: Array
    offset: Array
    low: Array
    high: Array
    fast: Array
    quick: Array

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.model.nv)


def draw_arm(rng: np.random.Generator) -> Arm:
    """A shipped robot in two of five trials, else a chain of one to seven joints."""
    if rng.random() < 0.4:
        urdf = Robot.load(str(rng.choice(SHIPPED))).urdf.read_text(encoding="utf-8")
    else:
        urdf = _random_urdf(rng, int(rng.choice([1, 2, 3, 4, 6, 6, 7])))
    model = pin.buildModelFromXML(urdf)
    n = model.nv
    for i in range(1, model.njoints):
        body = model.inertias[i]
        factor = rng.uniform(0.8, 1.2)
        model.inertias[i] = pin.Inertia(body.mass * factor, body.lever * rng.uniform(0.9, 1.1, 3),
                                        body.inertia * factor * rng.uniform(0.9, 1.1))
    middle = 0.5 * (model.lowerPositionLimit + model.upperPositionLimit)
    half = np.minimum(0.35 * (model.upperPositionLimit - model.lowerPositionLimit), 1.2)
    fast = np.where(prismatic_joints(model), rng.uniform(0.3, 1.0, n), rng.uniform(0.7, 2.0, n))
    quick = fast * rng.uniform(2.0, 5.0, n)
    # Sizes of drives from what the arm needs: friction a tenth to a third of it, rotors like the arm's own inertia.
    data = model.createData()
    sizes, masses = [], []
    for _ in range(20):
        q = middle + half * rng.uniform(-1, 1, n)
        sizes.append(np.abs(pin.rnea(model, data, q, fast * rng.uniform(-1, 1, n), quick * rng.uniform(-1, 1, n))))
        masses.append(np.diag(pin.crba(model, data, q)))
    need = np.mean(sizes, axis=0) + 1e-3
    mass = np.mean(masses, axis=0)
    coulomb = need * rng.uniform(0.08, 0.3, n)
    viscous = need * rng.uniform(0.05, 0.25, n) / fast
    rotor = mass * rng.uniform(0.1, 0.8, n)
    return Arm(urdf, model, rotor, viscous, coulomb, need * rng.normal(0, 0.02, n), middle - half, middle + half, fast,
               quick)


def _random_urdf(rng: np.random.Generator, n: int) -> str:
    axes = ["1 0 0", "0 1 0", "0 0 1"]
    parts = ['<robot name="arm">', '<link name="l0"/>']
    scale = 1.0
    for i in range(n):
        slides = rng.random() < (0.3 if n <= 2 else 0.08)
        mass = scale * rng.uniform(8.0, 25.0)
        length = rng.uniform(0.2, 0.5) * (scale**0.4)
        inertia = mass * length**2 / 12.0
        com = rng.uniform(-0.3, 0.3, 3) * length + np.array([0.0, 0.0, 0.4 * length])
        limit = "0.6" if slides else "2.6"
        parts.append(
            f'<link name="l{i + 1}"><inertial><origin xyz="{com[0]:.4f} {com[1]:.4f} {com[2]:.4f}"/>'
            f'<mass value="{mass:.4f}"/><inertia ixx="{inertia:.5f}" iyy="{inertia * 1.1:.5f}" '
            f'izz="{inertia * 0.6:.5f}" ixy="0" ixz="0" iyz="0"/></inertial></link>')
        x, y = rng.uniform(-0.1, 0.1, 2)
        parts.append(
            f'<joint name="j{i + 1}" type="{"prismatic" if slides else "revolute"}"><parent link="l{i}"/>'
            f'<child link="l{i + 1}"/><origin xyz="{x:.4f} {y:.4f} {0.0 if i == 0 else length:.4f}" rpy="0 0 0"/>'
            f'<axis xyz="{axes[int(rng.integers(3))]}"/><limit lower="-{limit}" upper="{limit}" effort="5000" '
            f'velocity="10"/></joint>')
        scale *= 0.7
    return "\n".join([*parts, "</robot>"])


def draw_motion(rng: np.random.Generator, arm: Arm, t: Array) -> tuple[Array, Array, Array]:
    """Positions, velocities and accelerations ``(N, n)``: a Fourier series, or smooth strokes between points.

    Args:
        rng: draws the motion.
        arm: whose limits count.
        t: times ``(N,)`` [s].
    """
    if rng.random() < 0.6:
        return _fourier(rng, arm, t)
    return _strokes(rng, arm, t)


def _fourier(rng: np.random.Generator, arm: Arm, t: Array) -> tuple[Array, Array, Array]:
    n, w0 = arm.n, 2.0 * np.pi / float(rng.choice([8.0, 10.0, 15.0]))
    q, qd, qdd = (np.zeros((len(t), n)) for _ in range(3))
    for j in range(n):
        for k in range(1, int(rng.integers(4, 9)) + 1):
            a, b = rng.normal(size=2) / k**0.7
            w = k * w0
            c, s = np.cos(w * t), np.sin(w * t)
            q[:, j] += a * c + b * s
            qd[:, j] += w * (b * c - a * s)
            qdd[:, j] -= w * w * (a * c + b * s)
        size = min(0.5 * (arm.high[j] - arm.low[j]) / np.max(np.abs(q[:, j])), arm.fast[j] / np.max(np.abs(qd[:, j])),
                   arm.quick[j] / np.max(np.abs(qdd[:, j])))
        q[:, j] = q[:, j] * size + 0.5 * (arm.high[j] + arm.low[j])
        qd[:, j] *= size
        qdd[:, j] *= size
    return q, qd, qdd


def _strokes(rng: np.random.Generator, arm: Arm, t: Array) -> tuple[Array, Array, Array]:
    """Septic polynomials between random points, each joint at its own pace, with short rests now and then."""
    n, N = arm.n, len(t)
    q, qd, qdd = (np.zeros((N, n)) for _ in range(3))
    for j in range(n):
        at, here = 0.0, float(rng.uniform(arm.low[j], arm.high[j]))
        while at < t[-1]:
            there = float(rng.uniform(arm.low[j], arm.high[j]))
            step = there - here
            # Peak velocity of the septic is 2.19 d/T, peak acceleration 7.52 d/T².
            T = max(2.19 * abs(step) / (arm.fast[j] * rng.uniform(0.3, 1.0)),
                    np.sqrt(7.52 * abs(step) / arm.quick[j]), 0.3)
            rows = (t >= at) & (t < at + T)
            s = (t[rows] - at) / T
            q[rows, j] = here + step * (35 * s**4 - 84 * s**5 + 70 * s**6 - 20 * s**7)
            qd[rows, j] = step / T * (140 * s**3 - 420 * s**4 + 420 * s**5 - 140 * s**6)
            qdd[rows, j] = step / T**2 * (420 * s**2 - 1680 * s**3 + 2100 * s**4 - 840 * s**5)
            at += T
            pause = float(rng.choice([0.0, 0.0, 0.2]))
            q[(t >= at) & (t < at + pause), j] = there
            at, here = at + pause, there
    return q, qd, qdd
