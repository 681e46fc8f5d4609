"""Effects of the trials that the library lacks: causes of a law it has, and causes it has no law for."""

from __future__ import annotations

import dataclasses

import numpy as np
import pinocchio as pin

from trials.strangers import drive
from trials.strangers.drawn_effect import Draw, Drawn, Setup, in_drive, in_proportion, span


def base_tilt(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """The base is not upright: gravity comes from elsewhere.

    Args:
        rng: source of the draw.
        s: plant and logger that get the effect.
        j: joint, from 0.
    """
    across = float(rng.uniform(0.0, 2.0 * np.pi))
    axis = np.array([np.cos(across), np.sin(across), 0.0])

    def apply(setup: Setup, size: float) -> Setup:
        model = setup.plant.model.copy()
        tilted = pin.exp3(np.deg2rad(size) * axis) @ model.gravity.linear
        model.gravity.linear = tilted
        return dataclasses.replace(setup, plant=dataclasses.replace(setup.plant, model=model))

    return Drawn("base_tilt", 0, apply, 8.0, lambda size: {("base_tilt", 0, "angle"): float(np.deg2rad(size))})


def torque_filter(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """All torques pass one more filter before they are logged.

    Args:
        rng: source of the draw.
        s: plant and logger that get the effect.
        j: joint, from 0.
    """
    def apply(setup: Setup, size: float) -> Setup:
        return dataclasses.replace(setup, logger=dataclasses.replace(setup.logger, lag=size * 3e-3))

    return Drawn("torque_filter", 0, apply, 12.0, lambda size: {("torque_filter", 0, "time constant"): 3e-3 * size})


def load_direction_friction(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """The gear loses more where the motor drives the load than where the load drives the motor.

    Args:
        rng: source of the draw.
        s: plant and logger that get the effect.
        j: joint, from 0.
    """
    return in_drive("load_direction_friction", j, {drive.DRIVING: 0.05}, {}, 12.0,
                    in_proportion("load_direction_friction", j, "friction per load driven", 0.05))


def angle_drag(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """Dry friction that grows with another joint's angle beyond some place.

    Args:
        rng: source of the draw.
        s: plant and logger that get the effect.
        j: joint, from 0.
    """
    other = int(rng.choice([i for i in range(s.plant.n) if i != j]))
    arm = s.plant.arm
    return in_drive("angle_drag", j, {drive.DRAG: 0.5 * arm.need[j] / span(s, other)},
                    {drive.DRAG_AXIS: other, drive.DRAG_FROM: 0.5 * float(arm.low[other] + arm.high[other]),
                     drive.DRAG_SIDE: float(rng.choice([-1.0, 1.0]))})


def place_friction(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """Dry friction that differs from place to place.

    Args:
        rng: source of the draw.
        s: plant and logger that get the effect.
        j: joint, from 0.
    """
    return in_drive("place_friction", j, {drive.PLACE: 0.1 * s.plant.arm.need[j]},
                    {drive.PLACE_ORDER: 2.0 * np.pi * rng.uniform(1.0, 3.0) / span(s, j),
                     drive.PHASE: float(rng.uniform(0, 6.28))})


def hose_pull(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """A hose that pulls only beyond some angle.

    Args:
        rng: source of the draw.
        s: plant and logger that get the effect.
        j: joint, from 0.
    """
    arm, side = s.plant.arm, float(rng.choice([-1.0, 1.0]))
    start = 0.5 * float(arm.low[j] + arm.high[j]) + side * rng.uniform(0.0, 0.2) * span(s, j)
    return in_drive("hose_pull", j, {drive.HOSE: 1.0 * arm.need[j] / span(s, j)},
                    {drive.HOSE_FROM: start, drive.HOSE_SIDE: side})


def bump(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """A torque at one place, of odd shape.

    Args:
        rng: source of the draw.
        s: plant and logger that get the effect.
        j: joint, from 0.
    """
    return in_drive("bump", j, {drive.BUMP: 0.1 * s.plant.arm.need[j]},
                    {drive.BUMP_AT: float(s.plant.arm.low[j] + rng.uniform(0.35, 0.65) * span(s, j)),
                     drive.BUMP_WIDTH: rng.uniform(0.06, 0.15) * span(s, j)})


def time_disturbance(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """A torque periodic in time, whatever the arm does.

    Args:
        rng: source of the draw.
        s: plant and logger that get the effect.
        j: joint, from 0.
    """
    return in_drive("time_disturbance", j, {drive.PULSE: 0.08 * s.plant.arm.need[j]},
                    {drive.PULSE_RATE: float(rng.uniform(0.05, 0.8)), drive.PHASE: float(rng.uniform(0, 6.28))})


NEW: dict[str, Draw] = {f.__name__: f for f in (base_tilt, torque_filter, load_direction_friction)}
OUTSIDE: dict[str, Draw] = {f.__name__: f for f in (angle_drag, place_friction, hose_pull, bump, time_disturbance)}
