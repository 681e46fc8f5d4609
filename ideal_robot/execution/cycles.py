"""A path of whatever sampling at the interpolation cycle, with rest before and behind."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import make_interp_spline

from ideal_robot.arrays import Array, held
from ideal_robot.errors import InputError
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.plausible import checked_time
from ideal_robot.signals.units import require_joint_units

REST_AFTER = 0.3
"""Rest added behind the path [s]."""


def path_at_cycles(t: Array, q_d: Array, robot: Robot, *, rest: float, file: str | None = None, column: str = "q_d"
                   ) -> tuple[Array, Array]:
    """Times ``(M,)`` [s] and positions ``(M, n)`` [rad] at the cycles, rest included.

    Args:
        t: times of the path ``(N,)`` [s].
        q_d: joint positions ``(N, n)`` [rad, or m where a joint slides].
        robot: cycle, number of joints, limits.
        rest: added before the path [s]; ``REST_AFTER`` is added behind.
        file: where the path comes from, for messages.
        column: what its positions are called there.

    Raises:
        InputError: shapes that do not fit, too few samples, times that do not rise, values that are not finite, other
            units than seconds, radians and metres.
    """
    t, q_d = np.asarray(t, dtype=float), np.asarray(q_d, dtype=float)
    if not 0.0 <= rest <= 60.0:
        raise InputError("expected 0 to 60 seconds", field="rest", value=rest)
    if q_d.ndim != 2 or q_d.shape[1] != robot.n:
        raise InputError(f"expected joint positions (N, {robot.n}), one column a joint of {robot.name}", file=file,
                         field=column, value=q_d.shape)
    if t.shape != (len(q_d),):
        raise InputError(f"expected one time for each of the {len(q_d)} rows of the path", file=file, field="t",
                         value=t.shape)
    if len(t) < 6 or not np.all(np.diff(t) > 0):
        raise InputError("needs at least six samples with rising times", file=file, field="t", value=len(t))
    for i, values in enumerate(q_d.T):
        if not np.isfinite(values).all():
            raise InputError("holds values that are not finite", file=file, field=f"{column}_{i + 1}")
    checked_time(t, file or "path")
    require_joint_units(q_d, robot, file=file, column=column)
    # The last cycle is the one in which the path's end is reached, wherever in it that lies.
    grid = np.minimum(np.arange(t[0], t[-1] + robot.t_ipo - 1e-9, robot.t_ipo), t[-1])
    if len(grid) == len(t) and np.allclose(grid, t, atol=1e-6):
        samples = q_d
    else:
        # Other sampling than the cycle: a spline through the samples, straight on from the last one.
        samples = np.asarray(make_interp_spline(t, q_d, k=min(5, len(t) - 1))(grid))
    first, last = round(rest / robot.t_ipo), round(REST_AFTER / robot.t_ipo)
    whole = held(samples, before=first, after=last)
    return np.asarray(robot.t_ipo * np.arange(float(len(whole)))), whole
