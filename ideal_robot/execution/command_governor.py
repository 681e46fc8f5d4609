r"""Commands that keep every limit, whatever is asked for: position, speed, acceleration and jerk.

Between a feedforward, which may ask for anything, and the positional interface. A command that keeps the limits, and
from which the arm can still come to rest within them, passes unchanged; otherwise the nearest one is taken for which
that holds. In each cycle ``T``, with ``v`` and ``a`` of the commands' own differences,

.. math::
    |a' - a| \le j_{max} T, \quad |a'| \le a_{max}, \quad v' = v + a' T, \quad |v'| \le v_{max}, \quad p' = p + v' T ,

and the braking motion from ``(p', v', a')`` stays within ``p_min … p_max`` as well. Since braking on was possible in
the cycle before, there is always such a command.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from ideal_robot.arrays import Array, eased
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
        q: what is asked for; NaN asks for braking.
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
            # Within rounding of what was asked for it is what was asked for.
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
    """Whether a command that changed by ``step`` in the last cycle can be held from now on.

    Args:
        step, t_ipo: change of the command ``(n,)`` [rad], and the cycle [s].
        robot: its acceleration limits.
    """
    return bool(np.all(np.abs(step) <= ACCELERATION * robot.a_max * t_ipo**2))


class CommandGovernor:
    """Keeps the commands of one motion within an arm's limits.

    Args:
        robot: limits of position, speed and acceleration; where unknown (infinite) there is none.
        q: where the arm rests before the first command ``(n,)`` [rad, or m where a joint slides].
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
        # Within rounding beyond a limit an arm would refuse the command and stop at once.
        for limit, inward in ((low, 1.0), (high, -1.0)):
            finite = np.isfinite(limit)
            limit[finite] += inward * 3.0 * ROUNDING * (1.0 + np.abs(limit[finite]))
        self._last = np.tile(start, (3, 1))

    def allowed(self, q_c: Array) -> Array:
        """The command nearest to ``q_c (n,)`` that keeps every limit, and remembers it; NaN asks for braking."""
        command = governed(np.asarray(q_c, dtype=float), self._last, self._T, self._bounds)
        self.passed(command)
        return command

    def require_room(self, q_c: Array, *, start: float = 0.0) -> None:
        """Refuses a command ``q_c (n,)`` [rad] that keeps the limits but leaves no room to come to rest within them.

        Raises LimitError, whose message has the command's time ``start`` [s].
        """
        near = governed(np.asarray(q_c, dtype=float), self._last, self._T, self._bounds)
        off = np.abs(near - q_c) > UNRESOLVED * (1.0 + np.abs(q_c))
        if off.any():
            j = int(np.argmax(off))
            raise LimitError(j + 1, f"position at {start:.3f} s after which the arm can still be braked "
                             f"[{self._units[j]}]", float(q_c[j]), float(near[j]), "slow down before the limit")

    def passed(self, q_c: Array) -> None:
        """Remembers a command ``(n,)`` that was handed over as it is, having been checked elsewhere."""
        self._last[:2] = self._last[1:]
        self._last[2] = q_c


# Coming to rest on the planned path when it cannot go on: the path stays, only its time slows down.

def stopping_rows(planned: Array, T: float, speed: float, deceleration: float) -> Iterator[Array]:
    r"""Horizons ``(n_d, n)`` for the coming cycles that brake to rest on the path planned so far, without end.

    Time along the path runs at the rate :math:`\dot\sigma`, which falls from 1 to 0 on a smooth cubic within
    :math:`1.5\, v / a`, the time in which the largest deceleration is ``a``; shorter if the plan ends before.

    Args:
        planned: desired joint positions of the coming cycles ``(m, n)`` [rad], first the one due now.
        T: interpolation cycle [s].
        speed, deceleration: path speed now [m/s], and the largest deceleration while braking [m/s²].
    """
    m = len(planned)
    path = CubicSpline(np.arange(m), planned)
    # The rate's mean over the braking time is 1/2.
    length = min(max(1.5 * speed / deceleration / T, 1.0), 2.0 * (m - 1))

    def travelled(cycles: Array) -> Array:
        u = np.clip(cycles / length, 0.0, 1.0)
        # Integral of 1 - 3u² + 2u³.
        return length * (u - u**3 + 0.5 * u**4)

    k = 0
    while True:
        yield np.asarray(path(travelled(k + np.arange(m, dtype=float))))
        k += 1


_STEEPEST = 10.0 / math.sqrt(3.0)
"""Largest acceleration of a quintic from rest to rest, over a way of one in a time of one."""
_SHARE = 0.25
"""Of the joints' accelerations that moving away takes. On the simulated KR 6 the commands of ``contour``, whose
feedforward knows the gears, then have up to 0.8 of the limits."""


def moved_away(horizons: Iterator[Array], way: Array, a_max: Array, T: float) -> Iterator[Array]:
    """The same horizons ``(n_d, n)``, on which every joint is moved by a way in the end.

    It begins without a step of the acceleration and takes ``_SHARE`` of what the joints may have: the rest is for
    braking, and for what a feedforward adds to the command.

    Args:
        horizons: of the coming cycles, without end [rad].
        way, a_max: of each joint ``(n,)`` [rad], and what it may accelerate ``(n,)`` [rad/s²].
        T: interpolation cycle [s].
    """
    lasts = max(float(np.sqrt(np.max(_STEEPEST * np.abs(way) / (_SHARE * a_max)))), T)
    for k, rows in enumerate(horizons):
        u = np.minimum((k + 1 + np.arange(len(rows)))[:, None] * T / lasts, 1.0)
        yield rows + eased(u) * way


# The limits of an arm along a path of commands: position, velocity, acceleration.

def check_limits(q: Array, arm: Robot, t_ipo: float, *, start: float = 0.0) -> None:
    """Raises LimitError where positions, speeds or accelerations of a path are outside the arm's limits.

    Args:
        q, t_ipo: joint positions at the cycles ``(N, n)`` [rad], and the cycle [s].
        arm: the limits.
        start: time of the first row, for the message [s].
    """
    speed = np.diff(q, axis=0) / t_ipo
    # A linear interpolator's acceleration is what speed changes over a cycle; twice the limit is what a
    # controller's own monitoring lets pass before it trips.
    bend = np.diff(speed, axis=0) / t_ipo
    checks = (("position", "rad", q, arm.q_min, arm.q_max, "move the path"),
              ("velocity", "rad/s", speed, -arm.v_max, arm.v_max, "move slower"),
              ("acceleration", "rad/s²", bend, -2 * arm.a_max, 2 * arm.a_max, "move slower or round corners"))
    for quantity, unit, values, low, high, remedy in checks:
        if len(values) == 0:
            continue
        # NaN is within no limits.
        outside = np.argwhere(~((values >= low) & (values <= high)))
        if len(outside):
            row, joint = (int(index) for index in outside[0])
            value = float(values[row, joint])
            limit = float(high[joint] if value > high[joint] else low[joint])
            raise LimitError(joint + 1, f"{quantity} [{arm.units(unit)[joint]}] at {start + row * t_ipo:.3f} s", value,
                             limit, remedy)


def require_within_limits(q_d: Array, arm: Robot, *, start: float = 0.0, file: str | Path | None = None,
                          column: str = "q_d") -> None:
    """Refuses a user's path that leaves the arm's limits: raises InputError.

    Args:
        q_d: joint positions at the cycles ``(N, n)`` [rad].
        arm: limits and cycle.
        start: time of the first row, for the message [s].
        file, column: where the path comes from, and what its positions are called there.
    """
    try:
        check_limits(q_d, arm, arm.t_ipo, start=start)
    except LimitError as error:
        raise InputError(str(error), file=file, field=f"{column}_{error.joint}") from error
