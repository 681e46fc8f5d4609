r"""Distance of the camera from a surface, from several features in one image ([L] 4.2).

"If multiple features can be sensed it is further possible to extract the distance d." Two features a known length
:math:`w_i` apart, square to the optical axis, are seen :math:`\Delta r_i = w_i / d` apart in normalised coordinates.
All pairs together give d by least squares over :math:`1/d`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ideal_robot.arrays import Array
from sensing.camera.camera_model import CameraModel
from sensing.sensing_error import SensingError


@dataclass(frozen=True)
class FeatureDistance:
    """Distance along the optical axis and its standard deviation [m]."""

    distance: float
    std: float


def distance_from_features(camera: CameraModel, pixels: Array, lengths: Array, *, sigma_px: float = 0.1
                           ) -> FeatureDistance:
    """Distance from pairs of features, e.g. both edges of a line of known width in several rows ([L] 4.2).

    For scripts that measure the height with the camera alone; no scene uses it.

    Args:
        camera: the camera as it is calibrated.
        pixels: both features of each pair ``(m, 2, 2)`` [px].
        lengths: how far apart they are on the surface ``(m,)`` [m].
        sigma_px: standard deviation of a feature's pixel coordinates.

    Raises:
        SensingError: no pair, or features that coincide.
    """
    pixels, lengths = np.asarray(pixels, dtype=float), np.asarray(lengths, dtype=float)
    if pixels.ndim != 3 or pixels.shape[1:] != (2, 2) or len(pixels) != len(lengths) or len(lengths) == 0:
        raise SensingError("a distance needs pairs of features of shape (m, 2, 2) with m known lengths")
    rays = camera.rays(pixels.reshape(-1, 2))
    points = (rays[:, :2] / rays[:, 2:]).reshape(-1, 2, 2)
    apart = np.linalg.norm(points[:, 1] - points[:, 0], axis=1)
    inverse = float(lengths @ apart / (lengths @ lengths))
    if inverse <= 0 or not np.isfinite(inverse):
        raise SensingError("the features coincide in the image; they do not determine a distance")
    # Two features of a pair scatter independently.
    focal = 0.5 * (camera.K[0, 0] + camera.K[1, 1])
    std_inverse = np.sqrt(2.0) * sigma_px / focal / float(np.linalg.norm(lengths))
    return FeatureDistance(1.0 / inverse, std_inverse / inverse**2)
