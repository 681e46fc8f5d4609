"""The surface ahead of the tip: waves once felt go on, and one that has none is not continued worse."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from ideal_robot.arrays import Array
from planning.force.surface_forecast import LENGTH, ROTATION, ROUGHEST, SurfaceForecast
from planning.line.deviation_model import matern

STEP = 0.0024
AHEAD = 0.014
NOISE = 1.2e-5


def waves(s: Array) -> Array:
    return 4e-3 * np.sin(2 * np.pi * s / 0.26) + 1.5e-3 * np.sin(2 * np.pi * s / 0.14 + 1.2) + 0.01 * s + 0.004


def bump(s: Array) -> Array:
    return 0.3 * (s - 0.4) ** 2 + 1e-3 * np.exp(-(((s - 0.45) / 0.08) ** 2))


def errors(surface: Callable[[Array], Array], count: int = 240) -> tuple[Array, Array]:
    """Errors 14 mm ahead of the forecast, and of a prior that knows smoothness alone."""
    s = STEP * np.arange(count)
    felt = surface(s) + NOISE * np.random.default_rng(3).standard_normal(count)
    forecast = SurfaceForecast((0.3, 0.002))
    ours, smooth = np.zeros(count), np.zeros(count)
    for n in range(count):
        forecast.add(float(s[n]), float(felt[n]), NOISE**2, np.zeros(2))
        x, here = s[n : n + 1] + AHEAD, s[max(0, n - 120) : n + 1]
        ours[n] = forecast.height(x)[0] - surface(x)[0]
        away = here - here[-1]
        K = 0.02**2 + ROTATION**2 * np.outer(away, away) + NOISE**2 * np.eye(len(here))
        K += ROUGHEST**2 * matern(np.abs(here[:, None] - here), LENGTH)
        cross = 0.02**2 + ROTATION**2 * AHEAD * away + ROUGHEST**2 * matern(np.abs(x - here), LENGTH)
        smooth[n] = cross @ np.linalg.solve(K, felt[max(0, n - 120) : n + 1]) - surface(x)[0]
    return ours, smooth


@pytest.mark.parametrize(("surface", "share"), [(waves, 0.4), (bump, 0.6)])
def test_what_was_felt_is_continued_better_than_by_smoothness_alone(
    surface: Callable[[Array], Array], share: float
) -> None:
    ours, smooth = errors(surface)
    later = slice(120, None)
    assert np.sqrt(np.mean(ours[later] ** 2)) < share * np.sqrt(np.mean(smooth[later] ** 2))


def test_a_tip_at_rest_says_where_it_is_and_nothing_else() -> None:
    forecast = SurfaceForecast((0.3, 0.002))
    for _ in range(40):
        forecast.add(0.0, 0.003, NOISE**2, np.zeros(2))
    np.testing.assert_allclose(forecast.height(np.array([0.0, 0.005])), 0.003, atol=2e-4)


def test_what_friction_hides_as_the_tip_begins_to_slide_is_no_slope() -> None:
    """Level ground; from the first tenth of a millimetre on friction makes it look 90 µm lower."""
    forecasts = SurfaceForecast((0.3, 0.002)), SurfaceForecast((0.3, 0.002, 0.3))
    for k in range(60):
        s = max(0.0, 1e-4 * (k - 30))
        slides = 3e-4 * -np.expm1(-s / 1e-4)
        for forecast, wrong in zip(forecasts, ([0.0, 0.0], [0.0, 0.0, slides]), strict=True):
            forecast.add(s, -0.3 * slides, NOISE**2, np.array(wrong))
    without, told = (abs(float(one.height(np.array([0.008]))[0])) for one in forecasts)
    assert told < 0.5 * without
