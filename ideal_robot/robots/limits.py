"""What any arm behind the positional interface refuses to be commanded."""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError, LimitError
from ideal_robot.robots.robot import Robot


def checked_command(robot: Robot, q_c: Array, before: Array, t_ipo: float) -> Array:
    """A command that the controller accepts, as a new array ``(n,)``.

    Args:
        robot: whose limits count.
        q_c: command ``(n,)`` [rad].
        before: command of the cycle before ``(n,)`` [rad].
        t_ipo: interpolation cycle [s].

    Raises:
        InputError: wrong size or not finite.
        LimitError: outside the joint limits, or more than twice the velocity limit away from the command before.
    """
    q = np.array(q_c, dtype=float)
    if q.shape != (robot.n,) or not np.isfinite(q).all():
        raise InputError(f"a command must be {robot.n} finite joint angles", field="q_c", value=q.tolist())
    outside = (q < robot.q_min) | (q > robot.q_max)
    if outside.any():
        j = int(np.argmax(outside))
        limit = robot.q_min[j] if q[j] < robot.q_min[j] else robot.q_max[j]
        raise LimitError(j + 1, "commanded angle [rad]", q[j], limit, "command angles within the joint limits")
    speed = np.abs(q - before) / t_ipo
    fast = speed > 2.0 * robot.v_max
    if fast.any():
        j = int(np.argmax(fast))
        raise LimitError(j + 1, "commanded velocity [rad/s]", speed[j], 2.0 * robot.v_max[j],
                         "hand over a path that starts where the arm is and keeps the velocity limits")
    return q
