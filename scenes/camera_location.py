"""Locates a camera from pictures of a target and a table of poses, for ``ideal-robot calibrate``."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pandas as pd
import pinocchio as pin
from numpy.typing import NDArray

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from scenes.detection import read_picture
from sensing.camera.camera_model import CameraModel
from sensing.camera.target_hand_eye import MOUNTED, CameraPose, TargetView, april_tags, checkerboard, locate_camera

COLUMNS = ("picture", "x", "y", "z", "qx", "qy", "qz", "qw")
"""Of the table of poses: a picture's file as seen from the table's folder, the tool in the base frame [m, 1]."""
Target = Callable[[NDArray[np.uint8]], tuple[Array, Array] | None]
"""Points of a target in a picture: in the target's frame and as pixels; None without."""


@dataclass(frozen=True)
class Located:
    """A located camera, with the pictures that were used.

    Attributes:
        camera: its intrinsics.
        intrinsic_error: root mean square residual of their calibration [px]; None where they were given.
        pose: its pose.
        shown: pictures with the target, by name; ``pose.used`` belongs to these.
        without: pictures in which the target was not found.
    """

    camera: CameraModel
    intrinsic_error: float | None
    pose: CameraPose
    shown: list[str]
    without: list[str]

    def json(self) -> dict[str, Any]:
        """All of it as plain values; metres, radians, pixels."""
        found = self.pose
        return {"mounted": found.mounted, "camera": _placed(found.camera), "target": _placed(found.target),
                "order": ["x", "y", "z", "rx", "ry", "rz"], "camera_covariance": found.covariance.tolist(),
                "target_covariance": found.target_covariance.tolist(), "sigma_pixel": found.sigma_pixel,
                "sigma_pose": list(found.sigma_pose), "residual_px": found.residual,
                "pictures": {name: bool(used) for name, used in zip(self.shown, found.used, strict=True)},
                "without_target": self.without,
                "intrinsics": {"width": self.camera.width, "height": self.camera.height, "K": self.camera.K.tolist(),
                               "distortion": self.camera.distortion.tolist(), "residual_px": self.intrinsic_error}}

    def table(self) -> tuple[list[str], list[list[Any]]]:
        """Column titles and rows for a person: mm and degrees."""
        found, sigma = self.pose, np.sqrt(np.diag(self.pose.covariance))
        axes = np.degrees(pin.log3(found.camera.rotation))
        rows = [[f"{name} [mm]", 1e3 * float(value), 1e3 * float(s)]
                for name, value, s in zip("xyz", found.camera.translation, sigma[:3], strict=True)]
        rows += [[f"turn about {name} [°]", float(value), float(np.degrees(s))]
                 for name, value, s in zip("xyz", axes, sigma[3:], strict=True)]
        rows += [["noise of a pixel [px]", found.sigma_pixel, None],
                 ["error of the arm's poses [mm]", 1e3 * found.sigma_pose[0], None],
                 ["error of the arm's poses [°]", float(np.degrees(found.sigma_pose[1])), None],
                 ["pictures used", int(found.used.sum()), None],
                 ["left out", int((~found.used).sum()) + len(self.without), None]]
        return ["", "value", "σ"], rows


def _placed(pose: pin.SE3) -> dict[str, list[float]]:
    return {"position": pose.translation.tolist(), "quaternion_xyzw": pin.Quaternion(pose.rotation).coeffs().tolist()}


def located(table: Path, target: Target, mounted: str, intrinsics: Path | None) -> Located:
    """Reads pictures and poses and locates the camera.

    Args:
        table: CSV with ``COLUMNS``.
        target: finds the target's points.
        mounted: see ``locate_camera``; errors as of it.
        intrinsics: JSON with width, height, K and distortion; estimated from the same pictures if None.

    Raises:
        InputError: a column, a number or a picture that is missing; pictures of several sizes.
    """
    if mounted not in MOUNTED:
        raise InputError(f"expected one of {', '.join(MOUNTED)}", field="mounted", value=mounted)
    views, shown, without = [], [], []
    size: tuple[int, int] | None = None
    for name, pose in _poses(table):
        picture = read_picture(table.parent / name)
        if size is not None and picture.shape[1::-1] != size:
            raise InputError(f"a picture of {picture.shape[1]} × {picture.shape[0]} pixels among others of {size[0]} × "
                             f"{size[1]}; one camera's are needed", file=table, field="picture", value=name)
        size = (picture.shape[1], picture.shape[0])
        points = target(picture)
        if points is None:
            without.append(name)
        else:
            views.append(TargetView(pose, *points))
            shown.append(name)
    if size is None or not views:
        raise InputError("no picture shows the target; look at --board and --square, or --tags", file=table)
    camera, error = _given(intrinsics) if intrinsics is not None else _intrinsics(views, size)
    return Located(camera, error, locate_camera(views, camera, mounted), shown, without)


def _poses(table: Path) -> list[tuple[str, pin.SE3]]:
    try:
        rows = pd.read_csv(table)
    except (ValueError, UnicodeDecodeError) as error:
        raise InputError("not a readable CSV table", file=table) from error
    missing = [column for column in COLUMNS if column not in rows]
    if missing:
        raise InputError(f"expected the columns {', '.join(COLUMNS)}", file=table, field=", ".join(missing))
    poses = []
    for index, row in enumerate(rows.to_dict("records")):
        try:
            values = np.array([float(row[column]) for column in COLUMNS[1:]])
        except (TypeError, ValueError) as error:
            raise InputError("expected numbers", file=table, field=f"line {index + 2}", value=str(row)) from error
        if not np.isfinite(values).all() or abs(np.linalg.norm(values[3:]) - 1.0) > 1e-2:
            raise InputError("expected a position [m] and a unit quaternion x, y, z, w", file=table,
                             field=f"line {index + 2}", value=values.tolist())
        unit = values[3:] / np.linalg.norm(values[3:])
        poses.append((str(row["picture"]), pin.XYZQUATToSE3(np.r_[values[:3], unit])))
    return poses


def _given(path: Path) -> tuple[CameraModel, None]:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        content = content.get("intrinsics", content)
        return CameraModel(int(content["width"]), int(content["height"]), np.array(content["K"], dtype=float),
                           np.array(content["distortion"], dtype=float), pin.SE3.Identity()), None
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError("expected JSON with width, height, K (3 × 3) and distortion (k1, k2, p1, p2, k3)", file=path,
                         value=str(error)) from error


def _intrinsics(views: list[TargetView], size: tuple[int, int]) -> tuple[CameraModel, float]:
    """The camera's intrinsics from the pictures themselves, by OpenCV, k3 left at none, and their residual [px]."""
    error, K, distortion, *_ = cv2.calibrateCamera(
        [np.asarray(view.points, dtype=np.float32) for view in views],
        [np.asarray(view.pixels, dtype=np.float32) for view in views], size,
        np.eye(3), np.zeros(5), flags=cv2.CALIB_FIX_K3)
    lens = np.ravel(distortion)[:5].astype(float)
    return CameraModel(*size, np.asarray(K, dtype=float), lens, pin.SE3.Identity()), float(error)


def board_target(board: str, square: float) -> Target:
    """A checkerboard of ``9x6`` inner corners; InputError for other words.

    Args:
        board: inner corners along and across.
        square: side of a square [m].
    """
    try:
        columns, rows = (int(word) for word in board.lower().split("x"))
    except ValueError as error:
        raise InputError("expected inner corners along and across, e.g. 9x6", field="--board", value=board) from error
    if min(columns, rows) < 3 or max(columns, rows) > 50:
        raise InputError("expected 3 to 50 inner corners each way", field="--board", value=board)
    return lambda picture: checkerboard(picture, columns, rows, square)


def tags_target(path: Path) -> Target:
    """AprilTags whose corners a JSON file gives: ``{"family": "36h11", "tags": {"3": [[x, y, z], …]}}``."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        family = str(content.get("family", "36h11"))
        places = {int(number): np.array(corners, dtype=float).reshape(4, 3)
                  for number, corners in content["tags"].items()}
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError('expected JSON such as {"family": "36h11", "tags": {"3": four corners [[x, y, z], …] [m]}}',
                         file=path, value=str(error)) from error
    if not hasattr(cv2.aruco, f"DICT_APRILTAG_{family}"):
        raise InputError("expected 16h5, 25h9, 36h10 or 36h11", file=path, field="family", value=family)
    return lambda picture: april_tags(picture, places, family)
