"""Line points of one camera field: one point per predicted search window, sub-pixel, checked against each other.

[L] 5: "a single line is tracked, represented by a polynomial which is computed from 5 detected line points". Here are
the points: windows where the line is predicted, edge pairs with gates of width and contrast, a least-squares fit of
each cross-section, and a test which of them together make one smooth line near the prediction.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.jit import jit
from sensing.camera.camera_device import Field
from sensing.camera.camera_model import CameraModel, pixel_rays
from sensing.camera.line_profile import MAX_CANDIDATES, Look, find_sections
from sensing.camera.line_search import DetectionSettings, PredictedImage, PredictedLine, predict_image, search_windows

# Which points of a field the others confirm.
#
# A straight line through three points, one of them far from the other two, is drawn to that one: its own residual stays
# small however wrong it is (its leverage is nearly 1; Baarda's *internal reliability*). So a point is compared with the
# line of the *other* points, extrapolated to it, never with a line that it determines itself. The prediction's
# covariance says how far a line of the right shape may be from that line: not at all where the shape is known.

BEND = 3.0
"""Standard deviations by which a line's shape may be another than predicted; it is by more once in 370 times."""


@jit()
def confirmed_points(along: Array, deviation: Array, used: NDArray[np.bool_], tolerance: float,
                     covariance: Array) -> NDArray[np.bool_]:
    """Mask of the points ``(m,)`` that lie within a tolerance of the least-squares line of the others.

    While one does not, the point that deviates most from the others is rejected. Two points or fewer cannot be checked
    and are accepted.

    Args:
        along: places along the prediction ``(m,)`` [m].
        deviation: from the prediction ``(m,)`` [m]; where not used, of no account.
        used: points to choose from ``(m,)``.
        tolerance: largest accepted deviation of a point [m], in addition to the prediction's uncertainty.
        covariance: of the prediction ``(m, m)`` [m²]; a common shift of the whole line is not part of it.
    """
    m = along.size
    confirmed, weight = used.copy(), np.empty(m)
    while confirmed.sum() > 2:
        worst, out, refused = 0.0, -1, False
        for i in range(m):
            if not confirmed[i]:
                continue
            count, a, d, aa, ad = 0, 0.0, 0.0, 0.0, 0.0
            for j in range(m):
                if confirmed[j] and j != i:
                    # About the point itself: the line's value there is the intercept.
                    x = along[j] - along[i]
                    count += 1
                    a, d, aa, ad = a + x, d + deviation[j], aa + x * x, ad + x * deviation[j]
            spread = aa - a * a / count
            slope = (ad - a * d / count) / spread if spread > 0.0 else 0.0
            for j in range(m):
                weight[j] = 0.0
                if confirmed[j] and j != i:
                    x = along[j] - along[i] - a / count
                    weight[j] = -1.0 / count + (a / count * x / spread if spread > 0.0 else 0.0)
            weight[i] = 1.0
            off = abs(deviation[i] - (d - slope * a) / count)
            open_to = float(weight @ covariance @ weight)
            off /= math.sqrt(1.0 + (BEND / tolerance) ** 2 * max(open_to, 0.0))
            refused = refused or off > tolerance
            # The deviation is divided by its standard deviation, as the others' extrapolation to a far end is
            # uncertain.
            off /= math.sqrt(1.0 + 1.0 / count + ((a / count) ** 2 / spread if spread > 0.0 else 0.0))
            if off > worst:
                worst, out = off, i
        if not refused:
            break
        confirmed[out] = False
    return confirmed


__all__ = ["DetectionSettings", "LineField", "PredictedLine", "detect_line", "search_windows"]

SAMPLING = 0.01
"""Error of a point that comes from sampling by pixels, not from noise; standard deviation [px]."""


@dataclass(frozen=True)
class LineField:
    """Line points of one field with their quality; row i belongs to predicted point i.

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


STEEP = 0.3
"""Slope against its prediction that a line of known shape may have."""


@jit()
def _off_chord(i: int, a: int, b: int, along: Array, covariance: Array) -> float:
    """Variance of how far point i leaves the straight line of deviations through points a and b [m²]."""
    ahead = 0.0 if a == b else (along[i] - along[a]) / (along[b] - along[a])
    chord = np.zeros(along.size)
    chord[i] += 1.0
    chord[a] -= 1.0 - ahead
    chord[b] -= ahead
    return max(float(chord @ covariance @ chord), 0.0)


@jit()
def _consensus(
    deviation: Array, quality: Array, window: NDArray[np.int64], along: Array, tolerance: float, sigma: float,
    covariance: Array,
) -> NDArray[np.int64]:
    """Chooses at most one candidate per window so that the deviations from the prediction make one smooth line.

    Every pair of candidates (and each alone) proposes a line of deviations: straight, but for what the prediction's
    covariance leaves open between and beyond the two. Its score is the sum of the nearest candidates' qualities, each
    falling with its distance from that line, times a prior on the mean deviation.
    """
    k, m = deviation.size, along.size
    square = np.empty(m)
    best, choice = np.empty(m, dtype=np.int64), np.empty(m, dtype=np.int64)
    gain = np.empty(m)
    for i in range(m):
        best[i] = -1
    best_score = 0.0
    for a in range(k):
        for b in range(a, k):
            if (a != b and window[a] == window[b]) or quality[a] <= 0.0 or quality[b] <= 0.0:
                continue
            A, B = window[a], window[b]
            span = along[B] - along[A]
            slope = 0.0 if a == b else (deviation[b] - deviation[a]) / span
            turned = 0.0 if a == b else (covariance[A, A] + covariance[B, B] - 2.0 * covariance[A, B]) / span**2
            if slope**2 > STEEP**2 + BEND**2 * turned:
                continue
            for i in range(m):
                choice[i], gain[i] = -1, 0.0
                square[i] = tolerance**2 + BEND**2 * _off_chord(i, A, B, along, covariance)
            for c in range(k):
                r = deviation[c] - deviation[a] - slope * (along[window[c]] - along[A])
                value = quality[c] * (1.0 - r * r / square[window[c]])
                if value > gain[window[c]]:
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
                for i in range(m):
                    best[i] = choice[i]
    return best


@jit()
def _sections(image: PredictedImage, gray: NDArray[np.uint8], windows: NDArray[np.int64],
              look: Look) -> tuple[Array, NDArray[np.int64], int]:
    """All cross-sections of all windows, the window of each, and how many there are.

    Columns: scan coordinate in the image, width, depth, residual, standard deviation per gray, and window's middle row
    minus predicted row.
    """
    pixels, axis, slant, metres = image
    m = pixels.shape[0]
    candidates, owner = np.empty((m * MAX_CANDIDATES, 6)), np.empty(m * MAX_CANDIDATES, dtype=np.int64)
    n = start = 0
    for i in range(m):
        a, w, h = axis[i], windows[i, 2], windows[i, 3]
        patch = gray[start : start + w * h].reshape(h, w)
        start += w * h
        # The new prediction may lie across the diagonal; the scan direction stays that of the window.
        if w * h == 0 or (h > w) != (a == 1):
            continue
        rows = np.ascontiguousarray(patch.T) if a == 1 else patch
        middle = windows[i, 1 - a] + 0.5 * (rows.shape[0] - 1) - pixels[i, 1 - a]
        sections = find_sections(rows, pixels[i, a] + slant[i] * middle - windows[i, a], slant[i],
                                 look.line_width / abs(metres[i]), look)
        for j in range(sections.shape[0]):
            for c in range(5):
                candidates[n, c] = sections[j, c]
            candidates[n, 0] += windows[i, a]
            candidates[n, 5] = middle
            owner[n] = i
            n += 1
    return candidates, owner, n


@jit()
def _evaluate(image: PredictedImage, points: Array, gray: NDArray[np.uint8], windows: NDArray[np.int64], look: Look,
              sigma: float, covariance: Array) -> tuple[Array, Array, Array, Array, NDArray[np.bool_], int]:
    """Pixels, lateral deviations, standard deviations, qualities, which are used, and windows with any section."""
    pixels, axis, slant, metres = image
    m = pixels.shape[0]
    s, owner, n = _sections(image, gray, windows, look)
    deviation, grade, good, nearest = np.empty(n), np.empty(n), np.empty(n), np.empty(m, dtype=np.int64)
    for i in range(m):
        nearest[i] = -1
    for j in range(n):
        i = owner[j]
        # The window's middle row is not the predicted point's: the line's slant between the two is no deviation.
        deviation[j] = (s[j, 0] - pixels[i, axis[i]] - s[j, 5] * slant[i]) * metres[i]
        width = s[j, 1] * abs(metres[i]) / look.line_width
        misfit = s[j, 3] / max(s[j, 2], 1.0)
        grade[j] = math.exp(-0.5 * ((width - 1.0) / 0.2) ** 2 - 0.5 * (misfit / 0.1) ** 2)
        good[j] = grade[j] if grade[j] >= look.min_quality else 0.0
        if nearest[i] < 0:
            nearest[i] = j
    along = np.zeros(m)
    for i in range(1, m):
        square = 0.0
        for c in range(3):
            square += (points[i, c] - points[i - 1, c]) ** 2
        along[i] = along[i - 1] + math.sqrt(square)
    chosen = _consensus(deviation, good, owner[:n], along, look.smoothness, sigma, covariance)
    agreeing = np.zeros(m)
    for i in range(m):
        if chosen[i] >= 0:
            agreeing[i] = deviation[chosen[i]]
    used = confirmed_points(along, agreeing, chosen >= 0, look.smoothness, covariance)
    place, lateral, spread = np.empty((m, 2)), np.empty(m), np.empty(m)
    quality, any_found = np.zeros(m), 0
    for i in range(m):
        place[i, 0] = place[i, 1] = lateral[i] = spread[i] = np.nan
        if nearest[i] < 0:
            continue
        any_found += 1
        j = chosen[i] if used[i] else nearest[i]
        lateral[i], quality[i] = deviation[j], grade[j]
        spread[i] = math.hypot(s[j, 4] * max(s[j, 3], look.noise), SAMPLING) * abs(metres[i])
        place[i, axis[i]] = s[j, 0]
        place[i, 1 - axis[i]] = pixels[i, 1 - axis[i]] + s[j, 5]
    return place, lateral, spread, quality, used, any_found


@jit()
def _back_project(pixels: Array, points: Array, normal: Array, R: Array, p: Array, K: Array, k: Array) -> Array:
    """Where the pixels' rays meet the planes through ``points``, in the tool frame; NaN of NaN."""
    rays = pixel_rays(pixels, K, k)
    crossings = np.empty((pixels.shape[0], 3))
    for i in range(pixels.shape[0]):
        above = along = 0.0
        for a in range(3):
            crossings[i, a] = R[a, 0] * rays[i, 0] + R[a, 1] * rays[i, 1] + R[a, 2] * rays[i, 2]
            above += normal[a] * (points[i, a] - p[a])
            along += normal[a] * crossings[i, a]
        for a in range(3):
            crossings[i, a] = p[a] + above / along * crossings[i, a]
    return crossings


def detect_line(
    field: Field, camera: CameraModel, prediction: PredictedLine, settings: DetectionSettings | None = None
) -> LineField:
    """Line points of a field, in the tool frame; see ``LineDetector.detect`` for arguments and errors.

    The prediction may be newer than the one the windows were made with; it must be of the same points.
    """
    s = settings or DetectionSettings()
    m = len(prediction.points)
    if len(field.windows) != m or len(field.patches) != m:
        raise InputError("expected one window per predicted point", field="field.windows", value=len(field.windows))
    points = np.ascontiguousarray(prediction.points, dtype=float)
    gray = np.concatenate([patch.ravel() for patch in field.patches])
    pixels, lateral, sigma, quality, used, with_section = _evaluate(
        predict_image(camera, prediction), points, gray, np.array(field.windows, dtype=np.int64), s.look,
        float(prediction.sigma), prediction.covariance_or_zero)
    T = camera.T_tool_camera
    points_tcp = _back_project(
        pixels, points, np.ascontiguousarray(prediction.normal, dtype=float), np.ascontiguousarray(T.rotation),
        np.ascontiguousarray(T.translation), camera.K, camera.distortion,
    )  # fmt: skip
    count = int(used.sum())
    reason = "" if count >= s.min_points else _reason(field, with_section, count, s)
    return LineField(field.t_stamp, points_tcp, pixels, lateral, sigma, quality, used, count >= s.min_points, reason)


def _reason(field: Field, found: int, used: int, s: DetectionSettings) -> str:
    if all(patch.size == 0 for patch in field.patches):
        return "the predicted line lies outside the image"
    if found == 0:
        return "no line of the expected width and contrast in any window"
    return f"only {used} of {len(field.windows)} points agree, {s.min_points} are needed"


# Line points of pictures whose rows are exposed one after the other.
#
# "We compute the camera position of the time instant of sensing and then evaluate the measured sensor data for this
# time instant" ([L] 4.3). With a rolling readout each row has an instant of its own: a point belongs to the arm's pose
# at its row's. The readout time is all that has to be known; with a readout time of zero nothing changes.

PoseAt = Callable[[float], pin.SE3]
"""Pose of the TCP in the base frame at a time [s], as the controller knows it."""
_ROUNDS = 2
"""Rounds in which a predicted point finds its row: each leaves a tenth of the error of the one before."""


def predicted_by_rows(prediction: PredictedLine, camera: CameraModel, t: float, pose_at: PoseAt) -> PredictedLine:
    """A prediction for a picture, each point in the tool frame of the instant at which its row is exposed.

    Args:
        prediction: in the tool frame at ``t``.
        camera: as it is calibrated, with its readout.
        t: time of the picture's middle row [s].
        pose_at: see ``PoseAt``; called within half the readout around ``t``.
    """
    if camera.readout == 0.0:
        return prediction
    pose, exposed = pose_at(t), prediction
    for _ in range(_ROUNDS):
        delays = camera.row_delay(camera.project_tool(exposed.points))
        moves = [pose_at(t + delay).actInv(pose) for delay in delays.tolist()]
        exposed = replace(
            prediction,
            points=np.array([move.act(point) for move, point in zip(moves, prediction.points, strict=True)]),
            tangents=np.array([move.rotation @ along for move, along in zip(moves, prediction.tangents, strict=True)]))
    return exposed


def at_middle_row(seen: LineField, camera: CameraModel, pose_at: PoseAt) -> LineField:
    """Line points of a field, all in the tool frame at the instant of the middle row, the field's time stamp.

    Args:
        seen: each point in the tool frame of its own row's instant.
        camera: as it is calibrated, with its readout.
        pose_at: see ``PoseAt``.
    """
    if camera.readout == 0.0:
        return seen
    pose, points = pose_at(seen.t), seen.points_tcp.copy()
    for i, delay in enumerate(camera.row_delay(seen.pixels).tolist()):
        points[i] = pose.actInv(pose_at(seen.t + delay)).act(points[i])
    return replace(seen, points_tcp=points)
