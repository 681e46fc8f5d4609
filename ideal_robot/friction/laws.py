"""The friction laws of [G] 3.1.1, and one with its own parameters in each direction."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.friction.base import FrictionModel


class ViscousCoulomb(FrictionModel):
    """[G] (1): ``a1 qd + a2 sign(qd)``.

    >>> ViscousCoulomb(np.array([[2.0], [0.5]])).torque(np.array([[-1.0], [0.0], [3.0]]))[:, 0]
    array([-2.5,  0. ,  6.5])
    """

    key = "viscous_coulomb"
    coefficient_names = ("Fv", "Fc")
    coefficient_units = ("{F} / ({v})", "{F}")

    @classmethod
    def columns(cls, qd: Array, direction: Array, shape: Array) -> list[Array]:
        """See ``FrictionModel.columns``."""
        return [qd, direction]


class CubeRoot(FrictionModel):
    """[G] (2): ``a1 qd + a2 sign(qd) + a3 qd^(1/3)``: degressive, yet linear in its parameters."""

    key = "cube_root"
    coefficient_names = ("a1", "a2", "a3")
    coefficient_units = ("{F} / ({v})", "{F}", "{F} / ({v})^(1/3)")

    @classmethod
    def columns(cls, qd: Array, direction: Array, shape: Array) -> list[Array]:
        """See ``FrictionModel.columns``."""
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
    shape_bounds: ClassVar[tuple[tuple[float, float], ...]] = ((1.0, 300.0),)

    @classmethod
    def columns(cls, qd: Array, direction: Array, shape: Array) -> list[Array]:
        """See ``FrictionModel.columns``."""
        return [qd, direction, np.arctan(shape[0] * qd)]


class Stribeck(FrictionModel):
    """[G] (4): ``a1 qd + a2 sign(qd) + a3 exp(-a4 |qd|) sign(qd)``: falls with speed at very low speed.

    [G] prints ``exp(-a4 qd)``, written for positive velocity; here it is odd like the other terms.
    """

    key = "stribeck"
    coefficient_names = ("a1", "a2", "a3")
    coefficient_units = ("{F} / ({v})", "{F}", "{F}")
    shape_names = ("a4",)
    shape_units = ("1 / ({v})",)
    shape_bounds: ClassVar[tuple[tuple[float, float], ...]] = ((1.0, 1000.0),)

    @classmethod
    def columns(cls, qd: Array, direction: Array, shape: Array) -> list[Array]:
        """See ``FrictionModel.columns``."""
        return [qd, direction, np.exp(-shape[0] * np.abs(qd)) * direction]


class Asymmetric(FrictionModel):
    """[G] (1) with its own parameters in each direction, all positive where they brake."""

    key = "asymmetric"
    coefficient_names = ("Fv+", "Fc+", "Fv-", "Fc-")
    coefficient_units = ("{F} / ({v})", "{F}", "{F} / ({v})", "{F}")

    @classmethod
    def columns(cls, qd: Array, direction: Array, shape: Array) -> list[Array]:
        """See ``FrictionModel.columns``."""
        forward = qd > 0
        return [qd * forward, np.maximum(direction, 0.0), qd * ~forward, np.minimum(direction, 0.0)]
