"""Joint controllers other than the industrial cascade, and delay and smoothing of commands before them.

    impedance         τ = K_p (K_v (r - q) - q̇) + c(q, q̇) + g(q)             the maker's bodies, no integrator
    pid               τ = K_p (K_v (r - q) + ṙ - q̇ + K_v/T_n ∫ (r - q) dt)    nothing known of the arm
    inverse_dynamics  τ = 1.1 (M(q) (r̈ + 1.4 K_v (ṙ - q̇) + K_v² (r - q)) + c(q, q̇) + g(q))     bodies 10 % too heavy

K_v, K_p and T_n are the world's position gain, velocity gain and integral time. ``r`` is the command as the cascade's
position loop would see it: interpolated, low-passed, at its cycle; rates of it are smoothed over a few cycles.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.robots.robot import Robot
from sim.arm import kernel
from sim.arm.world import World

_RATE = 0.01
"""Time constant that rates of commands are smoothed with [s]."""
_HEAVY = 1.1
"""Bodies of the inverse dynamics over those of the data sheet."""


class TorqueController:
    """A controller of all joints that commands torques at the cycle of the velocity loop.

    Args:
        robot: the arm by its data sheet.
        world: says which controller, with its gains.
        p: parameter block ``(PARAMETERS, n)``.
    """

    def __init__(self, robot: Robot, world: World, p: Array) -> None:
        self._model = robot.pinocchio.copy()
        self._model.armature = p[kernel.P_ROTOR].copy()
        self._data = self._model.createData()
        self._cycle, self._every = world.t_velocity, max(1, round(world.t_position / world.t_velocity))
        self._k_v, self._k_p = p[kernel.C_KV].copy(), p[kernel.C_KP].copy()
        self._k_i = self._k_v / world.per_joint("integral_time", robot.n)
        self._torque: Callable[[Array, Array, Array], Array] = getattr(self, f"_{world.controller}")

    @staticmethod
    def of(robot: Robot, world: World, p: Array) -> TorqueController | None:
        """The controller that a world sets; None for the cascade, which is compiled.

        Args:
            robot, world, p: see the class.
        """
        if world.controller == "cascade":
            return None
        p[kernel.C_TORQUE] = 1.0
        return TorqueController(robot, world, p)

    def reset(self, q: Array, holding: Array) -> None:
        """Puts the controller to rest at motor angles ``q (n,)`` [rad], ``holding (n,)`` the arm's weight [N m]."""
        self._r, self._rate, self._bend = q.copy(), np.zeros_like(q), np.zeros_like(q)
        self._integral = holding / self._k_p
        self._ticks = 0

    def ask(self, x: Array) -> None:
        """Writes the commanded torques into the state block ``x (STATES, n)``."""
        r = x[kernel.X_LOW2]
        if self._ticks % self._every == 0:
            step, before = self._every * self._cycle, self._rate
            share = 1.0 - np.exp(-step / _RATE)
            self._rate = before + share * ((r - self._r) / step - before)
            self._bend = self._bend + share * ((self._rate - before) / step - self._bend)
            self._r = r.copy()
        self._ticks += 1
        x[kernel.X_ASKED] = self._torque(r - x[kernel.X_ENCODER], x[kernel.X_ENCODER], x[kernel.X_VELOCITY])

    def _impedance(self, e: Array, q: Array, v: Array) -> Array:
        known = pin.nonLinearEffects(self._model, self._data, q.copy(), v.copy())
        return np.asarray(self._k_p * (self._k_v * e - v) + known)

    def _pid(self, e: Array, q: Array, v: Array) -> Array:
        self._integral = self._integral + self._cycle * self._k_i * e
        return np.asarray(self._k_p * (self._k_v * e + self._rate - v + self._integral))

    def _inverse_dynamics(self, e: Array, q: Array, v: Array) -> Array:
        wanted = self._bend + 1.4 * self._k_v * (self._rate - v) + self._k_v**2 * e
        return np.asarray(_HEAVY * pin.rnea(self._model, self._data, q.copy(), v.copy(), wanted))


class CommandPath:
    """The path of commands before the controller: delay, and smoothing with lines from cycle to cycle.

    Args:
        world: says how late they are, and the smoothing with its time.
    """

    def __init__(self, world: World) -> None:
        self._late, self._time = world.command_late / world.t_ipo, world.command_time / world.t_ipo
        self._smoothing = world.command_smoothing

    @staticmethod
    def of(world: World) -> CommandPath | None:
        """The path of a world; None where commands act as they are."""
        return CommandPath(world) if world.command_late > 0.0 or world.command_time > 0.0 else None

    def reset(self, q: Array) -> None:
        """Puts the command path to rest at ``q (n,)`` [rad]."""
        kept = int(np.ceil(self._late)) + int(np.ceil(self._time)) + 2
        self._given = deque([q.copy()] * kept, maxlen=kept)
        self._stages = [q.copy(), q.copy()]

    def next(self, q_c: Array) -> Array:
        """The commands at the end of this cycle ``(n,)`` [rad] behind delay and smoothing, given the newest one."""
        self._given.append(q_c.copy())
        if self._smoothing == "moving_average":
            return self._mean()
        r = self._at(self._late)
        if self._time > 0.0:
            # Exact for lines between cycles: x' = (u - x)/T with u from the last to the newest.
            u = [self._at(self._late + 1.0), r]
            stages, time = (1, self._time) if self._smoothing == "lag" else (2, 0.5 * self._time)
            for k in range(stages):
                slope = u[1] - u[0]
                after = u[1] - time * slope + (self._stages[k] - u[0] + time * slope) * np.exp(-1.0 / time)
                u, self._stages[k] = [self._stages[k], after], after
            r = u[1]
        return r

    def _at(self, cycles: float) -> Array:
        """The commands ``cycles`` ago, linear between them ``(n,)``."""
        whole = int(cycles)
        part = cycles - whole
        newer = self._given[-1 - whole]
        return newer if part == 0.0 else np.asarray((1.0 - part) * newer + part * self._given[-2 - whole])

    def _mean(self) -> Array:
        """The mean over the last commands, on the lines between them ``(n,)``."""
        ends = self._late + np.linspace(0.0, self._time, _POINTS + 1)
        values = np.array([self._at(float(cycles)) for cycles in ends])
        return np.asarray((0.5 * (values[0] + values[-1]) + values[1:-1].sum(axis=0)) / _POINTS)


_POINTS = 24
"""Of the trapezoidal rule of a moving average."""
