"""Shapes of lines: lengths and roundings known in closed form, and clear words for broken ones."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ideal_robot.errors import InputError
from scenes.shape import STEP, Shape


def _length(curve: np.ndarray) -> float:
    return float(np.sum(np.linalg.norm(np.diff(curve, axis=0), axis=1)))


@given(st.floats(0.05, 2.0), st.floats(-1.0, 1.0))
def test_points_are_evenly_spaced_and_start_at_the_origin(length: float, slope: float) -> None:
    curve = Shape(formula=f"{slope}*x + 0.1", length=length).curve()
    steps = np.linalg.norm(np.diff(curve, axis=0), axis=1)
    assert np.allclose(curve[0], 0.0)
    assert np.allclose(steps, steps[0], rtol=1e-6)
    assert abs(steps[0] - STEP) < 0.1 * STEP
    assert _length(curve) == pytest.approx(length * np.hypot(1, slope), rel=1e-9)


def test_rounded_corner_replaces_the_tangents_by_a_quarter_circle() -> None:
    curve = Shape(points=[(0, 0), (0.5, 0), (0.5, 0.4)], corner_radius=0.1).curve()
    assert _length(curve) == pytest.approx(0.9 - 2 * 0.1 + np.pi / 2 * 0.1, abs=1e-4)
    centre = np.array([0.4, 0.1])
    distance = np.linalg.norm(curve - centre, axis=1)
    assert distance.min() == pytest.approx(0.1, abs=1e-4)


def test_svg_is_scaled_to_the_length_asked_for_and_y_points_up() -> None:
    curve = Shape(svg="M 0 0 L 100 0 L 100 -50", svg_length=0.6).curve()
    assert _length(curve) == pytest.approx(0.6, rel=1e-3)
    assert curve[-1] == pytest.approx([0.4, 0.2], abs=1e-3)


@pytest.mark.parametrize(
    ("keys", "says"),
    [
        ({"svg": "M 0 0 Q zz"}, "broken SVG path"),
        ({"svg": ""}, "draws nothing"),
        ({"svg": "M 0 0 L 100 0 M 200 0 L 300 0"}, "several parts"),
        ({"svg": "not_there.svg"}, "no such SVG file"),
        ({"formula": "0.1*sinn(x)", "length": 1.0}, "cannot be evaluated"),
        ({"formula": "1/(x-x)", "length": 1.0}, "not finite"),
        ({"points": [(0, 0), (0, 0)]}, "two different points"),
        ({"points": [(0, 0), (0.1, 0), (0.1, 0.1)], "corner_radius": 0.2}, "too close"),
        ({"formula": "0", "length": 0.001}, "shorter than 10 mm"),
    ],
)
def test_broken_shapes_are_told_in_one_clear_line(keys: dict, says: str) -> None:
    with pytest.raises(InputError, match=says) as caught:
        Shape(**keys).curve()
    assert caught.value.field is not None
    assert "\n" not in str(caught.value)
