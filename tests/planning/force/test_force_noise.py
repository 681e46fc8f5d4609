"""The noise of a force sensor is found from its samples, whatever was assumed of it."""

from __future__ import annotations

import numpy as np
import pytest

from planning.force.force_noise import LEAST, ForceNoise


def heard(noise: ForceNoise, error: np.ndarray, rate: float = 250.0, begin: float = 0.0) -> ForceNoise:
    for k in range(0, len(error), 3):
        noise.hear(begin + np.arange(k, min(k + 3, len(error))) / rate, error[k : k + 3])
    return noise


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("sigma", [0.05, 0.3, 0.6, 1.5])
@pytest.mark.parametrize("directions", [1, 3])
def test_the_noise_is_found_from_a_second_of_samples(sigma: float, seed: int, directions: int) -> None:
    """With bias, and what the surface does at two hertz, ten times as large as an assumed noise."""
    rng, t = np.random.default_rng(seed), np.arange(400) / 250.0
    slow = 5.0 + 3.0 * np.sin(4.0 * np.pi * t)
    found = heard(ForceNoise(0.3), slow[:, None] + sigma * rng.standard_normal((400, directions)))
    assert found.std == pytest.approx(sigma, rel=0.15, abs=0.06)


@pytest.mark.parametrize("change", [0.2, 5.0])
def test_a_noise_that_changes_is_followed_in_two_seconds(change: float) -> None:
    rng = np.random.default_rng(4)
    noise = heard(ForceNoise(0.3), 0.3 * rng.standard_normal((500, 1)))
    heard(noise, 0.3 * change * rng.standard_normal((2000, 1)), begin=2.1)
    assert noise.std == pytest.approx(0.3 * change, rel=0.2)


def test_knocks_and_gaps_are_no_noise() -> None:
    rng = np.random.default_rng(5)
    error = 0.3 * rng.standard_normal((600, 1))
    error[::60] += 30.0
    assert heard(ForceNoise(0.3), error).std < 0.6
    apart = ForceNoise(0.3)
    for k in range(200):
        apart.hear(np.array([0.1 * k]), np.array([[10.0 * (-1.0) ** k]]))
    assert apart.std == pytest.approx(0.3)


def test_a_sensor_without_noise_is_believed_to_have_a_little() -> None:
    assert heard(ForceNoise(0.3), np.zeros((4000, 3))).std == pytest.approx(LEAST, abs=0.02)
