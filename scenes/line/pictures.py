"""Camera fields that are kept as pictures for the report."""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.robots.interface import RobotState
from planning.line.line_follower import LineFollower
from planning.line.measurement import SEEN_AHEAD
from scenes.online.line_camera import LineCamera
from scenes.online.log import FieldShown
from scenes.online.task import Sensor, Work
from sensing.camera.camera_device import Field
from sensing.camera.line_detection import LineField
from sensing.camera.line_polynomial import fit_of_lowest_order

SHOWN = 4
"""Camera fields kept as pictures."""


class Pictures(Sensor):
    """Stores some of the camera's fields for the report.

    Args:
        camera: the camera whose fields are drawn.
        follower: the follower along whose reference the line is drawn.
    """

    def __init__(self, camera: LineCamera, follower: LineFollower) -> None:
        self._camera, self._follower = camera, follower
        self._at = set(np.linspace(0.35 * follower.lasts, 0.9 * follower.lasts, SHOWN).astype(int))

    def fuse(self, t: float) -> Work:
        """Fuses nothing, as it only looks at the camera's fields."""
        return Work.NOTHING

    def ended(self, t0: float, measured: RobotState, torque: Array | None) -> None:
        """Notes the end of the cycle that began at ``t0`` [s]; see ``Sensor.ended``."""
        k = round(t0 / self._follower.robot.t_ipo)
        if k not in self._at:
            return
        self._at.discard(k)
        if self._camera.last is not None and self._camera.last[1].seen:
            self._camera.log.shown.append(self._picture(*self._camera.last))
        else:
            self._at.add(k + 1)

    def _picture(self, raw: Field, seen: LineField) -> FieldShown:
        """The points found in a field and the polynomial through them ([L] 5); the whole image is drawn later."""
        follower, reference = self._follower, self._follower.reference
        pose = follower.history.row_pose(seen.t)
        points = seen.points_tcp[seen.used] @ pose.rotation.T + pose.translation
        s, deviation, _ = reference.project(points, follower.s_at(seen.t) + SEEN_AHEAD)
        polynomial = fit_of_lowest_order(s, deviation, seen.sigma[seen.used])
        places = np.linspace(polynomial.span[0] - 0.01, polynomial.span[1] + 0.01, 60)
        frames = reference.frames(places)
        curve = frames.position + polynomial.deviation(places)[0][:, None] * frames.normal
        return FieldShown(seen.t, raw, np.empty((0, 0), dtype=np.uint8), seen.pixels, seen.used,
                          self._camera.known.camera.project_tool((curve - pose.translation) @ pose.rotation))
