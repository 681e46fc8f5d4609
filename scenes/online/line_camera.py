"""The camera in a task: fields at any times, the line points in them, and the results of their fusion."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np
import pinocchio as pin

from ideal_robot.effects.camera import CameraErrors
from ideal_robot.errors import RaisedBy
from ideal_robot.model.model import Model
from ideal_robot.signals.recording import expect
from planning.line.measurement import Fused, LineAhead, SeenLine
from planning.path.pose_history import PoseHistory
from scenes.online.live_sensors import EvaluatedField
from scenes.online.log import FieldUse, TaskLog
from scenes.online.task import Sensor, Work
from sensing.camera.camera_device import Camera, Field, Window
from sensing.camera.camera_model import CameraModel
from sensing.camera.detector import LineDetector
from sensing.camera.line_detection import LineField, at_middle_row
from sensing.camera.line_search import DetectionSettings, PredictedLine, search_windows

AT_ONCE = 0.008
"""Cycle from which on there is time to fuse a field, or forces beside fields, between packet and answer [s]."""
RECENT = 32
"""Fields among which one that comes twice is recognised by its time stamp."""


class Sight(Protocol):
    """Interface that predicts the line for the camera and measures the deviation from its fields."""

    def predict(self, t: float) -> LineAhead:
        """The line as predicted for a field exposed at ``t`` [s]."""

    def update(self, line: SeenLine, pose: pin.SE3 | None = None) -> Fused | None:
        """Fuses one field, with the TCP's ``pose`` at the exposure; None if it showed nothing."""

    def check(self, t: float) -> None:
        """Raises ``LineLostError`` if the line has not been seen for too long by ``t`` [s]."""


class Look(Protocol):
    """The camera model and the appearance of the line."""

    camera: CameraModel
    detection: DetectionSettings

    @property
    def detector(self) -> LineDetector:
        """The detector that finds a line's points in a field."""


class LineCamera(Sensor):
    """The camera on a line, as a ``Sensor`` of a task.

    Args:
        known: camera model, appearance of the line, and its detector.
        sight: receives the fused fields.
        history: past poses of the tool.
        log: is written to.
        model: of the arm, whose effects contain the camera's errors; None for a method without a model.
        at_once: see ``Sensor``.
        newest: whether of several fields that arrive together only the newest is fused, as it shows what the others
            show.
        points: line points of a field that are kept for the recording.
        shown_to: also receives each field, with the tool's pose at its exposure.
    """

    def __init__(self, known: Look, sight: Sight, history: PoseHistory, log: TaskLog,
                 model: Model | None = None, *, at_once: float = AT_ONCE, newest: bool = False, points: int = 0,
                 shown_to: Callable[[LineField, pin.SE3], None] | None = None) -> None:
        self.known, self.sight, self.history, self.log = known, sight, history, log
        self.camera: Camera
        self.at_once, self.newest, self._points, self._shown_to = at_once, newest, points, shown_to
        self.heard: Callable[[Fused | None], None] | None = None
        self._errors = CameraErrors.of(() if model is None else model.effects)
        self._detector = known.detector
        self._stamps: deque[float] = deque(maxlen=RECENT)
        self._from = -np.inf
        self._worked = False
        self.last: tuple[Field, LineField] | None = None
        """The last field that was fused in this cycle, and what was seen in it."""

    def connect(self, camera: Camera, heard: Callable[[Fused | None], None] | None = None) -> None:
        """Sets the camera that is read from now on; ``heard`` gets the result of each field, None for no line."""
        self.camera, self.heard = camera, heard

    def predicted(self, t: float) -> PredictedLine:
        """The line as predicted for a picture taken at ``t`` [s], in the tool frame."""
        return self.sight.predict(t).seen_by(self.known.camera, t, self.history.row_pose)

    def fuse(self, t: float) -> Work:
        """Fuses what has arrived by ``t`` [s], or does the next part of it; see ``Sensor``."""
        self.last = None
        # A field that the network delivers twice is used once.
        fields: list[Field] = []
        for field in self.camera.arrived(t):
            if field.t_stamp not in self._stamps and field.t_stamp >= self._from:
                self._stamps.append(field.t_stamp)
                fields.append(field)
        for field in fields[-1:] if self.newest else fields:
            self._fuse(t, field)
        self._worked = self._worked or bool(fields)
        return Work.FUSED if fields else Work.NOTHING

    def _fuse(self, t: float, field: Field) -> None:
        log = self.log
        arrived = replace(field, t_stamp=field.t_stamp + self._errors.late_by(field.t_stamp))
        pose = self.history.row_pose(arrived.t_stamp)
        seen = self._seen(arrived)
        if self._shown_to is not None:
            self._shown_to(seen, pose)
        fused = self.sight.update(seen, pose)
        if self.heard is not None:
            self.heard(fused)
        self.last = arrived, seen
        if self._points:
            log.add_points(seen, self._points)
        values = 0 if fused is None else fused.dof
        log.fields.append(FieldUse(field.t_stamp, values, seen.reason if fused is None else fused.reason))
        if values and not np.isfinite(log.first_used):
            log.first_used = t

    def _seen(self, field: Field) -> LineField:
        """Line points of a field, in the tool frame at the instant of its middle row."""
        camera, detector = self.known.camera, self._detector
        if isinstance(field, EvaluatedField):
            seen = replace(field.seen, t=field.t_stamp)
        else:
            with RaisedBy(f"detector {detector.name}: detect"):
                seen = detector.detect(field, camera, self.predicted(field.t_stamp), self.known.detection)
            expect(seen, LineField, f"detector {detector.name}", "return one from detect, also where no line is seen")
        seen = replace(seen, points_tcp=self._errors.points(seen.points_tcp, camera.axis_on_surface))
        return at_middle_row(seen, camera, self.history.row_pose)

    def stood(self, t: float) -> None:
        """Notes that the arm stood still: data from before ``t`` [s] belong to unexpected places; see ``Sensor``."""
        self._from = t

    def check(self, t: float) -> None:
        """Raises ``PlanningError`` where the line or the surface has been lost by ``t`` [s]; see ``Sensor``."""
        self.sight.check(t)

    def request(self, t0: float, t1: float) -> None:
        """Requests windows where the line should be; see ``Sensor.request``."""
        self.log.with_field.append(self._worked)
        self._worked = False
        self.camera.request(t0, t1, self._windows)

    def _windows(self, exposure: float) -> Sequence[Window]:
        ahead = self.predicted(exposure + self._errors.late_by(exposure))
        return search_windows(self.known.camera, ahead, self.known.detection)
