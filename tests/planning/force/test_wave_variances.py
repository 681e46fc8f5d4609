"""Variances of waves: the same as with a likelihood that is computed anew for each change."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from ideal_robot.arrays import Array
from planning.force import wave_variances
from planning.force.wave_variances import BETTER, MOST, likelier_variances

WAVELENGTHS = 1.0 / np.linspace(1.0 / 0.8, 1.0 / 0.08, 40)
LARGEST = 1e-4


def wave_columns(s: Array) -> Array:
    phase = 2 * np.pi / WAVELENGTHS * s[:, None]
    return np.concatenate([np.cos(phase), np.sin(phase)], axis=1)


@dataclass(frozen=True)
class Felt:
    """Two waves with noise, and what a regression makes of them."""

    s: Array
    value: Array
    noise: float

    def covariance(self, gamma: Array) -> Array:
        return (wave_columns(self.s) * np.tile(gamma, 2)) @ wave_columns(self.s).T + self.noise**2 * np.eye(len(self.s))

    def likelihood(self, gamma: Array) -> float:
        K = self.covariance(gamma)
        return -0.5 * float(self.value @ np.linalg.solve(K, self.value) + np.linalg.slogdet(K)[1])

    def likelier(self, gamma: Array) -> Array:
        inverse = np.linalg.inv(self.covariance(gamma))
        return likelier_variances(gamma, wave_columns(self.s), inverse, inverse @ self.value, LARGEST)


@pytest.fixture(params=[1e-5, 1e-7], ids=["noise 10 µm", "noise 0.1 µm"])
def felt(request: pytest.FixtureRequest) -> Felt:
    s = np.linspace(0.0, 0.5, 60)
    value = 3e-3 * np.sin(2 * np.pi * s / WAVELENGTHS[11]) + 5e-4 * np.cos(2 * np.pi * s / WAVELENGTHS[22])
    return Felt(s, value + request.param * np.random.default_rng(1).standard_normal(len(s)), request.param)


def test_changes_without_a_new_inverse_are_those_with_one(
    felt: Felt, monkeypatch: pytest.MonkeyPatch
) -> None:
    start = np.full(len(WAVELENGTHS), 1e-8)
    together = felt.likelier(start)
    monkeypatch.setattr(wave_variances, "MOST", 1)
    alone = start
    for _ in range(MOST):
        alone = felt.likelier(alone)
    assert np.count_nonzero(together != start) > 2
    np.testing.assert_allclose(together, alone, rtol=1e-3, atol=1e-14)


def test_each_change_gains_likelihood(felt: Felt, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(wave_variances, "MOST", 1)
    gamma = np.full(len(WAVELENGTHS), 1e-8)
    for _ in range(MOST):
        changed = felt.likelier(gamma)
        if np.array_equal(changed, gamma):
            break
        assert felt.likelihood(changed) > felt.likelihood(gamma) + BETTER
        gamma = changed
