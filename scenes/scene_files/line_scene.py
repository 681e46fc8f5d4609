"""The files of line scenes: surface, drawn line, its true place, camera and its errors."""

from __future__ import annotations

import math
from typing import Any, ClassVar, Literal

import pydantic

from ideal_robot.robots.robot import Robot
from scenes.arms import arm_of
from scenes.scene_files.drawn_line import (
    Calibration,
    CameraTable,
    Displacement,
    Feature,
    Line,
    Reference,
    Surface,
    check_clock,
)
from scenes.scene_files.scene import ARM, Box, Scene, Table


class Wear(Table):
    """Wear of the drawn line and its light: sizes and numbers; the seed draws the rest."""

    grain: Literal["none", "paper", "wood", "metal"] = "none"
    """What the bare surface looks like: even, or with the speckle or streaks of a material."""
    width_percent: float = pydantic.Field(default=0.0, ge=0, le=70)
    """By how much the line's width varies on its way, more or less."""
    fade_percent: float = pydantic.Field(default=0.0, ge=0, le=90)
    """How much of its contrast the ink has lost where it is palest."""
    gaps: int = pydantic.Field(default=0, ge=0, le=50)
    """Where the line is broken off."""
    gap_mm: float = pydantic.Field(default=35.0, gt=0, le=500)
    """Longest gap; each is half to whole of it."""
    scratches: int = pydantic.Field(default=0, ge=0, le=50)
    crossings: int = pydantic.Field(default=0, ge=0, le=50)
    glares: int = pydantic.Field(default=0, ge=0, le=50)
    shades: int = pydantic.Field(default=0, ge=0, le=50)


class Light(Table):
    """A lamp beside the cell; the seed draws its place. Without sizes the light is uniform."""

    height_m: float = pydantic.Field(default=1.6, gt=0.3, le=10)
    """Of the lamp above the surface."""
    aside_m: float = pydantic.Field(default=0.8, ge=0, le=10)
    """From the line's middle, in a direction that the seed draws."""
    radius_mm: float = pydantic.Field(default=30.0, gt=0, le=500)
    falloff: float = pydantic.Field(default=0.0, ge=0, le=1)
    """Share of the light that is the lamp's and fades with the distance from it."""
    shadow: float = pydantic.Field(default=0.0, ge=0, le=0.95)
    """Share of the light that the arm takes away where it stands in the lamp's way."""
    glare: float = pydantic.Field(default=0.0, ge=0, le=255)
    """Gray levels added where the surface mirrors the lamp into the camera."""


class BentDisplacement(Displacement):
    """Displacement of the drawn line and its surface from where the scene file says they are."""

    bow_mm: float = pydantic.Field(default=0.0, ge=0, le=20)
    """How far the surface's middle is out of the plane of its ends, over the line's length, up or down; needs
    camera.renderer = "bullet"."""


class LineScene(Scene):
    """An arm with a camera follows a drawn line."""

    @property
    def arm(self) -> Robot:
        """The robot with the scene's tool."""
        return arm_of(self.robot).with_tool(1e-3 * self.tool_mm, math.radians(self.tool_turn_deg))

    workshop: ClassVar[dict[str, dict[str, Any]]] = {
        "world": ARM,
        "displacement": {"height_mm": 3.0, "tilt_deg": 1.0},
        "camera": {"renderer": "bullet", "jitter": 0.004, "loss": 0.05, "doubled": 0.02, "auto_exposure": 0.15},
        "light": {"falloff": 0.6, "shadow": 0.4, "glare": 60.0},
        "wear": {"width_percent": 20.0, "fade_percent": 30.0, "gaps": 2, "scratches": 1, "crossings": 1, "glares": 1,
                 "shades": 1},
    }
    cell: ClassVar[dict[str, dict[str, Any]]] = {
        "camera": {"noise": 0.5, "full_well": 10000.0, "mosaic": True, "defocus_px": 0.6, "vignetting": 0.3,
                   "jpeg_quality": 92},
        "wear": {"grain": "paper", "width_percent": 30.0, "fade_percent": 40.0},
    }
    kind: Literal["line"]
    speed: float = pydantic.Field(default=0.7, gt=0, le=10)
    tool_mm: float = pydantic.Field(default=0.0, ge=0, le=1000)
    """How far the TCP is beyond the flange (the URDF's tool frame), along the approach axis."""
    tool_turn_deg: float = pydantic.Field(default=0.0, ge=-180, le=180)
    """How far tool and camera are turned about the approach axis: the camera looks ahead where the tool's x axis points
    along the travel, which a wrist with a short last joint cannot do in every direction."""
    method: str = "adapted"
    surface: Surface
    line: Line
    box: tuple[Box, ...] = ()
    """Boxes in the cell, each a table ``[[box]]``."""
    feature: tuple[Feature, ...] = ()
    wear: Wear = Wear()
    light: Light = Light()
    displacement: BentDisplacement = BentDisplacement()
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
    """Distance that may be travelled without a seen line before it is lost, unless the map still knows it [m]."""

    @pydantic.model_validator(mode="after")
    def _plays(self) -> LineScene:
        check_clock(self.camera, self.calibration)
        return self
