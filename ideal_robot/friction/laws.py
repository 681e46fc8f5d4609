"""Friction laws: their interface, those of [G] 3.1.1 and two more, and a law for each joint.

The same law object is used everywhere: identification fits it, the diagnosis takes its terms as effects
(``ideal_robot/effects/friction.py``), the loop that the feedforward inverts tabulates it. To add one, write its class
and a line in the table ``LAWS``; a package outside calls ``LAWS.register("my_law", MyLaw)`` or has an entry point of
the group ``ideal_robot.friction``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar, Self

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.friction.presliding import (
    first_direction,
    friction_of_sizes,
    measured_steps,
    sliding_direction,
)
from ideal_robot.registry import Registry, in_words
from ideal_robot.tolerances import CREEP


class FrictionModel(ABC):
    """Friction torque ``(…, n)`` [N m] of joint velocity ``(…, n)`` [rad/s], positive where it brakes positive motion.

    A law is linear in its ``coefficients`` and may have ``shape`` parameters in which it is not. Parameters do not
    claim to be physical; they force the sum of all losses of a multistage gear into a formula ([G] 3.1.1).

    Two refinements go with every law. *Presliding*: terms with ``sign(qd)`` are dry friction with memory, which
    reverses only after the joint has moved some distance and stays at rest (``ideal_robot.friction.presliding``).
    *Load*: dry friction in proportion to the torque the gear transmits, ``a_load |load| sign(qd)``; tooth forces rub.

    Args:
        coefficients: ``(m, n)``, one row per name in ``names_of``.
        shape: ``(s, n)``, one row per shape name; the presliding distance last where there is one.
        presliding: whether the last row of ``shape`` is the presliding distance [rad].
        loaded: whether the last row of ``coefficients`` is ``a_load`` [1].

    Attributes:
        key: name of the law in files, tables and on the command line.
        coefficient_names, coefficient_units: names and units; ``{F}`` and ``{v}`` stand for the units of torque and
            velocity.
        shape_names, shape_units, shape_bounds: of the law proper, without the refinements.
        each_brakes: whether each coefficient brakes by itself and so may not be negative; else only their sum has to.
        holds_offset: whether dry friction has a size of its own in each direction, so that half their difference is a
            constant torque.
        automatic: whether the automatic choice among laws tries it.
    """

    key: ClassVar[str]
    coefficient_names: ClassVar[tuple[str, ...]]
    coefficient_units: ClassVar[tuple[str, ...]]
    shape_names: ClassVar[tuple[str, ...]] = ()
    shape_units: ClassVar[tuple[str, ...]] = ()
    shape_bounds: ClassVar[tuple[tuple[float, float], ...]] = ()
    each_brakes: ClassVar[bool] = False
    holds_offset: ClassVar[bool] = False
    automatic: ClassVar[bool] = False

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
        """One array like ``qd (…, n)`` per coefficient of the law without refinements; ``direction`` is ``sign(qd)``.

        Args:
            qd: velocities ``(…, n)`` [rad/s].
            direction: of sliding ``(…, n)``, -1 … 1.
            shape: shape parameters of the law proper ``(s, n)``.
        """

    @staticmethod
    def by_load(load: Array, direction: Array) -> Array:
        """Dry friction per unit of the coefficient ``a_load``, shaped like ``load`` and ``direction``."""
        return np.abs(load) * direction

    def regressor(self, qd: Array, load: Array | None = None, q: Array | None = None,
                  direction: Array | None = None) -> Array:
        """Regressor ``(…, n, m)`` of the ``m`` coefficients of each joint; see ``FrictionModel.torque``."""
        qd = np.asarray(qd, dtype=float)
        if not self.presliding or q is None:
            return np.stack(self._columns(qd, load, direction), axis=-1)
        columns = [self._along(dry, fluid, qd, q) for dry, fluid in zip(*self._size_columns(qd, load), strict=True)]
        return np.stack(columns, axis=-1)

    def torque(self, qd: Array, load: Array | None = None, q: Array | None = None,
               direction: Array | None = None) -> Array:
        """Friction torque ``(…, n)`` [N m]; without presliding state zero at rest.

        Args:
            qd: joint velocity ``(…, n)`` [rad/s].
            load: torque the gear transmits ``(…, n)`` [N m]; zero if not given. Only laws with load dependence use it.
            q: joint position ``(N, n)`` [rad], consecutive in time: the presliding state follows it. Without it the
                direction is that of gross sliding, ``sign(qd)``.
            direction: of motion ``(…, n)``, -1 to 1, of who knows how sharply it changes; laws with presliding know it.
        """
        qd = np.asarray(qd, dtype=float)
        if not self.presliding or q is None:
            return self._sum(self._columns(qd, load, direction))
        return self._along(*self.sizes(qd, load), qd, q)

    def sizes(self, qd: Array, load: Array | None = None) -> tuple[Array, Array]:
        """Sizes of dry friction, which acts in the direction of sliding, and of the rest ``(…, n)`` each [N m].

        Args:
            qd: joint velocity ``(…, n)`` [rad/s]; at rest the forward value is used.
            load: torque the gear transmits ``(…, n)`` [N m]; zero if not given.
        """
        dry, fluid = self._size_columns(np.asarray(qd, dtype=float), load)
        return self._sum(dry), self._sum(fluid)

    @property
    def distance(self) -> Array:
        """Presliding distance ``(n,)`` [rad]; 0 without presliding."""
        return np.array(self.shape[-1]) if self.presliding else np.zeros(self.n)

    def _sum(self, columns: list[Array]) -> Array:
        """Coefficients times columns."""
        return np.asarray(np.sum([c * column for c, column in zip(self.coefficients, columns, strict=True)], axis=0))

    def _size_columns(self, qd: Array, load: Array | None) -> tuple[list[Array], list[Array]]:
        """Columns of the sizes of dry friction and of the rest, one like ``qd`` per coefficient each."""
        side = np.where(qd < 0.0, -1.0, 1.0)
        fluid = [side * column for column in self._columns(qd, load, np.zeros_like(qd))]
        both = [side * column for column in self._columns(qd, load, side)]
        return [whole - part for whole, part in zip(both, fluid, strict=True)], fluid

    def _along(self, dry: Array, fluid: Array, qd: Array, q: Array) -> Array:
        """Torque ``(N, n)`` of sizes ``(N, n)`` [N m] along measured positions, all ``(N, n)``."""
        steps = measured_steps(np.ascontiguousarray(q, dtype=float), self.distance)
        start = first_direction(qd[0], self.distance) * dry[0]
        sizes = np.ascontiguousarray(dry), np.ascontiguousarray(fluid)
        return friction_of_sizes(*sizes, np.ascontiguousarray(qd), steps, start, self.distance)[0]

    def _columns(self, qd: Array, load: Array | None, direction: Array | None) -> list[Array]:
        if direction is None:
            direction = np.sign(qd)
        columns = self.columns(qd, direction, self.shape)
        if self.loaded:
            columns.append(self.by_load(np.zeros_like(qd) if load is None else load, direction))
        return columns

    def altered(self, coefficients: Array | None = None, shape: Array | None = None) -> Self:
        """The same law with other coefficients ``(m, n)`` or another shape ``(s, n)``."""
        return type(self)(self.coefficients if coefficients is None else coefficients,
                          self.shape if shape is None else shape, presliding=self.presliding, loaded=self.loaded)

    @property
    def nonnegative(self) -> np.ndarray:
        """Mask ``(m,)`` of the coefficients that brake by themselves and must not be negative."""
        return np.array([self.each_brakes] * len(self.coefficient_names) + [True] * self.loaded)

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
        return in_words(self.key) + (f" with {' and '.join(extras)}" if extras else "")

    def to_dict(self) -> dict[str, Any]:
        """Plain values for the model file."""
        return {"law": self.key, "coefficients": self.coefficients.tolist(), "shape": self.shape.tolist(),
                "presliding": self.presliding, "loaded": self.loaded}


class ViscousCoulomb(FrictionModel):
    """[G] (1): ``a1 qd + a2 sign(qd)``.

    >>> ViscousCoulomb(np.array([[2.0], [0.5]])).torque(np.array([[-1.0], [0.0], [3.0]]))[:, 0]
    array([-2.5,  0. ,  6.5])
    """

    key = "viscous_coulomb"
    coefficient_names = ("Fv", "Fc")
    coefficient_units = ("{F} / ({v})", "{F}")
    each_brakes = True
    automatic = True

    @classmethod
    def columns(cls, qd: Array, direction: Array, shape: Array) -> list[Array]:
        """One array ``(…, n)`` per coefficient of the law; see ``FrictionModel.columns``."""
        return [qd, direction]


class CubeRoot(FrictionModel):
    """[G] (2): ``a1 qd + a2 sign(qd) + a3 qd^(1/3)``: degressive, yet linear in its parameters."""

    key = "cube_root"
    coefficient_names = ("a1", "a2", "a3")
    coefficient_units = ("{F} / ({v})", "{F}", "{F} / ({v})^(1/3)")
    automatic = True

    @classmethod
    def columns(cls, qd: Array, direction: Array, shape: Array) -> list[Array]:
        """One array ``(…, n)`` per coefficient of the law; see ``FrictionModel.columns``."""
        return [qd, direction, np.cbrt(qd)]


class Arctan(FrictionModel):
    """[G] (3): ``a1 qd + a2 sign(qd) + a3 arctan(a4 qd)``: degressive, saturating.

    Ten times the speed, less than twice the friction:

    >>> law = Arctan(np.array([[0.5], [1.0], [2.0]]), shape=np.array([[20.0]]))
    >>> law.torque(np.array([[0.1], [1.0]]))[:, 0].round(2)
    array([3.26, 4.54])
    """

    key = "arctan"
    coefficient_names = ("a1", "a2", "a3")
    coefficient_units = ("{F} / ({v})", "{F}", "{F}")
    shape_names = ("a4",)
    shape_units = ("1 / ({v})",)
    shape_bounds = ((1.0, 300.0),)
    automatic = True

    @classmethod
    def columns(cls, qd: Array, direction: Array, shape: Array) -> list[Array]:
        """One array ``(…, n)`` per coefficient of the law; see ``FrictionModel.columns``."""
        return [qd, direction, np.arctan(shape[0] * qd)]


class Stribeck(FrictionModel):
    """[G] (4): ``a1 qd + a2 sign(qd) + a3 exp(-a4 |qd|) sign(qd)``: falls with speed at very low speed.

    [G] prints ``exp(-a4 qd)``, written for positive velocity; here it is odd like the other terms. [G] leaves it out of
    the choice among laws, as it depends too strongly on operating conditions.
    """

    key = "stribeck"
    coefficient_names = ("a1", "a2", "a3")
    coefficient_units = ("{F} / ({v})", "{F}", "{F}")
    shape_names = ("a4",)
    shape_units = ("1 / ({v})",)
    shape_bounds = ((1.0, 1000.0),)

    @classmethod
    def columns(cls, qd: Array, direction: Array, shape: Array) -> list[Array]:
        """One array ``(…, n)`` per coefficient of the law; see ``FrictionModel.columns``."""
        return [qd, direction, np.exp(-shape[0] * np.abs(qd)) * direction]


class BellStribeck(Stribeck):
    """``a1 qd + a2 sign(qd) + a3 exp(-(a4 qd)²) sign(qd)``: flat at standstill, falls fastest about ``1/a4``.

    B. Armstrong-Hélouvry, P. Dupont, C. Canudas de Wit, Automatica 30(7), 1994, (5) with exponent 2.
    """

    key = "bell_stribeck"

    @classmethod
    def columns(cls, qd: Array, direction: Array, shape: Array) -> list[Array]:
        """One array ``(…, n)`` per coefficient of the law; see ``FrictionModel.columns``."""
        return [qd, direction, np.exp(-((shape[0] * qd) ** 2)) * direction]


class Asymmetric(FrictionModel):
    """[G] (1) with its own parameters in each direction, all positive where they brake."""

    key = "asymmetric"
    coefficient_names = ("Fv+", "Fc+", "Fv-", "Fc-")
    coefficient_units = ("{F} / ({v})", "{F}", "{F} / ({v})", "{F}")
    each_brakes = True
    holds_offset = True
    automatic = True

    @classmethod
    def columns(cls, qd: Array, direction: Array, shape: Array) -> list[Array]:
        """One array ``(…, n)`` per coefficient of the law; see ``FrictionModel.columns``."""
        forward = qd > 0
        return [qd * forward, np.maximum(direction, 0.0), qd * ~forward, np.minimum(direction, 0.0)]


_HERE = "ideal_robot.friction.laws:"
LAWS: Registry[type[FrictionModel]] = Registry("friction law", "ideal_robot.friction", {
    "viscous_coulomb": _HERE + "ViscousCoulomb",
    "cube_root": _HERE + "CubeRoot",
    "arctan": _HERE + "Arctan",
    "stribeck": _HERE + "Stribeck",
    "bell_stribeck": _HERE + "BellStribeck",
    "asymmetric": _HERE + "Asymmetric",
})
"""Key → law."""


def law_of(key: str) -> type[FrictionModel]:
    """The law of a key; raises InputError for an unknown key, or one that differs from the law's own ``key``."""
    if key not in LAWS:
        raise InputError(f"no such friction law; there are {', '.join(LAWS.names())}", field="friction", value=key)
    law = LAWS.get(key)
    if law.key != key:
        raise InputError(f"the key of {law.__name__} is {law.key!r}; register it by that key",
                         field="friction", value=key)
    return law


class PerJointFriction:
    """One single-joint law per joint; torque ``(…, n)`` of velocity ``(…, n)`` like every friction model."""

    def __init__(self, laws: Sequence[FrictionModel]) -> None:
        if any(law.n != 1 for law in laws):
            raise ValueError("expected laws of one joint each")
        self.laws = tuple(laws)
        alike = dict[tuple[type[FrictionModel], bool, bool], list[int]]()
        for j, law in enumerate(self.laws):
            alike.setdefault((type(law), law.presliding, law.loaded), []).append(j)
        # Joints of the same law are computed at once.
        self._together = [(joints, kind(np.hstack([self.laws[j].coefficients for j in joints]),
                                        np.hstack([self.laws[j].shape for j in joints]), presliding=presliding,
                                        loaded=loaded))
                          for (kind, presliding, loaded), joints in alike.items()]

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.laws)

    def torque(self, qd: Array, load: Array | None = None, q: Array | None = None,
               direction: Array | None = None) -> Array:
        """Friction torque ``(…, n)`` [N m]; without presliding state zero at rest; see ``FrictionModel.torque``."""
        qd = np.asarray(qd, dtype=float)
        tau = np.empty(qd.shape)
        for joints, law in self._together:
            tau[..., joints] = law.torque(qd[..., joints], *(None if values is None else values[..., joints]
                                                             for values in (load, q, direction)))
        return tau

    @property
    def dry(self) -> Array:
        """Dry friction of an unloaded gear at standstill, mean of both directions ``(n,)`` [N m]; never negative."""
        creeping = np.full((2, self.n), CREEP) * np.array([[1.0], [-1.0]])
        return np.asarray(np.maximum(self.sizes(creeping)[0].mean(axis=0), 0.0))

    def sliding(self, q: Array, qd: Array) -> Array:
        """Direction of sliding ``(N, n)`` of joints with presliding; NaN for others.

        Positions ``q`` [rad] and velocities ``qd`` [rad/s] are consecutive in time.
        """
        result = np.full(np.shape(q), np.nan)
        for j, law in enumerate(self.laws):
            if law.presliding:
                result[:, [j]] = sliding_direction(q[:, [j]], qd[:, [j]], law.shape[-1])
        return result

    def direction(self, q: Array, qd: Array) -> Array:
        """Direction of sliding ``(N, n)``, -1 to 1: by ``sliding``, in other joints the sign of velocity."""
        sliding = self.sliding(q, qd)
        return np.where(np.isnan(sliding), np.sign(qd), sliding)

    def sizes(self, qd: Array, load: Array | None = None) -> tuple[Array, Array]:
        """Sizes of dry friction and of the rest ``(…, n)`` each [N m]; see ``FrictionModel.sizes``."""
        qd = np.asarray(qd, dtype=float)
        dry, fluid = np.empty(qd.shape), np.empty(qd.shape)
        for joints, law in self._together:
            dry[..., joints], fluid[..., joints] = law.sizes(qd[..., joints],
                                                             None if load is None else load[..., joints])
        return dry, fluid

    @property
    def distance(self) -> Array:
        """Presliding distance ``(n,)`` [rad]; 0 without presliding; see ``FrictionModel.distance``."""
        return np.concatenate([law.distance for law in self.laws])

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
