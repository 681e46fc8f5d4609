"""Following a drawn line on devices: the planning of ``scenes.line`` with a camera that is elsewhere."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.elasticity.observer import GearDeflection
from ideal_robot.model.model import Model
from ideal_robot.robots.collisions import Shapes
from ideal_robot.robots.interface import RobotState
from ideal_robot.robots.robot import Robot
from planning.line.line_follower import FollowerSettings
from planning.path.reference import ReferencePath
from scenes.methods import SceneMethod
from scenes.online.camera_process import CalibratedCamera
from scenes.online.cell_check import Look
from scenes.online.cycle import Task
from scenes.online.line_known import (
    REST,
    START,
    CalibrationView,
    Known,
    calibration_postures,
    line_follower,
    piece_map,
    span_of,
)
from scenes.online.line_log import LineLog, plan_error
from scenes.online.line_task import AT_ONCE, LiveLineTask
from scenes.online.live_arm import LiveArm, moves
from scenes.online.live_sensors import FoundBefore, ImaginedCamera, LiveCamera, LiveForce, rehearse
from scenes.placing import shapes_about
from scenes.scene_files.drawn_line import reference_points
from scenes.scene_files.line_scene import LineScene
from scenes.scene_files.scene import SceneError
from sensing.camera.camera_model import CameraModel
from sensing.camera.hand_eye import BENT, PRIOR, HandEye
from sensing.camera.line_search import DetectionSettings, PredictedLine

# The camera on the tool is calibrated by moving the real arm over a piece of the line ([L] 4.4).

_PATIENCE = 60.0
"""How long the computation may take; the arm is held meanwhile [s]."""


@dataclass(frozen=True)
class Piece:
    """The piece of the line that is looked at.

    Attributes:
        reference: the reference path.
        at: arc length of it around which the piece lies [m].
        start: where the arm is, and is again afterwards ``(n,)`` [rad].
        clear: how far the tip keeps away from the reference at least [m].
        shapes: the arm in its cell.
        bent: whether the surface may be bent there, too.
    """

    reference: ReferencePath
    at: float
    start: Array
    clear: float = 0.0
    shapes: Shapes | None = None
    bent: bool = False

    def check_ways(self, *ends: Array) -> None:
        """Refuses a way from the start to one of ``ends (n,)`` [rad] on which the arm would touch something."""
        for end in ends:
            touch = None if self.shapes is None else self.shapes.touch_between(self.start, end)
            if touch is not None:
                raise SceneError(f"the camera cannot be calibrated: {touch} between the start and the calibration's "
                                 "poses; set calibration.by_moving = false")


@dataclass(frozen=True)
class CalibrationMotion:
    """From the start over the piece of the line and back, which is planned before the arm is connected.

    Attributes:
        piece: of the line.
        commands: ``(N, n)`` [rad].
        sag: how far the gears bend ``(N, n)`` [rad].
        begin, end: when the arm is over the piece [s]. On the way there and back another piece of the line is seen, or
            none: that fits no common curve.
        view: of the camera as mounted by hand.
    """

    piece: Piece
    commands: Array
    sag: Array
    begin: float
    end: float
    view: CalibrationView

    @classmethod
    def over(cls, piece: Piece, by_hand: CameraModel, model: Model, robot: Robot, detection: DetectionSettings
             ) -> CalibrationMotion:
        """Plans it, and loads what is compiled: nothing of either may fall into a cycle.

        Args:
            piece: of the line.
            by_hand: the camera as mounted by hand.
            model: of the arm, for the gears' deflection.
            robot: the arm.
            detection: how the line looks.

        Raises:
            SceneError: too few of the poses can be reached, or the arm would touch something.
        """
        reference, start, at = piece.reference, piece.start, piece.at
        postures = calibration_postures(robot, reference, by_hand, at, piece.clear, piece.shapes)
        piece.check_ways(postures[0], postures[-1])
        way, over, back = (moves(robot, some, REST) for some in ([start, postures[0]], postures, [postures[-1], start]))
        commands, begin = np.concatenate([way, over, back]), robot.t_ipo * len(way)
        imagined, view = (CalibrationView(robot, reference, by_hand, detection, FoundBefore(), start,
                                          piece_map(reference, at)) for _ in range(2))
        imagined.history.add(robot.t_ipo, start)
        camera, t = ImaginedCamera(), 0.5 * robot.t_ipo
        camera.predict = imagined.predicted
        camera.request(t, t, lambda _: None)
        for field in camera.arrived(t):
            imagined.look(field, imagined.predicted(t), 0.0)
        return cls(piece, commands, GearDeflection(model, robot.t_ipo).along(commands), begin,
                   begin + robot.t_ipo * len(over), view)


def calibrated_by_moving(motion: CalibrationMotion, arm: LiveArm, camera: LiveCamera) -> HandEye:
    """Moves from the start over the piece of the line and back; returns the camera that explains what was seen.

    Args:
        motion: as planned.
        arm: at the start, and again when this returns.
        camera: on the arm.

    Raises:
        SceneError: too few of the fields show the line.
        FollowStoppedError: the arm has to stop, or is gone.
    """
    piece, view = motion.piece, motion.view
    arm.begin()
    camera.predict = view.predicted
    fields = 0
    for q_c, sag in zip(motion.commands, motion.sag, strict=True):
        arm.check(arm.t)
        arm.q_d = q_c
        q = arm.cycle(q_c).q
        view.history.add(arm.t, q - sag)
        for field in camera.arrived(arm.t):
            if motion.begin <= field.t_stamp <= motion.end:
                fields += 1
                view.look(field, view.predicted(field.t_stamp), 0.0)
    near, up = view.piece(piece.at, fields, "how it looks (line.gray, line.width_mm), and the camera")
    prior = BENT if piece.bent else PRIOR
    arm.meanwhile(lambda: camera.calibrate(view.believed, view.observations, near, up, prior))
    for _ in range(int(_PATIENCE / arm.robot.t_ipo)):
        if camera.hand_eye is not None:
            break
        arm.check(arm.t)
        arm.cycle(piece.start)
    if not isinstance(camera.hand_eye, HandEye):
        raise SceneError(f"the camera could not be calibrated: {camera.hand_eye or 'it took too long'}")
    return camera.hand_eye


_UNDER_WAY = 2
"""Cycles from a picture's arrival until a plan is made with its line points; one more where plans are made ahead."""


class LineJob:
    """A line; a ``scenes.online.devices.Job``.

    Args:
        scene: what is followed; of its tables those of the world are not looked at.
        robot: with the controller's cycle.
        model: of the arm.
        method: how what is sensed becomes commands.
        delay: cycles of the controller's own delay.
        answers_within: time in which the arm's loop answers a command [s].
        calibration: of the camera, and whether there is one already.

    Attributes:
        moved: what the controller reported in a session before this one, cycle by cycle.
    """

    moved: Sequence[RobotState] = ()

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
        self.detection = scene.line.detection

    @property
    def camera(self) -> CameraModel | None:
        """See ``Job``."""
        return self._known.camera

    @property
    def look(self) -> Look | None:
        """See ``Job``."""
        reference = self._known.reference
        return (Look(reference, span_of(self.scene, reference)[0], self.q_start, self.calibration.camera, self.model)
                if self.calibration.known else None)

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
        """See ``Job.ready``."""
        if camera is None:
            raise SceneError("following a line needs a camera")
        camera.use(self.calibration.camera, self.calibration.time_offset)
        camera.calibrated = self.calibration.known
        self._task.camera, self._task.heard = camera, camera.fused
        task, moved = self._task, [*self.moved, *arm.reported]
        arm.meanwhile(lambda: task.learn(moved))
        task.lead(arm)
        camera.predict = lambda t: _predicted(self._known, t)
        return self._task

    def calibration_motion(self) -> CalibrationMotion:
        """See ``Job``."""
        middle = 0.5 * sum(span_of(self.scene, self._known.reference))
        piece = Piece(self._known.reference, middle, self.q_start,
                      shapes=shapes_about(self._known.scene, self._known.robot))
        return CalibrationMotion.over(piece, self._known.camera, self.model, self.robot, self.detection)

    def columns(self, t: Array) -> dict[str, Array]:
        """See ``Job``: ``cam_t`` and the line points of each field, as in recordings of line scenes."""
        return dict(self.log.field_columns(t, self.scene.points))

    def figures(self) -> dict[str, Any]:
        """See ``Job``."""
        fusion = self._known.follower.fusion
        return {"fields": {"seen": len(self.log.fields), "used": self.log.used},
                "first_used_s": self.log.first_used, "calibration": self.calibration.json(),
                "plan_error_mm": plan_error(self.log, fusion),
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
