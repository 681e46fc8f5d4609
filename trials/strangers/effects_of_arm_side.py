"""Effects of the trials that show where the arm's own angle is measured."""

from __future__ import annotations

import dataclasses

import numpy as np

from trials.strangers.drawn_effect import Draw, Drawn, Setup, span


def transmission_error(rng: np.random.Generator, s: Setup, j: int) -> Drawn | None:
    """A gear that turns unevenly, where the arm's angle is recorded.

    Args:
        rng: source of the draw.
        s: plant and logger that get the effect.
        j: joint, from 0.
    """
    if j not in s.logger.qa:
        return None
    order, phase = 2.0 * np.pi * rng.uniform(6.0, 40.0) / span(s, j), float(rng.uniform(0.0, 6.28))

    def apply(setup: Setup, size: float) -> Setup:
        uneven = setup.logger.uneven.copy()
        uneven[:, j] = size * 2e-5, order, phase
        return dataclasses.replace(setup, logger=dataclasses.replace(setup.logger, uneven=uneven))

    return Drawn("transmission_error", j + 1, apply)


def arm_delay(rng: np.random.Generator, s: Setup, j: int) -> Drawn:
    """All arm-side encoders are late by one clock.

    Args:
        rng: source of the draw.
        s: plant and logger that get the effect.
        j: joint, from 0.
    """
    def apply(setup: Setup, size: float) -> Setup:
        return dataclasses.replace(setup, logger=dataclasses.replace(setup.logger, qa_delay=size * 1e-4))

    return Drawn("arm_delay", 0, apply, 100.0)


ARM: dict[str, Draw] = {f.__name__: f for f in (transmission_error, arm_delay)}
