"""The parameter vector of an identified arm, and the derivatives of the torque by it.

Order: base parameters (rotor inertias and offsets among them), then for each joint the coefficients of its friction
law, then for each joint the law's shape parameters, in which the torque is not linear.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from itertools import pairwise
from typing import Any

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.dynamics.base_parameters import BaseParameters
from ideal_robot.friction import FrictionModel, PerJointFriction
from ideal_robot.results import Summarised, listed
from ideal_robot.robots.robot import joint_units


@dataclass(frozen=True)
class Parameter:
    """One entry of the parameter vector.

    Attributes:
        name: e.g. ``Izz_2`` or ``Fc_3``.
        joint: joint it belongs to, from 1.
        value, std: estimate and standard deviation.
        unit: its unit.
        meaning: sum of link parameters of a base parameter, or the friction law.
    """

    name: str
    joint: int
    value: float
    std: float
    unit: str
    meaning: str

    @property
    def std_percent(self) -> float:
        """Relative standard deviation [%], [J] (17); NaN where the value is zero."""
        return 100.0 * self.std / abs(self.value) if self.value else float("nan")

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {"name": self.name, "joint": self.joint, "value": self.value, "std": self.std,
                "std_percent": self.std_percent, "unit": self.unit, "meaning": self.meaning}


def parameter_vector(base_values: Array, friction: PerJointFriction) -> Array:
    """All parameters in order ``(P,)``."""
    coefficients = [law.coefficients[:, 0] for law in friction.laws]
    return np.concatenate([base_values, *coefficients, *[law.shape[:, 0] for law in friction.laws]])


def friction_places(base: BaseParameters, friction: PerJointFriction) -> list[slice]:
    """Slices of the parameter vector with the coefficients of each joint's friction law."""
    ends = base.count + np.cumsum([0, *(len(law.coefficients) for law in friction.laws)])
    return [slice(int(a), int(b)) for a, b in pairwise(ends)]


def described(base: BaseParameters, base_values: Array, friction: PerJointFriction, covariance: Array,
              model: pin.Model) -> tuple[Parameter, ...]:
    """Names, joints, units and standard deviations of the parameter vector.

    Args:
        base, base_values: base parameters of the rigid body, and their values ``(b,)``.
        friction: laws of all joints.
        covariance: of the parameter vector ``(P, P)``.
        model: kinematics.
    """
    rows: list[tuple[str, int, str, str]] = list(zip(base.names, base.joints, base.units, base.words(), strict=True))
    units = {symbol: joint_units(unit, model) for symbol, unit in (("F", "N m"), ("v", "rad/s"), ("x", "rad"))}
    for names_of in (lambda law: law.names, lambda law: law.names_of_shape):
        for j, law in enumerate(friction.laws):
            own = {symbol: unit[j] for symbol, unit in units.items()}
            rows += [(f"{name}_{j + 1}", j + 1, unit.format(**own), f"friction, {law.label}")
                     for name, unit in names_of(law)]
    values = parameter_vector(base_values, friction)
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    return tuple(Parameter(name, joint, float(value), float(s), unit, meaning)
                 for (name, joint, unit, meaning), value, s in zip(rows, values, std, strict=True))


def friction_sensitivity(friction: PerJointFriction, q: Array, qd: Array, load: Array | None = None) -> Array:
    """Derivative of friction torques with respect to the laws' coefficients and shapes, ``(N, n, p)``.

    Args:
        friction: laws of all joints.
        q, qd: joint positions and velocities ``(N, n)`` [rad, rad/s], consecutive in time, for the laws with memory.
        load: torque that the gears transmit ``(N, n)`` [N m]; it is taken as given.
    """
    n, blocks = q.shape[1], []
    for columns in (coefficient_columns, shape_columns):
        for j, law in enumerate(friction.laws):
            own = columns(law, qd[:, [j]], None if load is None else load[:, [j]], q[:, [j]])
            block = np.zeros((len(q), n, own.shape[1]))
            block[:, j] = own
            blocks.append(block)
    return np.concatenate(blocks, axis=2)


def coefficient_columns(law: FrictionModel, qd: Array, load: Array | None, q: Array | None) -> Array:
    """Regressor ``(N, m)`` of a law of one joint.

    Args:
        law: of one joint.
        qd, load, q: velocities [rad/s], torque that the gear transmits [N m], positions [rad], ``(N, 1)`` each.
    """
    return law.regressor(qd, load, q)[:, 0]


def shape_columns(law: FrictionModel, qd: Array, load: Array | None, q: Array | None) -> Array:
    """Derivative ``(N, s)`` of the torque of a one-joint law by its shape, by central differences.

    See ``coefficient_columns``.
    """
    result = np.empty((len(qd), len(law.shape)))
    for i in range(len(law.shape)):
        step = np.zeros_like(law.shape)
        step[i] = 1e-4 * law.shape[i]
        up, down = (law.altered(shape=law.shape + sign * step) for sign in (1.0, -1.0))
        result[:, i] = (up.torque(qd, load, q) - down.torque(qd, load, q))[:, 0] / (2.0 * step[i, 0])
    return result


@dataclass(frozen=True)
class ControllerModel:
    """Joint controllers of an arm with ``n`` joints; every array is ``(n,)``.

    The PD part and its two extra terms give ``u``, [G] (16), the integrator turns it into torque, [G] (17)::

        u(k)   = k_p e(k) + k_d ė(k) + k_1 q̇(k) + k_2 q̈(k) ,   e(k) = q_d(k) - q(k)
        tau(k) = tau(k-1) + (1 + k_i) u(k) - u(k-1)

    with derivatives as backward differences over one cycle ``t_cycle``. [G] writes the motor current; here it is the
    motor torque on the joint side, which is proportional to it.

    Attributes:
        t_cycle: the cycle the gains belong to [s]: the interpolation cycle.
        k_p, k_d, k_1, k_2: [N m/rad], [N m s/rad], [N m s/rad], [N m s²/rad].
        k_i: integral gain per cycle [1].
        filter_time: time constant of the controller's low-pass for commands [s]; 0 for none.
        filter_order: number of equal first-order stages of that low-pass.
        delay: dead time from the hand-over of a command to its effect, beyond the filter [s].
        integrated: share of all but ``k_p e`` that the integrator gets: 1 of [G]'s, 0 of PID control of the position.
        compensation, v_compensation: friction that the drives compensate by themselves: τ_c tanh(ṙ / v_c) is added to
            the torque, with ṙ of the command behind its low-pass [N m, rad/s]; None for none.
        schedule: share g in which all gains but ``k_i`` follow the inertia J that a joint moves by the data sheet, its
            rotor's included, as ``1 + g (J / J_0 - 1)``.
        coupled: whether the loops command accelerations (inverse dynamics), which the data sheet's mass matrix, its
            columns over J_0, converts to torques.
        scheduled_at: J_0 [kg m²]; None where gains are the same everywhere.
        rate_filter: time constant of the lag that rates of the command pass, each [s].
        acceleration: factor of the command's second derivative in u [N m s²/rad]; None for none.
        bodies: share of the data sheet's gravity and Coriolis torques that is added to the torque; None for none.
        std: standard deviations by field name, where known.
        spread: of a controller that was not identified, how far its cascade's numbers may be from these
            (``ideal_robot.model.cascade``), by name.
    """

    t_cycle: float
    k_p: Array
    k_d: Array
    k_1: Array
    k_2: Array
    k_i: Array
    filter_time: Array
    filter_order: int = 1
    delay: float = 0.0
    integrated: float = 1.0
    compensation: Array | None = None
    v_compensation: Array | None = None
    schedule: float = 0.0
    coupled: bool = False
    scheduled_at: Array | None = None
    rate_filter: float = 0.0
    acceleration: Array | None = None
    bodies: Array | None = None
    std: dict[str, list[float]] = field(default_factory=dict)
    spread: dict[str, list[float]] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """Plain values for the model file."""
        values = {entry.name: getattr(self, entry.name) for entry in fields(self)}
        return {key: value.tolist() if isinstance(value, np.ndarray) else value for key, value in values.items()}

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> ControllerModel:
        """Reads what ``to_dict`` wrote; keys of later versions are ignored."""
        known = {entry.name for entry in fields(cls)}
        arguments: dict[str, Any] = {key: np.array(value, dtype=float) if isinstance(value, list) else value
                                     for key, value in values.items() if key in known}
        return cls(**arguments)


@dataclass(frozen=True, repr=False)
class Prediction(Summarised):
    """Predicted and measured torque of a recording, both through the same decimation filter.

    Attributes:
        t: ``(M,)`` [s].
        tau: predicted motor torque ``(M, n)`` [N m].
        std: standard deviation of a measured value about it: parameters and noise together ``(M, n)`` [N m].
        measured: measured motor torque ``(M, n)`` [N m].
    """

    t: Array
    tau: Array
    std: Array
    measured: Array

    def summary(self) -> list[tuple[str, str]]:
        """Deviation of the model from the measurement as rows of label and value."""
        samples, joints = self.tau.shape
        return [("torques", f"{joints} joints, {samples} samples"),
                ("relative error", listed(self.relative_error_percent, "%"))]

    @property
    def relative_error_percent(self) -> Array:
        """``100 ‖y - ŷ‖ / ‖y‖`` per joint ``(n,)``; NaN for a joint without torque."""
        norm = np.linalg.norm(self.measured, axis=0)
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(100.0 * np.linalg.norm(self.measured - self.tau, axis=0) / norm)

    @property
    def residual_std_percent(self) -> Array:
        """Standard deviation of the residual over that of the torque per joint ``(n,)`` [%]."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(100.0 * np.std(self.measured - self.tau, axis=0) / np.std(self.measured, axis=0))


def joined(predictions: Sequence[Prediction]) -> Prediction:
    """Predictions of several recordings concatenated."""
    return Prediction(*(np.concatenate([getattr(prediction, entry.name) for prediction in predictions])
                        for entry in fields(Prediction)))
