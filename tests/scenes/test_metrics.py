"""The three path errors on motions whose errors are known."""

from __future__ import annotations

import numpy as np
import pytest

from ideal_robot.errors import InputError
from scenes.metrics import path_errors, reduction_percent

RADIUS, SPEED = 0.16, 0.63


def circle(t, radius=RADIUS):
    phase = SPEED / RADIUS * t
    return np.column_stack([radius * np.cos(phase), radius * np.sin(phase), np.zeros_like(t)])


T = np.arange(0.0, 1.5, 0.012)
FINE = np.arange(-0.2, 1.8, 0.002)


@pytest.mark.parametrize("delay", [0.015, 0.0007, -0.0007, -0.015])
def test_a_pure_delay_is_a_time_matched_error_only(delay):
    """Also of an arm that is early, as one is that is led by more than its delay."""
    errors = path_errors(T, circle(T), FINE, circle(FINE - delay))
    chord = 2 * RADIUS * np.sin(0.5 * SPEED / RADIUS * abs(delay))
    assert errors.time_matched.E_car == pytest.approx(chord, rel=1e-4)
    assert errors.delay == pytest.approx(delay, abs=1e-6)
    assert errors.aligned.E_max < 1e-6
    # What is left is the sagitta of the desired polyline's 12 ms chords.
    assert errors.geometric.E_max < (SPEED * 0.012) ** 2 / (8 * RADIUS) * 1.01


def test_a_radial_offset_shows_in_all_three():
    errors = path_errors(T, circle(T), FINE, circle(FINE, RADIUS + 1e-3))
    for error in (errors.time_matched, errors.aligned):
        assert error.E_car == pytest.approx(1e-3, rel=1e-3)
        assert error.E_max == pytest.approx(1e-3, rel=1e-2)
    assert errors.geometric.E_car == pytest.approx(1e-3, rel=0.05)


def test_geometric_never_exceeds_aligned_never_exceeds_time_matched():
    rng = np.random.default_rng(3)
    for _ in range(20):
        wobble = rng.normal(scale=1e-3, size=3) * np.sin(rng.uniform(2, 20) * FINE)[:, None]
        errors = path_errors(T, circle(T), FINE, circle(FINE - rng.uniform(-0.02, 0.05)) + wobble)
        assert errors.geometric.E_car <= errors.aligned.E_car * (1 + 1e-9) + 1e-9
        assert errors.aligned.E_car <= errors.time_matched.E_car * (1 + 1e-9) + 1e-12


def test_a_path_that_crosses_itself_is_not_flattered():
    phase = 2 * np.pi * T / T[-1]
    x_d = np.column_stack([np.sin(phase), np.sin(2 * phase), np.zeros_like(T)])
    # Near the crossing the arm takes a short cut along the other branch's direction.
    fine_phase = 2 * np.pi * FINE / T[-1]
    x = np.column_stack([np.sin(fine_phase), -np.sin(2 * fine_phase), np.zeros_like(FINE)])
    assert path_errors(T, x_d, FINE, x).geometric.E_car > 0.1


def test_too_little_is_refused():
    with pytest.raises(InputError, match="four instants"):
        path_errors(T[:3], circle(T[:3]), FINE, circle(FINE))


def test_reduction():
    assert reduction_percent(2.0, 0.5) == pytest.approx(75.0)
    assert reduction_percent(1.0, 2.0) == pytest.approx(-100.0)


def test_a_long_motion_is_compared_piece_by_piece(monkeypatch: pytest.MonkeyPatch) -> None:
    # A spline's end does not reach through the overlap of two pieces: all measures are those of the whole one.
    wobble = 1e-4 * np.random.default_rng(3).standard_normal((len(FINE), 3))
    whole = path_errors(T, circle(T), FINE, circle(FINE - 0.0137) + wobble)
    monkeypatch.setattr("scenes.metrics.PIECE", 150)
    pieces = path_errors(T, circle(T), FINE, circle(FINE - 0.0137) + wobble)
    assert len(FINE) > 300
    assert pieces.delay == pytest.approx(whole.delay, abs=1e-7)
    for kind in ("time_matched", "aligned", "geometric"):
        one, other = getattr(whole, kind), getattr(pieces, kind)
        assert other.E_car == pytest.approx(one.E_car, rel=1e-6)
    np.testing.assert_allclose(pieces.time_matched.deviation, whole.time_matched.deviation, atol=1e-12)
