"""The calibrated camera in a file: what calibration by moving has found stays with the cell."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.bounded_values import read_json
from ideal_robot.errors import InputError
from ideal_robot.whole_file import write_text
from sensing.camera.camera_model import CameraModel
from sensing.camera.hand_eye import HandEye


@dataclass(frozen=True)
class CalibratedCamera:
    """A camera, and where its calibration is kept.

    Attributes:
        camera: as it is believed to be.
        file: where the calibration is kept; None: nowhere.
        wanted: whether it has to be calibrated by moving.
        time_offset: what has to be added to its time stamps [s].
        residual: root mean square of what the calibration left [m]; NaN without one.
        surface: motion in the base frame that takes the surface to where it was seen; None where nothing was seen.
    """

    camera: CameraModel
    file: Path | None = None
    wanted: bool = False
    time_offset: float = 0.0
    residual: float = float("nan")
    surface: pin.SE3 | None = None

    def found(self, hand_eye: HandEye) -> CalibratedCamera:
        """With what a calibration has found, which is written to the file."""
        result = replace(self, camera=hand_eye.camera, wanted=False, time_offset=hand_eye.time_offset,
                         residual=hand_eye.residual_after, surface=hand_eye.surface)
        if self.file is not None:
            write_text(self.file, json.dumps(result.json(), indent=2) + "\n")
        return result

    def json(self) -> dict[str, Any]:
        """As plain values."""
        T = self.camera.T_tool_camera
        return {"width": self.camera.width, "height": self.camera.height, "K": self.camera.K.tolist(),
                "distortion": self.camera.distortion.tolist(), "translation_m": T.translation.tolist(),
                "rotation": T.rotation.tolist(), "time_offset_s": self.time_offset,
                "surface": None if self.surface is None else self.surface.homogeneous.tolist(),
                "residual_mm": None if np.isnan(self.residual) else 1e3 * self.residual}


def calibrated_camera(by_hand: CameraModel, file: Path | None) -> CalibratedCamera:
    """The camera of a file, if it is there; otherwise the one mounted by hand, to be calibrated where a file is given.

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
        if not abs(offset) < 1.0:
            raise ValueError("no time offset")
    except (ValueError, KeyError, TypeError, IndexError, OverflowError) as error:
        raise InputError(f"holds no calibrated camera ({error}); remove it, and the camera is calibrated anew",
                         file=file) from error
    if (camera.width, camera.height) != (by_hand.width, by_hand.height):
        raise InputError("is of pictures of another size than the scene's camera has", file=file)
    return CalibratedCamera(camera, file, False, offset, float("nan") if residual is None else 1e-3 * float(residual),
                            surface)


def _pose(rotation: Array, translation: Array) -> pin.SE3:
    """Of a rotation that is one; raises ValueError where it is none."""
    if (rotation.shape != (3, 3) or translation.shape != (3,) or not np.isfinite(translation).all()
            or not np.abs(rotation @ rotation.T - np.eye(3)).max() < 1e-6):
        raise ValueError("no pose")
    return pin.SE3(rotation, translation)
