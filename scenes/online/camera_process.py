"""The cycle's side of the camera process: requests without waiting, and no code that reads pictures."""

from __future__ import annotations

import json
import multiprocessing
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.bounded_values import read_json
from ideal_robot.errors import InputError
from ideal_robot.whole_file import write_text
from scenes.online.processes import called
from sensing.camera.camera_model import CameraModel
from sensing.camera.hand_eye import HandEye
from sensing.camera.line_detection import LineField
from sensing.camera.line_search import DetectionSettings, PredictedLine

# Messages of the camera's process to the process that commands the arm.

@dataclass(frozen=True)
class Header:
    """Notice of a picture: times of exposure and reading by this computer's clock, and the camera's stamp [s]."""

    number: int
    taken: float
    read: float
    stamp: float


_ASKED = 3
"""Predictions under way at most: who does not answer is not asked further."""


class CameraProcess:
    """The cycle's connection to the camera process, which never waits.

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
        self._process = context.Process(target=called, args=("scenes.online.camera_worker:work", address, least_delay,
                                                             camera, detector, theirs), daemon=True)
        self._process.start()
        theirs.close()
        kind, content = "failed", InputError(f"the camera was not ready within {patience:g} s")
        try:
            if self._pipe.poll(patience):
                kind, content = self._pipe.recv()
        except (EOFError, OSError):
            content = InputError("the camera's process ended before it was ready")
        if kind == "failed":
            self.close()
            raise InputError(content.message, file=content.file, field="--camera", value=content.value or address)
        self.stamps = str(content)

    @property
    def pid(self) -> int | None:
        """Identifier of the process."""
        return self._process.pid

    def poll(self) -> list[Header | LineField | Any]:
        """The messages since the last call: headers, line points found in pictures, a calibration."""
        messages: list[Any] = []
        try:
            while self.ended is None and self._pipe.poll():
                kind, content = self._pipe.recv()
                if kind == "ended":
                    self.ended = str(content)
                elif kind == "clock":
                    self.clock = content
                else:
                    self._asked -= kind == "seen"
                    messages.append(content)
        except (EOFError, OSError):
            self.ended = "the camera's process has ended"
        return messages

    def ask(self, number: int, t: float, prediction: PredictedLine, detection: DetectionSettings) -> None:
        """Requests the line points of a picture.

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

    def calibrate(self, *given: Any) -> None:
        """Requests a calibration with arguments of ``sensing.camera.hand_eye.calibrate``; ``poll`` returns it."""
        self._tell("calibrate", given)

    def use(self, camera: CameraModel) -> None:
        """Sets the calibrated camera that the process uses from now on."""
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


# The calibrated camera in a file, so that a calibration by moving is kept for the cell.

@dataclass(frozen=True)
class CalibratedCamera:
    """A camera model with its calibration and the file of that.

    Attributes:
        camera: as it is believed to be.
        file: where the calibration is kept; None: nowhere.
        wanted: whether it has to be calibrated by moving.
        time_offset: what has to be added to its time stamps [s].
        residual: root mean square residual of the calibration [m]; NaN without one.
        surface: motion in the base frame that takes the surface to where it was seen; None where nothing was seen.
    """

    camera: CameraModel
    file: Path | None = None
    wanted: bool = False
    time_offset: float = 0.0
    residual: float = float("nan")
    surface: pin.SE3 | None = None

    @property
    def known(self) -> bool:
        """Whether the camera was calibrated; otherwise it has its nominal mounting."""
        return self.file is not None and not self.wanted

    def found(self, hand_eye: HandEye) -> CalibratedCamera:
        """The camera with the result of a calibration, which is also written to its file."""
        result = replace(self, camera=hand_eye.camera, wanted=False, time_offset=hand_eye.time_offset,
                         residual=hand_eye.residual_after, surface=hand_eye.surface)
        if self.file is not None:
            write_text(self.file, json.dumps(result.json(), indent=2) + "\n")
        return result

    def json(self) -> dict[str, Any]:
        """Plain values for JSON."""
        T = self.camera.T_tool_camera
        return {"width": self.camera.width, "height": self.camera.height, "K": self.camera.K.tolist(),
                "distortion": self.camera.distortion.tolist(), "translation_m": T.translation.tolist(),
                "rotation": T.rotation.tolist(), "time_offset_s": self.time_offset,
                "surface": None if self.surface is None else self.surface.homogeneous.tolist(),
                "residual_mm": None if np.isnan(self.residual) else 1e3 * self.residual}


def calibrated_camera(by_hand: CameraModel, file: Path | None) -> CalibratedCamera:
    """The camera of a file if it exists; otherwise the nominal one, to be calibrated where a file is given.

    Args:
        by_hand: as the scene has it.
        file: where the calibration is kept; None: the camera is taken as it is.

    Raises:
        InputError: a file that holds no calibrated camera, or one of another picture size.
    """
    if file is None or not file.exists():
        return CalibratedCamera(by_hand, file, wanted=file is not None)
    try:
        values = read_json(file, "a calibrated camera")
        mount = _pose(np.array(values["rotation"], float), np.array(values["translation_m"], float))
        moved = None if values.get("surface") is None else np.array(values["surface"], float)
        surface = None if moved is None else _pose(moved[:3, :3], moved[:3, 3])
        camera = CameraModel(int(values["width"]), int(values["height"]), np.array(values["K"], float),
                             np.array(values["distortion"], float), mount, by_hand.readout)
        offset, residual = float(values["time_offset_s"]), values.get("residual_mm")
        residual = float("nan") if residual is None else 1e-3 * float(residual)
        if not abs(offset) < 1.0:
            raise ValueError("no time offset")
    except (ValueError, KeyError, TypeError, IndexError, OverflowError) as error:
        raise InputError(f"holds no calibrated camera ({error}); remove it, and the camera is calibrated anew",
                         file=file) from error
    if (camera.width, camera.height) != (by_hand.width, by_hand.height):
        raise InputError("is of pictures of another size than the scene's camera has", file=file)
    return CalibratedCamera(camera, file, False, offset, residual, surface)


def _pose(rotation: Array, translation: Array) -> pin.SE3:
    """The pose of a rotation and a translation; raises ValueError where it is none."""
    if (rotation.shape != (3, 3) or translation.shape != (3,) or not np.isfinite(translation).all()
            or not np.abs(rotation @ rotation.T - np.eye(3)).max() < 1e-6):
        raise ValueError("no pose")
    return pin.SE3(rotation, translation)
