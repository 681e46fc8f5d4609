"""Effects of the trials that the library has too, in formulas of their own, and what draws of effects share.

Sizes are relative to a drive: ``size = 1`` is a guess that is scaled afterwards until the recording shows the size that
was drawn (see ``logger.sizes``).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from studies.strangers import drive
from studies.strangers.arm import sliding
from studies.strangers.logger import Logger
from studies.strangers.plant import DAHL, BalanceSpring, Coupling, Plant

Values = dict[tuple[str, int, str], float]


@dataclass(frozen=True)
class Setup:
    """A plant and what records it."""

    plant: Plant
    logger: Logger

    def with_plant(self, **changes: Any) -> Setup:
        """The same with other values in the plant."""
        return Setup(replace(self.plant, **changes), self.logger)

    def with_logger(self, **changes: Any) -> Setup:
        """The same with other values in the logger."""
        return Setup(self.plant, replace(self.logger, **changes))


@dataclass(frozen=True)
class Drawn:
    """An effect with everything drawn but its size.

    Attributes:
        name: of the effect; for those outside the library a name of its own.
        joint: from 1; 0 for the whole arm.
        apply: the setup with the effect at a size.
        largest: size beyond which it would be another arm.
        values: at a size, the true numbers of the library's parameters by effect, joint, parameter.
    """

    name: str
    joint: int
    apply: Callable[[Setup, float], Setup]
    largest: float = np.inf
    values: Callable[[float], Values] = lambda size: {}


Draw = Callable[[np.random.Generator, Setup, int], Drawn | None]
"""``(rng, setup, j)`` → an effect at joint ``j`` (from 0) of a setup; None where that joint or plant cannot have it."""


def rows(setup: Setup, j: int, size: float, scaled: dict[int, float], fixed: dict[int, float]) -> Setup:
    """The setup with other numbers in the drive of one joint.

    Args:
        setup: plant and logger.
        j: joint, from 0.
        size: of the effect; 1 is a guess.
        scaled: what is added to a row of the parameter block at size 1, in the row's unit.
        fixed: what a row is set to whatever the size, in the row's unit.
    """
    block = setup.plant.block.copy()
    for row, value in scaled.items():
        block[row, j] += size * value
    for row, value in fixed.items():
        block[row, j] = value
    return setup.with_plant(block=block)


def in_drive(name: str, j: int, scaled: dict[int, float], fixed: dict[int, float], largest: float = np.inf,
             values: Callable[[float], Values] = lambda size: {}) -> Drawn:
    """An effect in the drive of one joint.

    Args:
        name: of the effect.
        j: joint, from 0.
        scaled: see ``rows``.
        fixed: see ``rows``.
        largest: size beyond which it would be another arm.
        values: at a size, the true numbers of the library's parameters.
    """
    return Drawn(name, j + 1, lambda setup, size: rows(setup, j, size, scaled, fixed), largest, values)


def span(s: Setup, j: int) -> float:
    """Range of a joint, counted from 0 [rad, or m]."""
    return float(s.plant.arm.high[j] - s.plant.arm.low[j])


def in_proportion(name: str, j: int, parameter: str, factor: float) -> Callable[[float], Values]:
    """The true number of one parameter that grows with the size.

    Args:
        name: of the effect.
        j: joint, from 0.
        parameter: its name in the library.
        factor: its value at size 1, in the parameter's unit.
    """
    return lambda size: {(name, j + 1, parameter): factor * size}


def _degressive(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """Friction that rises ever less with speed: ``D v/(v0 + |v|)``."""
    return in_drive("degressive", j, {drive.DEGRESSIVE: 0.1 * s.plant.arm.need[j]},
                    {drive.V_DEGRESSIVE: s.plant.arm.fast[j] * rng.uniform(0.05, 0.2)})


def _stribeck(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """Dry friction larger at standstill, of one of three shapes."""
    return in_drive("stribeck", j, {drive.SURPLUS: 0.1 * s.plant.arm.need[j]},
                    {drive.V_SURPLUS: s.plant.arm.fast[j] * rng.uniform(0.05, 0.2),
                     drive.SURPLUS_SHAPE: float(rng.choice([0.0, 1.0, 2.0]))})


def _asymmetric_friction(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """More viscous friction in one direction."""
    side = 0.1 * s.plant.arm.need[j] / s.plant.arm.fast[j]
    return in_drive("asymmetric_friction", j, {drive.VISCOUS_SIDE: side}, {},
                    values=in_proportion("asymmetric_friction", j, "half difference of viscous friction", 0.5 * side))


def _load_dependent_friction(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """Teeth pressed together by the load."""
    return in_drive("load_dependent_friction", j, {drive.LOAD: 0.05}, {}, 12.0,
                    in_proportion("load_dependent_friction", j, "friction per load", 0.05))


def _thermal_drift(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """Friction falls while the gear warms up."""
    return in_drive("thermal_drift", j, {drive.DRY_THERMAL: 0.2, drive.VISCOUS_THERMAL: 0.2},
                    {drive.THERMAL_TIME: float(rng.uniform(8.0, 30.0))}, 4.0)


def _torque_ripple(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """A tooth frequency and a little of its double."""
    order = 2.0 * np.pi * rng.uniform(8.0, 50.0) / span(s, j)
    size = 0.03 * s.plant.arm.need[j]
    return in_drive("torque_ripple", j, {drive.RIPPLE: size},
                    {drive.RIPPLE_ORDER: order, drive.PHASE: float(rng.uniform(0, 6.28))},
                    values=lambda x: {("torque_ripple", j + 1, "amplitude"): x * size,
                                      ("torque_ripple", j + 1, "order"): order})


def _cable_spring(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """A hose pack; a tendon where the engine has such."""
    k = 0.2 * s.plant.arm.need[j] / span(s, j)
    return in_drive("cable_spring", j, {drive.CABLE: k},
                    {drive.CABLE_REST: 0.5 * float(s.plant.arm.high[j] + s.plant.arm.low[j])},
                    values=in_proportion("cable_spring", j, "stiffness", k))


def _gravity_spring(rng: np.random.Generator, s: Setup, j: int) -> Drawn | None:
    """A preloaded spring between two links, where there is gravity to balance; a tendon where the engine has such."""
    if sliding(s.plant.model)[j] or not _carries(s, j):
        return None
    rest, angle, k = float(rng.uniform(0.1, 0.25)), float(rng.uniform(-np.pi, np.pi)), 1.0 * s.plant.arm.need[j]

    def apply(setup: Setup, size: float) -> Setup:
        spring = BalanceSpring(j, size * k, rest, 0.5, 0.2, angle)
        balancers = (*setup.plant.balancers, spring)
        return setup.with_plant(balancers=balancers)

    return Drawn("gravity_spring", j + 1, apply)


def _carries(s: Setup, j: int) -> bool:
    """Whether gravity asks of a joint what a balancer would be mounted for: a tenth of what motions ask of it."""
    arm = s.plant.arm
    places = [arm.low + share * (arm.high - arm.low) for share in np.linspace(0.0, 1.0, 9)]
    return bool(max(abs(s.plant.holding(q)[j]) for q in places) > 0.1 * arm.need[j])


def _axis_coupling(rng: np.random.Generator, s: Setup, j: int) -> Drawn | None:
    """A shaft that turns with the axis before as well, with inertia and friction of its own; wrists most of all."""
    if j == 0:
        return None
    p = s.plant
    inertia, viscous, dry = 0.3 * p.rotor[j], 0.5 * p.block[drive.VISCOUS, j], 0.4 * p.block[drive.COULOMB, j]
    sense = float(rng.choice([-1.0, 1.0]))

    def apply(setup: Setup, size: float) -> Setup:
        shaft = Coupling(j, j - 1, sense, size * inertia, size * viscous, size * dry)
        couplings = (*setup.plant.couplings, shaft)
        return setup.with_plant(couplings=couplings)

    return Drawn("axis_coupling", j + 1, apply)


def _joint_elasticity(rng: np.random.Generator, s: Setup, j: int) -> Drawn | None:
    """One soft gear among rigid ones."""
    if s.plant.elastic.any():
        return None
    k = (2.0 * np.pi * 30.0) ** 2 * max(s.plant.arm.mass[j], 0.2 * s.plant.rotor[j])

    def apply(setup: Setup, size: float) -> Setup:
        stiffness, damping = setup.plant.stiffness.copy(), setup.plant.damping.copy()
        stiffness[j] = k / size
        damping[j] = 0.12 * np.sqrt(stiffness[j] * max(s.plant.arm.mass[j], 0.2 * s.plant.rotor[j]))
        return setup.with_plant(stiffness=stiffness, damping=damping)

    return Drawn("joint_elasticity", j + 1, apply, 20.0,
                 lambda size: {("joint_elasticity", j + 1, "stiffness"): k / size})


def _backlash(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """Play of one gear."""
    def apply(setup: Setup, size: float) -> Setup:
        gap = setup.plant.gap.copy()
        gap[j] = size * 5e-4
        return setup.with_plant(gap=gap)

    return Drawn("backlash", j + 1, apply, 20.0, lambda size: {("backlash", j + 1, "half gap"): 2.5e-4 * size})


def _presliding_hysteresis(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """Dry friction that builds up over a long way after a reversal."""
    unit = 0.003 * span(s, j)

    def apply(setup: Setup, size: float) -> Setup:
        presliding, kinds = setup.plant.presliding.copy(), setup.plant.regularisation.copy()
        presliding[j], kinds[j] = size * unit, DAHL
        return setup.with_plant(presliding=presliding, regularisation=kinds)

    return Drawn("presliding_hysteresis", j + 1, apply, 20.0, in_proportion("presliding_hysteresis", j, "sigma", unit))


def _dead_time(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """One drive whose torque reaches the logger late."""
    def apply(setup: Setup, size: float) -> Setup:
        delay = setup.logger.delay.copy()
        delay[j] = size * 2e-3
        return setup.with_logger(delay=delay)

    return Drawn("dead_time", j + 1, apply, 15.0, in_proportion("dead_time", j, "delay", 2e-3))


INSIDE: dict[str, Draw] = {f.__name__[1:]: f for f in (
    _degressive, _stribeck, _asymmetric_friction, _load_dependent_friction, _thermal_drift, _torque_ripple,
    _cable_spring, _gravity_spring, _axis_coupling, _joint_elasticity, _backlash, _presliding_hysteresis, _dead_time)}


def _transmission_error(rng: np.random.Generator, s: Setup, j: int) -> Drawn | None:
    """A gear that turns unevenly, where the arm's angle is recorded."""
    if j not in s.logger.qa:
        return None
    order, phase = 2.0 * np.pi * rng.uniform(6.0, 40.0) / span(s, j), float(rng.uniform(0.0, 6.28))

    def apply(setup: Setup, size: float) -> Setup:
        uneven = setup.logger.uneven.copy()
        uneven[:, j] = size * 2e-5, order, phase
        return setup.with_logger(uneven=uneven)

    return Drawn("transmission_error", j + 1, apply)


def _arm_delay(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """All arm-side encoders are late by one clock."""
    def apply(setup: Setup, size: float) -> Setup:
        return setup.with_logger(qa_delay=size * 1e-4)

    return Drawn("arm_delay", 0, apply, 100.0)


ARM: dict[str, Draw] = {f.__name__[1:]: f for f in (_transmission_error, _arm_delay)}
