"""A line detector made of OpenCV's functions alone: sheared mean profile, Sobel edges, robust line through deviations.

The project's own detector is compared with it (``python -m studies detectors``); it is also an example of the interface
``LineDetector``.
"""

from __future__ import annotations

import math
from typing import ClassVar, NamedTuple

import cv2
import numpy as np

from ideal_robot.arrays import Array, arc_lengths
from ideal_robot.errors import InputError
from sensing.camera.camera_device import Field, Gray
from sensing.camera.camera_model import CameraModel
from sensing.camera.line_detection import LineField, confirmed_points
from sensing.camera.line_search import DetectionSettings, PredictedImage, PredictedLine, predict_image

_FINER = 8
"""Samples a pixel in which edges are looked for."""
_SAMPLING = 0.03
"""Error of a point that comes from sampling by pixels; standard deviation [px]."""
_REACH = 4.0
"""Standard deviations of the prediction beyond which a section is another line."""


class _Section(NamedTuple):
    """A cross-section in a window: place along the scan, width and standard deviation [px]."""

    at: float
    width: float
    sigma: float


class OpenCVProfiles:
    """Line points from mean profiles of the windows, with OpenCV only."""

    name: ClassVar[str] = "opencv"

    def detect(self, field: Field, camera: CameraModel, prediction: PredictedLine,
               settings: DetectionSettings) -> LineField:
        """Line points of a field, in the tool frame; see ``LineDetector.detect``."""
        m = len(prediction.points)
        if len(field.windows) != m or len(field.patches) != m:
            raise InputError("expected one window per predicted point", field="field.windows",
                             value=len(field.windows))
        image = predict_image(camera, prediction)
        sections = [self._sections(patch, i, field, image, settings) for i, patch in enumerate(field.patches)]
        deviation = np.full(m, np.nan)
        expected = [float(image.pixels[i, image.axis[i]]) for i in range(m)]
        reach = _REACH * prediction.sigma / np.abs(image.metres)
        chosen = [_nearest(group, line, px) for group, line, px in zip(sections, expected, reach.tolist(), strict=True)]
        for i, section in enumerate(chosen):
            if section is not None:
                deviation[i] = (section.at - expected[i]) * image.metres[i]
        along = arc_lengths(prediction.points)
        used = _agreeing(along, deviation, settings.smoothness)
        pixels, sigma, quality = np.full((m, 2), np.nan), np.full(m, np.nan), np.zeros(m)
        for i, section in enumerate(chosen):
            if section is None:
                continue
            a = int(image.axis[i])
            pixels[i, a] = section.at
            pixels[i, 1 - a] = image.pixels[i, 1 - a]
            sigma[i] = section.sigma * abs(image.metres[i])
            width = section.width * abs(image.metres[i]) / settings.line_width
            quality[i] = math.exp(-0.5 * ((width - 1.0) / 0.2) ** 2)
        used &= quality >= settings.min_quality
        used = confirmed_points(along, deviation, used, settings.smoothness, prediction.covariance_or_zero)
        points = np.full((m, 3), np.nan)
        normal = np.asarray(prediction.normal)
        for i in np.flatnonzero(np.isfinite(pixels[:, 0])).tolist():
            points[i] = camera.on_plane(pixels[i : i + 1], normal, float(normal @ prediction.points[i]))[0]
        # Three points easily agree with some straight line by chance, so points that do not fit count against it.
        count, against = int(used.sum()), int(np.sum(np.isfinite(deviation) & ~used))
        seen = count - against >= settings.min_points
        reason = "" if seen else (
            "no line of the expected width and contrast in any window" if not np.isfinite(deviation).any()
            else f"only {count} of {m} points agree, {settings.min_points + against} are needed"
                 + (f" with {against} against them" if against else ""))
        return LineField(field.t_stamp, points, pixels, deviation, sigma, quality, used, seen, reason)

    def _sections(self, patch: Gray, i: int, field: Field, image: PredictedImage,
                  s: DetectionSettings) -> list[_Section]:
        """Cross-sections of one window that pass the gates of width and contrast, in coordinates of the image."""
        window = field.windows[i]
        a = int(image.axis[i])
        if patch.size == 0 or (window.height > window.width) != (a == 1):
            return []
        rows = np.ascontiguousarray(patch.T if a == 1 else patch).astype(np.float32)
        middle_row = image.pixels[i, 1 - a] - window[1 - a]
        shear = np.array([[1.0, image.slant[i], -image.slant[i] * middle_row], [0.0, 1.0, 0.0]])
        upright = cv2.warpAffine(rows, shear, (rows.shape[1], rows.shape[0]),
                                 flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP, borderMode=cv2.BORDER_REPLICATE)
        profile = cv2.reduce(upright, 0, cv2.REDUCE_AVG) * (1.0 if s.dark else -1.0)
        fine = cv2.resize(profile, None, fx=_FINER, fy=1, interpolation=cv2.INTER_CUBIC)
        edges = cv2.GaussianBlur(cv2.Sobel(fine, cv2.CV_32F, 1, 0, ksize=1), (0, 0), s.blur * _FINER)
        slope = 0.5 * _FINER * np.asarray(edges, dtype=float).ravel()
        threshold = 0.15 * s.min_contrast
        falling, rising = _peaks(-slope, threshold), _peaks(slope, threshold)
        expected = s.line_width / abs(image.metres[i])
        noise = max(s.noise, float(np.std(rows - cv2.GaussianBlur(rows, (3, 1), 0))))
        sections = []
        for begin in falling:
            for end in rising:
                width = (end - begin) / _FINER
                if abs(width - expected) > s.width_tolerance * expected:
                    continue
                inside = fine[0, round(0.75 * begin + 0.25 * end) : round(0.25 * begin + 0.75 * end) + 1]
                around = np.r_[fine[0, max(round(begin) - _FINER * 3, 0) : max(round(begin) - _FINER, 1)],
                               fine[0, round(end) + _FINER : round(end) + 3 * _FINER]]
                depth = float(np.mean(around) - np.mean(inside)) if around.size and inside.size else 0.0
                if depth < s.min_contrast:
                    continue
                steep = 0.5 * (-slope[round(begin)] + slope[round(end)])
                sigma = math.hypot(noise / (steep * math.sqrt(2.0 * rows.shape[0])), _SAMPLING)
                # A resized row's sample k stands at (k + 0.5)/finer - 0.5 of the original.
                sections.append(_Section((0.5 * (begin + end) + 0.5) / _FINER - 0.5 + window[a], width, sigma))
        return sections


def _nearest(sections: list[_Section], expected: float, reach: float) -> _Section | None:
    """The section nearest to where the line is expected, if it is within reach [px]."""
    return min((cut for cut in sections if abs(cut.at - expected) <= reach), key=lambda cut: abs(cut.at - expected),
               default=None)


def _peaks(slope: Array, threshold: float) -> list[float]:
    """Places of local maxima above a threshold, by a parabola through each and its neighbours."""
    local = slope >= cv2.dilate(slope.reshape(1, -1), np.ones((1, 2 * _FINER + 1), np.uint8)).ravel()
    peaks = []
    for k in np.flatnonzero(local & (slope > threshold)):
        if 0 < k < slope.size - 1:
            bend = slope[k - 1] - 2.0 * slope[k] + slope[k + 1]
            peaks.append(float(k) + (0.5 * float(slope[k - 1] - slope[k + 1]) / float(bend) if bend < 0.0 else 0.0))
    return peaks


def _agreeing(along: Array, deviation: Array, smoothness: float) -> np.ndarray:
    """Deviations ``(m,)`` that lie on one straight line over ``along``, by OpenCV's robust line fit."""
    finite = np.isfinite(deviation)
    if finite.sum() < 2:
        return finite
    # In units of the tolerance on one axis and of the span on the other, so that distances mean deviations.
    span = max(float(np.ptp(along[finite])), 1e-9)
    points = np.column_stack([100.0 * along[finite] / span, deviation[finite] / smoothness]).astype(np.float32)
    vx, vy, x0, y0 = cv2.fitLine(points, cv2.DIST_HUBER, 0, 0.01, 0.01).ravel()
    if abs(vx) < 1e-6:
        return np.zeros_like(finite)
    off = np.abs(points[:, 1] - (y0 + (points[:, 0] - x0) * vy / vx))
    used = finite.copy()
    used[finite] = off < 1.0
    return used
