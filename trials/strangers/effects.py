"""Effects of the trials: how each changes the plant or the logger, and what may be said of it.

Sizes are relative to a drive: ``size = 1`` is a guess that is scaled afterwards until the recording shows the size that
was drawn (see ``visible``).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from trials.strangers import drive
from trials.strangers.arm import joint_axes, sliding
from trials.strangers.logger import Logger
from trials.strangers.plant import DAHL, BalanceSpring, Coupling, Plant

Values = dict[tuple[str, int, str], float]


@dataclass(frozen=True)
class Setup:
    """A plant and what records it."""

    plant: Plant
    logger: Logger


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
"""Draws an effect at a joint (from 0); None where that joint or plant cannot have it."""


def _rows(setup: Setup, j: int, size: float, scaled: dict[int, float], fixed: dict[int, float]) -> Setup:
    block = setup.plant.block.copy()
    for row, value in scaled.items():
        block[row, j] += size * value
    for row, value in fixed.items():
        block[row, j] = value
    return dataclasses.replace(setup, plant=dataclasses.replace(setup.plant, block=block))


def _in_drive(name: str, j: int, scaled: dict[int, float], fixed: dict[int, float], largest: float = np.inf,
              values: Callable[[float], Values] = lambda size: {}) -> Drawn:
    return Drawn(name, j + 1, lambda setup, size: _rows(setup, j, size, scaled, fixed), largest, values)


def _span(s: Setup, j: int) -> float:
    return float(s.plant.arm.high[j] - s.plant.arm.low[j])


def _one(name: str, j: int, parameter: str, factor: float) -> Callable[[float], Values]:
    return lambda size: {(name, j + 1, parameter): factor * size}


# -- of the library --------------------------------------------------------------------------------------------------


def degressive(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """Friction that rises ever less with speed: ``D v/(v0 + |v|)``."""
    return _in_drive("degressive", j, {drive.DEGRESSIVE: 0.1 * s.plant.arm.need[j]},
                     {drive.V_DEGRESSIVE: s.plant.arm.fast[j] * rng.uniform(0.05, 0.2)})


def stribeck(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """Dry friction larger at standstill, of one of three shapes."""
    return _in_drive("stribeck", j, {drive.SURPLUS: 0.1 * s.plant.arm.need[j]},
                     {drive.V_SURPLUS: s.plant.arm.fast[j] * rng.uniform(0.05, 0.2),
                      drive.SURPLUS_SHAPE: float(rng.choice([0.0, 1.0, 2.0]))})


def asymmetric_friction(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """More viscous friction in one direction."""
    side = 0.1 * s.plant.arm.need[j] / s.plant.arm.fast[j]
    return _in_drive("asymmetric_friction", j, {drive.VISCOUS_SIDE: side}, {},
                     values=_one("asymmetric_friction", j, "half difference of viscous friction", 0.5 * side))


def load_dependent_friction(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """Teeth pressed together by the load."""
    return _in_drive("load_dependent_friction", j, {drive.LOAD: 0.05}, {}, 12.0,
                     _one("load_dependent_friction", j, "friction per load", 0.05))


def thermal_drift(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """Friction falls while the gear warms up."""
    return _in_drive("thermal_drift", j, {drive.DRY_THERMAL: 0.2, drive.VISCOUS_THERMAL: 0.2},
                     {drive.THERMAL_TIME: float(rng.uniform(8.0, 30.0))}, 4.0)


def torque_ripple(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """A tooth frequency and a little of its double."""
    order = 2.0 * np.pi * rng.uniform(8.0, 50.0) / _span(s, j)
    size = 0.03 * s.plant.arm.need[j]
    return _in_drive("torque_ripple", j, {drive.RIPPLE: size},
                     {drive.RIPPLE_ORDER: order, drive.PHASE: float(rng.uniform(0, 6.28))},
                     values=lambda x: {("torque_ripple", j + 1, "amplitude"): x * size,
                                       ("torque_ripple", j + 1, "order"): order})


def cable_spring(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """A hose pack; a tendon where the engine has such."""
    k = 0.2 * s.plant.arm.need[j] / _span(s, j)
    return _in_drive("cable_spring", j, {drive.CABLE: k},
                     {drive.CABLE_REST: 0.5 * float(s.plant.arm.high[j] + s.plant.arm.low[j])},
                     values=_one("cable_spring", j, "stiffness", k))


def gravity_spring(rng: np.random.Generator, s: Setup, j: int) -> Drawn | None:
    """A preloaded spring between two links; a spatial tendon where the engine has such."""
    if sliding(s.plant.model)[j]:
        return None
    rest, angle, k = float(rng.uniform(0.1, 0.25)), float(rng.uniform(-np.pi, np.pi)), 1.0 * s.plant.arm.need[j]

    def apply(setup: Setup, size: float) -> Setup:
        spring = BalanceSpring(j, size * k, rest, 0.5, 0.2, angle)
        return dataclasses.replace(setup, plant=dataclasses.replace(setup.plant, spring=spring))

    return Drawn("gravity_spring", j + 1, apply)


def axis_coupling(rng: np.random.Generator, s: Setup, j: int) -> Drawn | None:
    """A shaft that turns with the axis before as well, with inertia and friction of its own; wrists most of all."""
    if j == 0:
        return None
    p = s.plant
    inertia, viscous, dry = 0.3 * p.rotor[j], 0.5 * p.block[drive.VISCOUS, j], 0.4 * p.block[drive.COULOMB, j]
    sense = float(rng.choice([-1.0, 1.0]))

    def apply(setup: Setup, size: float) -> Setup:
        shaft = Coupling(j, j - 1, sense, size * inertia, size * viscous, size * dry)
        return dataclasses.replace(setup, plant=dataclasses.replace(setup.plant, coupling=shaft))

    return Drawn("axis_coupling", j + 1, apply)


def joint_elasticity(rng: np.random.Generator, s: Setup, j: int) -> Drawn | None:
    """One soft gear among rigid ones."""
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
    """Play of one gear."""
    def apply(setup: Setup, size: float) -> Setup:
        gap = setup.plant.gap.copy()
        gap[j] = size * 5e-4
        return dataclasses.replace(setup, plant=dataclasses.replace(setup.plant, gap=gap))

    return Drawn("backlash", j + 1, apply, 20.0, lambda size: {("backlash", j + 1, "half gap"): 2.5e-4 * size})


def presliding_hysteresis(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """Dry friction that builds up over a long way after a reversal."""
    unit = 0.003 * _span(s, j)

    def apply(setup: Setup, size: float) -> Setup:
        way, kinds = setup.plant.presliding.copy(), setup.plant.regularisation.copy()
        way[j], kinds[j] = size * unit, DAHL
        return dataclasses.replace(setup, plant=dataclasses.replace(setup.plant, presliding=way, regularisation=kinds))

    return Drawn("presliding_hysteresis", j + 1, apply, 20.0, _one("presliding_hysteresis", j, "sigma", unit))


def dead_time(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """One drive whose torque reaches the logger late."""
    def apply(setup: Setup, size: float) -> Setup:
        delay = setup.logger.delay.copy()
        delay[j] = size * 2e-3
        return dataclasses.replace(setup, logger=dataclasses.replace(setup.logger, delay=delay))

    return Drawn("dead_time", j + 1, apply, 15.0, _one("dead_time", j, "delay", 2e-3))


# -- new causes ------------------------------------------------------------------------------------------------------


def base_tilt(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """The base is not upright: gravity comes from elsewhere."""
    across = float(rng.uniform(0.0, 2.0 * np.pi))
    axis = np.array([np.cos(across), np.sin(across), 0.0])

    def apply(setup: Setup, size: float) -> Setup:
        model = setup.plant.model.copy()
        tilted = pin.exp3(np.deg2rad(size) * axis) @ model.gravity.linear
        model.gravity.linear = tilted
        return dataclasses.replace(setup, plant=dataclasses.replace(setup.plant, model=model))

    return Drawn("base_tilt", 0, apply, 8.0, lambda size: {("base_tilt", 0, "angle"): float(np.deg2rad(size))})


def torque_filter(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """All torques pass one more filter before they are logged."""
    def apply(setup: Setup, size: float) -> Setup:
        return dataclasses.replace(setup, logger=dataclasses.replace(setup.logger, lag=size * 3e-3))

    return Drawn("torque_filter", 0, apply, 12.0, lambda size: {("torque_filter", 0, "time constant"): 3e-3 * size})


def zero_error(rng: np.random.Generator, s: Setup, j: int) -> Drawn | None:
    """The joint's zero is elsewhere than the controller thinks; gravity betrays it."""
    if sliding(s.plant.model)[j]:
        return None
    turn = float(rng.choice([-1.0, 1.0])) * np.deg2rad(0.5)
    axis = joint_axes(s.plant.model)[j, 3:]

    def apply(setup: Setup, size: float) -> Setup:
        model = setup.plant.model.copy()
        model.jointPlacements[j + 1] = model.jointPlacements[j + 1] * pin.SE3(pin.exp3(size * turn * axis), np.zeros(3))
        return dataclasses.replace(setup, plant=dataclasses.replace(setup.plant, model=model))

    return Drawn("zero_error", j + 1, apply, 10.0, _one("zero_error", j, "angle", turn))


def load_direction_friction(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """The gear loses more where the motor drives the load than where the load drives the motor."""
    return _in_drive("load_direction_friction", j, {drive.DRIVING: 0.05}, {}, 12.0)


# -- outside the library ---------------------------------------------------------------------------------------------


def angle_drag(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """Dry friction that grows with another joint's angle beyond some place."""
    other = int(rng.choice([i for i in range(s.plant.n) if i != j]))
    arm = s.plant.arm
    return _in_drive("angle_drag", j, {drive.DRAG: 0.5 * arm.need[j] / _span(s, other)},
                     {drive.DRAG_AXIS: other, drive.DRAG_FROM: 0.5 * float(arm.low[other] + arm.high[other]),
                      drive.DRAG_SIDE: float(rng.choice([-1.0, 1.0]))})


def place_friction(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """Dry friction that differs from place to place."""
    return _in_drive("place_friction", j, {drive.PLACE: 0.1 * s.plant.arm.need[j]},
                     {drive.PLACE_ORDER: 2.0 * np.pi * rng.uniform(1.0, 3.0) / _span(s, j),
                      drive.PHASE: float(rng.uniform(0, 6.28))})


def hose_pull(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """A hose that pulls only beyond some angle."""
    arm, side = s.plant.arm, float(rng.choice([-1.0, 1.0]))
    start = 0.5 * float(arm.low[j] + arm.high[j]) + side * rng.uniform(0.0, 0.2) * _span(s, j)
    return _in_drive("hose_pull", j, {drive.HOSE: 1.0 * arm.need[j] / _span(s, j)},
                     {drive.HOSE_FROM: start, drive.HOSE_SIDE: side})


def bump(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """A torque at one place, of odd shape."""
    return _in_drive("bump", j, {drive.BUMP: 0.1 * s.plant.arm.need[j]},
                     {drive.BUMP_AT: float(s.plant.arm.low[j] + rng.uniform(0.35, 0.65) * _span(s, j)),
                      drive.BUMP_WIDTH: rng.uniform(0.06, 0.15) * _span(s, j)})


def time_disturbance(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """A torque periodic in time, whatever the arm does."""
    return _in_drive("time_disturbance", j, {drive.PULSE: 0.08 * s.plant.arm.need[j]},
                     {drive.PULSE_RATE: float(rng.uniform(0.05, 0.8)), drive.PHASE: float(rng.uniform(0, 6.28))})


# -- against a model known before ------------------------------------------------------------------------------------


def _loaded(setup: Setup, joint: int, mass: float, centre: np.ndarray) -> Setup:
    model = setup.plant.model.copy()
    model.inertias[joint] = model.inertias[joint] + pin.Inertia(mass, centre, np.eye(3) * mass * 0.04**2)
    return dataclasses.replace(setup, plant=dataclasses.replace(setup.plant, model=model))


def payload(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """A body on the flange."""
    last = s.plant.n
    unit, centre = 0.3 * s.plant.model.inertias[last].mass, rng.uniform(-0.1, 0.15, 3)
    return Drawn("payload", 0, lambda setup, size: _loaded(setup, last, size * unit, centre), 15.0,
                 lambda size: {("payload", 0, "mass"): size * unit,
                               **{("payload", 0, f"c_{a}"): float(c) for a, c in zip("xyz", centre, strict=True)}})


def link_load(rng: np.random.Generator, s: Setup, j: int) -> Drawn | None:
    """A body on an inner link."""
    if j >= s.plant.n - 1:
        return None
    unit, centre = 0.1 * s.plant.model.inertias[j + 1].mass, rng.uniform(-0.15, 0.2, 3)
    return Drawn("link_load", j + 1, lambda setup, size: _loaded(setup, j + 1, size * unit, centre), 15.0,
                 lambda size: {("link_load", j + 1, "mass"): size * unit})


def viscous(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """More viscous friction than before."""
    unit = 0.3 * float(s.plant.block[drive.VISCOUS, j])
    return _in_drive("viscous", j, {drive.VISCOUS: unit}, {},
                     values=_one("viscous", j, "change of viscous friction", unit))


def coulomb(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """More dry friction than before."""
    unit = 0.3 * float(s.plant.block[drive.COULOMB, j])
    return _in_drive("coulomb", j, {drive.COULOMB: unit}, {},
                     values=_one("coulomb", j, "change of Coulomb friction", unit))


def current_offset(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """The zero of the current measurement moved."""
    unit = 0.1 * float(s.plant.arm.need[j]) * float(rng.choice([-1.0, 1.0]))
    return _in_drive("current_offset", j, {drive.OFFSET: unit}, {}, values=_one("current_offset", j, "offset", unit))


def drive_gain(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """More or less torque per ampere than before."""
    unit = 0.06 * float(rng.choice([-1.0, 1.0]))
    return _in_drive("drive_gain", j, {drive.GAIN: unit}, {}, 10.0,
                     _one("drive_gain", j, "relative error of the gain", unit))


def rotor_inertia(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """More inertia on the motor's side."""
    unit = 0.3 * float(s.plant.rotor[j])

    def apply(setup: Setup, size: float) -> Setup:
        rotor = setup.plant.rotor.copy()
        rotor[j] += size * unit
        return dataclasses.replace(setup, plant=dataclasses.replace(setup.plant, rotor=rotor))

    return Drawn("rotor_inertia", j + 1, apply, 15.0, _one("rotor_inertia", j, "change of rotor inertia", unit))


# -- seen where the arm's angle is measured --------------------------------------------------------------------------


def transmission_error(rng: np.random.Generator, s: Setup, j: int) -> Drawn | None:
    """A gear that turns unevenly, where the arm's angle is recorded."""
    if j not in s.logger.qa:
        return None
    order, phase = 2.0 * np.pi * rng.uniform(6.0, 40.0) / _span(s, j), float(rng.uniform(0.0, 6.28))

    def apply(setup: Setup, size: float) -> Setup:
        uneven = setup.logger.uneven.copy()
        uneven[:, j] = size * 2e-5, order, phase
        return dataclasses.replace(setup, logger=dataclasses.replace(setup.logger, uneven=uneven))

    return Drawn("transmission_error", j + 1, apply)


def arm_delay(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """All arm-side encoders are late by one clock."""
    def apply(setup: Setup, size: float) -> Setup:
        return dataclasses.replace(setup, logger=dataclasses.replace(setup.logger, qa_delay=size * 1e-4))

    return Drawn("arm_delay", 0, apply, 100.0)


INSIDE: dict[str, Draw] = {f.__name__: f for f in (
    degressive, stribeck, asymmetric_friction, load_dependent_friction, thermal_drift, torque_ripple, cable_spring,
    gravity_spring, axis_coupling, joint_elasticity, backlash, presliding_hysteresis, dead_time)}
NEW: dict[str, Draw] = {f.__name__: f for f in (base_tilt, torque_filter, load_direction_friction)}
OUTSIDE: dict[str, Draw] = {f.__name__: f for f in (angle_drag, place_friction, hose_pull, bump, time_disturbance)}
AGAINST_MODEL: dict[str, Draw] = {f.__name__: f for f in (
    payload, link_load, viscous, coulomb, current_offset, drive_gain, rotor_inertia, zero_error, base_tilt)}
ARM: dict[str, Draw] = {f.__name__: f for f in (transmission_error, arm_delay)}

NOT_IN = {"pybullet": frozenset({"axis_coupling", "drive_gain"})}
"""Effects that an engine has no means for."""
