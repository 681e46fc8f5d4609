"""On which side of its play a gear lies."""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array

_SLOW = 5e-3
"""Where the direction of motion decides, the side changes about this speed [rad/s]."""


def side_of_gap(load: Array, qd: Array, gap_load: Array) -> Array:
    """Side of the play on which the motor pushes the arm ``(…, n)``, -1 … 1: by load, or by direction of motion.

    Args:
        load: torque at the gear outputs ``(…, n)`` [N m].
        qd: arm velocities ``(…, n)`` [rad/s].
        gap_load: load over which the play is crossed ``(n,)`` [N m]; 0 where the direction of motion decides.
    """
    width = np.where(np.asarray(gap_load) > 0.0, gap_load, 1.0)
    return np.asarray(np.where(np.asarray(gap_load) > 0.0, np.tanh(load / width), np.tanh(qd / _SLOW)))
