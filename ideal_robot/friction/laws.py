"""The friction laws of [G] 3.1.1 and their asymmetric and load-dependent forms."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from ideal_robot.friction.base import FrictionModel
from ideal_robot.interface import Array


class ViscousCoulomb(FrictionModel):
    """[G] (1): ``a1 qd + a2 sign(qd)``."""

    key = "viscous_coulomb"
    coefficient_names = ("Fv", "Fc")
    coefficient_units = ("{F} / ({v})", "{F}")

    @classmethod
    def columns(cls, qd: Array, shape: Array, load: Array | None = None) -> list[Array]:
        return [qd, np.sign(qd)]


class CubeRoot(FrictionModel):
    """[G] (2): ``a1 qd + a2 sign(qd) + a3 qd^(1/3)``: degressive, yet linear in its parameters."""

    key = "cube_root"
    coefficient_names = ("a1", "a2", "a3")
    coefficient_units = ("{F} / ({v})", "{F}", "{F} / ({v})^(1/3)")

    @classmethod
    def columns(cls, qd: Array, shape: Array, load: Array | None = None) -> list[Array]:
        return [qd, np.sign(qd), np.cbrt(qd)]


class Arctan(FrictionModel):
    """[G] (3): ``a1 qd + a2 sign(qd) + a3 arctan(a4 qd)``: degressive, saturating."""

    key = "arctan"
    coefficient_names = ("a1", "a2", "a3")
    coefficient_units = ("{F} / ({v})", "{F}", "{F}")
    shape_names = ("a4",)
    shape_units = ("1 / ({v})",)
    shape_bounds: ClassVar[tuple[tuple[float, float], ...]] = ((0.3, 300.0),)

    @classmethod
    def columns(cls, qd: Array, shape: Array, load: Array | None = None) -> list[Array]:
        return [qd, np.sign(qd), np.arctan(shape[0] * qd)]


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
    def columns(cls, qd: Array, shape: Array, load: Array | None = None) -> list[Array]:
        sign = np.sign(qd)
        return [qd, sign, np.exp(-shape[0] * np.abs(qd)) * sign]


class Asymmetric(FrictionModel):
    """[G] (1) with its own parameters in each direction, all positive where they brake."""

    key = "asymmetric"
    coefficient_names = ("Fv+", "Fc+", "Fv-", "Fc-")
    coefficient_units = ("{F} / ({v})", "{F}", "{F} / ({v})", "{F}")

    @classmethod
    def columns(cls, qd: Array, shape: Array, load: Array | None = None) -> list[Array]:
        forward, backward = np.asarray(qd > 0, dtype=float), np.asarray(qd < 0, dtype=float)
        return [qd * forward, forward, qd * backward, -backward]


class LoadDependent(FrictionModel):
    """[G] (3) plus dry friction in proportion to the load the gear transmits: ``a5 |load| sign(qd)``.

    Tooth forces grow with the transmitted torque and rub in proportion; harmonic drives show it clearly.
    """

    key = "load_dependent"
    coefficient_names = ("a1", "a2", "a3", "a5")
    coefficient_units = ("{F} / ({v})", "{F}", "{F}", "1")
    shape_names = ("a4",)
    shape_units = ("1 / ({v})",)
    shape_bounds: ClassVar[tuple[tuple[float, float], ...]] = ((0.3, 300.0),)
    needs_load = True

    @classmethod
    def columns(cls, qd: Array, shape: Array, load: Array | None = None) -> list[Array]:
        sign = np.sign(qd)
        size = np.zeros_like(qd) if load is None else np.abs(load)
        return [qd, sign, np.arctan(shape[0] * qd), size * sign]
