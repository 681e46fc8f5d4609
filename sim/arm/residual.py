"""Torque that no effect of the world names, drawn anew for every play: as strong in each octave as it was measured."""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from sim.arm.world import ExtraTorque, World

LOWEST = 0.05
"""Where the first octave begins [Hz]: slower torques are those of postures."""
WAVES = 6
"""Sinusoids in an octave: with their random phases the sum is as good as normally distributed."""


def octave_edges(count: int) -> Array:
    """Frequencies between octaves ``(count + 1,)`` [Hz]."""
    return LOWEST * 2.0 ** np.arange(count + 1.0)


def residual_torque(world: World, n: int, rng: np.random.Generator) -> ExtraTorque | None:
    """The world's ``extra_torque`` with its residual and the offsets of its body; None where it has none of them.

    Args:
        world: the true world.
        n: number of joints.
        rng: draws frequencies and phases; is not touched where the world has no residual.

    Raises:
        InputError: a row of the residual for another number of joints.
    """
    offset = world.bodies(n)[11 * n :] if world.body else np.zeros(n)
    given = world.extra_torque
    if not world.residual:
        if not offset.any():
            return given
        return lambda t, q, qd, q_a: -offset + (0.0 if given is None else given(t, q, qd, q_a))
    for row in world.residual:
        if len(row) not in (1, n):
            raise InputError(f"expected rows of one number or {n}, one per joint", field="world.residual", value=row)
    bands = np.array([np.broadcast_to(row, n) for row in world.residual])
    edges = octave_edges(len(bands))
    share = rng.uniform(size=(len(bands), WAVES, 1))
    frequency = 2.0 * np.pi * edges[:-1, None, None] * 2.0**share
    phase = rng.uniform(0.0, 2.0 * np.pi, (len(bands), WAVES, n))
    size = np.sqrt(2.0 / WAVES) * bands[:, None, :] * np.ones((1, WAVES, 1))
    rate, phase, size = (np.ascontiguousarray(one.reshape(-1, one.shape[-1])) for one in (frequency, phase, size))

    def torque(t: float, q: Array, qd: Array, q_a: Array) -> Array:
        drawn = np.einsum("wn,wn->n", size, np.sin(rate * t + phase)) - offset
        return np.asarray(drawn if given is None else drawn + given(t, q, qd, q_a))

    return torque
