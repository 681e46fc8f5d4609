"""The regression of measured arm angles against motor angles."""

from __future__ import annotations

import dataclasses

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.channels.noise import noise_in_band
from ideal_robot.diagnosis.channels.regression import Regression
from ideal_robot.effects import ARM_POSITION
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.preprocess import resampled
from ideal_robot.signals.recording import Recording


def arm_angle_regression(recording: Recording, robot: Robot, torque: Regression,
                   stiffness: Array | None) -> Regression | None:
    """Arm angle minus motor angle of each joint, and minus the gears' known deflection.

    Only a constant difference is taken for granted.

    Args:
        recording: with ``qa_i``, else the result is None.
        robot: the arm.
        torque: the regression of its torques, for signals and filters.
        stiffness: of the gears as far as the model knows ``(n,)`` [N m/rad], or None.
    """
    if not recording.has("qa"):
        return None
    grid = torque.filtered.t
    qa, q = (resampled(recording.t, recording.joints(key), grid) for key in ("qa", "q"))
    n = robot.n
    y = torque.decimate(qa - q - deflection(torque, stiffness))
    W = np.zeros((len(y), n, n))
    W[:, np.arange(n), np.arange(n)] = 1.0
    names = tuple(f"qa_{j + 1}" for j in range(n))
    units = tuple("m" if unit == "N" else "rad" for unit in torque.units)
    return dataclasses.replace(torque, channels=names, units=units, y=y, measured=y - y.mean(axis=0),
                               W=W, use=np.ones(y.shape, dtype=bool), noise_floor=noise_in_band(y, torque),
                               domain=ARM_POSITION)


def deflection(torque: Regression, stiffness: Array | None) -> Array:
    """Arm minus motor angle by gears of known stiffness ``(N, n)``, [J] (2)."""
    if stiffness is None:
        return np.zeros_like(torque.signals.q)
    return np.asarray(-torque.signals.load / stiffness)
