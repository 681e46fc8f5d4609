"""Plants for the tests: one arm, bare or with some of what drives have."""

from __future__ import annotations

import dataclasses

import numpy as np

from studies.strangers import drive
from studies.strangers.arm import Arm, Motion, arm_of, draw_motion, random_urdf
from studies.strangers.plant import CONSTRAINT, Plant, draw_plant


def an_arm(seed: int = 3, n: int = 3) -> Arm:
    rng = np.random.default_rng(seed)
    return arm_of(rng, "chain", random_urdf(rng, n))


def a_motion(arm: Arm, seconds: float = 3.0, kind: str = "fourier") -> Motion:
    return draw_motion(np.random.default_rng(5), arm, seconds, kind)


def a_plant(arm: Arm, *, friction: bool = True, stiffness: float = np.inf, kind: int = CONSTRAINT) -> Plant:
    """A plant under the cascade, gears rigid or as stiff as said."""
    rng = np.random.default_rng(1)
    plant = draw_plant(rng, arm)
    while plant.controller != "cascade":
        plant = draw_plant(rng, arm)
    n, block = arm.n, plant.block.copy()
    if not friction:
        block[[drive.COULOMB, drive.VISCOUS]] = 0.0
    return dataclasses.replace(plant, block=block, stiffness=np.full(n, stiffness), damping=np.full(n, 5.0),
                               regularisation=np.full(n, kind), presliding=np.full(n, 5e-4), v_smooth=np.full(n, 2e-3))
