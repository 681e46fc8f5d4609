"""Following a drawn line on devices: the planning of ``scenes.line`` with a camera that is elsewhere."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from ideal_robot.arrays import Array
from ideal_robot.robots.interface import RobotState
from planning.line.line_follower import FollowerSettings
from scenes.online.configured import Configured, line_task
from scenes.online.devices import Job
from scenes.online.line_camera import AT_ONCE, LineCamera
from scenes.online.line_known import START, Known, line_follower
from scenes.online.live_arm import LiveArm
from scenes.online.live_sensors import FoundBefore, ImaginedCamera, LiveCamera, LiveForce, rehearse
from scenes.online.log import plan_error
from scenes.online.task import Task
from scenes.scene_files.drawn_line import reference_points
from scenes.scene_files.line_scene import LineScene
from scenes.scene_files.scene import SceneError

_UNDER_WAY = 2
"""Cycles from a picture's arrival until a plan is made with its line points; one more where plans are made ahead."""


class LineJob(Job):
    """A line.

    Attributes:
        moved: what the controller reported in a session before this one, cycle by cycle.
    """

    needs = ("camera",)
    moved: Sequence[RobotState] = ()
    scene: LineScene
    _known: Known

    def _set_up(self) -> None:
        self.braking = self.scene.reference.acceleration
        self._known = self._new_known()
        self.configured = self._new_task(self._known)
        self.longest = self.expected = (self._known.follower.lasts + 0.5) * self.robot.t_ipo

    def rehearse(self) -> None:
        """See ``Job``."""
        configured, camera = self._new_task(self._new_known()), ImaginedCamera()
        configured.connect(camera=camera)
        camera.predict = _eye(configured).predicted
        rehearse(configured.task, self.robot, math.ceil((START + 0.6) / self.robot.t_ipo))

    def ready(self, arm: LiveArm, camera: LiveCamera | None, force: LiveForce | None) -> Task:
        """See ``Job.ready``."""
        if camera is None:
            raise SceneError("following a line needs a camera")
        camera.use(self.calibration.camera, self.calibration.time_offset)
        camera.calibrated = self.calibration.known
        task, eye, moved = self.configured.task, _eye(self.configured), [*self.moved, *arm.reported]
        eye.connect(camera, camera.fused)
        arm.meanwhile(lambda: task.learn(moved))
        task.lead(arm)
        camera.predict = eye.predicted
        return task

    def columns(self, t: Array) -> dict[str, Array]:
        """See ``Job``: ``cam_t`` and the line points of each field, as in recordings of line scenes."""
        return dict(self.log.point_columns(t, self.scene.points))

    def figures(self) -> dict[str, Any]:
        """See ``Job``."""
        fusion = self._known.follower.fusion
        return {"fields": {"seen": len(self.log.fields), "used": self.log.seen},
                "first_used_s": self.log.first_used, "calibration": self.calibration.json(),
                "plan_error_mm": plan_error(self.log, fusion),
                "stamp_error_ms": 1e3 * float(fusion.bias("camera")[0][1])}

    def planned(self) -> Array:
        """See ``Job``."""
        return self.log.desired

    def _new_known(self) -> Known:
        scene, T = self.scene, self.robot.t_ipo
        reference, follower = line_follower(scene, self.robot, reference_points(scene), self.calibration.camera,
                                            self.calibration.surface,
                                            latency=FollowerSettings.latency + (_UNDER_WAY + (T < AT_ONCE)) * T)
        return Known(scene=scene, robot=self.robot, delay=self.delay, camera=self.calibration.camera,
                     reference=reference, follower=follower, detector=FoundBefore())

    def _new_task(self, known: Known) -> Configured:
        return line_task(known, self.method, self.model if self.method.knows_model else None)


def _eye(configured: Configured) -> LineCamera:
    """The camera of a task, which each along a line has."""
    assert configured.camera is not None
    return configured.camera
