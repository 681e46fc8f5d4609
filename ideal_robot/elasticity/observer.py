r"""Estimates arm angles from motor angles, through the elastic gears ([L] 2.1, 3.3).

Encoders sit on the motors, sensors on the arm. Between them are springs: the measured motor angles drive a model of the
arm behind its gears,

.. math:: M(q_a)\,\ddot q_a + n(q_a, \dot q_a) = k\,(q - q_a) + d\,(\dot q - \dot q_a) + \tau_{ext}

whose state is the arm. The gears' own damping lets errors of the start die out; at rest :math:`q_a = q - \tau/k`
([J] (1)). Without a stiffness in the model the documented fallback is :math:`q_a \approx q`, or
:math:`q_a \approx q_d` for a well-adapted ideal robot ([L] 3.3).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.dynamics.newton_euler import chain_of, inverse_dynamics
from ideal_robot.estimate.cholesky import factor, solve
from ideal_robot.jit import jit
from ideal_robot.model.arm_with_effects import chain_with, changes_of, dynamics_with, side_of_gap, stiffness_with
from ideal_robot.model.model import Model
from ideal_robot.robots.joints import mass_matrix
from ideal_robot.robots.robot import spread_postures
from ideal_robot.tolerances import SUBSTEP

FOLLOWED = 2.0
"""Largest h² k + 2 h d over the inertia of the arm that a substep h follows; beyond 4 the leapfrog diverges."""
LEAST_DAMPING = 0.04
"""Damping ratio that is assumed where none was identified."""


@dataclass(frozen=True)
class ObserverState:
    """State of the observer: arm angles and velocities ``(n,)``, motor angles now and a cycle ago, motor velocity."""

    q_a: Array
    v_a: Array
    q: Array
    before: Array
    v: Array


class ArmObserver:
    """Observer for the arm angles, from motor angles that come every ``T`` [s].

    Gears of unknown or infinite stiffness in the model are taken as rigid, and so do those too stiff for its time step.
    """

    def __init__(self, model: Model, T: float) -> None:
        changes = changes_of(model.effects)
        self._dynamics = dynamics_with(model.dynamics, changes)
        # Rotors turn with the motors, whose motion is measured: only the links move here.
        self._dynamics.armature = np.zeros(model.n)
        self._data = self._dynamics.createData()
        self._T, self._n = T, model.n
        known = np.full(model.n, np.inf) if model.gears is None else model.gears.rigid_if_unknown
        stiffness = stiffness_with(known, changes)
        self._elastic = np.isfinite(stiffness)
        self._k = np.where(self._elastic, stiffness, 0.0)
        identified = np.zeros(model.n) if model.gears is None else model.gears.known_damping
        inertia = np.diag(mass_matrix(self._dynamics, self._data, pin.neutral(self._dynamics)))
        damping = np.maximum(identified, 2 * LEAST_DAMPING * np.sqrt(self._k * inertia)) * self._elastic
        steps = max(1, round(T / SUBSTEP))
        self._leave_followed((T / steps) ** 2 * self._k + 2 * T / steps * damping)
        self._rigid = not self._elastic.any()
        self._gears = _Gears(np.where(self._elastic, self._k, 0.0), damping * self._elastic, self._elastic, steps)

    def _leave_followed(self, pull: Array) -> None:
        """Makes gears rigid until the substep h follows the others' oscillation anywhere; ``pull`` is h² k + 2 h d."""
        for q in spread_postures(self._dynamics.lowerPositionLimit, self._dynamics.upperPositionLimit):
            upper = mass_matrix(self._dynamics, self._data, q)
            while len(gears := np.flatnonzero(self._elastic)):
                root = np.sqrt(pull[gears])
                # Rigid joints follow the motors; elastic ones move with their own block of the mass matrix.
                values, ways = np.linalg.eigh(upper[np.ix_(gears, gears)] / np.outer(root, root), UPLO="U")
                if values[0] * FOLLOWED >= 1.0:
                    break
                self._elastic[gears[np.argmax(np.abs(ways[:, 0]))]] = False

    def init(self, q: Array, tau_ext: Array | None = None) -> ObserverState:
        """State at rest with motors at ``q (n,)`` [rad] under an external joint torque ``(n,)`` [N m]."""
        q_a = np.array(q, dtype=float)
        external = np.zeros(self._n) if tau_ext is None else tau_ext
        for _ in range(20):
            load = pin.computeGeneralizedGravity(self._dynamics, self._data, q_a) - external
            q_a = q - np.where(self._elastic, load / np.where(self._elastic, self._k, 1.0), 0.0)
        q = np.array(q, dtype=float)
        return ObserverState(q_a, np.zeros(self._n), q, q, np.zeros(self._n))

    def step(self, state: ObserverState, q: Array, tau_ext: Array | None = None) -> ObserverState:
        """Advances by one cycle: motor angles at its end, external joint torque during it.

        Args:
            state, q: state before the cycle, and motor angles at its end ``(n,)`` [rad].
            tau_ext: joint torque of external forces during it ``(n,)`` [N m]; None for none.
        """
        q = np.array(q, dtype=float)
        if self._rigid:
            return ObserverState(q, (q - state.q) / self._T, q, state.q, (q - state.q) / self._T)
        # Velocity at the end of the cycle from the parabola through the last three motor angles.
        v = (1.5 * q - 2.0 * state.q + 0.5 * state.before) / self._T
        upper = mass_matrix(self._dynamics, self._data, state.q_a)
        load = pin.nonLinearEffects(self._dynamics, self._data, state.q_a, state.v_a)
        if tau_ext is not None:
            load = load - tau_ext
        motors = _Motors(state.q, q, state.v, v)
        q_a, v_a = _substeps(state.q_a, state.v_a, motors, upper, load, self._gears, self._T)
        return ObserverState(q_a, v_a, q, state.q, v)


class _Motors(NamedTuple):
    """Angles and velocities of the motors at both ends of a cycle, ``(n,)`` each."""

    q0: Array
    q1: Array
    v0: Array
    v1: Array


class _Gears(NamedTuple):
    """Stiffness, damping and which gears give, ``(n,)`` each (0 where rigid); and substeps of a cycle."""

    k: Array
    d: Array
    elastic: Array
    steps: int


@jit()
def _substeps(q_a: Array, v_a: Array, motors: _Motors, upper: Array, load: Array, gears: _Gears, T: float
              ) -> tuple[Array, Array]:
    """Leapfrog with the mass matrix of the cycle's beginning, of which the upper half is given; motors on a cubic.

    A rigid joint follows its motor: it leaves the equations, and its mean acceleration loads the elastic ones.
    """
    x, v = q_a.copy(), v_a.copy()
    q0, q1, v0, v1 = motors.q0, motors.q1, motors.v0, motors.v1
    k, d, elastic, steps = gears.k, gears.d, gears.elastic, gears.steps
    h = T / steps
    n = len(x)
    mass, load = upper.copy(), load.copy()
    for i in range(n):
        for j in range(i):
            mass[i, j] = upper[j, i]
    for i in range(n):
        if not elastic[i]:
            for j in range(n):
                load[j] += mass[j, i] * (v1[i] - v0[i]) / T
                mass[i, j] = mass[j, i] = 0.0
            mass[i, i], load[i] = 1.0, 0.0
    acceleration = np.zeros(n)
    factor(mass)
    for step in range(steps):
        # Leapfrog: positions at the ends of steps, velocities half a step earlier.
        u = step / steps
        for j in range(n):
            slope = (q1[j] - q0[j])
            a, b = v0[j] * T - slope, -v1[j] * T + slope
            q_m = (1 - u) * q0[j] + u * q1[j] + u * (1 - u) * ((1 - u) * a + u * b)
            v_m = (slope + (1 - 2 * u) * (a * (1 - u) + b * u) + u * (1 - u) * (b - a)) / T
            acceleration[j] = k[j] * (q_m - x[j]) + d[j] * (v_m - v[j]) - load[j]
        solve(mass, acceleration)
        for j in range(n):
            v[j] += h * acceleration[j]
            x[j] += h * v[j]
    for j in range(n):
        if not elastic[j]:
            x[j], v[j] = q1[j], v1[j]
    return x, v


class GearDeflection:
    r"""Deflection :math:`q - q_a = \tau_g / k` with the gear torque of the desired path, [J] (1).

    Sensors are mounted on the arm, encoders on the motors: a sensor value belongs to :math:`\hat q_a = q - \tau_g/k`.
    The torque comes from the desired path, not from the noisy motor current. The model's effects are used: payload,
    stiffness, transmission error and backlash.

    Args:
        model: identified model; without a stiffness in it the deflection is zero.
        T: cycle of the desired positions [s].
    """

    def __init__(self, model: Model, T: float) -> None:
        self._T = T
        changes = changes_of(model.effects)
        self._chain = chain_with(chain_of(model.dynamics), changes)
        known = np.full(model.n, np.inf) if model.gears is None else model.gears.rigid_if_unknown
        stiffness = stiffness_with(known, changes)
        self._compliance = np.where(np.isfinite(stiffness), 1.0 / stiffness, 0.0)
        self._bends = bool(self._compliance.any())
        self._gears = [(effect.joint - 1, change) for effect, change in changes
                       if change.uneven is not None or change.half_gap]

    def at(self, q_d: Array) -> Array:
        """Deflection ``(n,)`` [rad] one cycle after row 0 of the horizon ``q_d (n_d ≥ 3, n)`` [rad]."""
        return np.asarray(self.along(q_d[:3])[1]) if len(q_d) > 2 else np.zeros(q_d.shape[1])

    def along(self, q_d: Array) -> Array:
        """Deflections ``(K, n)`` [rad] on a whole path ``(K, n)`` [rad]; zero at both ends."""
        deflection = np.zeros(q_d.shape)
        if len(q_d) < 3 or not (self._bends or self._gears):
            return deflection
        q, inside = q_d[1:-1], deflection[1:-1]
        v = (q_d[2:] - q_d[:-2]) / (2.0 * self._T)
        a = (q_d[2:] - 2.0 * q + q_d[:-2]) / self._T**2
        load = inverse_dynamics(self._chain, q, v, a)
        inside[:] = self._compliance * load
        for j, change in self._gears:
            if change.uneven is not None:
                order, cosine, sine = change.uneven
                inside[:, j] -= cosine * np.cos(order * q[:, j]) + sine * np.sin(order * q[:, j])
            if change.half_gap:
                inside[:, j] += change.half_gap * side_of_gap(load[:, j], v[:, j], np.array(change.gap_load))
        return deflection
