"""Following a drawn line on devices: the planning of ``scenes.line`` with a camera that is elsewhere."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from planning.line.line_follower import FollowerSettings
from scenes.cycle import Task
from scenes.drawn_line import reference_points
from scenes.follow.camera_file import CalibratedCamera
from scenes.follow.line_calibration import Piece, calibrated_by_moving
from scenes.follow.line_task import AT_ONCE, LiveLineTask
from scenes.follow.live_arm import LiveArm
from scenes.follow.live_camera import FoundBefore, LiveCamera
from scenes.follow.live_force import LiveForce
from scenes.follow.rehearsal import ImaginedCamera, rehearse
from scenes.line.known import START, Known, line_follower, span_of
from scenes.line.log import LineLog
from scenes.line.scene import LineScene
from scenes.methods import SceneMethod
from scenes.scene_error import SceneError
from sensing.camera.camera_model import CameraModel
from sensing.camera.line_search import DetectionSettings, PredictedLine

_CONTRAST = 0.3
"""Share of the line's contrast below which a cross-section does not count."""
_UNDER_WAY = 2
"""Cycles from a picture's arrival until a plan is made with its line points; one more where plans are made ahead."""


class LineJob:
    """A line; a ``scenes.follow.job.Job``.

    Args:
        scene: what is followed; of its tables those of the world are not looked at.
        robot: with the controller's cycle.
        model: of the arm.
        method: how what is sensed becomes commands.
        delay: cycles of the controller's own delay.
        answers_within: time in which the arm's loop answers a command [s].
        calibration: of the camera, and whether there is one already.
    """

    def __init__(self, scene: LineScene, robot: Robot, model: Model, method: SceneMethod, delay: int,
                 answers_within: float, calibration: CalibratedCamera) -> None:
        self.scene, self.robot, self.model, self.method = scene, robot, model, method
        self.answers_within, self.calibration = answers_within, calibration
        self.braking = scene.reference.acceleration
        self._delay = delay
        self._known = self._new_known()
        self.log = LineLog()
        self._task = self._new_task(self._known, self.log, ImaginedCamera())
        self.longest = self.expected = self._task.longest
        contrast = abs(scene.line.background - scene.line.gray)
        self.detection = DetectionSettings(
            line_width=1e-3 * scene.line.width_mm, dark=scene.line.gray < scene.line.background,
            min_contrast=min(DetectionSettings.min_contrast, _CONTRAST * contrast))

    @property
    def camera(self) -> CameraModel | None:
        """See ``Job``."""
        return self._known.camera

    @property
    def q_start(self) -> Array:
        """See ``Job``."""
        return self._known.follower.q_start

    def needs(self) -> tuple[str, ...]:
        """See ``Job``."""
        return ("camera",)

    def rehearse(self) -> None:
        """See ``Job``."""
        known, camera = self._new_known(), ImaginedCamera()
        task = self._new_task(known, LineLog(), camera)
        camera.predict = lambda t: _predicted(known, t)
        rehearse(task, self.robot, math.ceil((START + 0.6) / self.robot.t_ipo))
        # The first plan is a whole new one: longer than any answer may wait.
        self._task.prepare(0.0)

    def ready(self, arm: LiveArm, camera: LiveCamera | None, force: LiveForce | None) -> Task:
        """See ``Job``.

        Args:
            arm: connected, at the start.
            camera: on the arm.
            force: on the arm.
        """
        if camera is None:
            raise SceneError("following a line needs a camera")
        camera.use(self.calibration.camera, self.calibration.time_offset)
        self._task.camera = camera
        self._task.lead(arm)
        camera.predict = lambda t: _predicted(self._known, t)
        return self._task

    def calibrate(self, arm: LiveArm, camera: LiveCamera) -> CalibratedCamera:
        """Calibrates the camera by moving from the start over a piece of the line and back, and keeps it in its file.

        Raises:
            SceneError, SensingError: too little of the line was seen.
            FollowStoppedError: the arm had to stop, or is gone.
        """
        middle = 0.5 * sum(span_of(self.scene, self._known.reference))
        piece = Piece(self._known.reference, middle, self.q_start)
        return self.calibration.found(calibrated_by_moving(piece, self._known.camera, self.model, arm, camera))

    def columns(self, t: Array) -> dict[str, Array]:
        """See ``Job``: ``cam_t`` and the line points of each field, as in recordings of line scenes."""
        return dict(self.log.field_columns(t, self.scene.points))

    def figures(self) -> dict[str, Any]:
        """See ``Job``."""
        fusion = self._known.follower.fusion
        return {"fields": {"seen": len(self.log.fields), "used": self.log.used},
                "first_used_s": self.log.first_used, "calibration": self.calibration.json(),
                "stamp_error_ms": 1e3 * float(fusion.bias("camera")[0][1])}

    def planned(self) -> Array:
        """See ``Job``."""
        count = min(len(self.log.t), len(self.log.believed))
        return np.column_stack([self.log.t[:count], self.log.believed[:count]])

    def _new_known(self) -> Known:
        scene, T = self.scene, self.robot.t_ipo
        reference, follower = line_follower(scene, self.robot, reference_points(scene), self.calibration.camera,
                                            self.calibration.surface,
                                            latency=FollowerSettings.latency + (_UNDER_WAY + (T < AT_ONCE)) * T)
        return Known(scene=scene, robot=self.robot, delay=self._delay, camera=self.calibration.camera,
                     reference=reference, follower=follower, detector=FoundBefore())

    def _new_task(self, known: Known, log: LineLog, camera: Any) -> LiveLineTask:
        model = self.model if self.method.knows_model else None
        return LiveLineTask(known, self.method, camera, model, None, log)


def _predicted(known: Known, t: float) -> PredictedLine:
    """Where the line should be in a picture taken at ``t`` [s], in the tool frame."""
    return known.follower.predict(t).seen_by(known.camera, t, known.follower.history.row_pose)
