"""Changes of an arm whose model was identified before: loads, friction, rotors, currents, zeros."""

from __future__ import annotations

import dataclasses

import numpy as np
import pinocchio as pin

from trials.strangers import drive
from trials.strangers.arm import joint_axes, sliding
from trials.strangers.drawn_effect import Draw, Drawn, Setup, in_drive, in_proportion
from trials.strangers.effects_beyond_library import base_tilt


def _loaded(setup: Setup, joint: int, mass: float, centre: np.ndarray) -> Setup:
    model = setup.plant.model.copy()
    model.inertias[joint] = model.inertias[joint] + pin.Inertia(mass, centre, np.eye(3) * mass * 0.04**2)
    return dataclasses.replace(setup, plant=dataclasses.replace(setup.plant, model=model))


def payload(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """A body on the flange.

    Args:
        rng: source of the draw.
        s: plant and logger that get the effect.
        j: joint, from 0.
    """
    last = s.plant.n
    unit, centre = 0.3 * s.plant.model.inertias[last].mass, rng.uniform(-0.1, 0.15, 3)
    return Drawn("payload", 0, lambda setup, size: _loaded(setup, last, size * unit, centre), 15.0,
                 lambda size: {("payload", 0, "mass"): size * unit,
                               **{("payload", 0, f"c_{a}"): float(c) for a, c in zip("xyz", centre, strict=True)}})


def link_load(rng: np.random.Generator, s: Setup, j: int) -> Drawn | None:
    """A body on an inner link.

    Args:
        rng: source of the draw.
        s: plant and logger that get the effect.
        j: joint, from 0.
    """
    if j >= s.plant.n - 1:
        return None
    unit, centre = 0.1 * s.plant.model.inertias[j + 1].mass, rng.uniform(-0.15, 0.2, 3)
    return Drawn("link_load", j + 1, lambda setup, size: _loaded(setup, j + 1, size * unit, centre), 15.0,
                 lambda size: {("link_load", j + 1, "mass"): size * unit})


def viscous(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """More viscous friction than before.

    Args:
        rng: source of the draw.
        s: plant and logger that get the effect.
        j: joint, from 0.
    """
    unit = 0.3 * float(s.plant.block[drive.VISCOUS, j])
    return in_drive("viscous", j, {drive.VISCOUS: unit}, {},
                    values=in_proportion("viscous", j, "change of viscous friction", unit))


def coulomb(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """More dry friction than before.

    Args:
        rng: source of the draw.
        s: plant and logger that get the effect.
        j: joint, from 0.
    """
    unit = 0.3 * float(s.plant.block[drive.COULOMB, j])
    return in_drive("coulomb", j, {drive.COULOMB: unit}, {},
                    values=in_proportion("coulomb", j, "change of Coulomb friction", unit))


def current_offset(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """The zero of the current measurement moved.

    Args:
        rng: source of the draw.
        s: plant and logger that get the effect.
        j: joint, from 0.
    """
    unit = 0.1 * float(s.plant.arm.need[j]) * float(rng.choice([-1.0, 1.0]))
    return in_drive("current_offset", j, {drive.OFFSET: unit}, {},
                    values=in_proportion("current_offset", j, "offset", unit))


def drive_gain(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """More or less torque per ampere than before.

    Args:
        rng: source of the draw.
        s: plant and logger that get the effect.
        j: joint, from 0.
    """
    unit = 0.06 * float(rng.choice([-1.0, 1.0]))
    return in_drive("drive_gain", j, {drive.GAIN: unit}, {}, 10.0,
                    in_proportion("drive_gain", j, "relative error of the gain", unit))


def rotor_inertia(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """More inertia on the motor's side.

    Args:
        rng: source of the draw.
        s: plant and logger that get the effect.
        j: joint, from 0.
    """
    unit = 0.3 * float(s.plant.rotor[j])

    def apply(setup: Setup, size: float) -> Setup:
        rotor = setup.plant.rotor.copy()
        rotor[j] += size * unit
        return dataclasses.replace(setup, plant=dataclasses.replace(setup.plant, rotor=rotor))

    return Drawn("rotor_inertia", j + 1, apply, 15.0,
                 in_proportion("rotor_inertia", j, "change of rotor inertia", unit))


def zero_error(rng: np.random.Generator, s: Setup, j: int) -> Drawn | None:
    """The joint's zero is elsewhere than the controller thinks; gravity shows it.

    Args:
        rng: source of the draw.
        s: plant and logger that get the effect.
        j: joint, from 0.
    """
    if sliding(s.plant.model)[j]:
        return None
    turn = float(rng.choice([-1.0, 1.0])) * np.deg2rad(0.5)
    axis = joint_axes(s.plant.model)[j, 3:]

    def apply(setup: Setup, size: float) -> Setup:
        model = setup.plant.model.copy()
        model.jointPlacements[j + 1] = model.jointPlacements[j + 1] * pin.SE3(pin.exp3(size * turn * axis), np.zeros(3))
        return dataclasses.replace(setup, plant=dataclasses.replace(setup.plant, model=model))

    return Drawn("zero_error", j + 1, apply, 10.0, in_proportion("zero_error", j, "angle", turn))


AGAINST_MODEL: dict[str, Draw] = {f.__name__: f for f in (
    payload, link_load, viscous, coulomb, current_offset, drive_gain, rotor_inertia, zero_error, base_tilt)}
