"""The line in a whole picture of which nothing is known: width, polarity and place are found, not given.

For pictures of a user's own cell, before anything moves (``ideal-robot detect``). Three steps:

1. ridges of both polarities at several scales (second derivatives, OpenCV), of which the longest connected one is the
   line; its width and contrast follow from the picture;
2. windows along it, in which a ``LineDetector`` finds sub-pixel points;
3. a polynomial with covariance through the points, of the lowest order that leaves no more than noise.

A picture has no scale: all lengths are pixels. The camera is one that sees one unit a pixel, so that the detectors need
not know.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from sensing import SensingError
from sensing.camera.camera_device import Field, Gray
from sensing.camera.camera_model import CameraModel
from sensing.camera.detector import LineDetector
from sensing.camera.line_detection import LineField
from sensing.camera.line_polynomial import LinePolynomial, fit_line_polynomial
from sensing.camera.line_search import DetectionSettings, PredictedLine, search_windows

SCALES = (1.5, 2.5, 4.0, 6.5, 10.0, 16.0)
"""Half widths of the ridges looked for [px]."""
MAX_DEGREE = 5
_SHAPE = 0.05
"""What a polynomial may miss of the line's shape [px]."""
_OUTLIER = 8.0
"""Standard deviations from which on a point counts as an outlier."""
_DISTANCE = 1000.0
"""Of the stand-in camera from its picture plane [px]; it cancels."""
_LONGEST_SIDE = 640
"""The coarse search runs on a picture no larger than that [px]."""
_SHORTEST = 0.25
"""A ridge shorter than this share of the picture's longer side is not the line."""


@dataclass(frozen=True)
class RoughLine:
    """A line as the coarse search sees it.

    Attributes:
        along: image axis along which it runs: 0 for u, 1 for v.
        coefficients: polynomial of the other coordinate over that one, scaled to -1 … 1 over ``span``,
            ``(d + 1,)`` [px].
        span: first and last coordinate along it [px].
        width: its width [px].
        dark: darker than its surroundings.
        contrast: how much darker or brighter [gray].
    """

    along: int
    coefficients: Array
    span: tuple[float, float]
    width: float
    dark: bool
    contrast: float

    def at(self, along: Array) -> Array:
        """Coordinate across ``(m,)`` [px] at coordinates along ``(m,)`` [px]."""
        return np.asarray(np.polynomial.polynomial.polyval(self._scaled(along), self.coefficients))

    def slope(self, along: Array) -> Array:
        """Derivative of ``at`` ``(m,)``."""
        derivative = np.polynomial.polynomial.polyder(self.coefficients)
        return np.asarray(np.polynomial.polynomial.polyval(self._scaled(along), derivative) * 2.0
                          / (self.span[1] - self.span[0]))

    def _scaled(self, along: Array) -> Array:
        middle, half = 0.5 * (self.span[0] + self.span[1]), 0.5 * (self.span[1] - self.span[0])
        return (np.asarray(along, dtype=float) - middle) / half


@dataclass(frozen=True)
class PictureLine:
    """What was found in one picture.

    Attributes:
        size: width and height of the picture [px].
        rough: the coarse line, or None.
        field: sub-pixel points; ``points_tcp`` has no meaning here.
        polynomial: deviation of the line from ``rough`` over its length, with covariance [px], or None.
        reason: why there is no line, else empty.
    """

    size: tuple[int, int]
    rough: RoughLine | None
    field: LineField | None
    polynomial: LinePolynomial | None
    reason: str

    @property
    def found(self) -> bool:
        """Whether there is a line."""
        return self.polynomial is not None

    @property
    def sigma(self) -> float:
        """Standard deviation of the polynomial across the line in its middle [px]; NaN where none was found."""
        if self.polynomial is None:
            return float("nan")
        p = self.polynomial
        # What the points scatter beyond their own sigma is no longer theirs alone.
        return float(p.deviation(np.array([p.centre]))[1][0] * max(p.residual, 1.0))

    def curve(self, count: int = 100) -> Array:
        """The polynomial in the picture ``(count, 2)`` [px]; empty where none was found.

        Args:
            count: how many points.
        """
        if self.polynomial is None or self.rough is None:
            return np.empty((0, 2))
        along = np.linspace(*self.polynomial.span, count)
        slope = self.rough.slope(along)
        across = self.rough.at(along) + self.polynomial.deviation(along)[0] * np.hypot(1.0, slope)
        return np.column_stack([along, across] if self.rough.along == 0 else [across, along])


def detect_in_picture(gray: Gray, detector: LineDetector, *, points: int = 15) -> PictureLine:
    """Finds the one line of a picture.

    Args:
        gray: the picture ``(height, width)``.
        detector: what finds the sub-pixel points.
        points: windows along the line.

    Raises:
        InputError: not a gray picture of at least 32 × 32 pixels, or fewer than five points asked for.
    """
    if gray.ndim != 2 or gray.dtype != np.uint8 or min(gray.shape) < 32:
        raise InputError("expected a gray picture of 8 bits and at least 32 × 32 pixels", field="picture",
                         value=(gray.shape, str(gray.dtype)))
    if points < 5:
        raise InputError("five points are needed at least", field="points", value=points)
    size = (gray.shape[1], gray.shape[0])
    rough = find_rough_line(gray)
    if rough is None:
        return PictureLine(size, None, None, None, "no line-like ridge of sufficient length and contrast")
    camera = _unit_camera(size)
    inset = 0.02 * (rough.span[1] - rough.span[0])
    along = np.linspace(rough.span[0] + inset, rough.span[1] - inset, points)
    prediction = _predicted(rough, along, camera)
    settings = DetectionSettings(line_width=rough.width, dark=rough.dark, blur=max(0.5, 0.1 * rough.width), rows=3,
                                 margin=max(7.0, 1.5 * rough.width), max_half_width=max(48, round(3 * rough.width)),
                                 min_contrast=max(8.0, 0.5 * rough.contrast), width_tolerance=0.5,
                                 smoothness=max(2.0, 0.5 * rough.width), min_points=5)
    windows = search_windows(camera, prediction, settings)
    patches = tuple(np.ascontiguousarray(gray[w.v : w.v + w.height, w.u : w.u + w.width]) for w in windows)
    found = detector.detect(Field(0.0, 0.0, windows, patches), camera, prediction, settings)
    if not found.seen:
        return PictureLine(size, rough, found, None, found.reason)
    polynomial = _polynomial(along, found)
    if polynomial is None:
        return PictureLine(size, rough, found, None, "the points do not lie on one smooth curve")
    return PictureLine(size, rough, found, polynomial, "")


def find_rough_line(gray: Gray) -> RoughLine | None:
    """The longest ridge of either polarity, as a quintic with width and contrast; None where there is none.

    Args:
        gray: the picture ``(height, width)``.
    """
    shrink = min(1.0, _LONGEST_SIDE / max(gray.shape))
    small = cv2.resize(gray, None, fx=shrink, fy=shrink, interpolation=cv2.INTER_AREA) if shrink < 1.0 else gray
    values = small.astype(np.float32)
    bends = [_bends(values, sigma) for sigma in SCALES]
    best: tuple[float, RoughLine] | None = None
    for sign in (1.0, -1.0):
        for sigma, (mean, half) in zip(SCALES, bends, strict=True):
            found = _ridge(values, sign * mean + half, sign, sigma)
            if found is not None and (best is None or found[0] > best[0]):
                best = found
    if best is None:
        return None
    line = best[1]
    return RoughLine(line.along, line.coefficients / shrink, (line.span[0] / shrink, line.span[1] / shrink),
                     line.width / shrink, line.dark, line.contrast)


def _bends(values: np.ndarray, sigma: float) -> tuple[np.ndarray, np.ndarray]:
    """Mean and half difference of the principal curvatures at one scale ``(height, width)``."""
    smooth = cv2.GaussianBlur(values, (0, 0), sigma)
    xx, yy = cv2.Sobel(smooth, cv2.CV_32F, 2, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 2)
    xy = cv2.Sobel(smooth, cv2.CV_32F, 1, 1)
    return 0.5 * (xx + yy), np.sqrt(0.25 * (xx - yy) ** 2 + xy**2)


def _ridge(values: np.ndarray, strength: np.ndarray, sign: float, sigma: float) -> tuple[float, RoughLine] | None:
    """The longest ridge of one polarity at one scale, with its score: length times contrast over noise.

    Args:
        values: gray ``(height, width)``.
        strength: curvature across the ridges ``(height, width)``.
        sign: 1 for dark lines, -1 for bright ones.
        sigma: the scale [px].
    """
    # Order statistics of sorted values are a fraction of the work.
    ordered = np.sort(strength, axis=None)
    middle = np.median(ordered)
    level = float(middle + 5.0 * 1.4826 * np.median(np.sort(np.abs(ordered - middle)))) + 1e-3
    high = max(level, 0.35 * float(np.percentile(ordered, 99.5)))
    count, labels, stats, _ = cv2.connectedComponentsWithStats((strength > high).astype(np.uint8), connectivity=8)
    best: tuple[float, RoughLine] | None = None
    for label in np.argsort(-stats[1:count, cv2.CC_STAT_AREA])[:4] + 1:
        u, v, width, height, _ = (int(value) for value in stats[label])
        if max(width, height) - 1 < _SHORTEST * max(values.shape):
            continue
        rows, columns = np.nonzero(labels[v : v + height, u : u + width] == label)
        line = _fitted(values, rows + v, columns + u, sign, sigma)
        if line is not None and (best is None or line[0] > best[0]):
            best = line
    return best


def _fitted(values: np.ndarray, rows: np.ndarray, columns: np.ndarray, sign: float, sigma: float
            ) -> tuple[float, RoughLine] | None:
    """A quintic through one connected ridge, if it is thin, has one width and stands out along its length.

    Args:
        values: gray ``(height, width)``.
        rows: of the ridge's pixels ``(m,)``.
        columns: of the ridge's pixels ``(m,)``.
        sign: 1 for dark lines, -1 for bright ones.
        sigma: scale at which it was found [px].
    """
    extents = (int(np.ptp(columns)), int(np.ptp(rows)))
    along = int(extents[1] > extents[0])
    length = extents[along]
    s, across = (columns, rows) if along == 0 else (rows, columns)
    places = np.unique(s)
    # One place across for each along: a branching blob has many.
    counts = np.bincount(s - s.min())
    middle = (np.bincount(s - s.min(), across) / np.maximum(counts, 1))[places - s.min()]
    spread = np.sqrt(np.maximum((np.bincount(s - s.min(), across.astype(float) ** 2) / np.maximum(counts, 1))
                                [places - s.min()] - middle**2, 0.0))
    if np.median(spread) > 2.0 * sigma + 2.0:
        return None
    span = (float(places[0]), float(places[-1]))
    x = (places - 0.5 * sum(span)) / (0.5 * (span[1] - span[0]))
    keep = np.ones(len(x), bool)
    for _ in range(3):
        c = np.polynomial.polynomial.polyfit(x[keep], middle[keep], 5)
        off = np.abs(middle - np.polynomial.polynomial.polyval(x, c))
        keep = off < max(2.0 * sigma, 3.0 * float(np.median(off)))
    if np.mean(keep) < 0.7:
        return None
    rough = RoughLine(along, np.asarray(c), span, 2.0 * sigma, sign > 0, 0.0)
    profile, offsets = _mean_profile(values * sign, rough, sigma)
    measured = _width(profile, offsets)
    if measured is None:
        return None
    width, contrast, noise = measured
    if contrast < 8.0:
        return None
    # A scale that suits the width bends most; others see the same line weaker or together with its neighbours.
    suits = float(np.exp(-0.5 * (np.log(max(width, 0.5) / (2.0 * sigma)) / 0.7) ** 2))
    return length * contrast / (noise + 5.0) * suits, RoughLine(along, np.asarray(c), span, width, sign > 0, contrast)


def _mean_profile(values: np.ndarray, rough: RoughLine, sigma: float) -> tuple[Array, Array]:
    """Gray values across the line, the median along it, and their distances from it [px]."""
    offsets = np.arange(-6.0 * sigma - 4.0, 6.0 * sigma + 4.25, 0.25)
    along = np.linspace(rough.span[0], rough.span[1], 80)
    slope = rough.slope(along)
    unit = np.hypot(1.0, slope)
    a = along[:, None] - offsets * (slope / unit)[:, None]
    b = rough.at(along)[:, None] + offsets / unit[:, None]
    u, v = (a, b) if rough.along == 0 else (b, a)
    sampled = cv2.remap(values.astype(np.float32), u.astype(np.float32), v.astype(np.float32), cv2.INTER_LINEAR,
                        borderMode=cv2.BORDER_REPLICATE)
    return np.median(sampled, axis=0), offsets


def _width(profile: Array, offsets: Array) -> tuple[float, float, float] | None:
    """Width at half depth [px], depth and roughness beside the line [gray] of a dark profile; None without a dip."""
    centre = int(np.argmin(np.where(np.abs(offsets) < 0.5 * offsets[-1], profile, np.inf)))
    left, right = profile[: max(centre - 4, 1)], profile[centre + 4 :]
    if left.size < 4 or right.size < 4:
        return None
    floor = float(profile[centre])
    level = min(float(np.max(left)), float(np.max(right)))
    depth = level - floor
    half = floor + 0.5 * depth
    below = profile < half
    begin, end = centre, centre
    while begin > 0 and below[begin - 1]:
        begin -= 1
    while end < len(profile) - 1 and below[end + 1]:
        end += 1
    if begin == 0 or end == len(profile) - 1:
        return None
    outside = np.r_[profile[:begin], profile[end + 1 :]]
    return float(offsets[end] - offsets[begin] + 0.25), depth, float(np.std(outside))


def _unit_camera(size: tuple[int, int]) -> CameraModel:
    """A camera whose picture plane has one unit a pixel."""
    K = np.array([[_DISTANCE, 0.0, 0.0], [0.0, _DISTANCE, 0.0], [0.0, 0.0, 1.0]])
    return CameraModel(size[0], size[1], K, np.zeros(5), pin.SE3.Identity())


def _predicted(rough: RoughLine, along: Array, camera: CameraModel) -> PredictedLine:
    """The coarse line as a prediction for the stand-in camera."""
    across, slope = rough.at(along), rough.slope(along)
    ones, zeros = np.ones_like(along), np.zeros_like(along)
    points = np.column_stack([along, across, zeros + _DISTANCE])
    tangents = np.column_stack([ones, slope, zeros]) / np.hypot(1.0, slope)[:, None]
    if rough.along == 1:
        points[:, [0, 1]], tangents[:, [0, 1]] = points[:, [1, 0]], tangents[:, [1, 0]]
    normal = np.array([0.0, 0.0, 1.0 if rough.along == 0 else -1.0])
    return PredictedLine(points, tangents, normal, max(1.0, 0.3 * rough.width))


def _polynomial(along: Array, found: LineField) -> LinePolynomial | None:
    """The order that Akaike's corrected criterion prefers; points far off count as outliers, at a price each."""
    lateral = np.where(found.used, found.lateral, np.nan)
    count = int(found.used.sum())
    best: tuple[float, LinePolynomial] | None = None
    for degree in range(1, min(MAX_DEGREE, count - 3) + 1):
        try:
            fit = fit_line_polynomial(along, lateral, found.sigma, degree, shape_noise=_SHAPE)
        except SensingError:
            return None
        off = (fit.deviation(along)[0] - lateral) / np.hypot(found.sigma, _SHAPE)
        squares = float(np.sum(np.minimum(off[found.used] ** 2, _OUTLIER**2)))
        k = degree + 1
        criterion = squares + 2.0 * k + 2.0 * k * (k + 1) / (count - k - 1)
        if best is None or criterion < best[0]:
            best = criterion, fit
    if best is None or best[1].used.sum() < max(5, 0.6 * count):
        return None
    return best[1]
