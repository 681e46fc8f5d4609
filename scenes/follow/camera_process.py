"""The camera's process: reads pictures, finds the line's points in them, and leaves the cycle of the arm alone."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import time
from collections import deque
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from ideal_robot.errors import IdealRobotError, InputError
from sensing.camera.camera_model import CameraModel
from sensing.camera.cameras import open_camera
from sensing.camera.detector import DETECTORS
from sensing.camera.field import Field, Gray, Window
from sensing.camera.frame_source import Frame, FrameSource
from sensing.camera.hand_eye import calibrate
from sensing.camera.line_detection import LineField
from sensing.camera.line_search import DetectionSettings, PredictedLine, search_windows

_KEPT = 12
"""Pictures that wait for their prediction."""
_ASKED = 3
"""Predictions under way at most: who does not answer is not asked further."""
_CLOCK_EVERY = 0.5
"""Time between two reports of the camera's clock [s]."""


@dataclass(frozen=True)
class Header:
    """A picture has come: when it was taken and read, by this computer's clock [s]."""

    number: int
    taken: float
    read: float


@dataclass(frozen=True)
class Evaluated:
    """What was found in a picture, and its windows."""

    seen: LineField
    windows: tuple[Window, ...]
    patches: tuple[Gray, ...]


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
        self._process = context.Process(target=_work, args=(address, least_delay, camera, detector, theirs),
                                        daemon=True)
        self._process.start()
        theirs.close()
        try:
            if not self._pipe.poll(patience):
                raise InputError(f"the camera was not ready within {patience:.0f} s", field="--camera", value=address)
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


_PRIORITY = 20
"""Real-time priority of the camera's process where the system grants it: below that of the arm's cycle."""


def _work(address: str, least_delay: float, camera: CameraModel, detector: str, pipe: Connection) -> None:
    """The process: one thread reads the camera, this one evaluates."""
    try:
        # Ctrl-C is the business of the process that leads the arm.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        worker = _Worker(camera, detector, pipe)
        # Before the camera is opened: its pictures must not wait.
        worker.rehearse()
        source = open_camera(address, least_delay)
        if (source.width, source.height) != (camera.width, camera.height):
            raise InputError(f"its pictures have {source.width}×{source.height} px, the scene says "
                             f"{camera.width}×{camera.height}; set camera.width and camera.height", field="camera")
    except IdealRobotError as error:
        pipe.send(("failed", str(error)))
        return
    if hasattr(os, "sched_setscheduler"):
        with suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PRIORITY))
    pipe.send(("opened", source.stamps))
    threading.Thread(target=worker.read, args=(source,), daemon=True).start()
    with suppress(EOFError, OSError):
        while True:
            worker.answer(*pipe.recv())


class _Worker:
    """What both threads share."""

    def __init__(self, camera: CameraModel, detector: str, pipe: Connection) -> None:
        self.camera, self.detector = camera, DETECTORS.get(detector)()
        self._pipe, self._lock = pipe, threading.Lock()
        self._frames: deque[Frame] = deque(maxlen=_KEPT)

    def rehearse(self) -> None:
        """Loads what is compiled, before any picture waits."""
        points = np.column_stack([np.linspace(0.03, 0.1, 5), np.zeros(5), np.zeros(5)])
        prediction = PredictedLine(points, np.tile([1.0, 0.0, 0.0], (5, 1)), np.array([0.0, 0.0, -1.0]), 0.002)
        blank = Frame(-1, 0.0, 0.0, np.full((self.camera.height, self.camera.width), 200, dtype=np.uint8))
        self._evaluated(blank, 0.0, prediction, DetectionSettings())

    def read(self, source: FrameSource) -> None:
        """Reads pictures as long as there are any."""
        told = 0.0
        try:
            while True:
                frame = source.read(0.2)
                now = time.perf_counter()
                if now - told > _CLOCK_EVERY:
                    told = now
                    self._send("clock", source.clock.report().to_dict())
                if frame is not None:
                    self._frames.append(frame)
                    self._send("header", Header(frame.number, source.clock.host(frame.stamp), frame.arrived))
        except IdealRobotError as error:
            self._send("ended", str(error))
        except OSError:
            return

    def answer(self, kind: str, content: Any) -> None:
        """Does what the arm's side asks for."""
        if kind == "camera":
            self.camera = content
        elif kind == "calibrate":
            try:
                self._send("calibrated", calibrate(*content))
            except IdealRobotError as error:
                self._send("calibrated", error)
        else:
            number, t, prediction, detection = content
            frame = next((one for one in self._frames if one.number == number), None)
            nothing = np.empty(0)
            empty = Evaluated(LineField(t, np.empty((0, 3)), np.empty((0, 2)), nothing, nothing, nothing,
                                        np.empty(0, dtype=bool), False, "the picture was gone"), (), ())
            self._send("seen", empty if frame is None else self._evaluated(frame, t, prediction, detection))

    def _evaluated(self, frame: Frame, t: float, prediction: PredictedLine, detection: DetectionSettings) -> Evaluated:
        windows = tuple(search_windows(self.camera, prediction, detection))
        patches = tuple(frame.image[w.v : w.v + w.height, w.u : w.u + w.width] for w in windows)
        field = Field(t, t, windows, tuple(np.ascontiguousarray(patch) for patch in patches))
        return Evaluated(self.detector.detect(field, self.camera, prediction, detection), windows, ())

    def _send(self, kind: str, content: Any) -> None:
        with self._lock:
            self._pipe.send((kind, content))
