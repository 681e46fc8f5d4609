"""Values in other units than this program's, where that can be told: milliseconds, degrees, millimetres."""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.robots.robot import Robot

_SLOWEST = 0.5
"""Samples further apart than this are of no use for an arm, so they are not in seconds [s]."""
_FARTHEST = 30.0
"""No arm of ours reaches further [m]."""
_LEAVING = 1.05
"""Share of a joint limit beyond which a position cannot be one."""


def require_seconds(t: Array, *, file: str | None = None) -> None:
    """Refuses times that rise too fast to be seconds.

    Args:
        t: times ``(N,)`` [s].
        file: where they come from.

    Raises:
        InputError: they look like milliseconds, microseconds or nanoseconds.
    """
    step = float(np.median(np.abs(np.diff(t)))) if len(t) > 1 else 0.0
    if not step > _SLOWEST:
        return
    factor, unit = next((pair for pair in ((1e3, "milliseconds"), (1e6, "microseconds"))
                         if step / pair[0] <= _SLOWEST), (1e9, "nanoseconds"))
    raise InputError(f"samples are {step:.4g} s apart; that looks like {unit}, seconds are expected: divide t by "
                     f"{factor:.0e}", file=file, field="t", value=step)


def require_joint_units(q: Array, robot: Robot, *, file: str | None = None, column: str = "q") -> None:
    """Refuses positions that leave the joint limits by far: degrees for radians, millimetres for metres.

    Args:
        q: joint positions ``(N, n)`` [rad, or m where a joint slides].
        robot: limits.
        file: where they come from.
        column: their name without the joint.

    Raises:
        InputError: a joint leaves its limits.
    """
    largest = np.max(np.abs(q), axis=0)
    span = np.maximum(np.abs(robot.q_min), np.abs(robot.q_max))
    beyond = largest / np.where(np.isfinite(span) & (span > 0), span, np.inf)
    turning = ~robot.prismatic
    for j in np.flatnonzero(beyond > _LEAVING):
        if robot.prismatic[j]:
            unit, guess = "m", ("they look like millimetres, metres are expected: divide by 1000"
                                if 1e-3 * largest[j] <= _LEAVING * span[j] else "wrong robot, or not in metres?")
        else:
            in_limits = np.all(np.radians(largest)[turning] <= _LEAVING * span[turning])
            unit, guess = "rad", ("they look like degrees, radians are expected"
                                  if in_limits and np.any(beyond[turning] > 3.0) else "wrong robot, or not in radians?")
        raise InputError(f"positions up to {largest[j]:.4g} leave the joint limit of {span[j]:.4g} {unit}; {guess}",
                         file=file, field=f"{column}_{j + 1}", value=round(float(largest[j]), 4))


def require_metres(position: Array, *, file: str | None = None, column: str = "x") -> None:
    """Refuses a TCP position that is too far away to be in metres.

    Args:
        position: one coordinate ``(N,)`` [m]; NaN where it was not measured.
        file: where it comes from.
        column: its name.

    Raises:
        InputError: it looks like millimetres.
    """
    farthest = float(np.max(np.abs(position), initial=0.0, where=np.isfinite(position)))
    if farthest > _FARTHEST:
        raise InputError("that far away looks like millimetres, metres are expected: divide by 1000", file=file,
                         field=column, value=round(farthest, 3))
