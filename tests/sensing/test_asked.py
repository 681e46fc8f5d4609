"""A live sensor on a surface is believed whatever colour its noise has, a dead one is named; both are counted."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.special import chndtr

from ideal_robot.arrays import Array
from sensing.asked import HIDES, LEAST, WINDOWS, hidden
from sensing.life_signs import LifeSigns

RATE, E, ASKING, HZ = 250.0, 4000.0, 0.5, 10.0
Colour = Callable[[int, np.random.Generator], Array]
"""Noise of N samples [N]."""


def lagged(corner: float) -> Colour:
    """First-order noise of 0.3 N with a corner [Hz]."""
    a = np.exp(-2.0 * np.pi * corner / RATE)
    return lambda n, rng: 0.3 * np.sqrt(1.0 - a**2) * lfilter([1.0], [1.0, -a], rng.standard_normal(n + 500))[500:]


def swinging(frequency: float, damping: float) -> Colour:
    """An arm of 0.3 N that is shaken at its resonance."""
    w = 2.0 * np.pi * frequency / RATE
    r = np.exp(-damping * w)

    def noise(n: int, rng: np.random.Generator) -> Array:
        y = lfilter([1.0], [1.0, -2.0 * r * np.cos(w), r**2], rng.standard_normal(n + 1000))
        return 0.3 * y[1000:] / np.std(y) + 0.05 * rng.standard_normal(n)

    return noise


COLOURS: dict[str, Colour] = {
    "white, 0.1 N": lambda n, rng: 0.1 * rng.standard_normal(n),
    "white, 0.3 N": lambda n, rng: 0.3 * rng.standard_normal(n),
    "white, 2 N": lambda n, rng: 2.0 * rng.standard_normal(n),
    "corner 1 Hz": lagged(1.0), "corner 3 Hz": lagged(3.0), "corner 10 Hz": lagged(10.0), "corner 30 Hz": lagged(30.0),
    "random walk": lambda n, rng: np.cumsum(0.04 * rng.standard_normal(n)) + 0.05 * rng.standard_normal(n),
    "drift of 5 N/s": lambda n, rng: 5.0 * np.arange(n) / RATE + 0.2 * rng.standard_normal(n),
    "swings at 7 Hz": swinging(7.0, 0.05), "swings at 10 Hz": swinging(10.0, 0.05),
    "swings at 12 Hz": swinging(12.0, 0.05), "swings at 18 Hz": swinging(18.0, 0.02),
}


def felt(colour: str, gain: float, seed: int, seconds: float = 2.0, step: float = 0.0, since: float = 0.0,
         lost: int = 0) -> Array:
    """What a tip feels that swings by 0.5 N, over a surface that goes by millimetres, as ``Asked.add`` takes it.

    Each quarter of a second ``lost`` cycles of 12 ms are lost: the arm goes on, the path's time does not.
    """
    rng, n = np.random.default_rng(seed), round(seconds * RATE)
    t = np.arange(n) / RATE
    place = 0.2 * t
    surface = 5e-3 * np.sin(2.0 * np.pi * 5.0 * place + seed)
    height = surface - ASKING / E * np.sin(2.0 * np.pi * HZ * t)
    force = 20.0 + np.where(t < since, 1.0, gain) * E * (surface - height) + COLOURS[colour](n, rng)
    force = np.round(force / step) * step if step else force
    passed = np.where(t % 0.25 < 0.012 * (lost + 1), 1.0 / RATE / (lost + 1), 1.0 / RATE)
    return np.column_stack([np.cumsum(passed), place, height, force])


def judged(samples: Array) -> tuple[float | None, float]:
    """When a sensor was found to be dead, and the least logarithm of the probability so far."""
    signs = LifeSigns(1e5, ["fx"])
    for k in range(0, len(samples), 3):
        signs.answers(samples[k : k + 3], E, HZ, ASKING / E)
        if signs.fault is not None:
            assert "% of what the tip's swing" in signs.fault
            return float(samples[k, 0]), signs.unanswered
    return None, signs.unanswered


@pytest.mark.parametrize(("gain", "seeds"), [(1.0, 1), pytest.param(1.0, 40, marks=pytest.mark.slow),
                                             pytest.param(LEAST, 40, marks=pytest.mark.slow)])
def test_a_live_sensor_is_believed_whatever_colour_its_noise_has(gain: float, seeds: int) -> None:
    """Where noise was taken for white, as large as beside the swing, 34 of 90 coloured plays were stopped."""
    for colour in COLOURS:
        for seed in range(seeds):
            when, least = judged(felt(colour, gain, seed, step=0.25 * (seed % 2), lost=seed % 4))
            assert when is None, (colour, seed)
            # A bound over all strengths of the noise: 100 looks of one play do not come near it.
            assert least > np.log(HIDES), (colour, seed)


@pytest.mark.parametrize("colour", [name for name in COLOURS
                                    if name not in ("white, 2 N", *(f"swings at {near} Hz" for near in (7, 10, 12)))])
def test_a_sensor_that_dies_is_named(colour: str) -> None:
    """Stuck on the way, with its noise: the less noise at 10 Hz, the sooner.

    As much of it as is asked, within the 5 Hz that a window tells apart, hides that it is dead.
    """
    when, _ = judged(felt(colour, 0.0, 1, seconds=4.2, since=1.0))
    assert when is not None
    assert 1.2 < when < 4.2
    assert colour != "white, 0.1 N" or when < 2.0


def test_no_strength_of_noise_hides_an_answer_more_often_than_is_said() -> None:
    """χ² with 2 M degrees of freedom, not central: the exact probability, at the strength where it is largest."""
    strength = np.exp(np.linspace(np.log(0.2), np.log(60.0), 200))
    for share in (0.02, 0.07, 0.2, 0.4):
        said = np.exp(hidden(np.full(WINDOWS, share)))
        for m in range(1, WINDOWS + 1):
            exact = float(np.max(chndtr(share * 2.0 * m * strength, 2.0 * m, 2.0 * m * strength)))
            assert said[m - 1] == pytest.approx(exact, rel=0.1)


def test_what_the_tip_follows_of_a_surface_asks_nothing() -> None:
    """A corrugation of 10 Hz that the arm follows is in the height and not in the force; its swing is in both."""
    samples = felt("white, 0.3 N", 1.0, 1)
    rng = np.random.default_rng(2)
    for _ in range(3):
        followed = samples.copy()
        phase = np.repeat(rng.uniform(0.0, 2.0 * np.pi, 10), 50)
        followed[:, 2] += 1e-3 * np.sin(2.0 * np.pi * HZ * samples[:, 0] + phase)
        assert judged(followed)[0] is None


def test_a_tip_that_does_not_swing_asks_nothing() -> None:
    samples = felt("white, 0.3 N", 0.0, 1)
    samples[:, 2] = 0.0
    assert judged(samples)[0] is None
