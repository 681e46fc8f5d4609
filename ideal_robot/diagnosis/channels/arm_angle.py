"""The regression of measured arm angles against motor angles."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.channels.noise import noise_in_band
from ideal_robot.diagnosis.channels.regression import Regression
from ideal_robot.diagnosis.statistics.candidate import Candidate
from ideal_robot.effects import ARM_POSITION
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.preprocess import resampled
from ideal_robot.signals.recording import Recording


def arm_angle_regression(recording: Recording, robot: Robot, torque: Regression,
                   stiffness: Array | None) -> Regression | None:
    """Arm angle minus motor angle of each joint, and minus the gears' known deflection.

    Only a constant difference is taken for granted. Joints without an encoder on the arm's side are absent.

    Args:
        recording: with ``qa_i`` of some joints, else the result is None.
        robot: the arm.
        torque: the regression of its torques, for signals and filters.
        stiffness: of the gears as far as the model knows ``(n,)`` [N m/rad], or None.
    """
    there = recording.having("qa")
    if not there.any():
        return None
    n = robot.n
    motor = resampled(recording.t, recording.joints("q"), torque.filtered.t)
    y = torque.decimate(np.where(there, arm_angles(recording, torque, motor) - motor - deflection(torque, stiffness),
                                 0.0))
    W = np.zeros((len(y), n, n))
    W[:, np.arange(n), np.arange(n)] = 1.0
    names = tuple(f"qa_{j + 1}" for j in range(n))
    units = tuple("m" if unit == "N" else "rad" for unit in torque.units)
    without = {j + 1: "has no angle measured on the arm's side" for j in range(n) if not there[j]}
    return dataclasses.replace(torque, channels=names, units=units, y=y, measured=y - y.mean(axis=0),
                               W=W, use=np.tile(there, (len(y), 1)), noise_floor=noise_in_band(y, torque),
                               undecided={**torque.undecided, **without}, domain=ARM_POSITION,
                               absent=frozenset(int(j) for j in np.flatnonzero(~there)))


def arm_angles(recording: Recording, torque: Regression, otherwise: Array) -> Array:
    """Measured arm angles at the undecimated instants ``(N, n)``, where there are none something else.

    Args:
        recording: with ``qa_i`` of some joints.
        torque: the regression of its torques, for the instants.
        otherwise: for the other joints ``(N, n)``.
    """
    angles = np.array(otherwise)
    for j in np.flatnonzero(recording.having("qa")):
        angles[:, j] = resampled(recording.t, recording.columns[f"qa_{j + 1}"][:, None], torque.filtered.t)[:, 0]
    return angles


def deflection(torque: Regression, stiffness: Array | None) -> Array:
    """Arm minus motor angle by gears of known stiffness ``(N, n)``, [J] (2)."""
    if stiffness is None:
        return np.zeros_like(torque.signals.q)
    return np.asarray(-torque.signals.load / stiffness)


def with_loose_weights(made: Regression, effects: Sequence[Candidate]) -> Regression:
    """The regression with what springs bend their gears by, where torques do not tell them from the arm's weight.

    A term of the form of gravity goes to the spring or to the masses as it falls out, and whether a spring pulls on
    the motor's or on the arm's side of its gear no torque says: what the gear carries is known but for its columns.

    Args:
        made: of the arm angles.
        effects: of the motor torques.
    """
    loose = [made.decimate(one.effect.columns(made.signals, one.joint, one.theta)) for one in effects
             if one.joint not in made.undecided and one.effect.of_angle_alone
             and one.effect.like_the_model(made.signals, one.joint) is not None]
    if not loose:
        return made
    return dataclasses.replace(made, W=np.concatenate([made.W, *loose], axis=2))
