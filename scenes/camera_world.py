"""The camera of a scene file as the world has it."""

from __future__ import annotations

import math

from scenes.scene_files.drawn_line import CameraTable
from sim.camera.camera import CameraSettings
from sim.equipped_arm import Knock


def camera_settings(table: CameraTable) -> CameraSettings:
    """What the camera does to picture and time."""
    same = {key: getattr(table, key) for key in CameraSettings.__dataclass_fields__ if key not in ("phase", "rolling")}
    return CameraSettings(**same, rolling=1e-3 * table.rolling_ms)


def knock_of(table: CameraTable) -> Knock | None:
    """What happens to the camera's mounting on the way; None for nothing."""
    return Knock(table.knock_s, math.radians(table.knock_deg)) if table.knock_deg else None
