"""An arm behind another interpolation cycle, and how soon its loop answers."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ideal_robot.errors import InputError
from ideal_robot.loop.impulse_response import LinearLoop
from ideal_robot.loop.loop_model import LoopModel
from ideal_robot.robots.robot import Robot

_ANSWER_MAX = 0.4
"""Time after which a loop has answered a command [s]."""


def at_cycle(arm: Robot, cycle: float) -> Robot:
    """The arm behind another interpolation cycle [s]; the inner cycles are shortened until they fit into it.

    Raises:
        InputError: no cycle that a controller has.
    """
    if not (1e-3 <= cycle <= 0.1 and math.isclose(1e3 * cycle, round(1e3 * cycle))):
        raise InputError("expected whole milliseconds from 0.001 to 0.1 s", field="--cycle", value=cycle)
    grid = 1e-6
    position = math.gcd(round(cycle / grid), round(arm.t_position / grid))
    velocity = math.gcd(position, round(arm.t_velocity / grid))
    return replace(arm, t_ipo=cycle, t_position=grid * position, t_velocity=grid * velocity)


def answers_within(loop: LoopModel, arm: Robot) -> float:
    """Time in which the identified loop answers a command to 97 %, and half of it more [s]."""
    response = LinearLoop.of(loop, arm.home, length=math.ceil(_ANSWER_MAX / arm.t_ipo))
    open_until = (np.abs(np.cumsum(response.g, axis=0) - 1.0) > 0.03).any(axis=1)
    return float(1.5 * arm.t_ipo * (2 + np.flatnonzero(open_until)[-1]))
