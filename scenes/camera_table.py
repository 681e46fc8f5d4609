"""The camera of a scene file: as it really is, as it is believed to be, and how wrong its calibration is."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, Literal

import numpy as np
import pydantic

from scenes.scene import Table
from sensing.camera.camera_model import CalibrationError, CameraModel, default_mount


class CameraTable(Table):
    """The camera, and what it does to picture and time."""

    width: int = pydantic.Field(default=320, ge=64, le=1280)
    height: int = pydantic.Field(default=240, ge=48, le=1024)
    focal_px: float | None = pydantic.Field(default=None, gt=0)
    distortion: tuple[float, float, float, float, float] = (-0.2, 0.05, 0.0, 0.0, 0.0)
    mount_height: float = pydantic.Field(default=0.25, gt=0.03, le=2)
    """Of the camera above the TCP [m]."""
    mount_ahead: float = pydantic.Field(default=0.065, ge=-1, le=1)
    """Of the optical axis ahead of the TCP [m]."""
    rate: float = pydantic.Field(default=50.0, ge=0.1, le=1000)
    exposure: float = pydantic.Field(default=0.002, ge=0)
    sub_exposures: int = pydantic.Field(default=3, ge=1, le=50)
    supersampling: int = pydantic.Field(default=2, ge=1, le=8)
    noise: float = pydantic.Field(default=3.0, ge=0, le=100)
    latency: float = pydantic.Field(default=0.04, ge=0, le=2)
    jitter: float = pydantic.Field(default=0.001, ge=0, le=0.5)
    stamp_offset: float = pydantic.Field(default=0.0, ge=-1, le=1)
    stamp_drift: float = pydantic.Field(default=0.0, ge=-0.05, le=0.05)
    """By how much the clock of the time stamps runs fast [s/s]; needs calibration.by_moving = false."""
    stamp_noise: float = pydantic.Field(default=0.00005, ge=0, le=0.1)
    loss: float = pydantic.Field(default=0.0, ge=0, lt=1)
    doubled: float = pydantic.Field(default=0.0, ge=0, lt=1)
    """Probability that a field arrives twice."""
    rolling_ms: float = pydantic.Field(default=0.0, ge=0, le=100)
    """Time from the first row's exposure to the last row's; 0 for a camera that exposes all rows together."""
    auto_exposure: float = pydantic.Field(default=0.0, ge=0, le=10)
    """Time constant with which the camera's exposure follows the light [s]; 0 for a fixed exposure."""
    renderer: Literal["sampled", "bullet"] = "sampled"
    """Who makes the picture: PyBullet's renderer, with the tool's tip and a hose in it, or the drawn plane itself,
    sampled where the rays meet it, without a renderer's errors."""
    knock_deg: float = pydantic.Field(default=0.0, ge=-5, le=5)
    """By how much somebody's knock turns the camera about its optical axis on the way."""
    knock_s: float = pydantic.Field(default=1.4, ge=0)
    """When that happens, after the begin of the play [s]."""
    detector: str = pydantic.Field(default="edge_pairs", max_length=80)
    """What finds the line's points in a field: ``edge_pairs``, ``opencv`` or one of another package."""
    resolution: float = pydantic.Field(default=0.00025, gt=0, le=0.01)


class Calibration(Table):
    """Sizes of the errors between the camera as mounted and what is believed of it; the seed draws their signs."""

    roll_deg: float = pydantic.Field(default=0.3, ge=0, le=10)
    pitch_deg: float = pydantic.Field(default=0.3, ge=0, le=10)
    yaw_deg: float = pydantic.Field(default=0.3, ge=0, le=10)
    height_mm: float = pydantic.Field(default=1.0, ge=0, le=50)
    lateral_mm: float = pydantic.Field(default=0.5, ge=0, le=50)
    focal_percent: float = pydantic.Field(default=0.3, ge=0, le=20)
    principal_px: float = pydantic.Field(default=1.0, ge=0, le=50)
    k1: float = pydantic.Field(default=0.01, ge=0, le=1)
    rolling_ms: float | None = pydantic.Field(default=None, ge=0, le=100)
    """What the camera's data sheet says of camera.rolling_ms; the truth if not given."""
    by_moving: bool = True
    """Whether the camera is calibrated by moving it over a piece of the line before the run ([L] 4.4)."""


def believed_camera(table: CameraTable, told: Calibration | None = None) -> CameraModel:
    """The camera as mounted by hand, with the readout that its data sheet tells."""
    mounted = CameraModel.default(table.width, table.height, table.focal_px, table.distortion,
                                  default_mount(table.mount_height, table.mount_ahead))
    said = None if told is None else told.rolling_ms
    return replace(mounted, readout=1e-3 * (table.rolling_ms if said is None else said))


def true_camera(believed: CameraModel, table: Calibration, rng: np.random.Generator) -> CameraModel:
    """The camera as it is: the believed one with errors of the table's sizes; ``rng`` draws their signs.

    Args:
        believed: the camera as it is calibrated.
        table: sizes of the calibration errors, in the units of its keys.
        rng: draws their signs.
    """
    return believed.perturbed(**CalibrationError(**_sizes(table)).signed(rng))


def _sizes(table: Calibration) -> dict[str, Any]:
    """The table in SI units, as ``sensing.camera.camera_model.CalibrationError`` takes them."""
    return {
        "roll": math.radians(table.roll_deg),
        "pitch": math.radians(table.pitch_deg),
        "yaw": math.radians(table.yaw_deg),
        "height": 1e-3 * table.height_mm, "lateral": 1e-3 * table.lateral_mm, "focal": 1e-2 * table.focal_percent,
        "principal_point": table.principal_px, "distortion": table.k1,
    }
