"""The parameter vector of an identified arm and how the torque depends on it.

Order: base parameters (rotor inertias and offsets among them), then for each joint the coefficients of its friction
law, then for each joint the law's shape parameters, in which the torque is not linear.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.dynamics.base_parameters import BaseParameters, full_regressor
from ideal_robot.friction import FrictionModel, PerJointFriction
from ideal_robot.robots.joints import prismatic_joints


@dataclass(frozen=True)
class Parameter:
    """One entry of the parameter vector.

    Attributes:
        name: e.g. ``Izz_2`` or ``Fc_3``.
        joint: joint it belongs to, from 1.
        value, std: estimate and standard deviation.
        unit: its unit.
        meaning: the sum of link parameters a base parameter stands for, or the friction law.
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


def parameter_vector(base_values: Array, friction: PerJointFriction) -> Array:
    """All parameters in order ``(P,)``."""
    coefficients = [law.coefficients[:, 0] for law in friction.laws]
    return np.concatenate([base_values, *coefficients, *[law.shape[:, 0] for law in friction.laws]])


def described(base: BaseParameters, base_values: Array, friction: PerJointFriction, covariance: Array,
              model: pin.Model) -> tuple[Parameter, ...]:
    """Names, joints, units and standard deviations of the parameter vector.

    Args:
        base: base parameters of the rigid body.
        base_values: their values ``(b,)``.
        friction: laws of all joints.
        covariance: of the parameter vector ``(P, P)``.
        model: kinematics.
    """
    rows: list[tuple[str, int, str, str]] = list(zip(base.names, base.joints, base.units, base.words(), strict=True))
    prismatic = prismatic_joints(model)
    for names_of in (lambda law: law.names, lambda law: law.names_of_shape):
        for j, law in enumerate(friction.laws):
            units = {"F": "N", "v": "m/s", "x": "m"} if prismatic[j] else {"F": "N m", "v": "rad/s", "x": "rad"}
            rows += [(f"{name}_{j + 1}", j + 1, unit.format(**units), f"friction, {law.label}")
                     for name, unit in names_of(law)]
    values = parameter_vector(base_values, friction)
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    return tuple(Parameter(name, joint, float(value), float(s), unit, meaning)
                 for (name, joint, unit, meaning), value, s in zip(rows, values, std, strict=True))


def sensitivity(model: pin.Model, base: BaseParameters, friction: PerJointFriction, q: Array, qd: Array, qdd: Array,
                load: Array | None = None) -> Array:
    """Derivative of the torque with respect to the parameter vector, ``(N, n, P)``.

    In the linear parameters this is the regressor. The load, where a friction law looks at it, counts as given. The
    samples are consecutive in time, for the laws with memory.

    Args:
        model: kinematics.
        base: base parameters of the rigid body.
        friction: laws of all joints.
        q: joint positions ``(N, n)`` [rad].
        qd: joint velocities ``(N, n)`` [rad/s].
        qdd: joint accelerations ``(N, n)`` [rad/s²].
        load: torque that the gears transmit ``(N, n)`` [N m].
    """
    n = model.nv
    blocks = [full_regressor(model, q, qd, qdd, base.independent)]
    for columns in (coefficient_columns, shape_columns):
        for j, law in enumerate(friction.laws):
            own = columns(law, qd[:, [j]], None if load is None else load[:, [j]], q[:, [j]])
            block = np.zeros((len(q), n, own.shape[1]))
            block[:, j] = own
            blocks.append(block)
    return np.concatenate(blocks, axis=2)


def coefficient_columns(law: FrictionModel, qd: Array, load: Array | None, q: Array | None) -> Array:
    """Regressor ``(N, m)`` of a one-joint law at velocities ``(N, 1)``.

    Args:
        law: of one joint.
        qd: velocities ``(N, 1)`` [rad/s].
        load: torque that the gear transmits ``(N, 1)`` [N m].
        q: positions ``(N, 1)`` [rad].
    """
    return law.regressor(qd, load, q)[:, 0]


def shape_columns(law: FrictionModel, qd: Array, load: Array | None, q: Array | None) -> Array:
    """Derivative ``(N, s)`` of a one-joint law's torque with respect to its shape, by central differences.

    Args:
        law: of one joint.
        qd: velocities ``(N, 1)`` [rad/s].
        load: torque that the gear transmits ``(N, 1)`` [N m].
        q: positions ``(N, 1)`` [rad].
    """
    result = np.empty((len(qd), len(law.shape)))
    for i in range(len(law.shape)):
        step = np.zeros_like(law.shape)
        step[i] = 1e-4 * law.shape[i]
        up, down = (law.altered(shape=law.shape + sign * step) for sign in (1.0, -1.0))
        result[:, i] = (up.torque(qd, load, q) - down.torque(qd, load, q))[:, 0] / (2.0 * step[i, 0])
    return result
