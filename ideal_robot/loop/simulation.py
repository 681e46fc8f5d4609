"""Simulation of the *identified* closed loop: rigid body, friction, rotors, elastic gears, controller, command path.

It is what the ideal robot can try things on before the arm moves ([G] Fig. 15 with identified numbers). It knows
nothing of the simulated world in ``sim``; it is another program with other formulas.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.dynamics.newton_euler import Chain, joint_frames, mass_matrix, torque_at
from ideal_robot.errors import IdealRobotError, InputError
from ideal_robot.jit import jit
from ideal_robot.loop.from_model import further_torque
from ideal_robot.loop.loop_model import (
    Drives,
    LoopModel,
    bristles,
    dry_and_fluid,
    friction_of_load,
    ripple_torque,
    unevenness,
)


@dataclass(frozen=True)
class LoopMotion:
    """What the simulated loop did, at the instants ``t_k = k t_ipo`` at which commands are handed over.

    Attributes:
        t: ``(N,)`` [s]; row 0 is the start.
        q_a, q_m: arm and motor angles ``(N, n)`` [rad].
        tau: motor torque ``(N, n)`` [N m].
    """

    t: Array
    q_a: Array
    q_m: Array
    tau: Array


def interpolated(q_c: Array, q0: Array, loop: LoopModel) -> Array:
    """The command as the position loop gets it before its low-pass: delayed, linearly interpolated ``(N s, n)`` [rad].

    Row ``j`` belongs to the time ``j t_position``.

    Args:
        q_c, q0: commands of the cycles 0 … N-1 ``(N, n)`` [rad], and where the arm rests before ``(n,)`` [rad].
        loop: the identified loop.
    """
    s, N = loop.steps_ipo, len(q_c)
    knots = np.vstack([np.tile(q0, (loop.delay + 1, 1)), q_c])[: N + 1]
    weight = (np.arange(s) / s)[None, :, None]
    return np.asarray((knots[:-1, None] * (1 - weight) + knots[1:, None] * weight).reshape(N * s, -1))


def low_passed(command: Array, q0: Array, taps: Array) -> Array:
    """Convolves a command with the low-pass, at rest before.

    Args:
        command, q0: interpolated, every ``t_position`` ``(M, n)`` [rad], and where the arm rests before ``(n,)`` [rad].
        taps: impulse response of the low-pass ``(L, n)``.
    """
    out = np.empty_like(command)
    for i in range(command.shape[1]):
        out[:, i] = np.convolve(command[:, i] - q0[i], taps[:, i])[: len(command)] + q0[i]
    return out


def simulate(loop: LoopModel, q_c: Array, *, tau_ext: Array | None = None) -> LoopMotion:
    """Plays commands on the identified loop, from rest at the first one.

    At rest at the start means: arm and motor in equilibrium with gravity, integrators carrying it, the motor where
    ``q_c[0]`` says.

    Args:
        loop, q_c: the identified loop, and commands ``(N, n)`` [rad].
        tau_ext: on the arm during the cycles ``(N, n)`` [N m]; None for none.

    Raises:
        InputError: wrong shape or non-finite commands.
        IdealRobotError: the loop is unstable.
    """
    q_c = np.ascontiguousarray(q_c, dtype=float)
    if q_c.ndim != 2 or q_c.shape[1] != loop.n or not np.all(np.isfinite(q_c)):
        raise InputError(f"expected finite commands of shape (N, {loop.n})", field="q_c", value=q_c.shape)
    q0 = q_c[0]
    reference = low_passed(interpolated(q_c, q0, loop), q0, loop.command_filter)
    external = np.zeros_like(q_c) if tau_ext is None else np.ascontiguousarray(tau_ext, dtype=float)
    elastic = np.isfinite(loop.stiffness)
    R, p, M = np.empty((loop.n, 3, 3)), np.empty((loop.n, 3)), np.empty((loop.n, loop.n))
    joint_frames(loop.chain, q0, R, p)
    mass_matrix(loop.chain, R, p, M)
    # Rigid gears are played as gears whose own oscillation (80 Hz, well damped) nobody sees at the arm. Behind a rigid
    # gear it does not matter who has the inertia: a link much lighter than its rotor gets a share of it, else it would
    # sag; a rotor much lighter than its link must stand the gear at this step.
    added = np.where(~elastic & (np.diag(M) < 0.1 * loop.rotor_inertia), 0.1 * loop.rotor_inertia, 0.0)
    loop = loop.replace(chain=loop.chain._replace(armature=loop.chain.armature + added),
                        rotor_inertia=loop.rotor_inertia - added)
    link = np.diag(M) + added
    held = np.minimum((2 * np.pi * 80) ** 2 * link, loop.rotor_inertia / loop.t_velocity**2)
    stiffness = np.where(elastic, loop.stiffness, held)
    damping = np.where(elastic, loop.damping, np.minimum(2 * 0.5 * np.sqrt(held * link),
                                                         0.8 * loop.rotor_inertia / loop.t_velocity))
    tau0 = np.empty(loop.n)
    torque_at(loop.chain, R, p, np.zeros(loop.n), np.zeros(loop.n), 1.0, tau0)
    drives = loop.drives(stiffness, damping)
    try:
        q_a, q_m, tau = _played(loop, drives, reference, external, tau0, q0)
    except np.linalg.LinAlgError:
        raise IdealRobotError("the model's masses and inertias are those of no body (its mass matrix is not positive "
                              "definite), so its loop cannot be simulated; identify them with physical consistency, or "
                              "use the URDF's") from None
    if not np.isfinite(q_m).all():
        raise IdealRobotError("the identified loop is unstable in simulation; check its gains, rotor inertias and "
                              "stiffness (a very stiff gear counts as rigid when it is given as infinite)")
    return LoopMotion(np.asarray(np.arange(len(q_a)) * loop.t_ipo, dtype=float), q_a, q_m, tau)


class _Motion(NamedTuple):
    """State of the loop between position cycles, ``(n,)`` each; changed in place."""

    q_a: Array
    v_a: Array
    q_m: Array
    v_m: Array
    integral: Array
    filtered: Array
    previous: Array
    reference: Array
    bent: Array
    tau: Array
    load: Array


class _Inputs(NamedTuple):
    """Commanded angles of the position cycles, external torques of the interpolation cycles, further motor torques."""

    reference: Array
    external: Array
    further: Array


class _Clock(NamedTuple):
    """Cycles of position and velocity loops [s], and position cycles of an interpolation cycle."""

    t_position: float
    dt: float
    steps_ipo: int


def _played(loop: LoopModel, drives: Drives, reference: Array, external: Array, tau0: Array,
            q0: Array) -> tuple[Array, Array, Array]:
    """Arm angles, motor angles and motor torques at the cycles' ends."""
    n, steps = loop.n, loop.steps_ipo
    cycles = len(reference) // steps
    still = np.zeros(n)
    further = _further(loop, 0.0, q0, still, still, tau0, still)
    side = np.sign(tau0) * np.minimum(1.0, np.abs(tau0) / 1e-9)
    q_a = np.array([q + unevenness(loop.uneven, i, q)[0] for i, q in enumerate(q0)])
    q_a = q_a - tau0 / drives.stiffness - side * drives.half_gap
    holding = loop.gain * (tau0 + loop.offset) + further
    state = _Motion(q_a, still.copy(), q0.copy(), still.copy(), holding, still.copy(), q0.copy(), q0.copy(),
                    still.copy(), holding.copy(), tau0.copy())
    out = np.empty((3, cycles + 1, n))
    out[:, 0] = state.q_a, state.q_m, state.tau
    # Without further torques all is one compiled call; they are computed anew in every position cycle.
    stride = 1 if loop.terms else len(reference)
    before, clock = still, _Clock(loop.t_position, loop.t_velocity, steps)
    for start in range(0, cycles * steps, stride):
        if loop.terms and start:
            acceleration = (state.v_m - before) / loop.t_position
            further = _further(loop, start * loop.t_position, state.q_m, state.v_m, acceleration, state.load,
                               state.bent)
        before = state.v_m.copy()
        _play(loop.chain, drives, _Inputs(reference, external, further), state, out, clock,
              (start, min(start + stride, cycles * steps)))
    return out[0], out[1], out[2]


def _further(loop: LoopModel, t: float, q: Array, qd: Array, qdd: Array, load: Array, bent: Array) -> Array:
    if not loop.terms:
        return np.zeros(loop.n)
    direction = np.where(loop.friction_bend > 0.0, np.clip(bent, -1.0, 1.0), np.clip(qd / 1e-3, -1.0, 1.0))
    return further_torque(loop, np.array([t]), q[None], qd[None], qdd[None], load[None], direction[None])[0]


@jit()
def _play(chain: Chain, drives: Drives, inputs: _Inputs, state: _Motion, out: Array, clock: _Clock,
          span: tuple[int, int]) -> None:
    """Plays the position cycles of ``span``; ``out (3, cycles + 1, n)`` gets arm and motor angles and motor torques."""
    n = len(state.q_m)
    reference, external, further = inputs
    t_position, dt, steps_ipo = clock
    substeps = round(t_position / dt)
    q_a, v_a, q_m, v_m, load = state.q_a, state.v_a, state.q_m, state.v_m, state.load
    v_ref, bias, rise, acceleration = np.zeros(n), np.empty(n), np.empty(n), np.empty(n)
    R, p, M, zero = np.empty((n, 3, 3)), np.empty((n, 3)), np.empty((n, n)), np.zeros(n)
    for step in range(span[0], span[1]):
        cycle = step // steps_ipo
        r = reference[step]
        for i in range(n):
            v_ref[i] = drives.k_v[i] * (r[i] - q_m[i]) + drives.k_ff[i] * (r[i] - state.reference[i]) / t_position
            state.reference[i] = r[i]
        joint_frames(chain, q_a, R, p)
        mass_matrix(chain, R, p, M)
        for i in range(n):
            # Implicit midpoint for the gear springs: light wrists on stiff gears stay stable at this step.
            M[i, i] += 0.5 * dt * drives.damping[i] + 0.25 * dt * dt * drives.stiffness[i]
        L = np.linalg.cholesky(M)
        for sub in range(substeps):
            if sub > 0:
                joint_frames(chain, q_a, R, p)
            torque_at(chain, R, p, v_a, zero, 1.0, bias)
            _motors_step(drives, state, v_ref, further, dt, rise)
            for i in range(n):
                acceleration[i] = load[i] - bias[i] + external[cycle, i] + rise[i]
            _solve_cholesky(L, acceleration)
            for i in range(n):
                v_a[i] += acceleration[i] * dt
                q_a[i] += (v_a[i] - 0.5 * acceleration[i] * dt) * dt
                q_m[i] += v_m[i] * dt
        if (step + 1) % steps_ipo == 0:
            out[0, cycle + 1], out[1, cycle + 1], out[2, cycle + 1] = q_a, q_m, state.tau


@jit()
def _motors_step(drives: Drives, state: _Motion, v_ref: Array, further: Array, dt: float, rise: Array) -> None:
    """One step of velocity loops, gears and rotors; ``rise`` gets what each gear's load gains in half a step."""
    q_m, v_m, q_a, v_a, tau, load = state.q_m, state.v_m, state.q_a, state.v_a, state.tau, state.load
    stiffness, damping, k_p, k_i = drives.stiffness, drives.damping, drives.k_p, drives.k_i
    for i in range(len(q_m)):
        # Velocity loop, [G] (17) at its own cycle, with the low-pass differentiator.
        speed = (q_m[i] - state.previous[i]) / dt
        state.previous[i] = q_m[i]
        state.filtered[i] += dt / (dt + drives.t_filter[i]) * (speed - state.filtered[i])
        u = v_ref[i] - state.filtered[i]
        wanted = k_p[i] * u + state.integral[i] + k_i[i] * u * dt
        tau[i] = min(max(wanted, -drives.tau_max[i]), drives.tau_max[i])
        if wanted == tau[i]:
            state.integral[i] += k_i[i] * u * dt
        ahead, steeper, _ = unevenness(drives.uneven, i, q_m[i])
        slope = 1.0 + steeper
        twist = q_m[i] + ahead - q_a[i]
        gap = drives.half_gap[i]
        give = 1.0
        if gap > 0.0:
            give = 0.0 if abs(twist) <= gap else 1.0
            twist -= min(max(twist, -gap), gap)
        load[i] = stiffness[i] * twist + give * damping[i] * (slope * v_m[i] - v_a[i])
        net = ((tau[i] - further[i]) / drives.gain[i] - drives.offset[i] - slope * load[i]
               - ripple_torque(drives.ripple, i, q_m[i]))
        v_m[i] = _rubbed(v_m[i], net, dt, load[i], drives, state.bent, i)
        rise[i] = give * 0.5 * dt * stiffness[i] * (slope * v_m[i] - v_a[i])


@jit(inline="always")
def _solve_cholesky(L: np.ndarray, x: Array) -> None:
    """Solves ``L Lᵀ x = b`` in place: (M + dt/2 D + dt²/4 K) a = load half a step on - bias."""
    n = len(x)
    for i in range(n):
        for j in range(i):
            x[i] -= L[i, j] * x[j]
        x[i] /= L[i, i]
    for i in range(n - 1, -1, -1):
        for j in range(i + 1, n):
            x[i] -= L[j, i] * x[j]
        x[i] /= L[i, i]


@jit()
def _rubbed(v: float, torque: float, dt: float, load: float, drives: Drives, bent: Array, i: int) -> float:
    """Velocity after one step under ``torque`` and friction, which stops a joint but never drives it."""
    inertia, bends = drives.rotor_inertia[i], drives.friction_bend[i] > 0.0
    sense = v if v != 0.0 else torque
    side = 0 if sense > 0.0 else 1
    dry, fluid = dry_and_fluid(abs(v), drives.friction_velocity[:, i], drives.friction_turns[side, :, i],
                               drives.friction_torque[side, :, i])
    dry += friction_of_load(drives.friction_load[i], drives.friction_driven[i], load, sense)
    if bends:
        bent[i] = bristles(bent[i], v * dt, dry / drives.friction_dry[i], drives.friction_bend[i])
        return v + (torque - drives.friction_dry[i] * bent[i] - np.sign(v) * fluid) / inertia * dt
    free = v + torque / inertia * dt
    slow = (dry + fluid) / inertia * dt
    if abs(free) <= slow:
        return 0.0
    return free - np.sign(free) * slow
