"""The replay of a line-following run: arm, surface, drawn line, camera pictures, distance from the line."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.signals.recording import Recording
from scenes.line.result import LineResult
from scenes.online.line_task import FieldShown
from scenes.report.replay import Replay, sensed_force, sensed_line
from scenes.result import step
from sensing.camera.line_polynomial import Polyline

_MARGIN = 0.08
"""What is drawn of the surface beside the line [m]."""


def line_replay(result: LineResult) -> Replay | None:
    """The replay of a run; None where the recording is too short for one.

    Args:
        result: the run.
    """
    recording = result.recording
    if len(recording.t) < 2:
        return None
    robot = result.scene.arm
    rows = slice(None, None, step(len(recording.t)))
    t, q = recording.t[rows], recording.joints("qa", rows)
    pose = robot.fk()
    tool = np.array([pose(row).translation for row in q])
    drawn = result.geometry.drawn
    counted = result.control_error
    error = np.full(len(t), np.nan)
    if len(counted.t) > 1:
        error = np.abs(np.interp(t, counted.t, counted.lateral, left=np.nan, right=np.nan))
    curves = {"drawn line": drawn, "reference": result.geometry.reference}
    seen = sensed_line(robot, recording)
    if len(seen) > 1:
        curves["line as sensed"] = seen
    return Replay(robot, t, q, tool, _nearest(result, tool), 1e3 * error, "distance from the line",
                  curves=curves, surface=surface_corners(result), force=sensed_force(robot, recording, rows),
                  pictures=tuple((one.t, _png(one)) for one in result.shown))


def with_ghost(replay: Replay, other: Recording) -> Replay:
    """The replay with the arm of another run drawn pale.

    Args:
        replay: of a run.
        other: recording of another run of the same scene; it stands still where it has ended already.
    """
    rows = slice(None, None, step(len(other.t)))
    q = other.joints("qa", rows)
    return replace(replay, ghost=np.column_stack([np.interp(replay.t, other.t[rows], column) for column in q.T]))


def _nearest(result: LineResult, points: Array) -> Array:
    """The drawn line's points nearest to points ``(N, 3)`` [m], both in the surface."""
    plane = result.geometry.plane
    up = plane.rotation[:, 2]
    # The height above the surface is no error of following.
    height = np.outer((points - plane.translation) @ up, up)
    return np.asarray(Polyline(result.geometry.drawn).nearest(points - height, up).foot + height)


def surface_corners(result: LineResult) -> Array:
    """Corners ``(4, 3)`` [m] of the part of the surface that the line lies on."""
    plane = result.geometry.plane
    reference = (result.geometry.reference - plane.translation) @ plane.rotation
    xy = np.vstack([result.geometry.drawn_xy, reference[:, :2]])
    (x0, y0), (x1, y1) = xy.min(axis=0) - _MARGIN, xy.max(axis=0) + _MARGIN
    corners = np.array([[x0, y0, 0.0], [x1, y0, 0.0], [x1, y1, 0.0], [x0, y1, 0.0]])
    return np.asarray(corners @ plane.rotation.T + plane.translation)


def _png(shown: FieldShown) -> bytes:
    """A camera picture with search windows, points and polynomial."""
    image = cv2.cvtColor(shown.image, cv2.COLOR_GRAY2BGR)
    for window in shown.windows:
        cv2.rectangle(image, (window.u, window.v), (window.u + window.width - 1, window.v + window.height - 1),
                      (189, 110, 10), 1)
    curve = shown.polynomial_pixels
    if len(curve):
        cv2.polylines(image, [np.rint(curve[np.isfinite(curve).all(axis=1)]).astype(np.int32).reshape(-1, 1, 2)], False,
                      (0, 106, 224), 1, cv2.LINE_AA)
    for pixel, used in zip(shown.pixels, shown.used, strict=True):
        if np.isfinite(pixel).all():
            cv2.drawMarker(image, (round(pixel[0]), round(pixel[1])), (30, 160, 30) if used else (40, 40, 220),
                           cv2.MARKER_CROSS, 9, 1)
    return bytes(cv2.imencode(".png", image)[1])
