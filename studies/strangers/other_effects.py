"""Effects of the trials that the library lacks, and changes of an arm whose model was identified before."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from studies.strangers import drive
from studies.strangers.arm import joint_axes, sliding
from studies.strangers.effects import Draw, Drawn, Setup, Values, in_drive, in_proportion, span


def _base_tilt(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """The base is not upright: gravity comes from elsewhere."""
    across = float(rng.uniform(0.0, 2.0 * np.pi))
    axis = np.array([np.cos(across), np.sin(across), 0.0])

    def apply(setup: Setup, size: float) -> Setup:
        model = setup.plant.model.copy()
        tilted = pin.exp3(np.deg2rad(size) * axis) @ model.gravity.linear
        model.gravity.linear = tilted
        return setup.with_plant(model=model)

    return Drawn("base_tilt", 0, apply, 8.0, lambda size: {("base_tilt", 0, "angle"): float(np.deg2rad(size))})


def _torque_filter(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """All torques pass one more filter before they are logged."""
    def apply(setup: Setup, size: float) -> Setup:
        return setup.with_logger(lag=size * 3e-3)

    def values(size: float) -> Values:
        return {("torque_filter", 0, "time constant"): 3e-3 * size, ("common_delay", 0, "delay"): 3e-3 * size}

    return Drawn("torque_filter", 0, apply, 12.0, values)


def _load_direction_friction(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """The gear loses more where the motor drives the load than where the load drives the motor."""
    return in_drive("load_direction_friction", j, {drive.DRIVING: 0.05}, {}, 12.0,
                    in_proportion("load_direction_friction", j, "friction per load driven", 0.05))


def _angle_drag(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """Dry friction that grows with another joint's angle beyond some place."""
    other = int(rng.choice([i for i in range(s.plant.n) if i != j]))
    arm = s.plant.arm
    return in_drive("angle_drag", j, {drive.DRAG: 0.5 * arm.need[j] / span(s, other)},
                    {drive.DRAG_AXIS: other, drive.DRAG_FROM: 0.5 * float(arm.low[other] + arm.high[other]),
                     drive.DRAG_SIDE: float(rng.choice([-1.0, 1.0]))})


def _place_friction(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """Dry friction that differs from place to place."""
    return in_drive("place_friction", j, {drive.PLACE: 0.1 * s.plant.arm.need[j]},
                    {drive.PLACE_ORDER: 2.0 * np.pi * rng.uniform(1.0, 3.0) / span(s, j),
                     drive.PHASE: float(rng.uniform(0, 6.28))})


def _hose_pull(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """A hose that pulls only beyond some angle."""
    arm, side = s.plant.arm, float(rng.choice([-1.0, 1.0]))
    start = 0.5 * float(arm.low[j] + arm.high[j]) + side * rng.uniform(0.0, 0.2) * span(s, j)
    return in_drive("hose_pull", j, {drive.HOSE: 1.0 * arm.need[j] / span(s, j)},
                    {drive.HOSE_FROM: start, drive.HOSE_SIDE: side})


def _bump(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """A torque at one place, of odd shape."""
    return in_drive("bump", j, {drive.BUMP: 0.1 * s.plant.arm.need[j]},
                    {drive.BUMP_AT: float(s.plant.arm.low[j] + rng.uniform(0.35, 0.65) * span(s, j)),
                     drive.BUMP_WIDTH: rng.uniform(0.06, 0.15) * span(s, j)})


def _time_disturbance(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """A torque periodic in time, whatever the arm does."""
    return in_drive("time_disturbance", j, {drive.PULSE: 0.08 * s.plant.arm.need[j]},
                    {drive.PULSE_RATE: float(rng.uniform(0.05, 0.8)), drive.PHASE: float(rng.uniform(0, 6.28))})


NEW: dict[str, Draw] = {f.__name__[1:]: f for f in (_base_tilt, _torque_filter, _load_direction_friction)}
OUTSIDE: dict[str, Draw] = {f.__name__[1:]: f for f in (
    _angle_drag, _place_friction, _hose_pull, _bump, _time_disturbance)}


def _loaded(setup: Setup, joint: int, mass: float, centre: np.ndarray) -> Setup:
    model = setup.plant.model.copy()
    model.inertias[joint] = model.inertias[joint] + pin.Inertia(mass, centre, np.eye(3) * mass * 0.04**2)
    return setup.with_plant(model=model)


def _payload(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """A body on the flange."""
    last = s.plant.n
    unit, centre = 0.3 * s.plant.model.inertias[last].mass, rng.uniform(-0.1, 0.15, 3)
    return Drawn("payload", 0, lambda setup, size: _loaded(setup, last, size * unit, centre), 15.0,
                 lambda size: {("payload", 0, "mass"): size * unit,
                               **{("payload", 0, f"c_{a}"): float(c) for a, c in zip("xyz", centre, strict=True)}})


def _link_load(rng: np.random.Generator, s: Setup, j: int) -> Drawn | None:
    """A body on an inner link."""
    if j >= s.plant.n - 1:
        return None
    unit, centre = 0.1 * s.plant.model.inertias[j + 1].mass, rng.uniform(-0.15, 0.2, 3)
    return Drawn("link_load", j + 1, lambda setup, size: _loaded(setup, j + 1, size * unit, centre), 15.0,
                 lambda size: {("link_load", j + 1, "mass"): size * unit})


def _viscous(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """More viscous friction than before."""
    unit = 0.3 * float(s.plant.block[drive.VISCOUS, j])
    return in_drive("viscous", j, {drive.VISCOUS: unit}, {},
                    values=in_proportion("viscous", j, "change of viscous friction", unit))


def _coulomb(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """More dry friction than before."""
    unit = 0.3 * float(s.plant.block[drive.COULOMB, j])
    return in_drive("coulomb", j, {drive.COULOMB: unit}, {},
                    values=in_proportion("coulomb", j, "change of Coulomb friction", unit))


def _current_offset(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """The zero of the current measurement moved."""
    unit = 0.1 * float(s.plant.arm.need[j]) * float(rng.choice([-1.0, 1.0]))
    return in_drive("current_offset", j, {drive.OFFSET: unit}, {},
                    values=in_proportion("current_offset", j, "offset", unit))


def _drive_gain(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """More or less torque per ampere than before."""
    unit = 0.06 * float(rng.choice([-1.0, 1.0]))
    return in_drive("drive_gain", j, {drive.GAIN: unit}, {}, 10.0,
                    in_proportion("drive_gain", j, "relative error of the gain", unit))


def _rotor_inertia(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """More inertia on the motor's side."""
    unit = 0.3 * float(s.plant.rotor[j])

    def apply(setup: Setup, size: float) -> Setup:
        rotor = setup.plant.rotor.copy()
        rotor[j] += size * unit
        return setup.with_plant(rotor=rotor)

    return Drawn("rotor_inertia", j + 1, apply, 15.0,
                 in_proportion("rotor_inertia", j, "change of rotor inertia", unit))


def _zero_error(rng: np.random.Generator, s: Setup, j: int) -> Drawn | None:
    """The joint's zero is elsewhere than the controller thinks; gravity shows it."""
    if sliding(s.plant.model)[j]:
        return None
    turn = float(rng.choice([-1.0, 1.0])) * np.deg2rad(0.5)
    axis = joint_axes(s.plant.model)[j, 3:]

    def apply(setup: Setup, size: float) -> Setup:
        model = setup.plant.model.copy()
        model.jointPlacements[j + 1] = model.jointPlacements[j + 1] * pin.SE3(pin.exp3(size * turn * axis), np.zeros(3))
        return setup.with_plant(model=model)

    return Drawn("zero_error", j + 1, apply, 10.0, in_proportion("zero_error", j, "angle", turn))


AGAINST_MODEL: dict[str, Draw] = {f.__name__[1:]: f for f in (
    _payload, _link_load, _viscous, _coulomb, _current_offset, _drive_gain, _rotor_inertia, _zero_error, _base_tilt)}
