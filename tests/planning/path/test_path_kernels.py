"""Compiled arithmetic of path coordinates against the vectors it stands for."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.path.path_kernels import displaced_frames, sensor_errors
from planning.path.vectors import unit
from tests.planning.cell import reference

SEEDS = st.integers(0, 2**32 - 1)


@settings(max_examples=50, deadline=None)
@given(SEEDS)
def test_errors_of_a_camera_displace_points_as_vectors_say(seed: int) -> None:
    rng = np.random.default_rng(seed)
    normal, up, ray, lever = rng.standard_normal((4, 5, 3))
    velocity, rate = rng.standard_normal((2, 3))
    turned, moved, slant = sensor_errors(normal, up, ray, lever, velocity, rate)
    np.testing.assert_allclose(turned, np.sum(normal * np.cross(up, ray), axis=1), atol=1e-12)
    np.testing.assert_allclose(moved, np.sum(normal * (velocity + np.cross(rate, lever)), axis=1), atol=1e-12)
    np.testing.assert_allclose(slant, np.sum(ray * normal, axis=1) / np.sum(ray * up, axis=1), rtol=1e-9)


@pytest.mark.parametrize("directions", [1, 2])
def test_tangents_of_a_displaced_path_are_the_way_its_points_go(directions: int) -> None:
    def waves(s: np.ndarray) -> np.ndarray:
        return np.column_stack([0.01 * np.sin(9.0 * s), 0.004 * np.cos(7.0 * s)])[:, :directions]

    def displaced(s: np.ndarray) -> np.ndarray:
        frames, d = reference().frames(s), waves(s)
        return frames.position + d[:, :1] * frames.normal + (d[:, 1:] * frames.up if directions == 2 else 0.0)

    s, step = np.linspace(0.1, 0.9, 30), 1e-5
    f, slope = reference().frames(s), (waves(s + step) - waves(s - step)) / (2.0 * step)
    points, ahead, up = displaced_frames(f.position, f.tangent, f.normal, f.up, f.curvature, waves(s), slope)
    np.testing.assert_allclose(points, displaced(s), atol=1e-12)
    np.testing.assert_allclose(ahead, unit(displaced(s + step) - displaced(s - step)), atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(up, axis=1), 1.0, atol=1e-12)
    if directions == 2:
        np.testing.assert_allclose(np.sum(up * ahead, axis=1), 0.0, atol=1e-12)
