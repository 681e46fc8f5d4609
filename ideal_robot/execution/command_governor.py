r"""Makes commands keep every limit, whatever the input: position, speed, acceleration and jerk.

It stands between a feedforward, whose output is arbitrary, and the positional interface. A command that keeps the
limits, and from which the arm can still come to rest within them, passes unchanged; otherwise the nearest such command
is used. In each cycle ``T``, with ``v`` and ``a`` of the commands' own differences,

.. math::
    |a' - a| \le j_{max} T, \quad |a'| \le a_{max}, \quad v' = v + a' T, \quad |v'| \le v_{max}, \quad p' = p + v' T ,

and the braking motion from ``(p', v', a')`` stays within ``p_min … p_max`` as well. As the braking of the cycle before
can be continued, there is always such a command.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError, LimitError
from ideal_robot.jit import jit
from ideal_robot.robots.robot import Robot
from ideal_robot.tolerances import BRAKING_CYCLES, HALVINGS, ROUNDING, UNRESOLVED

ACCELERATION = 2.0
"""Acceleration limit of commands, as a multiple of the arm's: a linear interpolator's acceleration is what the speed
changes over a cycle, and controllers trip at about twice the limit."""


@jit()
def _braking(v: float, a: float, T: float, A: float, J: float) -> float:
    """Acceleration of the next cycle of a braking motion."""
    most = min(A, math.sqrt(2.0 * J * abs(v)))
    wanted = min(max(-v / T, -most), most)
    return min(max(wanted, a - J * T), a + J * T)


class Bounds(NamedTuple):
    """Limits of position, speed, acceleration and jerk, ``(n,)`` each."""

    low: Array
    high: Array
    V: Array
    A: Array
    J: Array


@jit()
def _can_rest(p: float, v: float, a: float, T: float, bounds: Bounds, j: int) -> bool:
    """Whether the braking motion of joint ``j`` from here keeps all limits and ends."""
    low, high, V, A, J = bounds.low[j], bounds.high[j], bounds.V[j], bounds.A[j], bounds.J[j]
    room = ROUNDING * (1.0 + abs(p))
    for _ in range(BRAKING_CYCLES):
        if p < low - room or p > high + room or abs(v) > V * (1.0 + ROUNDING):
            return False
        if abs(v) * T < 1e-15 and abs(a) * T * T < 1e-15:
            return True
        a = _braking(v, a, T, A, J)
        v += a * T
        p += v * T
    return False


@jit()
def governed(q: Array, last: Array, T: float, bounds: Bounds) -> Array:
    """The commands of the next cycle ``(n,)``: the nearest to ``q (n,)`` that keep every limit.

    Args:
        q: the requested commands; NaN requests braking.
        last: commands of the last three cycles ``(3, n)``, oldest first.
        T: cycle.
        bounds: the limits.
    """
    V, A, J = bounds.V, bounds.A, bounds.J
    result = np.empty(q.size)
    for j in range(q.size):
        p, v = last[2, j], (last[2, j] - last[1, j]) / T
        a = (v - (last[1, j] - last[0, j]) / T) / T
        brake = min(max(_braking(v, a, T, A[j], J[j]), -A[j]), A[j])
        if not math.isfinite(q[j]):
            result[j] = p + (v + brake * T) * T
            continue
        wanted = ((q[j] - p) / T - v) / T
        wanted = min(max(wanted, a - J[j] * T, -A[j], (-V[j] - v) / T), a + J[j] * T, A[j], (V[j] - v) / T)
        good, bad = brake, wanted
        speed = v + wanted * T
        if _can_rest(p + speed * T, speed, wanted, T, bounds, j):
            # Within rounding the requested command itself is returned.
            position = p + speed * T
            result[j] = q[j] if abs(position - q[j]) <= ROUNDING * (1.0 + abs(q[j])) * 1e-3 else position
            continue
        for _ in range(HALVINGS):
            middle = 0.5 * (good + bad)
            speed = v + middle * T
            if _can_rest(p + speed * T, speed, middle, T, bounds, j):
                good = middle
            else:
                bad = middle
        result[j] = p + (v + good * T) * T
    return result


def stops_at_once(step: Array, robot: Robot, t_ipo: float) -> bool:
    """Whether a command that changed by ``step`` in the last cycle can stay constant from now on.

    Args:
        step, t_ipo: change of the command ``(n,)`` [rad], and the cycle [s].
        robot: its acceleration limits.
    """
    return bool(np.all(np.abs(step) <= ACCELERATION * robot.a_max * t_ipo**2))


class CommandGovernor:
    """Keeps the commands of one motion within an arm's limits.

    Args:
        robot: limits of position, speed and acceleration; where unknown (infinite) there is none.
        q: joint positions at rest before the first command ``(n,)`` [rad, or m where a joint slides].
        t_ipo: interpolation cycle [s]; the robot's if None.
        j_max: jerk limit ``(n,)`` [rad/s³, m/s³]; by default what lets the acceleration change from one limit to the
            other in one cycle.

    Raises:
        InputError: a start outside the position limits.
    """

    def __init__(self, robot: Robot, q: Array, *, t_ipo: float | None = None, j_max: Array | None = None) -> None:
        self._T, self._units = robot.t_ipo if t_ipo is None else t_ipo, robot.units("rad")
        low, high = np.array(robot.q_min, dtype=float), np.array(robot.q_max, dtype=float)
        V, A = np.array(robot.v_max, dtype=float), ACCELERATION * np.array(robot.a_max, dtype=float)
        jerk = 2.0 * A / self._T if j_max is None else np.asarray(j_max, dtype=float)
        self._bounds = Bounds(low, high, V, A, np.broadcast_to(jerk, (robot.n,)).copy())
        start = np.array(q, dtype=float)
        if start.shape != (robot.n,) or not np.all((start >= low) & (start <= high)):
            raise InputError("expected a start within the joint limits", field="q", value=start.tolist())
        # A command beyond a limit by rounding would stop an arm at once, so it is moved inwards.
        for limit, inward in ((low, 1.0), (high, -1.0)):
            finite = np.isfinite(limit)
            limit[finite] += inward * 3.0 * ROUNDING * (1.0 + np.abs(limit[finite]))
        self._last = np.tile(start, (3, 1))

    def allowed(self, q_c: Array) -> Array:
        """The command nearest to ``q_c (n,)`` that keeps every limit; it is stored. NaN requests braking."""
        command = governed(np.asarray(q_c, dtype=float), self._last, self._T, self._bounds)
        self.passed(command)
        return command

    def require_room(self, q_c: Array, *, start: float = 0.0) -> None:
        """Raises LimitError for a command ``q_c (n,)`` [rad] from which the arm cannot come to rest within the limits.

        The message has the command's time ``start`` [s].
        """
        near = governed(np.asarray(q_c, dtype=float), self._last, self._T, self._bounds)
        off = np.abs(near - q_c) > UNRESOLVED * (1.0 + np.abs(q_c))
        if off.any():
            j = int(np.argmax(off))
            raise LimitError(j + 1, f"position at {start:.3f} s after which the arm can still be braked "
                             f"[{self._units[j]}]", float(q_c[j]), float(near[j]), "slow down before the limit")

    def passed(self, q_c: Array) -> None:
        """Stores a command ``(n,)`` that was sent unchanged, having been checked elsewhere."""
        self._last[:2] = self._last[1:]
        self._last[2] = q_c
