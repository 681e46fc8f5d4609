"""Everything the model side knows of one closed loop: rigid body, friction, gears, controller and command path.

Flat arrays only, made for compiled code; :func:`ideal_robot.loop.from_model.loop_model` builds one from an
identified model.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.dynamics.newton_euler import Chain
from ideal_robot.effects import FittedEffect
from ideal_robot.errors import InputError
from ideal_robot.friction.presliding import turned
from ideal_robot.jit import jit


def largest_speeds(v_max: Array) -> Array:
    """Speeds that friction is looked at over ``(n,)`` [rad/s]: the limits, 10 rad/s where an arm tells none."""
    return np.where(np.isfinite(v_max), v_max, 10.0)


def velocity_grid(v_max: Array) -> Array:
    """Velocities ``(161, n)`` at which friction is tabled: dense near zero, up to 1.2 × the limit."""
    return np.asarray(1.2 * largest_speeds(v_max) * np.linspace(0.0, 1.0, 161)[:, None] ** 3)


class Drives(NamedTuple):
    """What compiled code needs of the drives; the fields are those of ``LoopModel``, and ``turns_of`` its friction."""

    rotor_inertia: Array
    friction_velocity: Array
    friction_torque: Array
    friction_load: Array
    friction_driven: Array
    friction_bend: Array
    offset: Array
    stiffness: Array
    damping: Array
    k_v: Array
    k_ff: Array
    k_p: Array
    k_i: Array
    t_filter: Array
    tau_max: Array
    ripple: Array
    gain: Array
    half_gap: Array
    uneven: Array
    friction_dry: Array
    friction_turns: Array


@dataclass(frozen=True)
class LoopModel:
    """The identified closed loop of ``n`` joints, [G] Fig. 15.

    The controller is [G] (16), (17) at its own cycles: position loop ``u = k_v (r - q) + k_ff ṙ - q̇`` and velocity
    loop ``τ = k_p u + k_i ∫u``, with the command ``r`` behind interpolation and low-pass. (16) in these terms:
    ``k_P = k_v``, ``k_D = k_ff``, ``k_1 = k_ff - 1``.

    Attributes:
        chain: rigid body of the arm side.
        rotor_inertia: reflected to the joint side ``(n,)`` [kg m²].
        friction_velocity: speeds ≥ 0 at which friction is tabled ``(m, n)`` [rad/s].
        friction_torque: what sliding friction brakes with at them, forward and backward ``(2, m, n)`` [N m]. What
            falls with speed is dry and turns over an angle, what rises with speed is the lubricant's and acts at once.
        friction_load: friction in proportion to the torque the gear transmits ``(n,)`` [-].
        friction_driven: the same of torque that the motor drives the load with, on top ``(n,)`` [-]; 0 if not given.
        friction_bend: angle over which friction of size ``friction_dry`` turns after a reversal ``(n,)`` [rad]; 0 for a
            jump. More dry friction takes as much longer: bristles are as stiff as they were.
        friction_dry: dry friction that ``friction_bend`` belongs to ``(n,)`` [N m]; that of the table if not given.
        offset: constant torque of the drive ``(n,)`` [N m].
        stiffness: of the gears ``(n,)`` [N m/rad]; ``inf`` where they count as rigid.
        damping: of the gears ``(n,)`` [N m s/rad].
        k_v, k_ff: position loop ``(n,)`` [1/s], [-].
        k_p, k_i: velocity loop ``(n,)`` [N m s/rad], [N m/rad].
        t_filter: time constant of the low-pass differentiator ``(n,)`` [s].
        command_filter: impulse response of the command low-pass at the position loop's cycle ``(L, n)``, sums to 1.
        delay: cycles between hand-over of a command and the start of the interpolation towards it (0 or 1).
        t_ipo, t_position, t_velocity: cycle times [s].
        tau_max: torque limit ``(n,)`` [N m].
        q_min, q_max, v_max: limits ``(n,)``.
        ripple: torque the motor needs for its ripple, ``a cos(k q) + b sin(k q)``: ``(m, 3, n)`` of k [1/rad], a and b
            [N m]; ``m = 0`` for none.
        uneven: what the gear's output turns beyond the motor, in the same form [1/rad, rad, rad].
        gain: torque that is read over the torque that acts ``(n,)`` [1].
        half_gap: half the backlash of each gear ``(n,)`` [rad].
        gap_load: load over which the backlash is crossed ``(n,)`` [N m]; 0 where the direction of motion decides.
        terms: effects whose torque the motor has to give as well.
    """

    chain: Chain
    rotor_inertia: Array
    friction_velocity: Array
    friction_torque: Array
    friction_load: Array
    friction_bend: Array
    offset: Array
    stiffness: Array
    damping: Array
    k_v: Array
    k_ff: Array
    k_p: Array
    k_i: Array
    t_filter: Array
    command_filter: Array
    delay: int
    t_ipo: float
    t_position: float
    t_velocity: float
    tau_max: Array
    q_min: Array
    q_max: Array
    v_max: Array
    ripple: Array = field(default_factory=lambda: np.zeros((0, 3, 1)))
    uneven: Array = field(default_factory=lambda: np.zeros((0, 3, 1)))
    gain: Array = field(default_factory=lambda: np.ones(0))
    half_gap: Array = field(default_factory=lambda: np.zeros(0))
    gap_load: Array = field(default_factory=lambda: np.zeros(0))
    terms: tuple[FittedEffect, ...] = ()
    friction_dry: Array = field(default_factory=lambda: np.zeros(0))
    friction_driven: Array = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        for name, none in (("gain", 1.0), ("half_gap", 0.0), ("gap_load", 0.0), ("friction_driven", 0.0)):
            if not len(getattr(self, name)):
                object.__setattr__(self, name, np.full(len(self.rotor_inertia), none))
        if not len(self.friction_dry):
            # Without dry friction nothing turns; the number then only has to be one.
            dry = self.friction_torque[:, 0].mean(axis=0)
            object.__setattr__(self, "friction_dry", np.where(dry > 0.0, dry, 1.0))
        for name in ("k_v", "k_p", "rotor_inertia", "stiffness"):
            values = getattr(self, name)
            if np.any(~(values > 0)) and not (name == "rotor_inertia" and np.all(values >= 0)):
                raise InputError("must be positive for every joint; identify the closed loop first", field=name,
                                 value=np.round(values, 6).tolist())
        steps = self.t_ipo / self.t_position, self.t_position / self.t_velocity
        if any(abs(ratio - round(ratio)) > 1e-6 or ratio < 0.999 for ratio in steps):
            raise InputError("cycle times must be whole multiples of each other", field="t_ipo",
                             value=(self.t_ipo, self.t_position, self.t_velocity))
        for value in vars(self).values():
            if isinstance(value, np.ndarray):
                value.setflags(write=False)

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.rotor_inertia)

    @property
    def steps_ipo(self) -> int:
        """Position-loop cycles in one interpolation cycle."""
        return round(self.t_ipo / self.t_position)

    @property
    def compliance(self) -> Array:
        """1/stiffness ``(n,)`` [rad/(N m)]; 0 for rigid gears."""
        return np.where(np.isfinite(self.stiffness), 1.0 / self.stiffness, 0.0)

    def drives(self, stiffness: Array, damping: Array) -> Drives:
        """The drives with gears of finite ``stiffness`` and ``damping (n,)``.

        Copies that may be written: numba compiles anew for every field that is read-only or is not.
        """
        limit = np.where(np.isfinite(self.tau_max), self.tau_max, 1e12)
        changed = {"stiffness": stiffness, "damping": damping, "tau_max": limit,
                   "friction_turns": turns_of(self.friction_torque)}
        return Drives(**{name: np.array(changed[name] if name in changed else getattr(self, name), order="C")
                         for name in Drives._fields})

    def replace(self, **changes: Any) -> LoopModel:
        """A copy with some fields changed."""
        return replace(self, **changes)


@jit()
def ripple_torque(ripple: Array, i: int, q: float) -> float:
    """Ripple of a joint [N m].

    Args:
        ripple: order, cosine and sine amplitude of each component ``(m, 3, n)`` [1, N m, N m].
        i, q: joint, from 0, and its motor angle [rad].
    """
    torque = 0.0
    for m in range(ripple.shape[0]):
        phase = ripple[m, 0, i] * q
        torque += ripple[m, 1, i] * np.cos(phase) + ripple[m, 2, i] * np.sin(phase)
    return torque


@jit()
def friction_of_load(per_load: float, per_driven: float, load: float, sense: float) -> float:
    """What the load on a gear's teeth adds to its sliding friction [N m].

    Args:
        per_load, per_driven: friction per torque, and the same on top where the motor drives the load [-].
        load: torque that the gear transmits [N m].
        sense: direction of sliding, or the torque that is about to move a joint at rest; only its sign counts.
    """
    return (per_load + (per_driven if load * sense > 0.0 else 0.0)) * abs(load)


def turns_of(table: Array) -> Array:
    """What turns over the presliding distance of friction ``(2, m, n)`` at rising speeds [N m]: what has not risen."""
    return np.asarray(np.minimum.accumulate(table, axis=1))


@jit()
def dry_and_fluid(speed: float, speeds: Array, turns: Array, table: Array) -> tuple[float, float]:
    """Sizes of a joint's friction [N m]: dry friction, which turns over, and the lubricant's, which acts at once.

    Args:
        speed: of the motor [rad/s]; compiled, ``np.interp`` of one number takes several times as long.
        speeds, turns, table: of the table of friction ``(m,)``, what ``turns_of`` leaves of it, and itself.
    """
    low, high = 0, len(speeds) - 1
    if speed >= speeds[high]:
        return turns[high], table[high] - turns[high]
    while high - low > 1:
        middle = (low + high) // 2
        if speed < speeds[middle]:
            high = middle
        else:
            low = middle
    share = (speed - speeds[low]) / (speeds[high] - speeds[low])
    dry = turns[low] + share * (turns[high] - turns[low])
    whole = table[low] + share * (table[high] - table[low])
    return dry, whole - dry


@jit()
def bristles(bent: float, step: float, size: float, bend: float) -> float:
    """Dry friction of a joint over its identified size after a step: dF/dq = σ (1 - F sign(q̇) / dry) (Dahl).

    Bristles are as stiff as the identified ones, σ; so dry friction that has grown takes longer to turn.

    Args:
        bent: before; its share of ``size`` is the direction of sliding.
        step: of the motor [rad].
        size: dry friction now over its identified size.
        bend: angle over which friction of that size turns [rad].
    """
    size = max(size, 1e-12)
    return size * turned(bent / size, step, bend * min(max(size, 0.2), 5.0))


@jit()
def friction_along(drives: Drives, v: Array, load: Array, dt: float, bent: Array, still: float
                   ) -> tuple[Array, Array, Array]:
    """Friction torque [N m] along a motion, the bend of its bristles and the direction of sliding, all ``(m, n)``.

    Args:
        drives: of the loop.
        v, load: of the motors [rad/s], and torque that each gear transmits [N m], ``(m, n)``.
        dt, bent: time between two of them [s], and the bend before ``(n,)``, see ``bristles``.
        still: velocity [rad/s] within which friction that jumps passes zero; else rounding at rest would switch it.
    """
    torque, bend, sliding = np.empty_like(v), np.empty_like(v), np.empty_like(v)
    for i in range(v.shape[1]):
        now, unit = bent[i], drives.friction_dry[i]
        for j in range(len(v)):
            side = 0 if v[j, i] >= 0.0 else 1
            dry, fluid = dry_and_fluid(abs(v[j, i]), drives.friction_velocity[:, i],
                                       drives.friction_turns[side, :, i], drives.friction_torque[side, :, i])
            dry += friction_of_load(drives.friction_load[i], drives.friction_driven[i], load[j, i], v[j, i])
            if drives.friction_bend[i] > 0.0:
                now = bristles(now, v[j, i] * dt, dry / unit, drives.friction_bend[i])
                sliding[j, i] = min(max(now * unit / max(dry, 1e-12), -1.0), 1.0)
            else:
                sliding[j, i] = min(max(v[j, i] / still, -1.0), 1.0)
                now = sliding[j, i] * dry / unit
            torque[j, i] = now * unit + np.sign(v[j, i]) * fluid
            bend[j, i] = now
    return torque, bend, sliding


@jit()
def unevenness(uneven: Array, i: int, q: float) -> tuple[float, float, float]:
    """What a joint turns beyond its motor, and its two derivatives by the motor angle.

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
    """Motor angles, velocities and accelerations ``(N, n)`` for wanted gear outputs.

    Args:
        uneven: see ``unevenness``.
        q, v, a: wanted outputs ``(N, n)`` [rad], their velocities and accelerations.
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
    # The tail that is cut off is below 1e-5; the static gain must be 1 exactly.
    return np.asarray(taps / taps.sum(axis=0))
