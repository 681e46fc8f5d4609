"""The independent integrator: Newton–Euler bodies, implicit friction, symplectic steps.

Per step the velocity after it solves

    M v⁺ = M v + dt (τ - h - ...) - dt (D v⁺ + f(v⁺))

where the dry friction f of every joint, whatever its way through standstill, is a monotone function of its own v⁺; the
joints are swept one after the other until nothing changes (projected Gauss–Seidel), so standstill is exact.
"""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.jit import jit
from studies.strangers.arm import STEP, Motion
from studies.strangers.drive import ACTING, BELIEVED, FLUID, LEVEL, RESULTS, STATES, drive_step
from studies.strangers.plant import BRISTLE, CONSTRAINT, TANH, Coupling, Plant, Run

_SWEEPS, _TOLERANCE = 30, 1e-9
# Rows of the state: motors' position, gears' load, motors' velocity, bristles' deflection over the one of sliding, dry
# and fluid friction, links' position and velocity.
Q, LOAD, V, Z, FRICTION, QA, VA = range(7)
STATE = 7
# Rows of friction: level of the dry one, the fluid one over velocity, way through standstill as numbered in ``plant``,
# velocity over which tanh turns the sign, way over which bristles do.
DRY, WET, KIND, SMOOTH, WAY = range(5)


@jit(inline="always")
def _dry(rub: Array, v: float, z: float) -> float:
    """Dry friction at a velocity, ``z`` being what the bristles carried before the step, -1 … 1."""
    level = rub[DRY]
    if rub[KIND] == TANH:
        return level * math.tanh(v / rub[SMOOTH])
    ratio = abs(v) * STEP / rub[WAY]
    towards = 1.0 if v > 0.0 else -1.0
    after = towards + (z - towards) * math.exp(-ratio)
    damping = 0.0
    if rub[KIND] == BRISTLE:
        damping = 0.02 * level * v / (rub[WAY] * (1.0 + abs(v) / 0.01) * 50.0)
    return level * after + damping


@jit()
def _solved(a: float, b: float, rub: Array, z: float, guess: float) -> float:
    """The velocity with ``a v + dt f(v) = b``; the left side rises with v, so it is bracketed and bisected by secants.

    The friction is never larger than about its level, which brackets the root.
    """
    level = rub[DRY]
    if level <= 0.0:
        return b / a
    if rub[KIND] == CONSTRAINT:
        push = STEP * level
        return 0.0 if abs(b) <= push else (b - math.copysign(push, b)) / a
    low, high = (b - 2.0 * STEP * level) / a - 1e-12, (b + 2.0 * STEP * level) / a + 1e-12
    f_low = a * low + STEP * _dry(rub, low, z) - b
    f_high = a * high + STEP * _dry(rub, high, z) - b
    v = min(max(guess, low), high)
    for _ in range(60):
        f = a * v + STEP * _dry(rub, v, z) - b
        if f > 0.0:
            high, f_high = v, f
        else:
            low, f_low = v, f
        if high - low < 1e-12 or abs(f) < 1e-13 * (abs(b) + STEP * level + 1e-9):
            break
        middle = low - f_low * (high - low) / (f_high - f_low) if f_high > f_low else 0.5 * (low + high)
        # A secant that hardly moves an end is followed by a bisection.
        edge = 0.05 * (high - low)
        v = middle if low + edge < middle < high - edge else 0.5 * (low + high)
    return v


@jit()
def motor_step(M: Array, push: Array, rub: Array, x: Array) -> None:
    """A step of what moves with the motors; ``x`` in place.

    Args:
        M: mass matrix ``(n, n)`` [kg m²].
        push: torque without friction, velocity products taken off ``(n,)`` [N m].
        rub: of friction ``(5, n)``, rows ``DRY`` to ``WAY``.
        x: rows ``V`` to ``FRICTION`` of the state ``(3, n)``.
    """
    n, v, z = x.shape[1], x[0], x[1]
    b = M @ v + STEP * push
    for _ in range(_SWEEPS):
        moved = 0.0
        for j in range(n):
            rest = b[j]
            for i in range(n):
                if i != j:
                    rest -= M[j, i] * v[i]
            new = _solved(M[j, j] + STEP * rub[WET, j], rest, rub[:, j], z[j], v[j])
            moved = max(moved, abs(new - v[j]))
            v[j] = new
        if moved < _TOLERANCE:
            break
    impulse = b - M @ v
    for j in range(n):
        x[2, j] = impulse[j] / STEP
        if rub[KIND, j] != TANH and rub[KIND, j] != CONSTRAINT and v[j] != 0.0:
            towards = 1.0 if v[j] > 0.0 else -1.0
            z[j] = towards + (z[j] - towards) * math.exp(-abs(v[j]) * STEP / rub[WAY, j])


@jit()
def _solution(M: Array, b: Array) -> Array:
    """``M⁻¹ b`` by Cholesky's factors; NaN rather than an exception where the plant has left its path."""
    n = b.shape[0]
    L, x = np.zeros((n, n)), b.copy()
    for j in range(n):
        for i in range(j, n):
            rest = M[i, j]
            for k in range(j):
                rest -= L[i, k] * L[j, k]
            if i == j:
                L[j, j] = math.sqrt(rest) if rest > 0.0 else math.nan
            else:
                L[i, j] = rest / L[j, j]
    for i in range(n):
        for k in range(i):
            x[i] -= L[i, k] * x[k]
        x[i] /= L[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            x[i] -= L[k, i] * x[k]
        x[i] /= L[i, i]
    return x


@jit()
def _step(upper: Array, h: Array, rotors: Array, push: Array, gears: Array, rub: Array, x: Array) -> None:
    """A step of an arm whose gears are all rigid (no rows in ``gears``) or all elastic; ``x (STATE, n)`` in place.

    ``upper (n, n)`` is the mass matrix's upper triangle, ``h (n,)`` gravity and velocity products, ``gears (4, n)``
    stiffness, damping, half of the gap, and 1 where it is elastic.
    """
    n = x.shape[1]
    M = np.zeros((n, n))
    for i in range(n):
        for j in range(i, n):
            M[i, j] = upper[i, j]
            M[j, i] = upper[i, j]
    if gears.shape[0]:
        k_gear, d_gear, half = gears[0], gears[1], gears[2]
        for j in range(n):
            twist = x[Q, j] - x[QA, j]
            beyond = twist - half[j] if twist > half[j] else (twist + half[j] if twist < -half[j] else 0.0)
            x[LOAD, j] = k_gear[j] * beyond + (d_gear[j] * (x[V, j] - x[VA, j]) if beyond != 0.0 else 0.0)
        motor_step(rotors, push - x[LOAD], rub, x[V : FRICTION + 1])
        faster = _solution(M, x[LOAD] - h)
        for j in range(n):
            x[VA, j] += STEP * faster[j]
            x[Q, j] += STEP * x[V, j]
            x[QA, j] += STEP * x[VA, j]
    else:
        before = x[V].copy()
        motor_step(M + rotors, push - h, rub, x[V : FRICTION + 1])
        # Number by number: assignments of rows take two seconds to compile.
        for j in range(n):
            x[Q, j] += STEP * x[V, j]
            x[LOAD, j] = push[j] - x[FRICTION, j] - rotors[j, j] * (x[V, j] - before[j]) / STEP
            x[QA, j], x[VA, j] = x[Q, j], x[V, j]


def simulate(plant: Plant, motion: Motion) -> Run:
    """Plays a motion on a plant.

    Args:
        plant: the arm.
        motion: desired motion, every ``STEP``.

    Raises:
        RuntimeError: the plant left its path.
    """
    n, N = plant.n, len(motion.t)
    model, data, elastic = plant.model, plant.model.createData(), plant.elastic
    wanted, mixed = plant.wanted(motion), bool(elastic.any() and not elastic.all())
    controller, out = np.zeros((STATES, n)), np.zeros((RESULTS, n))
    gears = np.array([*plant.springs(), 0.5 * plant.gap, elastic]) if elastic.any() else np.zeros((0, n))
    x, log = _at_rest(plant, motion.q[0]), np.zeros((3, N, n))
    rotors = np.diag(plant.rotor)
    for coupling in plant.couplings:
        rotors = rotors + _coupled(coupling, n, coupling.inertia)
    rub = np.array([out[LEVEL], out[FLUID], plant.regularisation, plant.v_smooth, plant.presliding])
    for k in range(N):
        drive_step(k, plant.cycle, plant.block, controller, x[: V + 1], wanted[k], out)
        log[0, k], log[1, k], log[2, k] = x[Q], x[QA], out[BELIEVED]
        rub[DRY], rub[WET] = out[LEVEL], out[FLUID]
        push = _pushed(plant, out[ACTING].copy(), x)
        M, h = pin.crba(model, data, x[QA]), pin.nonLinearEffects(model, data, x[QA], x[VA])
        if mixed:
            _mixed_step(M, h, rotors, push, gears, rub, x)
        else:
            _step(M, h, rotors, push, gears, rub, x)
        if k % 1000 == 0 and not np.abs(x[QA]).max() < 100.0:
            break
    if not np.isfinite(log[0]).all() or np.abs(log[0] - motion.q).max() > 2.0 or not np.isfinite(x[Q]).all():
        raise RuntimeError("the plant left its path")
    return Run(motion.t, motion.q, *log)


def _at_rest(plant: Plant, q: Array) -> Array:
    """State ``(STATE, n)`` of an arm that its motors hold at ``q (n,)``."""
    x = np.zeros((STATE, plant.n))
    load = plant.holding(q)
    stiffness, _ = plant.springs()
    x[Q], x[LOAD] = q, load
    x[QA] = q - np.where(plant.elastic, load / stiffness + np.sign(load) * (0.5 * plant.gap), 0.0)
    return x


def _pushed(plant: Plant, push: Array, x: Array) -> Array:
    """Torque of the motors ``(n,)`` [N m], less that of couplings and balancing springs."""
    v = x[V]
    for coupling in plant.couplings:
        speed = v[coupling.joint] + coupling.sense * v[coupling.partner]
        torque = coupling.viscous * speed + coupling.dry * math.tanh(speed / 2e-3)
        push[coupling.joint] -= torque
        push[coupling.partner] -= coupling.sense * torque
    for spring in plant.balancers:
        push[spring.joint] -= spring.torque(float(x[Q, spring.joint]))
    return push


def _mixed_step(upper: Array, h: Array, rotors: Array, push: Array, gears: Array, rub: Array, x: Array) -> None:
    """As ``_step`` where some gears are rigid: there the link moves with its motor."""
    M = np.triu(upper) + np.triu(upper, 1).T
    k_gear, d_gear, half, elastic = *gears[:3], gears[3] > 0.0
    twist = x[Q] - x[QA]
    beyond = np.where(elastic, np.sign(twist) * np.maximum(np.abs(twist) - half, 0.0), 0.0)
    gear = k_gear * beyond + np.where(beyond != 0.0, d_gear * (x[V] - x[VA]), 0.0)
    # Unknowns: motors, and links of elastic gears; T maps them to link velocities.
    n, free = len(elastic), np.flatnonzero(elastic)
    m = len(free)
    T = np.zeros((n, n + m))
    T[np.flatnonzero(~elastic), np.flatnonzero(~elastic)] = 1.0
    T[free, n + np.arange(m)] = 1.0
    full = T.T @ M @ T
    full[:n, :n] += rotors
    total = T.T @ (gear - h)
    total[:n] += push - gear
    w, every = np.zeros((3, n + m)), np.zeros((len(rub), n + m))
    w[:, :n], every[:, :n] = x[V : FRICTION + 1], rub
    w[0, n:] = x[VA, free]
    # Links have no friction of their own.
    every[SMOOTH:, n:] = 1.0
    motor_step(full, total, every, w)
    x[V : FRICTION + 1] = w[:, :n]
    x[VA] = x[V]
    x[VA, free] = w[0, n:]
    x[LOAD] = np.where(elastic, gear, push - x[FRICTION])
    x[Q] = x[Q] + STEP * x[V]
    x[QA] = np.where(elastic, x[QA] + STEP * x[VA], x[Q])


def _coupled(coupling: Coupling, n: int, inertia: float) -> Array:
    row = np.zeros(n)
    row[coupling.joint], row[coupling.partner] = 1.0, coupling.sense
    return inertia * np.outer(row, row)
