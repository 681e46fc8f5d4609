"""Line points of one camera field: one point per predicted search window, sub-pixel, checked against each other.

[L] 5: "a single line is tracked, represented by a polynomial which is computed from 5 detected line points". Here are
the points: windows where the line is predicted, edge pairs with gates of width and contrast, a least-squares fit of
each cross-section, and a test which of them together make one smooth line near the prediction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numba import njit
from numpy.typing import NDArray

from ideal_robot.errors import InputError
from ideal_robot.interface import Array
from sensing.camera_model import CameraModel
from sensing.field import Field, Window
from sensing.line_profile import find_sections

SAMPLING = 0.01
"""Error of a point that comes from sampling by pixels, not from noise; standard deviation [px]."""


@dataclass(frozen=True)
class PredictedLine:
    """Where the line should be, in the tool frame at the exposure.

    Attributes:
        points: predicted line points ``(m, 3)`` [m]; five in [L].
        tangents: unit tangents ``(m, 3)``.
        normal: unit normal of the surface ``(3,)``; the points' plane is taken through each of them.
        sigma: standard deviation of the lateral prediction [m].
    """

    points: Array
    tangents: Array
    normal: Array
    sigma: float

    @classmethod
    def from_base(cls, points: Array, tangents: Array, normal: Array, pose: pin.SE3, sigma: float) -> PredictedLine:
        """The same from points, tangents and surface normal in the base frame and the TCP's pose."""
        R = pose.rotation
        return cls((np.asarray(points) - pose.translation) @ R, np.asarray(tangents) @ R, np.asarray(normal) @ R, sigma)


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
        min_quality: cross-sections below this quality do not count.
        smoothness: how far the points may leave a straight line of deviations from the prediction [m].
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


@dataclass(frozen=True)
class LineField:
    """What one field says of the line; row i belongs to predicted point i.

    Attributes:
        t: time stamp of the exposure [s].
        points_tcp: line points in the tool frame ``(m, 3)`` [m]; NaN where none was found.
        pixels: the same in the image ``(m, 2)`` [px].
        lateral: signed distance from the predicted line along normal × tangent ``(m,)`` [m].
        sigma: lateral standard deviation ``(m,)`` [m].
        quality: 0 to 1 ``(m,)``: how well width, contrast and shape of the cross-section fit; 0 where none was found.
        used: points that passed the outlier test ``(m,)``.
        seen: enough points agree.
        reason: why not, else empty.
    """

    t: float
    points_tcp: Array
    pixels: Array
    lateral: Array
    sigma: Array
    quality: Array
    used: NDArray[np.bool_]
    seen: bool
    reason: str


@dataclass(frozen=True)
class _Image:
    """The prediction in the image: pixels, scan axis (0 columns, 1 rows), slant, metres of lateral shift per pixel."""

    pixels: Array
    axis: NDArray[np.int64]
    slant: Array
    metres: Array


def _predict_image(camera: CameraModel, prediction: PredictedLine) -> _Image:
    step = 5e-4
    p, t = prediction.points, prediction.tangents
    lateral = np.cross(prediction.normal, t)
    m = len(p)
    d, e = step * t, step * lateral
    pixels = camera.project_tool(np.concatenate([p, p - d, p + d, p - e, p + e]))
    along = pixels[2 * m : 3 * m] - pixels[m : 2 * m]
    across = (pixels[4 * m :] - pixels[3 * m : 4 * m]) / (2 * step)
    axis = (np.abs(along[:, 0]) > np.abs(along[:, 1])).astype(int)
    row = np.arange(m)
    slant = along[row, axis] / along[row, 1 - axis]
    # A pixel e along the scan is the lateral shift d with e - d·across parallel to the line.
    return _Image(pixels[:m], axis, slant, 1.0 / (across[row, axis] - slant * across[row, 1 - axis]))


def search_windows(
    camera: CameraModel, prediction: PredictedLine, settings: DetectionSettings | None = None
) -> tuple[Window, ...]:
    """One window per predicted point, across the line along image rows or columns, whichever cuts it more squarely.

    A window that would lie outside the image is empty (0 × 0), so that windows and points stay aligned.
    """
    s = settings or DetectionSettings()
    image = _predict_image(camera, prediction)
    return tuple(
        _window(camera, image.pixels[i], int(image.axis[i]), 3.0 * prediction.sigma / abs(image.metres[i]), s)
        for i in range(len(image.pixels))
    )


def _window(camera: CameraModel, pixel: Array, axis: int, reach: float, s: DetectionSettings) -> Window:
    limits = (camera.width, camera.height)
    if not np.all(np.isfinite(pixel)):
        return Window(0, 0, 0, 0)
    half = int(min(np.ceil(reach + s.margin), s.max_half_width))
    centre = np.rint(pixel).astype(int)
    start, size = np.empty(2, dtype=int), np.empty(2, dtype=int)
    for a, before, after in ((axis, half, half), (1 - axis, (s.rows - 1) // 2, s.rows // 2)):
        first, last = max(centre[a] - before, 0), min(centre[a] + after, limits[a] - 1)
        start[a], size[a] = first, last - first + 1
    if size[axis] < half or size[1 - axis] < s.rows or not 0 <= centre[axis] < limits[axis]:
        return Window(0, 0, 0, 0)
    return Window(int(start[0]), int(start[1]), int(size[0]), int(size[1]))


@njit(cache=True)
def _consensus(
    deviation: Array,
    quality: Array,
    window: NDArray[np.int64],
    along: Array,
    tolerance: float,
    sigma: float,
    least: float,
    m: int,
) -> NDArray[np.int64]:
    """Chooses at most one candidate per window so that the deviations from the prediction make one straight line.

    Every pair of candidates (and each alone) proposes a line of deviations. Its score is the sum of the nearest
    candidates' qualities, each falling with its distance from that line, times a prior on the mean deviation.
    """
    k = deviation.size
    best = np.full(m, -1, dtype=np.int64)
    choice = np.empty(m, dtype=np.int64)
    gain = np.empty(m)
    best_score = 0.0
    for a in range(k):
        for b in range(a, k):
            if (a != b and window[a] == window[b]) or quality[a] < least or quality[b] < least:
                continue
            slope = 0.0 if a == b else (deviation[b] - deviation[a]) / (along[window[b]] - along[window[a]])
            if abs(slope) > 0.3:
                continue
            choice[:] = -1
            gain[:] = 0.0
            for c in range(k):
                r = (deviation[c] - deviation[a] - slope * (along[window[c]] - along[window[a]])) / tolerance
                value = quality[c] * (1.0 - r * r)
                if quality[c] >= least and value > gain[window[c]]:
                    gain[window[c]], choice[window[c]] = value, c
            total, mean = 0.0, 0.0
            for i in range(m):
                total += gain[i]
                if choice[i] >= 0:
                    mean += gain[i] * (deviation[choice[i]] / (3.0 * sigma)) ** 2
            if total <= 0.0:
                continue
            score = total * np.exp(-0.5 * mean / total)
            if score > best_score:
                best_score = score
                best[:] = choice
    return best


def detect_line(
    field: Field, camera: CameraModel, prediction: PredictedLine, settings: DetectionSettings | None = None
) -> LineField:
    """Line points of a field, in the tool frame.

    Args:
        field: patches of the windows that ``search_windows`` asked for.
        camera: the camera as it is calibrated.
        prediction: the line as predicted for the exposure, in the tool frame; may be a better one than the windows
            were made with, but for the same points.
        settings: how the line looks and what is accepted.

    Raises:
        InputError: the field has not one window per predicted point.
    """
    s = settings or DetectionSettings()
    m = len(prediction.points)
    if len(field.windows) != m:
        raise InputError("expected one window per predicted point", field="field.windows", value=len(field.windows))
    image = _predict_image(camera, prediction)
    sections, owner = _all_sections(field, image, s)
    lateral, sigma, quality = np.full(m, np.nan), np.full(m, np.nan), np.zeros(m)
    pixels, points = np.full((m, 2), np.nan), np.full((m, 3), np.nan)
    used = np.zeros(m, dtype=bool)
    if len(sections):
        metres = image.metres[owner]
        deviation = (sections[:, 0] - image.pixels[owner, image.axis[owner]]) * metres
        # The window's middle row is not the predicted point's: what the line runs on between them is no deviation.
        deviation -= sections[:, 5] * image.slant[owner] * metres
        expected = s.line_width / np.abs(metres)
        misfit = sections[:, 3] / np.maximum(sections[:, 2], 1.0)
        grade = np.exp(-0.5 * ((sections[:, 1] / expected - 1.0) / 0.2) ** 2 - 0.5 * (misfit / 0.1) ** 2)
        along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(prediction.points, axis=0), axis=1))])
        chosen = _consensus(deviation, grade, owner, along, s.smoothness, prediction.sigma, s.min_quality, m)
        used = chosen >= 0
        for i in range(m):
            c = chosen[i]
            if c < 0:
                own = np.flatnonzero(owner == i)
                if len(own) == 0:
                    continue
                c = own[0]
            lateral[i], quality[i] = deviation[c], grade[c]
            sigma[i] = np.hypot(sections[c, 4] * max(sections[c, 3], s.noise), SAMPLING) * abs(image.metres[i])
            pixels[i, image.axis[i]] = sections[c, 0]
            pixels[i, 1 - image.axis[i]] = image.pixels[i, 1 - image.axis[i]] + sections[c, 5]
            height = float(prediction.normal @ prediction.points[i])
            points[i] = camera.on_plane(pixels[i : i + 1], prediction.normal, height)[0]
    count = int(used.sum())
    return LineField(field.t_stamp, points, pixels, lateral, sigma, quality, used, count >= s.min_points,
                     _reason(field, len(set(owner.tolist())), count, s))


def _all_sections(field: Field, image: _Image, s: DetectionSettings) -> tuple[Array, NDArray[np.int64]]:
    """All cross-sections of all windows, scan coordinate in image pixels; column 5: middle row minus predicted row."""
    sections, owners = [np.empty((0, 6))], [np.empty(0, dtype=np.int64)]
    for i, (window, patch) in enumerate(zip(field.windows, field.patches, strict=True)):
        if patch.size == 0:
            continue
        axis = int(image.axis[i])
        if (window.height > window.width) != bool(axis):
            # Predicted anew, the line may lie across the diagonal; the window's own direction stays the scan.
            continue
        first = window[axis]
        middle = window[1 - axis] + 0.5 * (window[3 - axis] - 1) - image.pixels[i, 1 - axis]
        rows = np.ascontiguousarray(patch.T if axis else patch)
        predicted = image.pixels[i, axis] + image.slant[i] * middle - first
        found = find_sections(rows, predicted, image.slant[i], s.line_width / abs(image.metres[i]), s.blur,
                              1.0 if s.dark else -1.0, s.min_contrast, s.width_tolerance)
        found[:, 0] += first
        sections.append(np.column_stack([found, np.full(len(found), middle)]))
        owners.append(np.full(len(found), i))
    return np.concatenate(sections), np.concatenate(owners)


def _reason(field: Field, found: int, used: int, s: DetectionSettings) -> str:
    if used >= s.min_points:
        return ""
    if all(patch.size == 0 for patch in field.patches):
        return "the predicted line lies outside the image"
    if found == 0:
        return "no line of the expected width and contrast in any window"
    return f"only {used} of {len(field.windows)} points agree, {s.min_points} are needed"
