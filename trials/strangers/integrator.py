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
from trials.strangers.drive import ACTING, BELIEVED, FLUID, LEVEL, RESULTS, STATES, drive_step
from trials.strangers.motion import STEP, Motion
from trials.strangers.plant import BRISTLE, CONSTRAINT, TANH, BalanceSpring, Coupling, Plant, Run

_SWEEPS, _TOLERANCE = 30, 1e-9


@jit(inline="always")
def _dry(kind: int, v: float, level: float, v_smooth: float, presliding: float, z: float) -> float:
    """Dry friction at a velocity, ``z`` being what the bristles carried before the step, -1 … 1."""
    if kind == TANH:
        return level * math.tanh(v / v_smooth)
    way = abs(v) * STEP / presliding
    towards = 1.0 if v > 0.0 else -1.0
    after = towards + (z - towards) * math.exp(-way)
    damping = 0.0
    if kind == BRISTLE:
        damping = 0.02 * level * v / (presliding * (1.0 + abs(v) / 0.01) * 50.0)
    return level * after + damping


@jit()
def _solved(kind: int, a: float, b: float, level: float, v_smooth: float, presliding: float, z: float,
            guess: float) -> float:
    """The velocity with ``a v + dt f(v) = b``; the left side rises with v, so it is bracketed and bisected by secants.

    The friction is never larger than about its level, which brackets the root.
    """
    if level <= 0.0:
        return b / a
    if kind == CONSTRAINT:
        push = STEP * level
        return 0.0 if abs(b) <= push else (b - math.copysign(push, b)) / a
    low, high = (b - 2.0 * STEP * level) / a - 1e-12, (b + 2.0 * STEP * level) / a + 1e-12
    f_low = a * low + STEP * _dry(kind, low, level, v_smooth, presliding, z) - b
    f_high = a * high + STEP * _dry(kind, high, level, v_smooth, presliding, z) - b
    v = min(max(guess, low), high)
    for _ in range(60):
        f = a * v + STEP * _dry(kind, v, level, v_smooth, presliding, z) - b
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
def motor_step(M: Array, push: Array, v: Array, level: Array, fluid: Array, kinds: Array, v_smooth: Array,
               presliding: Array, z: Array, friction: Array) -> None:
    """Velocities after a step ``v (n,)`` in place, bristles ``z`` and the dry and fluid ``friction`` with them.

    Args:
        M: mass matrix of what moves with the motors ``(n, n)`` [kg m²].
        push: torque without friction, velocity products taken off ``(n,)`` [N m].
        v: velocity ``(n,)`` [rad/s], changed.
        level: of dry friction ``(n,)`` [N m].
        fluid: fluid friction over velocity ``(n,)`` [N m s/rad].
        kinds: ways through standstill ``(n,)``, numbered as in ``trials.strangers.plant``.
        v_smooth: velocity over which tanh turns the sign ``(n,)`` [rad/s].
        presliding: way over which bristles turn the sign ``(n,)`` [rad].
        z: bristles' deflection over the one of sliding ``(n,)``, changed.
        friction: the result ``(n,)`` [N m].
    """
    n = v.shape[0]
    b = M @ v + STEP * push
    for _ in range(_SWEEPS):
        moved = 0.0
        for j in range(n):
            rest = b[j]
            for i in range(n):
                if i != j:
                    rest -= M[j, i] * v[i]
            new = _solved(kinds[j], M[j, j] + STEP * fluid[j], rest, level[j], v_smooth[j], presliding[j], z[j], v[j])
            moved = max(moved, abs(new - v[j]))
            v[j] = new
        if moved < _TOLERANCE:
            break
    left = b - M @ v
    for j in range(n):
        friction[j] = left[j] / STEP
        if kinds[j] != TANH and kinds[j] != CONSTRAINT and v[j] != 0.0:
            towards = 1.0 if v[j] > 0.0 else -1.0
            z[j] = towards + (z[j] - towards) * math.exp(-abs(v[j]) * STEP / presliding[j])


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
def _step(upper: Array, h: Array, elastic: bool, rotors: Array, push: Array, k_gear: Array, d_gear: Array, half: Array,
          q: Array, v: Array, qa: Array, va: Array, level: Array, fluid: Array, kinds: Array, v_smooth: Array,
          presliding: Array, z: Array, friction: Array, load: Array) -> None:
    """A step of an arm whose gears are all rigid or all elastic; positions, velocities, friction, load in place.

    ``upper (n, n)`` is the mass matrix's upper triangle, ``h (n,)`` gravity and velocity products.
    """
    n = q.shape[0]
    M = np.zeros((n, n))
    for i in range(n):
        for j in range(i, n):
            M[i, j] = upper[i, j]
            M[j, i] = upper[i, j]
    if elastic:
        for j in range(n):
            twist = q[j] - qa[j]
            beyond = twist - half[j] if twist > half[j] else (twist + half[j] if twist < -half[j] else 0.0)
            load[j] = k_gear[j] * beyond + (d_gear[j] * (v[j] - va[j]) if beyond != 0.0 else 0.0)
        motor_step(rotors, push - load, v, level, fluid, kinds, v_smooth, presliding, z, friction)
        va += STEP * _solution(M, load - h)
        q += STEP * v
        qa += STEP * va
    else:
        before = v.copy()
        motor_step(M + rotors, push - h, v, level, fluid, kinds, v_smooth, presliding, z, friction)
        q += STEP * v
        for j in range(n):
            load[j] = push[j] - friction[j] - rotors[j, j] * (v[j] - before[j]) / STEP
            qa[j], va[j] = q[j], v[j]


def simulate(plant: Plant, motion: Motion) -> Run:
    """Plays a motion on a plant.

    Args:
        plant: the arm.
        motion: desired motion, every ``STEP``.

    Raises:
        RuntimeError: the plant left its path.
    """
    n, N = plant.n, len(motion.t)
    model, data = plant.model, plant.model.createData()
    forward = plant.forward(motion)
    P, x, out = plant.block, np.zeros((STATES, n)), np.zeros((RESULTS, n))
    elastic, half = plant.elastic, 0.5 * plant.gap
    mixed = bool(elastic.any() and not elastic.all())
    k_gear, d_gear = plant.springs()
    q = motion.q[0].copy()
    load = plant.holding(q)
    qa = q - np.where(elastic, load / k_gear + np.sign(load) * half, 0.0)
    v, va, z, friction = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    log_q, log_qa, log_tau = np.zeros((N, n)), np.zeros((N, n)), np.zeros((N, n))
    rotors = np.diag(plant.rotor)
    for coupling in plant.couplings:
        rotors = rotors + _coupled(coupling, n, coupling.inertia)
    kinds = plant.regularisation.astype(np.int64)
    for k in range(N):
        drive_step(k, plant.cycle, P, x, q, v, load, motion.q[k], motion.qd[k], forward[k], out)
        log_q[k], log_qa[k], log_tau[k] = q, qa, out[BELIEVED]
        push = out[ACTING].copy()
        for coupling in plant.couplings:
            speed = v[coupling.joint] + coupling.sense * v[coupling.partner]
            torque = coupling.viscous * speed + coupling.dry * math.tanh(speed / 2e-3)
            push[coupling.joint] -= torque
            push[coupling.partner] -= coupling.sense * torque
        for spring in plant.balancers:
            push[spring.joint] -= spring_torque(spring, float(q[spring.joint]))
        M = pin.crba(model, data, qa)
        h = pin.nonLinearEffects(model, data, qa, va)
        if mixed:
            M = np.triu(M) + np.triu(M, 1).T
            beyond = np.where(elastic, np.sign(q - qa) * np.maximum(np.abs(q - qa) - half, 0.0), 0.0)
            gear = k_gear * beyond + np.where(beyond != 0.0, d_gear * (v - va), 0.0)
            v, va = _mixed_step(plant, M, h, rotors, push, gear, v, va, out, kinds, z, friction)
            load = np.where(elastic, gear, push - friction)
            q = q + STEP * v
            qa = np.where(elastic, qa + STEP * va, q)
        else:
            _step(M, h, bool(elastic.any()), rotors, push, k_gear, d_gear, half, q, v, qa, va, out[LEVEL], out[FLUID],
                  kinds, plant.v_smooth, plant.presliding, z, friction, load)
        if k % 1000 == 0 and not np.abs(qa).max() < 100.0:
            break
    if not np.isfinite(log_q).all() or np.abs(log_q - motion.q).max() > 2.0 or not np.isfinite(q).all():
        raise RuntimeError("the plant left its path")
    return Run(motion.t, motion.q, log_q, log_qa, log_tau)


def _mixed_step(plant: Plant, M: Array, h: Array, rotors: Array, push: Array, gear: Array, v: Array, va: Array,
                  out: Array, kinds: Array, z: Array, friction: Array) -> tuple[Array, Array]:
    """Velocities of motors and links after a step; where a gear is rigid the link moves with its motor."""
    elastic = plant.elastic
    n = plant.n
    # Unknowns: motors, and links of elastic gears; S and T map them to motor and link velocities.
    free = np.flatnonzero(elastic)
    m = len(free)
    T = np.zeros((n, n + m))
    T[np.flatnonzero(~elastic), np.flatnonzero(~elastic)] = 1.0
    T[free, n + np.arange(m)] = 1.0
    full = T.T @ M @ T
    full[:n, :n] += rotors
    total = T.T @ (gear - h)
    total[:n] += push - gear
    w = np.concatenate([v, va[free]])
    pad, zero = np.ones(m), np.zeros(m)
    z_all, f_all = np.concatenate([z, zero]), np.zeros(n + m)
    motor_step(full, total, w, np.concatenate([out[LEVEL], zero]), np.concatenate([out[FLUID], zero]),
               np.concatenate([kinds, np.zeros(m, dtype=np.int64)]), np.concatenate([plant.v_smooth, pad]),
               np.concatenate([plant.presliding, pad]), z_all, f_all)
    z[:], friction[:] = z_all[:n], f_all[:n]
    after = w[:n].copy()
    links = after.copy()
    links[free] = w[n:]
    return after, links


def _coupled(coupling: Coupling, n: int, inertia: float) -> Array:
    row = np.zeros(n)
    row[coupling.joint], row[coupling.partner] = 1.0, coupling.sense
    return inertia * np.outer(row, row)


def spring_torque(s: BalanceSpring, q: float) -> float:
    """Torque of the balance spring that the motor works against [N m]: dU/dq of ``k/2 (l - rest)²``."""
    length = math.sqrt(s.reach**2 + s.lever**2 - 2.0 * s.reach * s.lever * math.cos(q - s.angle))
    return s.stiffness * (length - s.rest) * s.reach * s.lever * math.sin(q - s.angle) / length
