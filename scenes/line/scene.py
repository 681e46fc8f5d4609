"""The line-following scene as a file: surface, drawn line, where it really is, camera and its errors."""

from __future__ import annotations

from typing import Literal

import pydantic

from scenes.camera_table import Calibration, CameraTable
from scenes.drawn_line import Displacement, Feature, Line, Reference, Surface
from scenes.scene import Scene


class LineScene(Scene):
    """An arm with a camera follows a drawn line."""

    kind: Literal["line"]
    speed: float = pydantic.Field(default=0.7, gt=0, le=10)
    method: str = "ideal"
    surface: Surface
    line: Line
    feature: tuple[Feature, ...] = ()
    displacement: Displacement = Displacement()
    reference: Reference = Reference()
    camera: CameraTable = CameraTable()
    calibration: Calibration = Calibration()
    points: int = pydantic.Field(default=5, ge=3, le=25)
    """Line points looked for in each field; [L] takes 5."""
    measurement: Literal["polynomial", "points"] = "polynomial"
    """What of a field goes into the map of the line: value and slope of the polynomial through its points, or each of
    the points."""
    n_d: int | None = pydantic.Field(default=None, ge=1, le=200)
    """Desired positions that the feedforward is given in each cycle, the current one included ([L] 2.2); all that are
    planned if not given."""
    tracker: bool = True
    """Whether the recording holds an external measuring device's arm angles and TCP."""
    stamp_estimate: bool = True
    """Whether the follower estimates on the way by how much the camera's time stamps are wrong."""
    max_gap: float = pydantic.Field(default=0.15, gt=0, le=5)
    """Distance that may be travelled without a seen line before it counts as lost [m]."""
