"""Pairs of causes that a poor recording does not tell apart, and the same arm on any other motion.

A cause has physical numbers of its own, drawn from the arm and not from the motion, so that it is the same in every
recording. The first recording is short, slow and of few frequencies, as one of an arm at work is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy import interpolate

from ideal_robot.arrays import Array
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from trials.arms import Arm, draw_arm
from trials.torque import measured, visible
from trials.torque_truth import INSIDE, Scene, scene

RATE = 200.0
"""Of the recordings [Hz]."""
CAUSES = ("stribeck", "degressive", "asymmetric_friction", "load_dependent_friction", "gravity_spring", "cable_spring",
          "presliding_hysteresis", "torque_ripple", "dead_time", "joint_elasticity")
_OWN_NUMBERS = ("stribeck", "degressive", "asymmetric_friction", "load_dependent_friction", "gravity_spring")
"""Causes of other trials whose numbers come from arm and seed alone."""
_LONGEST, _FARTHEST = 0.03, 0.02
"""Delay [s] and bend of a gear [rad], at most."""

Motion = tuple[Array, Array, Array, Array]
"""Times ``(N,)`` [s], positions, velocities and accelerations ``(N, n)``."""


@dataclass(frozen=True)
class RivalTrial:
    """An arm with one hidden cause.

    Attributes:
        seed: everything follows from it.
        arm: as drawn.
        truth: name of the cause and joint from 1.
        first: the poor recording.
        size: of the cause, in its unit.
        noise: standard deviation of the torque ``(n,)`` [N m].
    """

    seed: int
    arm: Arm
    truth: tuple[str, int]
    first: Recording
    size: float
    noise: Array

    def recording(self, motion: Motion, rng: np.random.Generator) -> Recording:
        """What the same arm records on another motion.

        Args:
            motion: times and the arm's true motion.
            rng: draws the noise.
        """
        return _recorded(self.arm, self.truth, self.size, self.seed, motion, self.noise, rng)


def draw_rivals(seed: int) -> RivalTrial:
    """Draws an arm, a cause and a poor recording of it; whether rivals are left the diagnosis says."""
    rng = np.random.default_rng([seed, 7207])
    while True:
        arm = draw_arm(rng)
        name, joint = str(rng.choice(CAUSES)), int(rng.integers(arm.n)) + 1
        motion = poor_motion(rng, arm)
        s = scene(arm, *motion)
        noise = np.std(s.torque, axis=0) * rng.uniform(0.005, 0.02, arm.n) + 1e-6
        small = 1e-5 * float(np.std(s.torque[:, joint - 1])) / _unit(s, name, joint - 1)
        q, tau = _with_cause(s, (name, joint), small, seed)
        change = tau - scene_torque(arm, s.t, q) + scene_torque(arm, s.t, s.q) - s.torque
        once = visible(s, change, joint - 1, noise)
        size = small * rng.uniform(0.5, 2.0) / max(once, 1e-12)
        if once <= 0.0 or size / small * float(np.std(change[:, joint - 1])) > 0.5 * np.std(s.torque[:, joint - 1]):
            continue
        if (name == "dead_time" and size > _LONGEST) or (name == "joint_elasticity"
                                                         and size * np.max(np.abs(s.load[:, joint - 1])) > _FARTHEST):
            continue
        first = _recorded(arm, (name, joint), size, seed, motion, noise, rng)
        return RivalTrial(seed, arm, (name, joint), first, size, noise)


def _unit(s: Scene, name: str, j: int) -> float:
    """About what a unit of the cause's size is worth [N m]."""
    if name == "dead_time":
        return float(np.std(np.gradient(s.torque[:, j], s.t))) + 1e-9
    if name == "joint_elasticity":
        bend = np.gradient(np.gradient(s.load[:, j], s.t), s.t)
        return float(np.std(bend)) * float(s.arm.rotor[j] + 1e-3) + 1e-9
    return float(s.arm.coulomb[j])


def scene_torque(arm: Arm, t: Array, q: Array) -> Array:
    """Torque ``(N, n)`` that a rigid arm needs for recorded positions.

    Args:
        arm: that moves.
        t: times ``(N,)`` [s].
        q: positions ``(N, n)`` [rad].
    """
    qd = np.gradient(q, t, axis=0)
    return scene(arm, t, q, qd, np.gradient(qd, t, axis=0)).torque


def poor_motion(rng: np.random.Generator, arm: Arm) -> Motion:
    """Two frequencies a joint, slow and narrow, for 8 to 14 s.

    Args:
        rng: draws it.
        arm: whose limits count.
    """
    t = np.arange(0.0, float(rng.uniform(8.0, 14.0)), 1.0 / RATE)
    q, qd, qdd = (np.zeros((len(t), arm.n)) for _ in range(3))
    for j in range(arm.n):
        for w in 2.0 * np.pi / 8.0 * rng.choice([1.0, 2.0, 3.0, 5.0], 2, replace=False):
            a, phase = rng.uniform(0.4, 1.0) / w, rng.uniform(0, 2 * np.pi)
            q[:, j] += a * np.sin(w * t + phase)
            qd[:, j] += a * w * np.cos(w * t + phase)
            qdd[:, j] -= a * w**2 * np.sin(w * t + phase)
        size = min(0.1 * (arm.high[j] - arm.low[j]) / np.max(np.abs(q[:, j])),
                   0.35 * arm.fast[j] / np.max(np.abs(qd[:, j])), 0.5 * arm.quick[j] / np.max(np.abs(qdd[:, j])))
        q[:, j] = q[:, j] * size + 0.5 * (arm.high[j] + arm.low[j])
        qd[:, j] *= size
        qdd[:, j] *= size
    return t, q, qd, qdd


def limited(robot: Robot, arm: Arm) -> Robot:
    """The robot with the limits that the arm's recordings stay within."""
    return replace(robot, q_min=arm.low, q_max=arm.high, v_max=arm.fast, a_max=arm.quick,
                   tau_max=np.full(arm.n, np.inf))


def motion_of(commands: Array, t_ipo: float) -> Motion:
    """The motion of an arm that follows commands ``(N, n)`` [rad] every ``t_ipo`` [s] exactly."""
    spline = interpolate.CubicSpline(t_ipo * np.arange(float(len(commands))), commands, axis=0)
    t = np.arange(0.0, t_ipo * (len(commands) - 1), 1.0 / RATE)
    return t, spline(t), spline(t, 1), spline(t, 2)


def _recorded(arm: Arm, truth: tuple[str, int], size: float, seed: int, motion: Motion, noise: Array,
              rng: np.random.Generator) -> Recording:
    s = scene(arm, *motion)
    q, tau = _with_cause(s, truth, size, seed)
    return measured(rng, arm, s.t, q, tau, noise, None)


def _with_cause(s: Scene, truth: tuple[str, int], size: float, seed: int) -> tuple[Array, Array]:
    """Positions that are recorded and torques, ``(N, n)`` each, with the cause at its size."""
    name, j = truth[0], truth[1] - 1
    if name == "joint_elasticity":
        bend = size * s.load[:, j]
        rate = np.gradient(bend, s.t)
        q, tau = s.q.copy(), s.torque.copy()
        q[:, j] += bend
        # The motor's friction and rotor move with the motor.
        width = 2e-3 * s.arm.fast[j]
        tau[:, j] += (s.arm.rotor[j] * np.gradient(rate, s.t) + s.arm.viscous[j] * rate
                      + s.arm.coulomb[j] * (np.tanh((s.qd[:, j] + rate) / width) - np.tanh(s.qd[:, j] / width)))
        return q, tau
    tau = s.torque.copy()
    if name == "dead_time":
        tau[:, j] = np.interp(s.t - size, s.t, s.torque[:, j])
        return s.q, tau
    rng = np.random.default_rng([seed, 99])
    column = INSIDE[name](rng, s, j)[:, j] if name in _OWN_NUMBERS else _FIXED[name](rng, s, j)
    tau[:, j] += size * column
    return s.q, tau


def _cable_spring(rng: np.random.Generator, s: Scene, j: int) -> Array:
    """A hose pack about the middle of the range, slightly hardening."""
    half = 0.5 * (s.arm.high[j] - s.arm.low[j])
    x = s.q[:, j] - 0.5 * (s.arm.high[j] + s.arm.low[j]) - 0.2 * half * rng.uniform(-1, 1)
    return np.asarray(x * (1.0 + 0.1 * (x / half) ** 2))


def _presliding_hysteresis(rng: np.random.Generator, s: Scene, j: int) -> Array:
    """Dry friction made of four elasto-plastic elements (Maxwell slip) instead of a sign."""
    span = (s.arm.high[j] - s.arm.low[j]) * rng.uniform(0.004, 0.02)
    forces = np.zeros(len(s.t))
    for reach in (0.2, 0.5, 1.0, 2.0):
        spring, top = 0.0, 0.25
        for k in range(1, len(s.t)):
            spring = min(max(spring + (s.q[k, j] - s.q[k - 1, j]) / (reach * span) * top, -top), top)
            forces[k] += spring
    return np.asarray(s.arm.coulomb[j] * (forces - np.tanh(s.qd[:, j] / (2e-3 * s.arm.fast[j]))))


def _torque_ripple(rng: np.random.Generator, s: Scene, j: int) -> Array:
    """A tooth frequency and a little of its double."""
    k = 2.0 * np.pi * rng.uniform(12.0, 60.0) / (s.arm.high[j] - s.arm.low[j])
    phase = rng.uniform(0, 2 * np.pi)
    return np.asarray(np.cos(k * s.q[:, j] + phase) + 0.15 * np.cos(2 * k * s.q[:, j]))


_FIXED: dict[str, Callable[[np.random.Generator, Scene, int], Array]] = {
    "cable_spring": _cable_spring, "presliding_hysteresis": _presliding_hysteresis, "torque_ripple": _torque_ripple}
