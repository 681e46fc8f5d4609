"""The identified closed loop as one record: rigid body, friction, drives, controller and command path.

``Loop`` is one record of arrays for Python and for compiled code; :func:`ideal_robot.loop.from_model.loop_model` builds
it from an identified model, and :func:`ideal_robot.loop.loop.checked` checks it.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.dynamics.newton_euler import Chain, frames_of, inverse_dynamics, joint_frames, mass_matrix, torque_at
from ideal_robot.effects import FittedEffect, Signals
from ideal_robot.errors import InputError
from ideal_robot.friction.table import Friction
from ideal_robot.jit import jit


class Drives(NamedTuple):
    """Motors and gears of ``n`` joints, reflected to the joint side.

    Attributes:
        rotor_inertia: ``(n,)`` [kg m²].
        offset: constant torque of the drive ``(n,)`` [N m].
        gain: torque that is read over the torque that acts ``(n,)`` [1].
        ripple: torque the motor needs for its ripple, ``a cos(k q) + b sin(k q)``: ``(m, 3, n)`` of k [1/rad], a and b
            [N m]; ``m`` may be 0.
        stiffness: of the gears ``(n,)`` [N m/rad]; infinite where they are rigid.
        damping: of the gears ``(n,)`` [N m s/rad].
        uneven: transmission error of the gear, in the form of ``ripple`` [1/rad, rad, rad].
        half_gap: half the backlash of each gear ``(n,)`` [rad].
        gap_load: load over which the backlash is crossed ``(n,)`` [N m]; 0 where the direction of motion decides.
    """

    rotor_inertia: Array
    offset: Array
    gain: Array
    ripple: Array
    stiffness: Array
    damping: Array
    uneven: Array
    half_gap: Array
    gap_load: Array


class Cascade(NamedTuple):
    """Position and velocity loops of ``n`` joints, [G] (16), (17), at their own cycles.

    Position loop ``u = k_v (r - q) + k_ff ṙ + k_a r̈ - q̇``, velocity loop ``τ = k_p u + k_i ∫u``. (16) in these terms:
    ``k_P = k_v``, ``k_D = k_ff``, ``k_1 = k_ff - 1``. Rates of the command may pass a lag each. In PID control of the
    position the integrator gets ``k_v (r - q)`` alone, a share w = 0 of the rest; impedance control has no integrator.

    Attributes:
        k_v, k_ff, k_a: position loop ``(n,)`` [1/s], [-], [s].
        t_rate: time constant of the lag of the command's rates [s].
        k_p, k_i: velocity loop ``(n,)`` [N m s/rad], [N m/rad].
        t_filter: time constant of the low-pass differentiator ``(n,)`` [s].
        tau_max: torque limit ``(n,)`` [N m]; infinite for none.
        integrated: share w of the terms other than position in the integrator; 1 for a cascade, 0 for PID control.
    """

    k_v: Array
    k_ff: Array
    k_a: Array
    t_rate: float
    k_p: Array
    k_i: Array
    t_filter: Array
    tau_max: Array
    integrated: float


class Compensation(NamedTuple):
    """Model-based parts of joint controllers; arrays are ``(n,)``.

    To the torque of the velocity loops some add

    - the friction of a motion in the direction of the command, ``τ_c tanh(ṙ / v_c)``, - a share b of the data sheet's
    gravity and Coriolis torques.

    Their gains may follow the inertia J that the joint moves by the data sheet, its rotor's included: ``k_p (1 + g
    (J(q) / J_0 - 1))``, and ``k_i`` likewise. If the loops command accelerations, which the data sheet's mass matrix M
    converts to torques (inverse dynamics), their output is multiplied by ``M(q) diag(1 / J_0)``.

    Attributes:
        friction_torque: τ_c [N m]; 0 where the drive compensates none.
        turning_speed: v_c, of the command, over which that turns round [rad/s].
        bodies: b; 0 where no bodies are compensated.
        schedule: g; 0 for gains that are the same everywhere.
        coupled: whether the mass matrix converts the loops' output to torques.
        scheduled_at: J_0, at which gains are those of the record [kg m²].
        sheet, rotors: bodies and rotor inertias [kg m²] of the data sheet.
    """

    friction_torque: Array
    turning_speed: Array
    bodies: Array
    schedule: float
    coupled: bool
    scheduled_at: Array
    sheet: Chain
    rotors: Array

    @classmethod
    def none(cls, sheet: Chain, rotors: Array) -> Compensation:
        """No compensation: controllers without a model, with data sheet ``sheet`` and ``rotors (n,)`` [kg m²]."""
        zero, one = np.zeros_like(rotors), np.ones_like(rotors)
        return cls(zero, one, zero, 0.0, False, one, sheet, rotors)


class CommandPath(NamedTuple):
    """The path from a command to the position loop's reference: filter, delay, cycles and limits.

    Attributes:
        command_filter: impulse response of the command low-pass at the position loop's cycle ``(L, n)``, sums to 1.
        delay: cycles between hand-over of a command and the start of the interpolation towards it (0 or 1).
        t_ipo, t_position, t_velocity: cycle times [s].
        q_min, q_max, v_max: limits of commands ``(n,)`` [rad, rad/s].
    """

    command_filter: Array
    delay: int
    t_ipo: float
    t_position: float
    t_velocity: float
    q_min: Array
    q_max: Array
    v_max: Array


class Loop(NamedTuple):
    """The identified closed loop of ``n`` joints, [G] Fig. 15.

    Attributes:
        chain: rigid body of the arm side.
        drives: motors and gears.
        friction: of every joint.
        cascade: position and velocity loops.
        compensation: model-based parts of the controllers.
        path: from a command to the position loop.
        terms: effects with a motor torque of their own; compiled code uses only the other records.
    """

    chain: Chain
    drives: Drives
    friction: Friction
    cascade: Cascade
    compensation: Compensation
    path: CommandPath
    terms: tuple[FittedEffect, ...] = ()

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.drives.rotor_inertia)

    @property
    def t_ipo(self) -> float:
        """Interpolation cycle [s]."""
        return self.path.t_ipo

    @property
    def steps_ipo(self) -> int:
        """Position-loop cycles in one interpolation cycle."""
        return round(self.path.t_ipo / self.path.t_position)

    @property
    def compliance(self) -> Array:
        """1/stiffness ``(n,)`` [rad/(N m)]; 0 for rigid gears."""
        return np.asarray(1.0 / self.drives.stiffness)

    def changed(self, **fields: Any) -> Loop:
        """The loop with some fields of its records, or whole records, changed.

        Args:
            fields: new values by name; each name occurs in one record only.
        """
        for name in [name for name in fields if name in Loop._fields]:
            self = self._replace(**{name: fields.pop(name)})
        for record in ("chain", "drives", "friction", "cascade", "compensation", "path"):
            values: Any = getattr(self, record)
            own = {name: fields.pop(name) for name in list(fields) if name in values._fields}
            if own:
                self = self._replace(**{record: values._replace(**own)})
        if fields:
            raise TypeError(f"no record of the loop has {', '.join(fields)}")
        return self


def checked(loop: Loop) -> Loop:
    """The loop with contiguous arrays for compiled code; InputError for impossible values."""
    values = {"k_v": loop.cascade.k_v, "k_p": loop.cascade.k_p, "stiffness": loop.drives.stiffness}
    for name, value in values.items():
        if not np.all(value > 0.0):
            raise InputError("must be positive for every joint; identify the closed loop first", field=name,
                             value=np.round(value, 6).tolist())
    if not np.all(loop.drives.rotor_inertia >= 0.0):
        raise InputError("must not be negative for any joint; identify the closed loop first", field="rotor_inertia",
                         value=np.round(loop.drives.rotor_inertia, 6).tolist())
    path = loop.path
    ratios = path.t_ipo / path.t_position, path.t_position / path.t_velocity
    if any(abs(ratio - round(ratio)) > 1e-6 or ratio < 0.999 for ratio in ratios):
        raise InputError("cycle times must be whole multiples of each other", field="t_ipo",
                         value=(path.t_ipo, path.t_position, path.t_velocity))
    return Loop(_in_one_piece(loop.chain), _in_one_piece(loop.drives), _in_one_piece(loop.friction),
                _in_one_piece(loop.cascade),
                _in_one_piece(loop.compensation._replace(sheet=_in_one_piece(loop.compensation.sheet))),
                _in_one_piece(path), loop.terms)


def _in_one_piece(record: Any) -> Any:
    """A record whose arrays are contiguous and may be written: code is compiled anew for every other kind."""
    return record._make(np.require(value, requirements=("C", "W")) if isinstance(value, np.ndarray) else value
                        for value in record)


@jit()
def ripple_torque(ripple: Array, i: int, q: float) -> float:
    """Ripple of a joint [N m].

    Args:
        ripple: order, cosine and sine amplitude of each component ``(m, 3, n)`` [1, N m, N m].
        i, q: joint, from 0, and its motor angle [rad].
    """
    torque = 0.0
    for m in range(ripple.shape[0]):
        # A joint has few of all joints' components; the cosines take the time.
        if ripple[m, 1, i] != 0.0 or ripple[m, 2, i] != 0.0:
            phase = ripple[m, 0, i] * q
            torque += ripple[m, 1, i] * np.cos(phase) + ripple[m, 2, i] * np.sin(phase)
    return torque


@jit()
def mass_at(chain: Chain, rotor_inertia: Array, q: Array) -> Array:
    """Mass matrix at a posture, with the rotors on its diagonal ``(n, n)`` [kg m²].

    Args:
        chain, rotor_inertia: of the arm, ``(n,)`` [kg m²].
        q: joint angles ``(n,)`` [rad].
    """
    n = len(q)
    (R, p), M = frames_of(chain), np.empty((n, n))
    joint_frames(chain, q, R, p)
    mass_matrix(chain, R, p, M)
    return M + np.diag(rotor_inertia)


@jit()
def gains_at(compensation: Compensation, q: Array) -> Array:
    """Matrix ``(n, n)`` that multiplies the velocity loops' torques at a posture, by the scheduled gains.

    Args:
        compensation: of all joints.
        q: motor angles ``(n,)`` [rad].
    """
    if compensation.schedule == 0.0 and not compensation.coupled:
        return np.eye(len(q))
    M = mass_at(compensation.sheet, compensation.rotors, q)
    if compensation.coupled:
        return M / compensation.scheduled_at
    return np.diag(1.0 + compensation.schedule * (np.diag(M) / compensation.scheduled_at - 1.0))


@jit()
def sheet_torque(compensation: Compensation, q: Array, v: Array) -> Array:
    """Gravity and Coriolis torques that controllers add for the data sheet's bodies ``(n,)`` [N m].

    Args:
        compensation: of all joints.
        q, v: motor angles and velocities ``(n,)`` [rad, rad/s].
    """
    n = len(q)
    torque = np.zeros(n)
    if np.any(compensation.bodies != 0.0):
        R, p = frames_of(compensation.sheet)
        joint_frames(compensation.sheet, q, R, p)
        torque_at(compensation.sheet, R, p, v, np.zeros(n), 1.0, torque)
    return compensation.bodies * torque


@jit()
def compensated(compensation: Compensation, i: int, rate: float) -> float:
    """Friction compensation that a joint's drive adds to its loops' torque [N m].

    Args:
        compensation: of all joints.
        i, rate: joint, from 0, and how fast its command moves [rad/s].
    """
    if compensation.friction_torque[i] == 0.0:
        return 0.0
    return float(compensation.friction_torque[i] * np.tanh(rate / compensation.turning_speed[i]))


@jit()
def unevenness(uneven: Array, i: int, q: float) -> tuple[float, float, float]:
    """Transmission error of a joint, and its two derivatives by the motor angle.

    Args:
        uneven: order, cosine and sine part of each component ``(m, 3, n)`` [1/rad, rad, rad].
        i, q: joint, from 0, and its motor angle [rad].
    """
    value, slope, bend = 0.0, 0.0, 0.0
    for m in range(uneven.shape[0]):
        k, a, b = uneven[m, 0, i], uneven[m, 1, i], uneven[m, 2, i]
        c, s = np.cos(k * q), np.sin(k * q)
        value += a * c + b * s
        slope += k * (b * c - a * s)
        bend -= k * k * (a * c + b * s)
    return value, slope, bend


@jit()
def behind_uneven_gears(uneven: Array, q: Array, v: Array, a: Array) -> tuple[Array, Array, Array]:
    """Motor angles, velocities and accelerations ``(N, n)`` for desired gear outputs.

    Args:
        uneven: see ``unevenness``.
        q, v, a: desired outputs ``(N, n)`` [rad], their velocities and accelerations.
    """
    q_m, v_m, a_m = q.copy(), v.copy(), a.copy()
    for i in range(q.shape[1]):
        for k in range(len(q)):
            for _ in range(3):
                q_m[k, i] = q[k, i] - unevenness(uneven, i, q_m[k, i])[0]
            _, slope, bend = unevenness(uneven, i, q_m[k, i])
            v_m[k, i] = v[k, i] / (1.0 + slope)
            a_m[k, i] = (a[k, i] - bend * v_m[k, i] ** 2) / (1.0 + slope)
    return q_m, v_m, a_m


def further_torque(loop: Loop, t: Array, q: Array, qd: Array, qdd: Array, load: Array, sliding: Array) -> Array:
    """Sum of the torques of ``loop.terms`` along a motion of the motors ``(N, n)`` [N m].

    Args:
        loop, t: the identified loop, and instants ``(N,)`` [s].
        q, qd, qdd: motor angles, velocities and accelerations ``(N, n)`` [rad, rad/s, rad/s²].
        load: torque at the gear outputs [N m].
        sliding: direction of sliding, -1 to 1.
    """
    if not loop.terms:
        return np.zeros_like(q)
    signals = Signals(t, q, qd, qdd, load, load, np.zeros_like(load), sliding=sliding,
                      rigid=lambda q, qd, qdd: inverse_dynamics(loop.chain, q, qd, qdd))
    return np.asarray(np.sum([effect.contribution(signals) for effect in loop.terms], axis=0))


def low_pass_taps(time_constant: Array | float, order: int, t_position: float, n: int, *,
                  dead_time: float = 0.0) -> Array:
    """Impulse response ``(L, n)`` of ``order`` equal first-order stages ``r += (1 - a)(x - r)``, ``a = exp(-T/time)``.

    Args:
        time_constant: of each stage, for all joints or per joint ``(n,)`` [s]; 0 for none.
        order, n: number of stages and of joints.
        t_position: cycle at which the filter runs [s].
        dead_time: before it, spread over two taps where it is no whole number of cycles [s].
    """
    times = np.broadcast_to(np.asarray(time_constant, dtype=float), (n,))
    length = 2 + int(np.ceil(dead_time / t_position) + np.ceil((12 + 3 * order) * max(times.max(), 0) / t_position))
    taps = np.zeros((length, n))
    whole, part = divmod(dead_time / t_position, 1.0)
    taps[int(whole)] = 1 - part
    taps[int(whole) + 1] = part
    for i, time in enumerate(times):
        for _ in range(order if time > 0 else 0):
            a = np.exp(-t_position / time)
            taps[:, i] = np.convolve(taps[:, i], (1 - a) * a ** np.arange(length))[:length]
    # The truncated tail is below 1e-5; the static gain must be exactly 1.
    return np.asarray(taps / taps.sum(axis=0))
