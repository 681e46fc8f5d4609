"""The camera in the loop of a live arm: pictures come when they come, and are evaluated elsewhere."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ideal_robot.arrays import Array
from scenes.follow.camera_messages import Evaluated, Header
from scenes.follow.camera_process import CameraProcess
from scenes.follow.live_arm import LiveArm
from sensing.camera.camera_device import WindowsAt
from sensing.camera.camera_model import CameraModel
from sensing.camera.field import Field
from sensing.camera.hand_eye import HandEye, Observation
from sensing.camera.line_detection import LineField
from sensing.camera.line_search import DetectionSettings, PredictedLine
from sensing.sensing_error import SensingError

OLDEST = 0.4
"""Age from which on a picture is of no use: the arm's poses of that time are forgotten [s]."""
AHEAD = 0.04
"""How far ahead of the arm's last state a picture may be stamped [s]."""

Predict = Callable[[float], PredictedLine]
"""Where the line should be in a picture taken at a time of the run [s], in the tool frame."""


@dataclass(frozen=True)
class EvaluatedField(Field):
    """A field whose line points have been found already."""

    seen: LineField = None  # type: ignore[assignment]


class FoundBefore:
    """The detector of fields that were evaluated elsewhere; a ``LineDetector``."""

    name: ClassVar[str] = "found_before"

    def detect(self, field: Field, camera: CameraModel, prediction: PredictedLine,
               settings: DetectionSettings) -> LineField:
        """As ``LineDetector.detect``.

        Args:
            field: an ``EvaluatedField``.
            camera: not needed.
            prediction: not needed.
            settings: not needed.
        """
        if not isinstance(field, EvaluatedField):
            raise SensingError("only fields that were evaluated before")
        return dataclasses.replace(field.seen, t=field.t_stamp)


class LiveCamera:
    """A ``sensing.camera.camera_device.Camera`` that exposes as it likes.

    Args:
        process: reads and evaluates.
        arm: whose time the fields are given.
        detection: how the line looks.

    Attributes:
        predict: see ``Predict``; nothing is evaluated before it is given.
        late, early: pictures that were not evaluated because of their stamps.
        ages: from mid-exposure until the field was used [s].
        hand_eye: a calibration that was asked for, once it has come, or why there is none.
    """

    def __init__(self, process: CameraProcess, arm: LiveArm, detection: DetectionSettings) -> None:
        self._process, self._arm, self.detection = process, arm, detection
        self.predict: Predict | None = None
        self.late = self.early = 0
        self.time_offset = 0.0
        self.ages: list[float] = []
        self.hand_eye: HandEye | Exception | None = None
        self._evaluated: list[Field] = []
        self._headers: list[Header] = []
        arm.between.append(self.serve)

    def request(self, t0: float, t1: float, windows: WindowsAt) -> None:
        """See ``Camera.request``; whole pictures come anyway."""

    def arrived(self, t: float) -> list[Field]:
        """See ``Camera.arrived``."""
        self._take()
        found, self._evaluated = self._evaluated, []
        self.ages += [t - field.t_stamp for field in found]
        return found

    def calibrate(self, camera: CameraModel, observations: Sequence[Observation], near: Array, normal: Array) -> None:
        """Asks for a calibration; ``hand_eye`` is what comes of it.

        Args:
            camera: as mounted by hand.
            observations: see ``sensing.camera.hand_eye.calibrate``.
            near: see there.
            normal: see there.
        """
        self.predict = None
        self._process.calibrate(camera, observations, near, normal)

    def use(self, camera: CameraModel, time_offset: float) -> None:
        """The camera as it is calibrated, and what has to be added to its stamps [s]."""
        self._process.use(camera)
        self.time_offset = time_offset

    def serve(self) -> None:
        """Sends the predictions for pictures that have come; called while the controller is busy."""
        self._take()
        headers, self._headers = self._headers, []
        for header in headers:
            self._ask(header)

    def _take(self) -> None:
        for message in self._process.poll():
            if isinstance(message, Header):
                self._headers.append(message)
            elif isinstance(message, Evaluated):
                seen = message.seen
                self._evaluated.append(EvaluatedField(seen.t, self._arm.t, message.windows, message.patches, seen))
            else:
                self.hand_eye = message
        if self._process.ended is not None:
            self._arm.stop(self._process.ended)

    def _ask(self, header: Header) -> None:
        t = self._arm.play_time(header.taken + self.time_offset)
        if self.predict is None or not np.isfinite(t):
            return
        if t < max(self._arm.t - OLDEST, 0.0):
            self.late += 1
        elif t > self._arm.t + AHEAD:
            self.early += 1
        else:
            self._process.ask(header.number, t, self.predict(t), self.detection)
