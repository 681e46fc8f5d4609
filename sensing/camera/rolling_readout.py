"""Line points of pictures whose rows are exposed one after the other.

"We compute the camera position of the time instant of sensing and then evaluate the measured sensor data for this time
instant" ([L] 4.3). With a rolling readout each row has an instant of its own: a point belongs to the arm's pose at its
row's. Told once how long the readout takes, a camera needs no more than that; without one nothing changes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pinocchio as pin

from sensing.camera.camera_model import CameraModel
from sensing.camera.line_detection import LineField
from sensing.camera.line_search import PredictedLine

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
    pose, seen = pose_at(t), prediction
    for _ in range(_ROUNDS):
        delays = camera.row_delay(camera.project_tool(seen.points))
        moves = [pose_at(t + delay).actInv(pose) for delay in delays.tolist()]
        seen = replace(
            prediction,
            points=np.array([move.act(point) for move, point in zip(moves, prediction.points, strict=True)]),
            tangents=np.array([move.rotation @ one for move, one in zip(moves, prediction.tangents, strict=True)]))
    return seen


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
