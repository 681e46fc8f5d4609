"""Signals that effects use: those of a recording, or of a motion, on one time grid."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.jit import jit
from ideal_robot.signals.filters import lowpass

RigidBody = Callable[[Array, Array, Array], Array]
"""Rigid-body torque ``(N, n)`` of ``q, qd, qdd`` ``(N, n)`` each, without friction and rotors."""

LEVER = 1e-4
"""A turn about an axis this close to the TCP [m] does not move it."""
_STEP = 1e-3
"""Of a position [rad or m]: rounding costs ``1e-13`` of the torque, curvature a millionth of the derivative."""
_KEPT = 128e6
"""Bytes of derivatives that are kept; the joint asked for last is kept at any length."""
_LEAST_INERTIA = 0.05
"""Share of its mean below which the inertia behind a gear does not fall."""
_WEIGHTLESS = 1e-3
"""Weight, over that of the arm's most loaded joint, below which gravity does not turn a joint."""


@dataclass(frozen=True)
class Frames:
    """Kinematics along a motion.

    Attributes:
        axis: joint axes in the base frame ``(N, n, 3)``.
        normal: a direction of each joint's frame across its axis ``(N, n, 3)``.
        position: origins of the joint frames ``(N, n, 3)`` [m].
        tool: TCP ``(N, 3)`` [m].
        jacobian: of the TCP's position ``(N, 3, n)``.
    """

    axis: Array
    normal: Array
    position: Array
    tool: Array
    jacobian: Array


def constant_of_weight(offset: Array, weight: Array) -> Array:
    """Constant torques that may be weight ``(n,)``: all where gravity acts on the joint, zero elsewhere.

    Args:
        offset: constant torque of the motors ``(n,)`` [N m].
        weight: gravity torques of the motors along a motion ``(N, n)`` [N m].
    """
    size = np.max(np.abs(weight), axis=0, initial=0.0)
    return np.asarray(np.where(size > _WEIGHTLESS * np.max(size, initial=0.0), offset, 0.0))


class RigidDerivatives:
    """Derivatives of the rigid body's torques by one joint's motion, cached as far as memory allows.

    Torques are linear in accelerations and quadratic in velocities, so differences are exact there.

    Args:
        rigid: torque ``(N, n)`` of ``q, qd, qdd`` ``(N, n)`` each.
        q, qd, qdd: positions, velocities and accelerations ``(N, n)`` [rad or m; rad/s, rad/s²].
    """

    def __init__(self, rigid: RigidBody, q: Array, qd: Array, qdd: Array) -> None:
        self._rigid, self._motion = rigid, (q, qd, qdd)
        self._known: dict[int, tuple[Array, Array, Array]] = {}

    def by(self, joint: int) -> tuple[Array, Array, Array]:
        """``d tau/dq_j, d tau/dqd_j, d tau/dqdd_j``, each ``(N, n)``, of ``joint`` (from 1)."""
        j = joint - 1
        known = self._known.pop(joint, None) or (self._difference(j, 0, _STEP), self._difference(j, 1, 1.0),
                                                 self.mass[j])
        size = sum(values.nbytes for values in known)
        while self._known and size * (len(self._known) + 1) > _KEPT:
            del self._known[next(iter(self._known))]
        self._known[joint] = known
        return known

    def along(self, joint: int, position: Array, velocity: Array, acceleration: Array) -> Array:
        """First-order change of all torques ``(N, n)`` by small changes of one joint's motion.

        Args:
            joint: from 1.
            position, velocity, acceleration: changes ``(N,)`` [rad or m; rad/s, rad/s²].
        """
        change = (np.ascontiguousarray(values) for values in (position, velocity, acceleration))
        return np.asarray(_combined(*self.by(joint), *change))


    @cached_property
    def mass(self) -> list[Array]:
        """Torques ``(N, n)`` of a unit acceleration of each joint: columns of the mass matrix."""
        q, still = self._motion[0], np.zeros_like(self._motion[0])
        at_rest = self._rigid(q, still, still)
        return [self._rigid(q, still, still + unit) - at_rest for unit in np.eye(q.shape[1])]

    def _difference(self, j: int, k: int, step: float) -> Array:
        sides = []
        for sign in (1.0, -1.0):
            q, qd, qdd = (values.copy() if i == k else values for i, values in enumerate(self._motion))
            (q, qd, qdd)[k][:, j] += sign * step
            sides.append(self._rigid(q, qd, qdd))
        return np.asarray((sides[0] - sides[1]) / (2.0 * step))


@jit()
def _combined(a: Array, b: Array, c: Array, x: Array, y: Array, z: Array) -> Array:
    """``a x + b y + c z`` of torques ``(N, n)`` and numbers ``(N,)``, without arrays in between."""
    result = np.empty_like(a)
    for k in range(a.shape[0]):
        for j in range(a.shape[1]):
            result[k, j] = a[k, j] * x[k] + b[k, j] * y[k] + c[k, j] * z[k]
    return result


@dataclass(frozen=True)
class Signals:
    """Signals of a motion on one uniform time grid of ``N`` samples, the inputs of effects.

    Attributes:
        t: time since the start of the recording ``(N,)`` [s].
        q, qd, qdd: motor position, velocity and acceleration on the joint side ``(N, n)`` [rad or m, SI].
        load: torque at the gear output, i.e. of the rigid body without friction and rotors ``(N, n)`` [N m].
        torque: the present model's motor torque ``(N, n)`` [N m].
        friction: the part of ``torque`` that is friction ``(N, n)`` [N m].
        dry: dry friction of each joint at standstill, in the model ``(n,)`` [N m]; None where no model says so.
        compliance: of the gears as far as the model knows it, else zero ``(n,)`` [rad/(N m)]; None where it knows none.
        temperature: gear temperature ``(N, n)`` [°C], or None where it was not measured.
        rigid: the rigid body as a function, for effects that change positions; None where there is none.
        weight: gravity torques of the motors along the motion ``(N, n)``, in the unit of ``torque``; None without a
            rigid body.
        constant: constant torque of the motors that may be weight ``(n,)`` [N m]: a joint that turns little does not
            distinguish the two. None without a model.
        extra: further columns by name ``(N,)``, e.g. those of the sensor loop.
        frames: kinematics along the motion, or None.
        payload: regressor ``(N, n, 10)`` of a body rigidly on the last link (mass, first moments, inertias), or None.
        bodies: regressor ``(N, n, 10)`` of a body rigidly on a link (from 1), or None.
        gravity_across: torques ``(N, n, 2)`` of 1 m/s² of gravity along the base's x and y axes at positions
            ``(N, n)``, or None.
        cutoff: of the zero-phase filter that the positions went through [Hz]; None where they are exact.
        v_small: velocity below which the direction of motion is lost in noise ``(n,)`` [rad/s]; None for exact data.
        sliding: direction of sliding ``(N, n)``, -1 to 1, of joints whose friction in the model builds up over a
            displacement, NaN for others; None where no model says so.
        tool: mounting point of tools in the frame of the last link ``(3,)`` [m]; None where unknown.
        elsewhere: times ``(K,)`` [s] of the recording that effects were fitted to, where this is another one; None
            where it is the same.
    """

    t: Array
    q: Array
    qd: Array
    qdd: Array
    load: Array
    torque: Array
    friction: Array
    temperature: Array | None = None
    rigid: RigidBody | None = None
    weight: Array | None = None
    constant: Array | None = None
    extra: Mapping[str, Array] = field(default_factory=dict)
    payload: Array | None = None
    bodies: Callable[[int], Array] | None = None
    gravity_across: Callable[[Array], Array] | None = None
    frames: Frames | None = None
    v_small: Array | None = None
    cutoff: float | None = None
    sliding: Array | None = None
    dry: Array | None = None
    compliance: Array | None = None
    tool: Array | None = None
    elsewhere: Array | None = None

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.q.shape[1])

    @property
    def dt(self) -> float:
        """Sampling interval [s]; 1 for a single sample."""
        return float(self.t[1] - self.t[0]) if len(self.t) > 1 else 1.0

    def over_time(self, function: Callable[[Array], Array]) -> Array:
        """A function of the time since a recording began ``(N, …)``.

        Drift belongs to its recording. Of another one nobody knows when in it that began: there is its mean.

        Args:
            function: of times ``(K,)`` [s], with values ``(K, …)``.
        """
        if self.elsewhere is None:
            return np.asarray(function(self.t))
        mean = np.mean(function(self.elsewhere), axis=0)
        return np.broadcast_to(mean, (len(self.t), *np.shape(mean))).copy()

    @cached_property
    def across(self) -> Array | None:
        """Torques of horizontal gravity along the motion ``(N, n, 2)``, by ``gravity_across``; None where unknown."""
        return None if self.gravity_across is None else self.gravity_across(self.q)

    @cached_property
    def derivatives(self) -> RigidDerivatives | None:
        """Derivatives of the rigid body's torques by one joint's motion; None without a rigid body."""
        return None if self.rigid is None else RigidDerivatives(self.rigid, self.q, self.qd, self.qdd)

    def slow_load(self, joint: int, cutoff: float) -> Array:
        """Load of the gear of ``joint`` (from 1) below a frequency [Hz] ``(N,)`` [N m]."""
        return self.once(("load", joint, cutoff), lambda: lowpass(self.load[:, joint - 1], self.dt, cutoff))

    def span(self, joint: int) -> float:
        """Driven range of ``joint`` (from 1), above zero [rad or m]."""
        return float(np.ptp(self.q[:, joint - 1])) + 1e-12

    def top_speed(self, joint: int) -> float:
        """Speed of ``joint`` (from 1) that is exceeded in a hundredth of the time [rad/s or m/s]."""
        return self.once(("speed", joint), lambda: float(np.percentile(np.abs(self.qd[:, joint - 1]), 99)))

    def once(self, key: tuple[Any, ...], make: Callable[[], Any]) -> Any:
        """Caches ``make()`` by a key, for values that depend on the signals alone."""
        if key not in self._made:
            self._made[key] = make()
        return self._made[key]

    @cached_property
    def _made(self) -> dict[tuple[Any, ...], Any]:
        return {}

    @cached_property
    def inertia(self) -> Array:
        """Inertia behind each gear with the other joints fixed ``(N, n)`` [kg m²]; ones without a rigid body."""
        if self.derivatives is None:
            return np.ones((len(self.t), self.n))
        return np.column_stack([column[:, j] for j, column in enumerate(self.derivatives.mass)])

    def inertia_behind(self, joint: int) -> Array:
        """Inertia behind the gear of ``joint`` (from 1), bounded away from zero ``(N,)`` [kg m²]."""
        inertia = self.inertia[:, joint - 1]
        return np.asarray(np.maximum(inertia, _LEAST_INERTIA * np.mean(inertia)))

    def borne(self, joint: int) -> Array:
        """Load of the gear of ``joint`` (from 1), including a constant torque that may be weight ``(N,)`` [N m].

        A fit determines the sum better than each part, and the sum decides where the load changes sign.
        """
        return np.asarray(self.load[:, joint - 1] + (0.0 if self.constant is None else self.constant[joint - 1]))

    def direction(self, qd: Array, joint: int) -> Array:
        """Sign of a velocity ``(N,)`` of ``joint`` (from 1), smoothed where noise hides it."""
        if self.v_small is None:
            return np.sign(qd)
        return np.tanh(qd / self.v_small[joint - 1])

    def sliding_direction(self, joint: int) -> Array:
        """Direction ``(N,)`` of dry friction of ``joint`` (from 1), with the model's presliding state.

        Terms of dry friction build up after a reversal as dry friction does.
        """
        if self.sliding is not None and len(self.t) and np.isfinite(self.sliding[0, joint - 1]):
            return np.asarray(self.sliding[:, joint - 1])
        return np.asarray(self._directions[joint - 1])

    @cached_property
    def _directions(self) -> Array:
        """Directions of motion ``(n, N)``; many effects ask for them, with many values of theta."""
        return np.array([self.direction(qd, j + 1) for j, qd in enumerate(self.qd.T)])

    def on_joint(self, joint: int, *columns: Array) -> Array:
        """Columns ``(N,)`` that act on one joint (from 1) only, as ``(N, n, m)``, contiguous in memory."""
        result = np.zeros((self.n, len(columns), len(self.t)))
        for i, column in enumerate(columns):
            result[joint - 1, i] = column
        return result.transpose(2, 0, 1)

    def rate(self, values: Array) -> Array:
        """Time derivative ``(N, …)`` by central differences; zero for a single sample."""
        if len(self.t) < 3:
            return np.zeros_like(values)
        return np.gradient(values, self.dt, axis=0)
