"""Distance from several features, [L] 4.2."""

from __future__ import annotations

import numpy as np
import pytest

from sensing.camera.camera_model import CameraModel
from sensing.camera.feature_distance import distance_from_features
from sensing.sensing_error import SensingError


def test_distance_and_its_spread() -> None:
    camera = CameraModel.default()
    rng = np.random.default_rng(0)
    d = 0.27
    centre = rng.uniform(-0.03, 0.03, (12, 2))
    angle = rng.uniform(0, np.pi, 12)
    length = rng.uniform(0.02, 0.05, 12)
    half = 0.5 * length[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    points = np.stack([centre - half, centre + half], axis=1)
    exact = camera.project(np.concatenate([points.reshape(-1, 2), np.full((24, 1), d)], axis=1)).reshape(12, 2, 2)
    assert distance_from_features(camera, exact, length).distance == pytest.approx(d, rel=1e-6)
    found = [distance_from_features(camera, exact + 0.2 * rng.standard_normal(exact.shape), length, sigma_px=0.2)
             for _ in range(200)]
    assert np.std([one.distance for one in found]) == pytest.approx(found[0].std, rel=0.25)
    assert np.mean([one.distance for one in found]) == pytest.approx(d, rel=2e-3)


def test_what_tells_no_distance_is_said() -> None:
    camera = CameraModel.default()
    with pytest.raises(SensingError, match="pairs of features"):
        distance_from_features(camera, np.zeros((0, 2, 2)), np.zeros(0))
    with pytest.raises(SensingError, match="coincide"):
        distance_from_features(camera, np.full((2, 2, 2), 100.0), np.array([0.01, 0.02]))
