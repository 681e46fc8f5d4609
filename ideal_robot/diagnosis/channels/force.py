"""Regressions of a force sensor: without contact of its wrench, in contact of the tip's place."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.channels.blocks import Blocks, time_blocks
from ideal_robot.diagnosis.channels.contact import contact_regression
from ideal_robot.diagnosis.channels.regression import Regression
from ideal_robot.diagnosis.channels.wrench import wrench_of, wrench_regression
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording


def force_regressions(recording: Recording, validate: Recording | None, robot: Robot, torque: Regression,
                      validation: Regression | None,
                      stiffness: Array | None) -> Iterator[tuple[Regression, Regression | None]]:
    """The regressions that a recording's wrench allows, each with that of the validation recording if it has one.

    Args:
        recording: with ``fx fy fz`` and at best ``mx my mz``, else there are none.
        validate: the other recording, or None.
        robot: the arm.
        torque: the regression of its torques, for signals and filters.
        validation: that of the other recording's, or None.
        stiffness: of the gears as far as the model knows ``(n,)`` [N m/rad], or None.
    """
    wrench = wrench_of(recording, robot, torque)
    if wrench is None:
        return
    other = None if validate is None or validation is None else wrench_of(validate, robot, validation)
    free = wrench_regression(wrench, torque, wrench.turns)
    if free is not None:
        yield free, None if other is None or validation is None else wrench_regression(other, validation, wrench.turns)
    contact = contact_regression(recording, robot, wrench, torque, stiffness)
    # The surface of another recording is another one: its curve would say nothing here.
    if contact is not None:
        yield contact, None


def blocks_of(made: Regression, held_out: bool) -> Blocks:
    """Blocks of a regression whose rows are few: eight or more, shorter than those of the torque."""
    count = int(np.clip(len(made.t) / 10, 8, 32))
    return time_blocks(len(made.t), 0.5 * count / len(made.t), held_out)
