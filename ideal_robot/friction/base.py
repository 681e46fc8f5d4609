"""The seam of all friction laws: joint torque lost in gear, bearings and motor as a function of joint velocity."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, ClassVar

import numpy as np

from ideal_robot.interface import Array


class FrictionModel(ABC):
    """Friction torque ``(…, n)`` [N m] of joint velocity ``(…, n)`` [rad/s], positive where it brakes positive motion.

    A law is linear in its ``coefficients`` and may have ``shape`` parameters in which it is not. Both are arrays with
    one row per parameter and one column per joint. Parameters do not claim to be physical; they force the sum of all
    losses of a multistage gear into a formula ([G] 3.1.1).

    Attributes:
        key: name of the law in files, tables and on the command line.
        coefficient_names, coefficient_units: one per row of ``coefficients``; ``{F}`` and ``{v}`` in a unit stand for
            those of torque and velocity.
        shape_names, shape_units: one per row of ``shape``.
        shape_bounds: lowest and highest value of each shape parameter.
        needs_load: whether ``columns`` asks for the load torque on the gear.
    """

    key: ClassVar[str]
    coefficient_names: ClassVar[tuple[str, ...]]
    coefficient_units: ClassVar[tuple[str, ...]]
    shape_names: ClassVar[tuple[str, ...]] = ()
    shape_units: ClassVar[tuple[str, ...]] = ()
    shape_bounds: ClassVar[tuple[tuple[float, float], ...]] = ()
    needs_load: ClassVar[bool] = False

    def __init__(self, coefficients: Array, shape: Array | None = None) -> None:
        self.coefficients = np.array(coefficients, dtype=float)
        n = self.coefficients.shape[1]
        self.shape = np.empty((0, n)) if shape is None else np.array(shape, dtype=float).reshape(-1, n)
        if len(self.coefficients) != len(self.coefficient_names) or len(self.shape) != len(self.shape_names):
            raise ValueError(f"{self.key}: expected {len(self.coefficient_names)} coefficients and "
                             f"{len(self.shape_names)} shape parameters per joint")
        self.coefficients.setflags(write=False)
        self.shape.setflags(write=False)

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.coefficients.shape[1])

    @classmethod
    @abstractmethod
    def columns(cls, qd: Array, shape: Array, load: Array | None = None) -> list[Array]:
        """One array like ``qd (…, n)`` per coefficient: the torque is their sum weighted by the coefficients."""

    def regressor(self, qd: Array, load: Array | None = None) -> Array:
        """Regressor ``(…, n, m)`` with respect to the ``m`` coefficients of each joint."""
        return np.stack(self.columns(np.asarray(qd, dtype=float), self.shape, self._load(qd, load)), axis=-1)

    def torque(self, qd: Array, load: Array | None = None) -> Array:
        """Friction torque ``(…, n)`` [N m]; zero at rest, where friction balances what drives and no law can know.

        Args:
            qd: joint velocity ``(…, n)`` [rad/s].
            load: torque the gear transmits, ``(…, n)`` [N m]; zero if not given. Only some laws look at it.
        """
        columns = self.columns(np.asarray(qd, dtype=float), self.shape, self._load(qd, load))
        return np.sum([c * column for c, column in zip(self.coefficients, columns, strict=True)], axis=0)

    def _load(self, qd: Array, load: Array | None) -> Array | None:
        if not self.needs_load:
            return None
        return np.zeros_like(np.asarray(qd, dtype=float)) if load is None else load

    def to_dict(self) -> dict[str, Any]:
        """Plain values for the model file."""
        return {"law": self.key, "coefficients": self.coefficients.tolist(), "shape": self.shape.tolist()}
