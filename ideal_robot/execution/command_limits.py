"""The limits of an arm along a path of commands: position, velocity, acceleration."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError, LimitError
from ideal_robot.robots.robot import Robot


def check_limits(q: Array, arm: Robot, t_ipo: float, *, start: float = 0.0) -> None:
    """Raises LimitError where positions, speeds or accelerations of a path are outside the arm's limits.

    Args:
        q, t_ipo: joint positions at the cycles ``(N, n)`` [rad], and the cycle [s].
        arm: the limits.
        start: time of the first row, for the message [s].
    """
    speed = np.diff(q, axis=0) / t_ipo
    # A linear interpolator's acceleration is the change of speed over a cycle; controllers typically tolerate twice the
    # limit before their monitoring trips.
    bend = np.diff(speed, axis=0) / t_ipo
    checks = (("position", "rad", q, arm.q_min, arm.q_max, "move the path"),
              ("velocity", "rad/s", speed, -arm.v_max, arm.v_max, "move slower"),
              ("acceleration", "rad/s²", bend, -2 * arm.a_max, 2 * arm.a_max, "move slower or round corners"))
    for quantity, unit, values, low, high, remedy in checks:
        if len(values) == 0:
            continue
        # NaN is within no limits.
        within = (values >= low) & (values <= high)
        if not within.all():
            row, joint = (int(index) for index in np.argwhere(~within)[0])
            value = float(values[row, joint])
            limit = float(high[joint] if value > high[joint] else low[joint])
            raise LimitError(joint + 1, f"{quantity} [{arm.units(unit)[joint]}] at {start + row * t_ipo:.3f} s", value,
                             limit, remedy)


def require_within_limits(q_d: Array, arm: Robot, *, start: float = 0.0, file: str | Path | None = None,
                          column: str = "q_d") -> None:
    """Raises InputError for a user's path that leaves the arm's limits.

    Args:
        q_d: joint positions at the cycles ``(N, n)`` [rad].
        arm: limits and cycle.
        start: time of the first row, for the message [s].
        file, column: source of the path, and the name of its positions there.
    """
    try:
        check_limits(q_d, arm, arm.t_ipo, start=start)
    except LimitError as error:
        raise InputError(str(error), file=file, field=f"{column}_{error.joint}") from error
