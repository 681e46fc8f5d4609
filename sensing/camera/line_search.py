"""Where the line is searched in the image: small windows across its prediction."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.jit import jit
from sensing.camera.camera_device import Window
from sensing.camera.camera_model import CameraModel, distort
from sensing.camera.line_profile import Look

Integers = NDArray[np.int64]


@dataclass(frozen=True)
class PredictedLine:
    """The line as predicted, in the tool frame at the exposure.

    Attributes:
        points: predicted line points ``(m, 3)`` [m]; five in [L].
        tangents: unit tangents ``(m, 3)``.
        normal: unit normal of the surface ``(3,)``; the points' plane is taken through each of them.
        sigma: standard deviation of the lateral prediction [m].
        covariance: of the lateral predictions ``(m, m)`` [m²]; None where the line has the predicted shape, wherever it
            lies and however it is turned.
    """

    points: Array
    tangents: Array
    normal: Array
    sigma: float
    covariance: Array | None = None

    @property
    def covariance_or_zero(self) -> Array:
        """Covariance of the lateral predictions, without a common shift of the line ``(m, m)`` [m²]."""
        return np.zeros((len(self.points),) * 2) if self.covariance is None else self.covariance

    @classmethod
    def from_base(cls, points: Array, tangents: Array, normal: Array, pose: pin.SE3, sigma: float,
                  covariance: Array | None = None) -> PredictedLine:
        """A prediction from points, tangents and surface normal in the base frame and the TCP's pose.

        Args:
            points: in the base frame ``(m, 3)`` [m].
            tangents: unit vectors along the line in the base frame ``(m, 3)``.
            normal: unit normal of the surface in the base frame ``(3,)``.
            pose: of the TCP in the base frame.
            sigma: standard deviation of the prediction across the line [m].
            covariance: of the predictions ``(m, m)`` [m²]; None where the shape is known.
        """
        R = pose.rotation
        return cls((np.asarray(points) - pose.translation) @ R, np.asarray(tangents) @ R, np.asarray(normal) @ R, sigma,
                   covariance)


CONTRAST = 0.3
"""Share of a line's contrast below which a cross-section does not count."""


@dataclass(frozen=True)
class DetectionSettings:
    """How the line looks and what is accepted.

    Attributes:
        line_width: width of the line [m].
        dark: darker than its surroundings.
        blur: σ of the blurred edge [px].
        rows: rows of a search window [px].
        margin: half width of a search window beyond three standard deviations of the prediction [px].
        max_half_width: largest half width of a window [px].
        min_contrast: least depth of the cross-section [gray].
        width_tolerance: largest relative deviation of the width.
        min_quality: cross-sections below this quality are rejected.
        smoothness: how far the points may leave a straight line of deviations from the prediction [m], in addition to
            the prediction's uncertainty of the shape.
        noise: gray noise that is assumed at least, for the standard deviation of a point.
        min_points: fewer agreeing points are no measurement.
    """

    line_width: float = 0.003
    dark: bool = True
    blur: float = 0.5
    rows: int = 3
    margin: float = 7.0
    max_half_width: int = 48
    min_contrast: float = 30.0
    width_tolerance: float = 0.35
    smoothness: float = 0.0005
    noise: float = 2.0
    min_quality: float = 0.4
    min_points: int = 3

    def __post_init__(self) -> None:
        for name in ("line_width", "blur", "rows", "margin", "max_half_width", "min_contrast", "width_tolerance",
                     "min_quality", "smoothness", "noise", "min_points"):
            if not getattr(self, name) > 0:
                raise InputError("must be positive", field=f"detection.{name}", value=getattr(self, name))

    @classmethod
    def of(cls, width: float, darker: float) -> DetectionSettings:
        """Settings for a line of this width [m], darker than its background by ``darker`` [gray], or brighter."""
        return cls(line_width=width, dark=darker > 0, min_contrast=min(cls.min_contrast, CONTRAST * abs(darker)))

    @property
    def look(self) -> Look:
        """The settings as compiled functions take them."""
        return Look(self.line_width, self.blur, 1.0 if self.dark else -1.0, self.min_contrast, self.width_tolerance,
                    self.min_quality, self.smoothness, self.noise)


class PredictedImage(NamedTuple):
    """The predicted line in pixels.

    Attributes:
        pixels: of the predicted points ``(m, 2)``; NaN behind the camera.
        axis: scan direction across the line, 0 along columns' numbers (u), 1 along rows' (v), ``(m,)``.
        slant: pixels that the line moves along the scan per pixel across it ``(m,)``.
        metres: lateral shift on the surface along normal × tangent per pixel along the scan ``(m,)`` [m].
    """

    pixels: Array
    axis: Integers
    slant: Array
    metres: Array


@jit()
def _predict(
    points: Array, tangents: Array, normal: Array, R: Array, p: Array, K: Array, k: Array
) -> tuple[Array, Integers, Array, Array]:
    m = points.shape[0]
    pixels = np.empty((m, 2))
    axis = np.zeros(m, dtype=np.int64)
    slant, metres = np.empty(m), np.empty(m)
    step = 5e-4
    projected, lateral, d = np.empty((5, 2)), np.empty(3), np.empty(3)
    for i in range(m):
        t = tangents[i]
        lateral[0] = normal[1] * t[2] - normal[2] * t[1]
        lateral[1] = normal[2] * t[0] - normal[0] * t[2]
        lateral[2] = normal[0] * t[1] - normal[1] * t[0]
        for j in range(5):
            along = step * ((j == 2) - (j == 1))
            across = step * ((j == 4) - (j == 3))
            for r in range(3):
                d[r] = points[i, r] + along * t[r] + across * lateral[r] - p[r]
            z = R[0, 2] * d[0] + R[1, 2] * d[1] + R[2, 2] * d[2]
            x, y = np.nan, np.nan
            if z > 0.0:
                x, y = distort((R[0, 0] * d[0] + R[1, 0] * d[1] + R[2, 0] * d[2]) / z,
                               (R[0, 1] * d[0] + R[1, 1] * d[1] + R[2, 1] * d[2]) / z, k)
            projected[j, 0] = K[0, 0] * x + K[0, 1] * y + K[0, 2]
            projected[j, 1] = K[1, 1] * y + K[1, 2]
        pixels[i, 0], pixels[i, 1] = projected[0, 0], projected[0, 1]
        a = 1 if abs(projected[2, 0] - projected[1, 0]) > abs(projected[2, 1] - projected[1, 1]) else 0
        axis[i] = a
        slant[i] = (projected[2, a] - projected[1, a]) / (projected[2, 1 - a] - projected[1, 1 - a])
        # A pixel e along the scan corresponds to the lateral shift d for which e - d·across is parallel to the line.
        metres[i] = 1.0 / ((projected[4, a] - projected[3, a]) / (2.0 * step)
                           - slant[i] * ((projected[4, 1 - a] - projected[3, 1 - a]) / (2.0 * step)))
    return pixels, axis, slant, metres


def predict_image(camera: CameraModel, prediction: PredictedLine) -> PredictedImage:
    """Projects a prediction, with the scale and slant that the line has in the image."""
    T = camera.T_tool_camera
    return PredictedImage(*_predict(
        np.ascontiguousarray(prediction.points, dtype=float), np.ascontiguousarray(prediction.tangents, dtype=float),
        np.ascontiguousarray(prediction.normal, dtype=float), np.ascontiguousarray(T.rotation),
        np.ascontiguousarray(T.translation), camera.K, camera.distortion))  # fmt: skip


def search_windows(
    camera: CameraModel, prediction: PredictedLine, settings: DetectionSettings | None = None
) -> tuple[Window, ...]:
    """One search window per predicted point, across the line along image rows or columns, whichever is more square.

    A window that would lie outside the image is empty (0 × 0), so that windows and points stay aligned.

    Args:
        camera: the camera as it is calibrated.
        prediction: where the line should be, ``m`` points.
        settings: how the line looks; the defaults if None.
    """
    s = settings or DetectionSettings()
    image = predict_image(camera, prediction)
    return tuple(
        _window(camera, pixel, a, 3.0 * prediction.sigma / abs(metres), s)
        for pixel, a, metres in zip(image.pixels.tolist(), image.axis.tolist(), image.metres.tolist(), strict=True)
    )


def _window(camera: CameraModel, pixel: list[float], axis: int, reach: float, s: DetectionSettings) -> Window:
    if not (math.isfinite(pixel[0]) and math.isfinite(pixel[1])):
        return Window(0, 0, 0, 0)
    limits = (camera.width, camera.height)
    half = int(min(math.ceil(reach + s.margin), s.max_half_width))
    centre = (round(pixel[0]), round(pixel[1]))
    start, size = [0, 0], [0, 0]
    for a, before, after in ((axis, half, half), (1 - axis, (s.rows - 1) // 2, s.rows // 2)):
        first, last = max(centre[a] - before, 0), min(centre[a] + after, limits[a] - 1)
        start[a], size[a] = first, last - first + 1
    if size[axis] < half or size[1 - axis] < s.rows or not 0 <= centre[axis] < limits[axis]:
        return Window(0, 0, 0, 0)
    return Window(start[0], start[1], size[0], size[1])
