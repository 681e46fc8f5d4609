"""The arm's side of the camera's process: asks without ever waiting, and loads nothing that reads pictures."""

from __future__ import annotations

import multiprocessing
from contextlib import suppress
from typing import Any

from ideal_robot.errors import InputError
from scenes.follow.camera_messages import Evaluated, Header
from scenes.follow.elsewhere import called
from sensing.camera.camera_model import CameraModel
from sensing.camera.line_search import DetectionSettings, PredictedLine

_ASKED = 3
"""Predictions under way at most: who does not answer is not asked further."""


class CameraProcess:
    """The arm's side: asks without ever waiting.

    Args:
        address: of the camera, see ``open_camera``.
        least_delay: from mid-exposure to arrival, at least [s].
        camera: as it is believed to be.
        detector: name of the line detector.
        patience: how long the camera is waited for [s].

    Raises:
        InputError: the camera cannot be opened, or its pictures have another size than ``camera``'s.

    Attributes:
        ended: why there will be no more pictures; None while there will.
        clock: the last report of the camera's clock.
        stamps: whose clock the stamps are of.
        left_out: pictures that were not evaluated because others were under way.
    """

    def __init__(self, address: str, least_delay: float, camera: CameraModel, detector: str,
                 patience: float = 20.0) -> None:
        self.ended: str | None = None
        self.clock: dict[str, Any] = {}
        self.stamps, self.left_out, self._asked = "", 0, 0
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=called, args=("scenes.follow.camera_worker:work", address, least_delay,
                                                             camera, detector, theirs), daemon=True)
        self._process.start()
        theirs.close()
        try:
            if not self._pipe.poll(patience):
                raise InputError(f"the camera was not ready within {patience:g} s", field="--camera", value=address)
            kind, content = self._pipe.recv()
        except (EOFError, OSError) as error:
            self.close()
            raise InputError("the camera's process ended before it was ready", field="--camera",
                             value=address) from error
        except InputError:
            self.close()
            raise
        if kind == "failed":
            self.close()
            raise InputError(content, field="--camera", value=address)
        self.stamps = str(content)

    @property
    def pid(self) -> int | None:
        """Of the process."""
        return self._process.pid

    def poll(self) -> list[Header | Evaluated | Any]:
        """What has come since: headers, evaluated fields, a calibration."""
        found: list[Any] = []
        try:
            while self.ended is None and self._pipe.poll():
                kind, content = self._pipe.recv()
                if kind == "ended":
                    self.ended = str(content)
                elif kind == "clock":
                    self.clock = content
                else:
                    self._asked -= kind == "seen"
                    found.append(content)
        except (EOFError, OSError):
            self.ended = "the camera's process has ended"
        return found

    def ask(self, number: int, t: float, prediction: PredictedLine, detection: DetectionSettings) -> None:
        """Asks for the line's points in a picture.

        Args:
            number: of its header.
            t: when it was taken, as the field's stamp shall say [s].
            prediction: where the line should be.
            detection: how it looks.
        """
        if self._asked >= _ASKED:
            self.left_out += 1
        elif self._tell("detect", (number, t, prediction, detection)):
            self._asked += 1

    def calibrate(self, camera: CameraModel, observations: Any, near: Any, normal: Any) -> None:
        """Asks for a calibration from what was observed; it comes out of ``poll``.

        Args:
            camera: as it is believed to be.
            observations: see ``sensing.camera.hand_eye.calibrate``.
            near: see there.
            normal: see there.
        """
        self._tell("calibrate", (camera, observations, near, normal))

    def use(self, camera: CameraModel) -> None:
        """The camera as it is calibrated, from now on."""
        self._tell("camera", camera)

    def close(self) -> None:
        """Ends the process, whatever state it is in."""
        with suppress(OSError):
            self._pipe.close()
        self._process.join(1.0)
        if self._process.is_alive():
            self._process.kill()
            self._process.join(2.0)

    def _tell(self, kind: str, content: Any) -> bool:
        try:
            self._pipe.send((kind, content))
        except (OSError, ValueError):
            self.ended = self.ended or "the camera's process has ended"
            return False
        return True
