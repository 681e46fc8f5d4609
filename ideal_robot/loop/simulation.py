"""Simulation of the *identified* closed loop: rigid body, friction, rotors, elastic gears, controller, command path.

The ideal robot uses it before the arm moves ([G] Fig. 15 with identified numbers). It is independent of the simulated
world in ``sim``, which has other formulas.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.dynamics.newton_euler import Chain, frames_of, joint_frames, mass_matrix, torque_at
from ideal_robot.errors import IdealRobotError, InputError
from ideal_robot.estimate.cholesky import factor, solve
from ideal_robot.friction.table import Friction, Presliding, friction_along, friction_step
from ideal_robot.jit import jit
from ideal_robot.loop.loop import (
    Cascade,
    Compensation,
    Drives,
    Loop,
    compensated,
    further_torque,
    gains_at,
    ripple_torque,
    sheet_torque,
    unevenness,
)
from ideal_robot.tolerances import ROUNDING, ZERO_CROSSING


@dataclass(frozen=True)
class LoopMotion:
    """Motion of the simulated loop at the instants ``t_k = k t_ipo`` at which commands are sent.

    Attributes:
        t: ``(N,)`` [s]; row 0 is the start.
        q_a, q_m: arm and motor angles ``(N, n)`` [rad].
        tau: motor torque ``(N, n)`` [N m].
    """

    t: Array
    q_a: Array
    q_m: Array
    tau: Array


def interpolated(q_c: Array, q0: Array, loop: Loop) -> Array:
    """The command at the position loop before its low-pass: delayed, linearly interpolated ``(N s, n)`` [rad].

    Row ``j`` belongs to the time ``j t_position``.

    Args:
        q_c, q0: commands of the cycles 0 … N-1 ``(N, n)`` [rad], and where the arm rests before ``(n,)`` [rad].
        loop: the identified loop.
    """
    s, N = loop.steps_ipo, len(q_c)
    knots = np.vstack([np.tile(q0, (loop.path.delay + 1, 1)), q_c])[: N + 1]
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


def simulate(loop: Loop, q_c: Array, *, tau_ext: Array | None = None) -> LoopMotion:
    """Simulates the identified loop with commands, from rest at the first one.

    At rest at the start means: arm and motor in equilibrium with gravity, held by the integrators, the motor at
    ``q_c[0]``.

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
    reference = low_passed(interpolated(q_c, q0, loop), q0, loop.path.command_filter)
    external = np.zeros_like(q_c) if tau_ext is None else np.ascontiguousarray(tau_ext, dtype=float)
    loop = _with_gears(loop, q0)
    (R, p), tau0 = frames_of(loop.chain), np.empty(loop.n)
    joint_frames(loop.chain, q0, R, p)
    torque_at(loop.chain, R, p, np.zeros(loop.n), np.zeros(loop.n), 1.0, tau0)
    try:
        q_a, q_m, tau = _played(loop, reference, external, tau0, q0)
    except np.linalg.LinAlgError:
        raise IdealRobotError("the model's masses and inertias are those of no body (its mass matrix is not positive "
                              "definite), so its loop cannot be simulated; identify them with physical consistency, or "
                              "use the URDF's") from None
    if not np.isfinite(q_m).all():
        raise IdealRobotError("the identified loop is unstable in simulation; check its gains, rotor inertias and "
                              "stiffness (a very stiff gear counts as rigid when it is given as infinite)")
    return LoopMotion(np.asarray(np.arange(len(q_a)) * loop.t_ipo, dtype=float), q_a, q_m, tau)


def _with_gears(loop: Loop, q: Array) -> Loop:
    """The loop with a spring for every gear, at a posture ``(n,)`` [rad].

    Rigid gears are simulated as gears whose own oscillation (80 Hz, well damped) nobody sees at the arm. Behind a rigid
    gear it does not matter which side has the inertia: a link much lighter than its rotor gets a share of it, else it
    would sag; a rotor much lighter than its link must withstand the gear at this step.
    """
    drives, dt = loop.drives, loop.path.t_velocity
    rigid, rotor = np.isinf(drives.stiffness), drives.rotor_inertia
    (R, p), M = frames_of(loop.chain), np.empty((loop.n, loop.n))
    joint_frames(loop.chain, q, R, p)
    mass_matrix(loop.chain, R, p, M)
    added = np.where(rigid & (np.diag(M) < 0.1 * rotor), 0.1 * rotor, 0.0)
    rotor, link = rotor - added, np.diag(M) + added
    stiffness = np.minimum((2 * np.pi * 80) ** 2 * link, rotor / dt**2)
    damping = np.minimum(2 * 0.5 * np.sqrt(stiffness * link), 0.8 * rotor / dt)
    return loop.changed(armature=loop.chain.armature + added, rotor_inertia=rotor,
                        stiffness=np.where(rigid, stiffness, drives.stiffness),
                        damping=np.where(rigid, damping, drives.damping))


class _Motion(NamedTuple):
    """State of the loop between position cycles, ``(n,)`` each; changed in place.

    Arm and motor angles and velocities, integrator, filtered velocity and angle before of the velocity loop, reference
    before, its lagged rate and that one's, presliding state, motor torque, and torque of the gears.
    """

    q_a: Array
    v_a: Array
    q_m: Array
    v_m: Array
    integral: Array
    filtered: Array
    previous: Array
    reference: Array
    rate: Array
    bend: Array
    force: Array
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


def _played(loop: Loop, reference: Array, external: Array, tau0: Array, q0: Array) -> tuple[Array, Array, Array]:
    """Arm angles, motor angles and motor torques at the cycles' ends."""
    n, steps, drives = loop.n, loop.steps_ipo, loop.drives
    cycles = len(reference) // steps
    still = np.zeros(n)
    further = further_torque(loop, np.zeros(1), q0[None], still[None], still[None], tau0[None], still[None])[0]
    side = np.sign(tau0) * np.minimum(1.0, np.abs(tau0) / ROUNDING)
    q_a = np.array([q + unevenness(drives.uneven, i, q)[0] for i, q in enumerate(q0)])
    q_a = q_a - tau0 / drives.stiffness - side * drives.half_gap
    holding = drives.gain * (tau0 + drives.offset) + further
    summed = holding - sheet_torque(loop.compensation, q0, still)
    # Without an integrator the joint deflects under gravity until its stiffness balances it.
    sag = np.linalg.solve(gains_at(loop.compensation, q0), np.where(loop.cascade.k_i > 0.0, 0.0, summed))
    sag = sag / (loop.cascade.k_p * loop.cascade.k_v)
    state = _Motion(q_a - sag, still.copy(), q0 - sag, still.copy(), np.where(loop.cascade.k_i > 0.0, summed, 0.0),
                    still.copy(), q0 - sag, q0.copy(), still.copy(), still.copy(), still.copy(), holding.copy(),
                    tau0.copy())
    out = np.empty((3, cycles + 1, n))
    out[:, 0] = state.q_a, state.q_m, state.tau
    # Without further torques the whole simulation is one compiled call; with them it is called per position cycle.
    stride = 1 if loop.terms else len(reference)
    v, q, direction = still, q0, still
    clock = _Clock(loop.path.t_position, loop.path.t_velocity, steps)
    for start in range(0, cycles * steps, stride):
        if loop.terms and start:
            acceleration = (state.v_m - v) / loop.path.t_position
            _, presliding = friction_along(loop.friction, state.v_m[None], state.load[None], (state.q_m - q)[None],
                                           Presliding(state.force, direction))
            direction = presliding.direction[0]
            further = _further(loop, start * loop.path.t_position, state, acceleration, direction)
        v, q = state.v_m.copy(), state.q_m.copy()
        _play(loop.chain, drives, loop.friction, (loop.cascade, loop.compensation),
              _Inputs(reference, external, further), state, out, clock, (start, min(start + stride, cycles * steps)))
    return out[0], out[1], out[2]


def _further(loop: Loop, t: float, state: _Motion, acceleration: Array, direction: Array) -> Array:
    """Torque of further effects ``(n,)`` [N m] in a state of the motion, its joints sliding in a direction ``(n,)``."""
    return further_torque(loop, np.array([t]), state.q_m[None], state.v_m[None], acceleration[None], state.load[None],
                          direction[None])[0]


@jit()
def _play(chain: Chain, drives: Drives, friction: Friction, controller: tuple[Cascade, Compensation],
          inputs: _Inputs, state: _Motion, out: Array, clock: _Clock, span: tuple[int, int]) -> None:
    """Plays the position cycles of ``span``; ``out (3, cycles + 1, n)`` gets arm and motor angles and motor torques."""
    n = len(state.q_m)
    helped, position, direct, summed = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    cascade, compensation = controller
    reference, external, further = inputs
    t_position, dt, steps_ipo = clock
    substeps = round(t_position / dt)
    # Share of a change that passes a lag in a cycle.
    share = 1.0 - np.exp(-t_position / cascade.t_rate) if cascade.t_rate > 0.0 else 1.0
    q_a, v_a, q_m, v_m, load = state.q_a, state.v_a, state.q_m, state.v_m, state.load
    v_ref, bias, rise, acceleration = np.zeros(n), np.empty(n), np.empty(n), np.empty(n)
    (R, p), M, zero = frames_of(chain), np.empty((n, n)), np.zeros(n)
    for step in range(span[0], span[1]):
        cycle = step // steps_ipo
        r = reference[step]
        added = sheet_torque(compensation, q_m, v_m)
        for i in range(n):
            rate = state.rate[i] + share * ((r[i] - state.reference[i]) / t_position - state.rate[i])
            state.bend[i] += share * ((rate - state.rate[i]) / t_position - state.bend[i])
            position[i] = cascade.k_v[i] * (r[i] - q_m[i])
            v_ref[i] = position[i] + cascade.k_ff[i] * rate + cascade.k_a[i] * state.bend[i]
            helped[i] = compensated(compensation, i, rate) + added[i]
            state.reference[i], state.rate[i] = r[i], rate
        gains = gains_at(compensation, q_m)
        joint_frames(chain, q_a, R, p)
        mass_matrix(chain, R, p, M)
        for i in range(n):
            # Implicit midpoint for the springs of gears, implicit Euler for their damping, which does not oscillate for
            # very light links: light wrists on stiff gears stay stable at this step.
            M[i, i] += dt * drives.damping[i] + 0.25 * dt * dt * drives.stiffness[i]
        if not factor(M):
            raise np.linalg.LinAlgError("the mass matrix is not positive definite")
        for sub in range(substeps):
            if sub > 0:
                joint_frames(chain, q_a, R, p)
            torque_at(chain, R, p, v_a, zero, 1.0, bias)
            for i in range(n):
                direct[i], summed[i] = _velocity_loop(cascade, state, v_ref[i], position[i], dt, i)
            if compensation.coupled:
                direct[:], summed[:] = gains @ direct, gains @ summed
            for i in range(n):
                own = 1.0 if compensation.coupled else gains[i, i]
                tau = _limited(cascade, state, own * direct[i] + helped[i], own * summed[i], i)
                mesh, slope = _gear(drives, state, i)
                net = ((tau - further[i]) / drives.gain[i] - drives.offset[i] - slope * load[i]
                       - ripple_torque(drives.ripple, i, q_m[i]))
                before = v_m[i]
                v_m[i] = _rotor(friction, drives.rotor_inertia[i], state, net, dt, i)
                # Change of the gear torque: of its spring in half a step, and of its damper by the motor's
                # acceleration.
                rise[i] = mesh * (0.5 * dt * drives.stiffness[i] * (slope * v_m[i] - v_a[i])
                                  + drives.damping[i] * slope * (v_m[i] - before))
            for i in range(n):
                acceleration[i] = load[i] - bias[i] + external[cycle, i] + rise[i]
            # (M + dt D + dt²/4 K) a = load of the spring half a step later and of the damper a step later - bias.
            solve(M, acceleration)
            for i in range(n):
                v_a[i] += acceleration[i] * dt
                q_a[i] += (v_a[i] - 0.5 * acceleration[i] * dt) * dt
                q_m[i] += v_m[i] * dt
        if (step + 1) % steps_ipo == 0:
            out[0, cycle + 1], out[1, cycle + 1], out[2, cycle + 1] = q_a, q_m, state.tau


@jit(inline="always")
def _velocity_loop(cascade: Cascade, state: _Motion, v_ref: float, position: float, dt: float,
                   i: int) -> tuple[float, float]:
    """Torque of a joint's velocity loop, [G] (17) at its own cycle, and what its integrator gains in it [N m].

    At the record's gains, with the low-pass differentiator; ``position`` is what of ``v_ref`` is of it [rad/s].
    """
    speed = (state.q_m[i] - state.previous[i]) / dt
    state.previous[i] = state.q_m[i]
    state.filtered[i] += dt / (dt + cascade.t_filter[i]) * (speed - state.filtered[i])
    u = v_ref - state.filtered[i]
    return cascade.k_p[i] * u, cascade.k_i[i] * (cascade.integrated * u + (1.0 - cascade.integrated) * position) * dt


@jit(inline="always")
def _limited(cascade: Cascade, state: _Motion, direct: float, summed: float, i: int) -> float:
    """Motor torque [N m] within the limits; there the integrator stands, else it goes on by ``summed`` [N m]."""
    wanted = direct + summed + state.integral[i]
    state.tau[i] = min(max(wanted, -cascade.tau_max[i]), cascade.tau_max[i])
    if wanted == state.tau[i]:
        state.integral[i] += summed
    return state.tau[i]


@jit(inline="always")
def _gear(drives: Drives, state: _Motion, i: int) -> tuple[float, float]:
    """Whether a joint's gear is in mesh (1 or 0), and its speed over the motor's; its torque goes to ``load``."""
    ahead, steeper, _ = unevenness(drives.uneven, i, state.q_m[i])
    slope = 1.0 + steeper
    twist = state.q_m[i] + ahead - state.q_a[i]
    gap = drives.half_gap[i]
    mesh = 1.0
    if gap > 0.0:
        mesh = 0.0 if abs(twist) <= gap else 1.0
        twist -= min(max(twist, -gap), gap)
    state.load[i] = drives.stiffness[i] * twist + mesh * drives.damping[i] * (slope * state.v_m[i] - state.v_a[i])
    return mesh, slope


@jit(inline="always")
def _rotor(friction: Friction, inertia: float, state: _Motion, net: float, dt: float, i: int) -> float:
    """Velocity of a joint's rotor after a step under a torque [N m] and friction, which stops but never drives."""
    v = state.v_m[i]
    if friction.distance[i] > 0.0:
        torque, state.force[i] = friction_step(friction, i, v, state.load[i], state.force[i], v * dt)
        return v + (net - torque) / inertia * dt
    # The jump is full friction against the motion, or against the torque that is about to move a joint at rest.
    speed = max(abs(v), ZERO_CROSSING)
    torque, _ = friction_step(friction, i, speed if (v if v != 0.0 else net) > 0.0 else -speed, state.load[i], 0.0, 0.0)
    free, slow = v + net / inertia * dt, abs(torque) / inertia * dt
    if abs(free) <= slow:
        return 0.0
    return free - np.sign(free) * slow
