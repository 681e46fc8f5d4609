"""True effects for blind trials, written with other formulas than the effect library fits, and effects outside it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from trials.arms import Arm


@dataclass(frozen=True)
class Scene:
    """One motion of an arm: what effects act on.

    Attributes:
        arm, t, q, qd, qdd: the arm and its true motion ``(N, n)``.
        load: torque at the gear output ``(N, n)``.
        friction: true friction without effects ``(N, n)``.
        torque: true motor torque without effects ``(N, n)``.
    """

    arm: Arm
    t: Array
    q: Array
    qd: Array
    qdd: Array
    load: Array
    friction: Array
    torque: Array


TorqueEffect = Callable[[np.random.Generator, Scene, int], Array]
"""Torque ``(N, n)`` of unit-like size that an effect at a joint (from 0) adds; the caller scales it."""


def scene(arm: Arm, t: Array, q: Array, qd: Array, qdd: Array) -> Scene:
    """Computes the torques of a motion.

    Args:
        arm: that moves.
        t: times ``(N,)`` [s].
        q: joint angles ``(N, n)`` [rad].
        qd: velocities ``(N, n)`` [rad/s].
        qdd: accelerations ``(N, n)`` [rad/s²].
    """
    data = arm.model.createData()
    load = np.array([pin.rnea(arm.model, data, *row) for row in zip(q, qd, qdd, strict=True)]).reshape(q.shape)
    friction = arm.viscous * qd + arm.coulomb * np.tanh(qd / (2e-3 * arm.fast))
    return Scene(arm, t, q, qd, qdd, load, friction, load + friction + arm.rotor * qdd + arm.offset)


def _on(s: Scene, j: int, column: Array) -> Array:
    result = np.zeros_like(s.q)
    result[:, j] = column
    return result


def _degressive(rng: np.random.Generator, s: Scene, j: int) -> Array:
    """Saturating rise ``v / (v0 + |v|)``."""
    v = s.qd[:, j]
    v0 = s.arm.fast[j] * rng.uniform(0.05, 0.2)
    return _on(s, j, s.arm.coulomb[j] * v / (v0 + np.abs(v)))


def _stribeck(rng: np.random.Generator, s: Scene, j: int) -> Array:
    """Excess at standstill falling like a bell curve."""
    v = s.qd[:, j]
    v0 = s.arm.fast[j] * rng.uniform(0.05, 0.2)
    return _on(s, j, s.arm.coulomb[j] * np.tanh(v / (2e-3 * s.arm.fast[j])) * np.exp(-((v / v0) ** 2)))


def _asymmetric_friction(rng: np.random.Generator, s: Scene, j: int) -> Array:
    """More viscous friction in one direction."""
    v = s.qd[:, j]
    return _on(s, j, float(rng.choice([-1.0, 1.0])) * s.arm.viscous[j] * np.maximum(v, 0.0))


def _load_dependent_friction(rng: np.random.Generator, s: Scene, j: int) -> Array:
    """Teeth pressed together by the load, softly rounded at zero load."""
    load = np.sqrt(s.load[:, j] ** 2 + (0.02 * np.std(s.load[:, j])) ** 2)
    return _on(s, j, 0.1 * load * np.tanh(s.qd[:, j] / (2e-3 * s.arm.fast[j])))


def _thermal_drift(rng: np.random.Generator, s: Scene, j: int) -> Array:
    """Friction falls while the gear warms up, like ``1/(1 + t/T)``."""
    T = (s.t[-1] - s.t[0]) * rng.uniform(0.3, 1.0)
    warm = 1.0 - 1.0 / (1.0 + s.t / T)
    return _on(s, j, -warm * (0.7 * s.arm.viscous[j] * s.qd[:, j] + 0.7 * s.arm.coulomb[j] * np.sign(s.qd[:, j])))


def _presliding_hysteresis(rng: np.random.Generator, s: Scene, j: int) -> Array:
    """Dry friction made of four elasto-plastic elements (Maxwell slip) instead of a sign."""
    span = float(np.ptp(s.q[:, j])) * rng.uniform(0.004, 0.03)
    forces = np.zeros(len(s.t))
    for reach in (0.2, 0.5, 1.0, 2.0):
        spring, top = 0.0, 0.25
        for k in range(1, len(s.t)):
            spring = min(max(spring + (s.q[k, j] - s.q[k - 1, j]) / (reach * span) * top, -top), top)
            forces[k] += spring
    return _on(s, j, s.arm.coulomb[j] * (forces - np.tanh(s.qd[:, j] / (2e-3 * s.arm.fast[j]))))


def _torque_ripple(rng: np.random.Generator, s: Scene, j: int) -> Array:
    """A tooth frequency and half as much of its double."""
    periods = rng.uniform(6.0, 60.0)
    k = 2.0 * np.pi * periods / float(np.ptp(s.q[:, j]))
    phase = rng.uniform(0, 2 * np.pi)
    return _on(s, j, np.cos(k * s.q[:, j] + phase) + 0.15 * np.cos(2 * k * s.q[:, j]))


def _gravity_spring(rng: np.random.Generator, s: Scene, j: int) -> Array:
    """A preloaded spring between two points."""
    a, b, rest = 1.0, rng.uniform(0.3, 0.7), rng.uniform(0.3, 0.8)
    angle = s.q[:, j] - rng.uniform(-np.pi, np.pi)
    length = np.sqrt(a * a + b * b + 2 * a * b * np.cos(angle))
    return _on(s, j, 20.0 * (length - rest) / length * a * b * np.sin(angle))


def _cable_spring(rng: np.random.Generator, s: Scene, j: int) -> Array:
    """A hose pack, slightly hardening."""
    x = s.q[:, j] - np.mean(s.q[:, j])
    return _on(s, j, x * (1.0 + 0.1 * (x / (np.max(np.abs(x)) + 1e-9)) ** 2))


def _axis_coupling(rng: np.random.Generator, s: Scene, j: int) -> Array:
    """The motor of joint ``j`` turns with its neighbour as well, and both feel it."""
    i = j - 1
    v = s.qd[:, j] + s.qd[:, i]
    dry = s.arm.coulomb[j] * np.tanh(v / (2e-3 * s.arm.fast[j]))
    result = _on(s, j, 0.6 * s.arm.rotor[j] * s.qdd[:, i] + s.arm.viscous[j] * s.qd[:, i] + dry)
    result[:, i] = 0.6 * s.arm.rotor[j] * s.qdd[:, j] + s.arm.viscous[j] * s.qd[:, j] + dry
    return result


def _bump(rng: np.random.Generator, s: Scene, j: int) -> Array:
    """Outside the library: a torque at one place of the range, of odd shape."""
    x = (s.q[:, j] - np.quantile(s.q[:, j], rng.uniform(0.3, 0.7))) / float(np.ptp(s.q[:, j]))
    width = rng.uniform(0.06, 0.15)
    return _on(s, j, np.exp(-((x / width) ** 2)) * (1.0 + 1.5 * np.tanh(x / width)))


def _product_coupling(rng: np.random.Generator, s: Scene, j: int) -> Array:
    """Outside the library: a torque by the product of two axes' speeds."""
    i = int(rng.choice([k for k in range(s.arm.n) if k != j]))
    return _on(s, j, s.qd[:, i] * s.qd[:, j] + 0.5 * s.qd[:, i] * np.abs(s.qd[:, i]))


def _position_coupling(rng: np.random.Generator, s: Scene, j: int) -> Array:
    """Outside the library: a torque by another axis' position."""
    i = int(rng.choice([k for k in range(s.arm.n) if k != j]))
    x = (s.q[:, i] - np.mean(s.q[:, i])) / float(np.std(s.q[:, i]))
    return _on(s, j, np.tanh(1.5 * x) + 0.3 * x**2)


def _disturbance(rng: np.random.Generator, s: Scene, j: int) -> Array:
    """Outside the library: a disturbance that changes with time."""
    span = s.t[-1] - s.t[0]
    f = rng.uniform(1.5, 6.0) / span
    jump = 0.5 * np.tanh((s.t - 0.6 * span) / (0.05 * span))
    return _on(s, j, np.sin(2 * np.pi * f * s.t + rng.uniform(0, 6)) + jump)


def _directed_place(rng: np.random.Generator, s: Scene, j: int) -> Array:
    """Outside the library: dry friction that differs from place to place."""
    x = (s.q[:, j] - np.min(s.q[:, j])) / float(np.ptp(s.q[:, j]))
    return _on(s, j, np.sign(s.qd[:, j]) * (np.tanh(6 * (x - rng.uniform(0.3, 0.7))) + 0.5 * x))


INSIDE: dict[str, TorqueEffect] = {f.__name__[1:]: f for f in (
    _degressive, _stribeck, _asymmetric_friction, _load_dependent_friction, _thermal_drift, _presliding_hysteresis,
    _torque_ripple, _gravity_spring, _cable_spring, _axis_coupling)}
OUTSIDE: dict[str, TorqueEffect] = {f.__name__[1:]: f for f in (
    _bump, _product_coupling, _position_coupling, _disturbance, _directed_place)}
