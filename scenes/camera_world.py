"""The camera of a scene file as the world has it."""

from __future__ import annotations

from scenes.camera_table import CameraTable
from sim.camera.camera_settings import CameraSettings


def camera_settings(table: CameraTable) -> CameraSettings:
    """What the camera does to picture and time."""
    return CameraSettings(**{key: getattr(table, key) for key in CameraSettings.__dataclass_fields__ if key != "phase"})
