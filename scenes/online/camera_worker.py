"""The camera's own process: reads pictures and finds line points in them, so that the arm's cycle is not delayed."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections import deque
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from ideal_robot.errors import IdealRobotError, InputError, RaisedBy, described
from scenes.online.camera_process import Header
from scenes.online.processes import give_back
from sensing.camera.camera_device import Field
from sensing.camera.camera_model import CameraModel
from sensing.camera.cameras import Frame, FrameSource, open_camera
from sensing.camera.detector import DETECTORS
from sensing.camera.hand_eye import calibrate
from sensing.camera.line_detection import LineField
from sensing.camera.line_search import DetectionSettings, PredictedLine, search_windows

_KEPT = 12
"""Pictures that wait for their prediction."""
_CLOCK_EVERY = 0.5
"""Time between two reports of the camera's clock [s]."""
_PRIORITY = 20
"""Real-time priority of the camera's process where the system grants it: below that of the arm's cycle."""


def work(address: str, least_delay: float, camera: CameraModel, detector: str, pipe: Connection) -> None:
    """Runs the camera process: one thread reads the camera, this one evaluates pictures.

    Args:
        address: of the camera, see ``open_camera``.
        least_delay: from mid-exposure to arrival, at least [s].
        camera: as it is believed to be.
        detector: name of the line detector.
        pipe: to the process that commands the arm.
    """
    try:
        # Ctrl-C is handled by the process that commands the arm.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        worker = _Worker(camera, detector, pipe)
        # Before the camera is opened, as its pictures must not wait.
        worker.rehearse()
        give_back()
        worker.rehearse()
        source = open_camera(address, least_delay)
        if (source.width, source.height) != (camera.width, camera.height):
            raise InputError(f"its pictures have {source.width}×{source.height} px, the scene says "
                             f"{camera.width}×{camera.height}; set camera.width and camera.height", field="camera")
    except Exception as error:  # any exception of a user's detector or a camera's library
        with suppress(OSError):
            pipe.send(("failed", error if isinstance(error, InputError) else InputError(described(error))))
        return
    if hasattr(os, "sched_setscheduler"):
        with suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PRIORITY))
    # The parent may have given up waiting and closed its end.
    with suppress(EOFError, OSError):
        pipe.send(("opened", source.stamps))
        threading.Thread(target=worker.read, args=(source,), daemon=True).start()
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
        reported_at = 0.0
        try:
            while True:
                frame = source.read(0.2)
                now = time.perf_counter()
                if now - reported_at > _CLOCK_EVERY:
                    reported_at = now
                    self._send("clock", source.clock.report().to_dict())
                if frame is not None:
                    self._frames.append(frame)
                    self._send("header", Header(frame.number, source.clock.host(frame.stamp), frame.arrived,
                                                frame.stamp))
        except Exception as error:  # any exception of a camera's library: the process that commands the arm has to know
            # The process that commands the arm may have ended.
            with suppress(OSError):
                self._send("ended", ("" if isinstance(error, IdealRobotError) else "the camera cannot be read: ")
                           + described(error))

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
            # The list is copied first, as another picture may arrive during the loop.
            frame = next((frame for frame in list(self._frames) if frame.number == number), None)
            nothing = np.empty(0)
            empty = LineField(t, np.empty((0, 3)), np.empty((0, 2)), nothing, nothing, nothing,
                              np.empty(0, dtype=bool), False, "the picture was gone")
            self._send("seen", empty if frame is None else self._evaluated(frame, t, prediction, detection))

    def _evaluated(self, frame: Frame, t: float, prediction: PredictedLine, detection: DetectionSettings) -> LineField:
        field = Field.cut(t, frame.image, search_windows(self.camera, prediction, detection))
        with RaisedBy(f"detector {self.detector.name}: detect"):
            return self.detector.detect(field, self.camera, prediction, detection)

    def _send(self, kind: str, content: Any) -> None:
        with self._lock:
            self._pipe.send((kind, content))
