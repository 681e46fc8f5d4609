"""The seam of all friction laws: joint torque lost in gear, bearings and motor as a function of joint velocity."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, ClassVar

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.friction.presliding import sliding_direction


class FrictionModel(ABC):
    """Friction torque ``(…, n)`` [N m] of joint velocity ``(…, n)`` [rad/s], positive where it brakes positive motion.

    A law is linear in its ``coefficients`` and may have ``shape`` parameters in which it is not. Parameters do not
    claim to be physical; they force the sum of all losses of a multistage gear into a formula ([G] 3.1.1).

    Two refinements go with every law. *Presliding*: its ``sign(qd)`` becomes a direction with memory, which turns over
    only after the joint has moved some distance and stays when it rests. *Load*: dry friction in proportion to the
    torque the gear transmits, ``a_load |load| sign(qd)``; tooth forces rub.

    Args:
        coefficients: ``(m, n)``, one row per name in ``names_of``.
        shape: ``(s, n)``, one row per shape name; the presliding distance last where there is one.
        presliding: whether the last row of ``shape`` is the presliding distance [rad].
        loaded: whether the last row of ``coefficients`` is ``a_load`` [1].

    Attributes:
        key: name of the law in files, tables and on the command line.
        coefficient_names, coefficient_units: ``{F}`` and ``{v}`` in a unit stand for those of torque and velocity.
        shape_names, shape_units, shape_bounds: of the law proper, without the refinements.
    """

    key: ClassVar[str]
    coefficient_names: ClassVar[tuple[str, ...]]
    coefficient_units: ClassVar[tuple[str, ...]]
    shape_names: ClassVar[tuple[str, ...]] = ()
    shape_units: ClassVar[tuple[str, ...]] = ()
    shape_bounds: ClassVar[tuple[tuple[float, float], ...]] = ()

    def __init__(self, coefficients: Array, shape: Array | None = None, *, presliding: bool = False,
                 loaded: bool = False) -> None:
        self.coefficients = np.array(coefficients, dtype=float)
        n = self.coefficients.shape[1]
        self.shape = np.empty((0, n)) if shape is None else np.array(shape, dtype=float).reshape(-1, n)
        self.presliding = presliding
        self.loaded = loaded
        rows = len(self.coefficient_names) + loaded, len(self.shape_names) + presliding
        if (len(self.coefficients), len(self.shape)) != rows:
            raise ValueError(f"{self.key}: expected {rows[0]} coefficients and {rows[1]} shape parameters per joint")
        self.coefficients.setflags(write=False)
        self.shape.setflags(write=False)

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.coefficients.shape[1])

    @classmethod
    @abstractmethod
    def columns(cls, qd: Array, direction: Array, shape: Array) -> list[Array]:
        """One array like ``qd (…, n)`` per coefficient of the law proper; ``direction`` stands for ``sign(qd)``.

        Args:
            qd: velocities ``(…, n)`` [rad/s].
            direction: of sliding ``(…, n)``, -1 … 1.
            shape: shape parameters of the law proper ``(s, n)``.
        """

    def regressor(self, qd: Array, load: Array | None = None, q: Array | None = None,
                  direction: Array | None = None) -> Array:
        """Regressor ``(…, n, m)`` with respect to the ``m`` coefficients of each joint; arguments as in ``torque``.

        Args:
            qd: velocities ``(…, n)`` [rad/s].
            load: torque that the gears transmit ``(…, n)`` [N m].
            q: positions ``(…, n)`` [rad].
            direction: of sliding ``(…, n)``, -1 … 1.
        """
        return np.stack(self._columns(qd, load, q, direction), axis=-1)

    def torque(self, qd: Array, load: Array | None = None, q: Array | None = None,
               direction: Array | None = None) -> Array:
        """Friction torque ``(…, n)`` [N m]; without memory zero at rest, where no law can know what friction balances.

        Args:
            qd: joint velocity ``(…, n)`` [rad/s].
            load: torque the gear transmits ``(…, n)`` [N m]; zero if not given. Only loaded laws look at it.
            q: joint position ``(N, n)`` [rad], consecutive in time: what the memory of presliding follows. Without it
                the direction is that of gross sliding, ``sign(qd)``.
            direction: of motion ``(…, n)``, -1 to 1, of who knows how sharply it changes; laws with presliding know it.
        """
        columns = self._columns(qd, load, q, direction)
        return np.sum([c * column for c, column in zip(self.coefficients, columns, strict=True)], axis=0)

    def _columns(self, qd: Array, load: Array | None, q: Array | None, direction: Array | None) -> list[Array]:
        qd = np.asarray(qd, dtype=float)
        if self.presliding and q is not None:
            direction = sliding_direction(q, qd, self.shape[-1])
        elif direction is None:
            direction = np.sign(qd)
        columns = self.columns(qd, direction, self.shape)
        if self.loaded:
            columns.append((np.zeros_like(qd) if load is None else np.abs(load)) * direction)
        return columns

    @property
    def names(self) -> tuple[tuple[str, str], ...]:
        """Names and units of the coefficients, refinements included."""
        own = tuple(zip(self.coefficient_names, self.coefficient_units, strict=True))
        return (*own, ("a_load", "1")) if self.loaded else own

    @property
    def names_of_shape(self) -> tuple[tuple[str, str], ...]:
        """Names and units of the shape parameters, refinements included."""
        own = tuple(zip(self.shape_names, self.shape_units, strict=True))
        return (*own, ("presliding", "{x}")) if self.presliding else own

    @property
    def label(self) -> str:
        """The law in words."""
        extras = [word for word, on in (("presliding", self.presliding), ("load", self.loaded)) if on]
        return self.key.replace("_", " ") + (f" with {' and '.join(extras)}" if extras else "")

    def to_dict(self) -> dict[str, Any]:
        """Plain values for the model file."""
        return {"law": self.key, "coefficients": self.coefficients.tolist(), "shape": self.shape.tolist(),
                "presliding": self.presliding, "loaded": self.loaded}
