"""A motion above a path before the job, at its speeds and with the reversals that an unknown surface asks for."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.robots.robot import Robot
from planning.path.kinematics import InverseKinematics
from planning.path.reference import ReferencePath

CLEAR = 0.03
"""Distance from the reference that the tip keeps at least [m]."""
WAVES = (0.25, 0.1)
"""Lengths of the waves of the tip's height [m]."""
SLOPE = 0.1
"""Largest slope of each wave."""
LONGEST = 12.0
"""Time that the motion takes at most, unless joints are too slow for that [s]."""
SHARE = 0.6
"""Of the joints' largest speeds that the motion may use."""


def dry_run(robot: Robot, reference: ReferencePath, speed: float, q_start: Array) -> Array:
    """Joint angles ``(N, n)`` [rad] at the cycles: along the path and back, from rest to rest, without touching.

    s = S sin²(π t/T), whose largest speed is that of the job; slower ones are passed on the way. Each place is passed
    in both directions, which tells friction from weight.

    Args:
        robot: cycle time and limits.
        reference: the path.
        speed: of the job [m/s].
        q_start: joint angles near the path's start ``(n,)`` [rad].

    Raises:
        OutOfReachError: a place above the path cannot be reached.
    """
    kinematics = InverseKinematics(robot)
    way = min(reference.length, speed * LONGEST / np.pi)
    lasts = np.pi * way / speed
    steps = max(round(lasts / robot.t_ipo), 2)
    s = way * np.sin(np.pi * np.arange(steps + 1) / steps) ** 2
    frames = reference.frames(s)
    waves = [SLOPE * length / (2 * np.pi) * (1.0 - np.cos(2 * np.pi * s / length)) for length in WAVES]
    height = CLEAR + np.sum(waves, axis=0)
    places = frames.position + height[:, None] * frames.up
    q = kinematics.path([pin.SE3(R, p) for R, p in zip(reference.rotation(s), places, strict=True)], q_start)
    fastest = float(np.max(np.abs(np.diff(q, axis=0)) / (SHARE * robot.v_max * robot.t_ipo)))
    if fastest <= 1.0:
        return q
    slower = np.linspace(0.0, steps, int(np.ceil(fastest * steps)) + 1)
    return np.column_stack([np.interp(slower, np.arange(steps + 1), one) for one in q.T])
