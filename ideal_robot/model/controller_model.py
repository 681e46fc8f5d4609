"""The joint controllers as they are identified from outside, [G] 5.2.2."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from ideal_robot.arrays import Array


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
        filter_time: time constant of the low-pass the controller puts on commands [s]; 0 where none was found.
        filter_order: number of equal first-order stages of that low-pass.
        delay: dead time from the hand-over of a command to its effect, beyond the filter [s].
        std: standard deviations by field name, where known.
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
    std: dict[str, list[float]] = field(default_factory=dict)

    @property
    def position_gain(self) -> Array:
        """Gain of the outer loop of the equivalent P/PI cascade ``k_p / k_d`` [1/s] ``(n,)``."""
        return np.asarray(self.k_p / self.k_d)

    @property
    def velocity_gain(self) -> Array:
        """Proportional gain of the inner loop of the equivalent cascade ``k_d`` [N m s/rad] ``(n,)``."""
        return self.k_d

    @property
    def integral_time(self) -> Array:
        """Integral time of the equivalent cascade ``t_cycle / k_i`` [s] ``(n,)``; inf without integrator."""
        with np.errstate(divide="ignore"):
            return np.asarray(self.t_cycle / self.k_i)

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
