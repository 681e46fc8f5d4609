"""Nearest points on a polyline against brute force and against a circle."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ideal_robot.errors import InputError
from sensing.camera.polyline import Polyline

UP = np.array([0.0, 0.0, 1.0])


@given(seed=st.integers(0, 2**32 - 1))
def test_distance_is_the_least_over_all_segments(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x = np.linspace(0.0, 1.0, 400)
    points = np.column_stack([x, 0.1 * np.sin(5 * x + rng.uniform(0, 6)), 0.05 * np.cos(3 * x)])
    line = Polyline(points)
    queries = points[rng.integers(0, 400, 30)] + rng.normal(0.0, 0.02, (30, 3))
    a, d = points[:-1], np.diff(points, axis=0)
    along = np.clip(np.einsum("mkj,kj->mk", queries[:, None] - a, d) / np.sum(d**2, axis=1), 0.0, 1.0)
    brute = np.linalg.norm(queries[:, None] - a - along[..., None] * d, axis=2).min(axis=1)
    np.testing.assert_allclose(line.nearest(queries, UP).distance, brute, atol=2e-6)


def test_circle() -> None:
    angle = np.linspace(0.0, np.pi, 4000)
    line = Polyline(0.1 * np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle]))
    assert line.length == pytest.approx(0.1 * np.pi, rel=1e-6)
    at = np.linspace(0.3, 2.8, 40)
    radius = np.where(np.arange(40) % 2, 0.103, 0.094)
    found = line.nearest(radius[:, None] * np.column_stack([np.cos(at), np.sin(at), 0.0 * at]), UP)
    # Travelled counter-clockwise, the centre is on the left.
    np.testing.assert_allclose(found.lateral, 0.1 - radius, atol=1e-7)
    np.testing.assert_allclose(found.distance, np.abs(0.1 - radius), atol=1e-7)
    # Feet stay away from a corner's inside and gather at its outside: by the offset times half the corner's angle.
    np.testing.assert_allclose(found.s, 0.1 * at, atol=0.5 * 0.006 * np.pi / 3999 * 1.01)
    points, tangents = line.at(found.s)
    np.testing.assert_allclose(points, found.foot, atol=1e-9)
    np.testing.assert_allclose(tangents[:, 0], -np.sin(at), atol=1e-3)


def test_beyond_its_ends_a_polyline_is_clipped() -> None:
    line = Polyline(np.array([[0.0, 0, 0], [1.0, 0, 0]]))
    found = line.nearest(np.array([[-0.3, 0.4, 0.0], [2.0, 0.0, 0.0]]), UP)
    np.testing.assert_allclose(found.distance, [0.5, 1.0])
    np.testing.assert_allclose(found.s, [0.0, 1.0])
    np.testing.assert_allclose(line.at(np.array([-1.0, 5.0]))[0], [[0, 0, 0], [1, 0, 0]])


@pytest.mark.parametrize("points", [[[0, 0, 0]], [[0, 0, 0], [0, 0, 0]], [[0, 0], [1, 0]]])
def test_no_line(points: list[list[float]]) -> None:
    with pytest.raises(InputError, match=r"line\.points"):
        Polyline(np.array(points, dtype=float))
