"""Each joint with the friction law that describes it best, behind the seam of a single one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.friction.base import FrictionModel
from ideal_robot.friction.laws import Arctan, Asymmetric, CubeRoot, Stribeck, ViscousCoulomb
from ideal_robot.friction.presliding import sliding_direction

LAWS: dict[str, type[FrictionModel]] = {
    law.key: law for law in (ViscousCoulomb, CubeRoot, Arctan, Stribeck, Asymmetric)
}
"""Key → law."""


class PerJointFriction:
    """One single-joint law per joint; torque ``(…, n)`` of velocity ``(…, n)`` like every friction model.

    Args:
        laws: ``n`` laws of one joint each.
    """

    def __init__(self, laws: Sequence[FrictionModel]) -> None:
        if any(law.n != 1 for law in laws):
            raise ValueError("expected laws of one joint each")
        self.laws = tuple(laws)

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.laws)

    def torque(self, qd: Array, load: Array | None = None, q: Array | None = None,
               direction: Array | None = None) -> Array:
        """Friction torque ``(…, n)`` [N m]; arguments as in ``FrictionModel.torque``.

        Args:
            qd: velocities ``(…, n)`` [rad/s].
            load: torque that the gears transmit ``(…, n)`` [N m].
            q: positions ``(…, n)`` [rad].
            direction: of sliding ``(…, n)``, -1 … 1.
        """
        qd = np.asarray(qd, dtype=float)
        others = (load, q, direction)
        parts = [law.torque(qd[..., [j]], *(None if values is None else values[..., [j]] for values in others))
                 for j, law in enumerate(self.laws)]
        return np.concatenate(parts, axis=-1)

    def sliding(self, q: Array, qd: Array) -> Array:
        """Direction of sliding ``(N, n)`` of the joints whose friction builds up over a displacement; NaN for others.

        Args:
            q: positions ``(N, n)`` [rad], consecutive in time.
            qd: velocities ``(N, n)`` [rad/s].
        """
        result = np.full(np.shape(q), np.nan)
        for j, law in enumerate(self.laws):
            if law.presliding:
                result[:, [j]] = sliding_direction(q[:, [j]], qd[:, [j]], law.shape[-1])
        return result

    def turned(self, q: Array, qd: Array) -> Array:
        """How far friction has turned ``(N, n)``, -1 to 1: as ``sliding`` says, in other joints at once.

        Args:
            q: positions ``(N, n)`` [rad], consecutive in time.
            qd: velocities ``(N, n)`` [rad/s].
        """
        sliding = self.sliding(q, qd)
        return np.where(np.isnan(sliding), np.sign(qd), sliding)

    def to_dict(self) -> list[dict[str, Any]]:
        """Plain values for the model file, one entry per joint."""
        return [law.to_dict() for law in self.laws]

    @classmethod
    def from_dict(cls, values: list[dict[str, Any]]) -> PerJointFriction:
        """Reads what ``to_dict`` wrote."""
        return cls([law_of(entry["law"])(np.array(entry["coefficients"]), np.array(entry["shape"]),
                                         presliding=bool(entry.get("presliding")), loaded=bool(entry.get("loaded")))
                    for entry in values])

    @classmethod
    def none(cls, n: int) -> PerJointFriction:
        """No friction at all."""
        return cls([ViscousCoulomb(np.zeros((2, 1))) for _ in range(n)])


def law_of(key: str) -> type[FrictionModel]:
    """The law of a key.

    Raises:
        InputError: no such law.
    """
    if key not in LAWS:
        raise InputError(f"no such friction law; there are {', '.join(LAWS)}", field="friction", value=key)
    return LAWS[key]
