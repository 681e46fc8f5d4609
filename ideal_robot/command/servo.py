"""A joint under PD control, the position actuator of simulators, with its drive's compensation of body torques.

    τ = K (q_c - q) - D q̇ + s_g g(q) + s_c c(q, q̇)

with the measured torque. As a law of the command, ``q_c - q = τ/K + (D/K) q̇ - (s_g/K) g - (s_c/K) c``; drives that
take rates from the last two readings and report the last cycle's torque use rate and torque with a delay of a part of a
cycle, which terms of the acceleration and of the torque's rate represent.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from ideal_robot.arrays import Array

SERVO = ("offset", "velocity", "torque", "gravity", "coriolis", "acceleration", "torque_rate")
"""Terms of the command's law that it is fitted with."""
_SURE = 3.0
"""Standard deviations by which the torque has to lead the command."""


@dataclass(frozen=True)
class Servo:
    """Gains of a joint with standard deviations.

    Attributes:
        stiffness, stiffness_std: torque per position error [N m/rad, N/m where it slides].
        damping, damping_std: torque per speed [N m s/rad, N s/m].
        gravity, gravity_std: share of gravity's torque that the drive adds; of wide deviation where there is none.
        coriolis, coriolis_std: share of centrifugal and Coriolis torques.
        late: by how much commands act later than they are handed over [s].
    """

    stiffness: float
    stiffness_std: float
    damping: float
    damping_std: float
    gravity: float
    gravity_std: float
    coriolis: float
    coriolis_std: float
    late: float = 0.0

    @classmethod
    def of(cls, coefficients: Mapping[str, float], covariance: Array, late: float = 0.0) -> Servo | None:
        """The servo of a law's coefficients; None where the coefficient of the torque is not positive.

        Args:
            coefficients: of ``SERVO``.
            covariance: of the coefficients ``(7, 7)``.
            late: of the law [s].
        """
        at, compliance = SERVO.index("torque"), float(coefficients["torque"])
        if compliance <= _SURE * np.sqrt(covariance[at, at]):
            return None

        def over(name: str, sign: float) -> tuple[float, float]:
            """A coefficient over the compliance, with its standard deviation."""
            ratio = float(coefficients[name]) / compliance
            slope = np.zeros(len(SERVO))
            slope[SERVO.index(name)], slope[at] = 1.0 / compliance, -ratio / compliance
            return sign * ratio, float(np.sqrt(max(float(slope @ covariance @ slope), 0.0)))

        std = float(np.sqrt(covariance[at, at])) / compliance**2
        return cls(1.0 / compliance, std, *over("velocity", 1.0), *over("gravity", -1.0), *over("coriolis", -1.0),
                   late)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any] | None) -> Servo | None:
        """Reads a servo from a model file; None for none."""
        return None if values is None else cls(*(float(values[own.name]) for own in fields(cls)))
