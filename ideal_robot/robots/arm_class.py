"""Typical masses and speeds of arms by their reach, with which URDFs are compared."""

from __future__ import annotations

import math

import numpy as np

REACH = (0.30, 0.50, 0.90, 1.30, 1.80, 2.60, 3.30)
"""Of the arms of a class, from the second joint to the flange stretched out [m]."""
MASS = (0.5, 8.0, 30.0, 80.0, 250.0, 900.0, 1500.0)
"""Of the moving links together [kg]."""
BASE_SPEED = (4.0, 3.1, 3.1, 2.6, 2.6, 2.1, 1.8)
"""Of the first joints [rad/s] …"""
WRIST_SPEED = (5.0, 5.2, 5.2, 5.2, 5.2, 3.8, 3.1)
"""… and of the last three. The rows are rounded between the data sheets of arms of about that reach: desktop servo arms
(0.3 m), UR3e (0.5 m), UR5e, LBR iiwa 14, Panda, KR 6 R900 (0.9 m), UR10e, KR 10 R1420 (1.3 m), KR 16, IRB 2600 (1.8 m),
KR 120 R2500, IRB 6640 (2.6 m), KR 210 R3100 (3.3 m); single arms differ from them by a factor of about three in mass
and two in speed."""
SLIDING_SPEED = 1.0
"""Of joints that slide [m/s]."""


def class_of(values: tuple[float, ...], size: float) -> float:
    """A row of the table at a reach [m], interpolated logarithmically; constant beyond its ends."""
    return float(np.exp(np.interp(math.log(max(size, 1e-6)), np.log(REACH), np.log(values))))
