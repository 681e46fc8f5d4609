"""Effects of the trials that the library of effects has too, in formulas of their own."""

from __future__ import annotations

import dataclasses

import numpy as np

from trials.strangers import drive
from trials.strangers.arm import sliding
from trials.strangers.drawn_effect import Draw, Drawn, Setup, in_drive, in_proportion, span
from trials.strangers.plant import DAHL, BalanceSpring, Coupling


def degressive(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """Friction that rises ever less with speed: ``D v/(v0 + |v|)``.

    Args:
        rng: source of the draw.
        s: plant and logger that get the effect.
        j: joint, from 0.
    """
    return in_drive("degressive", j, {drive.DEGRESSIVE: 0.1 * s.plant.arm.need[j]},
                    {drive.V_DEGRESSIVE: s.plant.arm.fast[j] * rng.uniform(0.05, 0.2)})


def stribeck(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """Dry friction larger at standstill, of one of three shapes.

    Args:
        rng: source of the draw.
        s: plant and logger that get the effect.
        j: joint, from 0.
    """
    return in_drive("stribeck", j, {drive.SURPLUS: 0.1 * s.plant.arm.need[j]},
                    {drive.V_SURPLUS: s.plant.arm.fast[j] * rng.uniform(0.05, 0.2),
                     drive.SURPLUS_SHAPE: float(rng.choice([0.0, 1.0, 2.0]))})


def asymmetric_friction(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """More viscous friction in one direction.

    Args:
        rng: source of the draw.
        s: plant and logger that get the effect.
        j: joint, from 0.
    """
    side = 0.1 * s.plant.arm.need[j] / s.plant.arm.fast[j]
    return in_drive("asymmetric_friction", j, {drive.VISCOUS_SIDE: side}, {},
                    values=in_proportion("asymmetric_friction", j, "half difference of viscous friction", 0.5 * side))


def load_dependent_friction(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """Teeth pressed together by the load.

    Args:
        rng: source of the draw.
        s: plant and logger that get the effect.
        j: joint, from 0.
    """
    return in_drive("load_dependent_friction", j, {drive.LOAD: 0.05}, {}, 12.0,
                    in_proportion("load_dependent_friction", j, "friction per load", 0.05))


def thermal_drift(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """Friction falls while the gear warms up.

    Args:
        rng: source of the draw.
        s: plant and logger that get the effect.
        j: joint, from 0.
    """
    return in_drive("thermal_drift", j, {drive.DRY_THERMAL: 0.2, drive.VISCOUS_THERMAL: 0.2},
                    {drive.THERMAL_TIME: float(rng.uniform(8.0, 30.0))}, 4.0)


def torque_ripple(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """A tooth frequency and a little of its double.

    Args:
        rng: source of the draw.
        s: plant and logger that get the effect.
        j: joint, from 0.
    """
    order = 2.0 * np.pi * rng.uniform(8.0, 50.0) / span(s, j)
    size = 0.03 * s.plant.arm.need[j]
    return in_drive("torque_ripple", j, {drive.RIPPLE: size},
                    {drive.RIPPLE_ORDER: order, drive.PHASE: float(rng.uniform(0, 6.28))},
                    values=lambda x: {("torque_ripple", j + 1, "amplitude"): x * size,
                                      ("torque_ripple", j + 1, "order"): order})


def cable_spring(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """A hose pack; a tendon where the engine has such.

    Args:
        rng: source of the draw.
        s: plant and logger that get the effect.
        j: joint, from 0.
    """
    k = 0.2 * s.plant.arm.need[j] / span(s, j)
    return in_drive("cable_spring", j, {drive.CABLE: k},
                    {drive.CABLE_REST: 0.5 * float(s.plant.arm.high[j] + s.plant.arm.low[j])},
                    values=in_proportion("cable_spring", j, "stiffness", k))


def gravity_spring(rng: np.random.Generator, s: Setup, j: int) -> Drawn | None:
    """A preloaded spring between two links, where there is gravity to balance; a tendon where the engine has such.

    Args:
        rng: source of the draw.
        s: plant and logger that get the effect.
        j: joint, from 0.
    """
    if sliding(s.plant.model)[j] or not _carries(s, j):
        return None
    rest, angle, k = float(rng.uniform(0.1, 0.25)), float(rng.uniform(-np.pi, np.pi)), 1.0 * s.plant.arm.need[j]

    def apply(setup: Setup, size: float) -> Setup:
        spring = BalanceSpring(j, size * k, rest, 0.5, 0.2, angle)
        balancers = (*setup.plant.balancers, spring)
        return dataclasses.replace(setup, plant=dataclasses.replace(setup.plant, balancers=balancers))

    return Drawn("gravity_spring", j + 1, apply)


def _carries(s: Setup, j: int) -> bool:
    """Whether gravity asks of a joint what a balancer would be mounted for: a tenth of what motions ask of it."""
    arm = s.plant.arm
    places = [arm.low + share * (arm.high - arm.low) for share in np.linspace(0.0, 1.0, 9)]
    return bool(max(abs(s.plant.holding(q)[j]) for q in places) > 0.1 * arm.need[j])


def axis_coupling(rng: np.random.Generator, s: Setup, j: int) -> Drawn | None:
    """A shaft that turns with the axis before as well, with inertia and friction of its own; wrists most of all.

    Args:
        rng: source of the draw.
        s: plant and logger that get the effect.
        j: joint, from 0.
    """
    if j == 0:
        return None
    p = s.plant
    inertia, viscous, dry = 0.3 * p.rotor[j], 0.5 * p.block[drive.VISCOUS, j], 0.4 * p.block[drive.COULOMB, j]
    sense = float(rng.choice([-1.0, 1.0]))

    def apply(setup: Setup, size: float) -> Setup:
        shaft = Coupling(j, j - 1, sense, size * inertia, size * viscous, size * dry)
        couplings = (*setup.plant.couplings, shaft)
        return dataclasses.replace(setup, plant=dataclasses.replace(setup.plant, couplings=couplings))

    return Drawn("axis_coupling", j + 1, apply)


def joint_elasticity(rng: np.random.Generator, s: Setup, j: int) -> Drawn | None:
    """One soft gear among rigid ones.

    Args:
        rng: source of the draw.
        s: plant and logger that get the effect.
        j: joint, from 0.
    """
    if s.plant.elastic.any():
        return None
    k = (2.0 * np.pi * 30.0) ** 2 * max(s.plant.arm.mass[j], 0.2 * s.plant.rotor[j])

    def apply(setup: Setup, size: float) -> Setup:
        stiffness, damping = setup.plant.stiffness.copy(), setup.plant.damping.copy()
        stiffness[j] = k / size
        damping[j] = 0.12 * np.sqrt(stiffness[j] * max(s.plant.arm.mass[j], 0.2 * s.plant.rotor[j]))
        return dataclasses.replace(setup, plant=dataclasses.replace(setup.plant, stiffness=stiffness, damping=damping))

    return Drawn("joint_elasticity", j + 1, apply, 20.0,
                 lambda size: {("joint_elasticity", j + 1, "stiffness"): k / size})


def backlash(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """Play of one gear.

    Args:
        rng: source of the draw.
        s: plant and logger that get the effect.
        j: joint, from 0.
    """
    def apply(setup: Setup, size: float) -> Setup:
        gap = setup.plant.gap.copy()
        gap[j] = size * 5e-4
        return dataclasses.replace(setup, plant=dataclasses.replace(setup.plant, gap=gap))

    return Drawn("backlash", j + 1, apply, 20.0, lambda size: {("backlash", j + 1, "half gap"): 2.5e-4 * size})


def presliding_hysteresis(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """Dry friction that builds up over a long way after a reversal.

    Args:
        rng: source of the draw.
        s: plant and logger that get the effect.
        j: joint, from 0.
    """
    unit = 0.003 * span(s, j)

    def apply(setup: Setup, size: float) -> Setup:
        way, kinds = setup.plant.presliding.copy(), setup.plant.regularisation.copy()
        way[j], kinds[j] = size * unit, DAHL
        return dataclasses.replace(setup, plant=dataclasses.replace(setup.plant, presliding=way, regularisation=kinds))

    return Drawn("presliding_hysteresis", j + 1, apply, 20.0, in_proportion("presliding_hysteresis", j, "sigma", unit))


def dead_time(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """One drive whose torque reaches the logger late.

    Args:
        rng: source of the draw.
        s: plant and logger that get the effect.
        j: joint, from 0.
    """
    def apply(setup: Setup, size: float) -> Setup:
        delay = setup.logger.delay.copy()
        delay[j] = size * 2e-3
        return dataclasses.replace(setup, logger=dataclasses.replace(setup.logger, delay=delay))

    return Drawn("dead_time", j + 1, apply, 15.0, in_proportion("dead_time", j, "delay", 2e-3))


INSIDE: dict[str, Draw] = {f.__name__: f for f in (
    degressive, stribeck, asymmetric_friction, load_dependent_friction, thermal_drift, torque_ripple, cable_spring,
    gravity_spring, axis_coupling, joint_elasticity, backlash, presliding_hysteresis, dead_time)}
