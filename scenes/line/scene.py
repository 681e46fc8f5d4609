"""The line-following scene as a file: surface, drawn line, where it really is, camera and its errors."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import pinocchio as pin
import pydantic

from ideal_robot.arrays import Array
from scenes.scene import Scene
from scenes.shape import STEP, Shape


class _Table(pydantic.BaseModel):
    model_config = pydantic.ConfigDict(extra="forbid", frozen=True)


class Surface(_Table):
    """The plane on which the line is drawn."""

    origin: tuple[float, float, float]
    """Where the line's own origin lies in the base frame [m]."""
    heading_deg: float = 0.0
    """Direction of the line's own x axis in the surface, from the base's x axis."""
    tilt_deg: tuple[float, float] = (0.0, 0.0)
    """Tilt of the surface about the base's x and y axis."""

    def pose(self) -> pin.SE3:
        """Pose of the plane: x along the heading, z out of the surface."""
        tilt = pin.rpy.rpyToMatrix(math.radians(self.tilt_deg[0]), math.radians(self.tilt_deg[1]), 0.0)
        return pin.SE3(tilt @ pin.rpy.rpyToMatrix(0.0, 0.0, math.radians(self.heading_deg)), np.array(self.origin))


class Line(Shape):
    """The drawn line: its shape, and how it looks."""

    width_mm: float = pydantic.Field(default=3.0, gt=0, le=50)
    gray: float = pydantic.Field(default=40.0, ge=0, le=255)
    background: float = pydantic.Field(default=200.0, ge=0, le=255)
    edge_mm: float = pydantic.Field(default=1.0, gt=0)


class Feature(_Table):
    """Something that makes the line hard to see."""

    kind: Literal["gap", "crossing", "parallel", "scratch", "glare", "shade"]
    at_mm: float = pydantic.Field(ge=0)
    length_mm: float = pydantic.Field(default=30.0, gt=0)
    offset_mm: float = 0.0
    angle_deg: float = 90.0
    width_mm: float = pydantic.Field(default=3.0, gt=0)
    gray: float | None = pydantic.Field(default=None, ge=0, le=255)


class Displacement(_Table):
    """How far the drawn line is from its reference: sizes; the seed draws half to whole of each, with sign."""

    lateral_mm: float = pydantic.Field(default=10.0, ge=0, le=60)
    along_mm: float = pydantic.Field(default=5.0, ge=0, le=60)
    turn_deg: float = pydantic.Field(default=1.0, ge=0, le=20)

    def draw(self, rng: np.random.Generator) -> tuple[float, float, float]:
        """Shift along and across [m], turn about the line's middle [rad]."""
        size = np.array([1e-3 * self.along_mm, 1e-3 * self.lateral_mm, math.radians(self.turn_deg)])
        along, across, turn = size * rng.uniform(0.5, 1.0, 3) * rng.choice([-1.0, 1.0], 3)
        return float(along), float(across), float(turn)


class Reference(_Table):
    """The reference path: the line's nominal shape unless another is given, longer than the line at both ends."""

    shape: Shape | None = None
    run_up: float = pydantic.Field(default=0.15, ge=0.0, le=2)
    """Straight piece before the line, on which the arm gets up to speed and finds it [m]."""
    run_out: float = pydantic.Field(default=0.05, ge=0.0, le=2)
    """Straight piece behind the line [m]."""
    acceleration: float = pydantic.Field(default=4.0, gt=0, le=50)
    """Along the path [m/s²]."""


class Camera(_Table):
    """The camera, and what it does to picture and time."""

    width: int = pydantic.Field(default=320, ge=64, le=1280)
    height: int = pydantic.Field(default=240, ge=48, le=1024)
    focal_px: float | None = pydantic.Field(default=None, gt=0)
    distortion: tuple[float, float, float, float, float] = (-0.2, 0.05, 0.0, 0.0, 0.0)
    mount_height: float = pydantic.Field(default=0.25, gt=0.03, le=2)
    """Of the camera above the TCP [m]."""
    mount_ahead: float = pydantic.Field(default=0.065, ge=-1, le=1)
    """Of the optical axis ahead of the TCP [m]."""
    rate: float = pydantic.Field(default=50.0, gt=0, le=1000)
    exposure: float = pydantic.Field(default=0.002, ge=0)
    sub_exposures: int = pydantic.Field(default=3, ge=1, le=50)
    supersampling: int = pydantic.Field(default=2, ge=1, le=8)
    noise: float = pydantic.Field(default=3.0, ge=0, le=100)
    latency: float = pydantic.Field(default=0.04, ge=0, le=2)
    jitter: float = pydantic.Field(default=0.001, ge=0, le=0.5)
    stamp_offset: float = pydantic.Field(default=0.0, ge=-1, le=1)
    stamp_noise: float = pydantic.Field(default=0.00005, ge=0, le=0.1)
    loss: float = pydantic.Field(default=0.0, ge=0, lt=1)
    resolution: float = pydantic.Field(default=0.00025, gt=0, le=0.01)


class Calibration(_Table):
    """Sizes of the errors between the camera as mounted and what is believed of it; the seed draws their signs."""

    roll_deg: float = pydantic.Field(default=0.3, ge=0, le=10)
    pitch_deg: float = pydantic.Field(default=0.3, ge=0, le=10)
    yaw_deg: float = pydantic.Field(default=0.3, ge=0, le=10)
    height_mm: float = pydantic.Field(default=1.0, ge=0, le=50)
    lateral_mm: float = pydantic.Field(default=0.5, ge=0, le=50)
    focal_percent: float = pydantic.Field(default=0.3, ge=0, le=20)
    principal_px: float = pydantic.Field(default=1.0, ge=0, le=50)
    k1: float = pydantic.Field(default=0.01, ge=0, le=1)
    by_moving: bool = True
    """Whether the camera is calibrated by moving it over a piece of the line before the run ([L] 4.4)."""


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
    camera: Camera = Camera()
    calibration: Calibration = Calibration()
    points: int = pydantic.Field(default=5, ge=3, le=25)
    """Line points looked for in each field; [L] takes 5."""
    tracker: bool = True
    """Whether the recording holds an external measuring device's arm angles and TCP."""
    stamp_estimate: bool = True
    """Whether the follower estimates on the way by how much the camera's time stamps are wrong."""
    max_gap: float = pydantic.Field(default=0.15, gt=0, le=5)
    """Distance that may be travelled without a seen line before it counts as lost [m]."""


@dataclass(frozen=True)
class Geometry:
    """Where everything is, in the base frame.

    Attributes:
        plane: pose of the surface.
        reference: points of the reference path with run-up and run-out ``(N, 3)`` [m].
        drawn: points of the drawn line, where it really is ``(N, 3)`` [m].
        drawn_xy: the same in the plane ``(N, 2)`` [m].
        displacement: shift along and across [m], turn [rad] that the seed drew.
    """

    plane: pin.SE3
    reference: Array
    drawn: Array
    drawn_xy: Array
    displacement: tuple[float, float, float]


def geometry(scene: LineScene, rng: np.random.Generator) -> Geometry:
    """Reference path and drawn line of a scene; ``rng`` draws where the line really is."""
    plane = scene.surface.pose()
    nominal = Shape(**{key: getattr(scene.line, key) for key in Shape.model_fields}).curve(scene.folder)
    wanted = nominal if scene.reference.shape is None else scene.reference.shape.curve(scene.folder)
    along, across, turn = scene.displacement.draw(rng)
    chord = nominal[-1] - nominal[0]
    # "Along" and "across" are the line's own directions, start to end; a closed line takes its x axis.
    length = float(np.linalg.norm(chord))
    u = chord / length if length > 0.1 * STEP * len(nominal) else np.array([1.0, 0.0])
    c, s = math.cos(turn), math.sin(turn)
    middle = nominal.mean(axis=0)
    turned = (nominal - middle) @ np.array([[c, -s], [s, c]]).T + middle
    drawn = turned + along * u + across * np.array([-u[1], u[0]])
    ends = [_straight(wanted[0], wanted[0] - wanted[1], scene.reference.run_up)[::-1], wanted,
            _straight(wanted[-1], wanted[-1] - wanted[-2], scene.reference.run_out)]
    return Geometry(plane, _lifted(np.vstack(ends), plane), _lifted(drawn, plane), drawn, (along, across, turn))


def _straight(start: Array, direction: Array, length: float) -> Array:
    """Points every half millimetre straight on from ``start``, which is left out."""
    unit = direction / np.linalg.norm(direction)
    return np.asarray(start + STEP * np.arange(1, int(length / STEP) + 1)[:, None] * unit)


def _lifted(xy: Array, plane: pin.SE3) -> Array:
    return np.asarray(np.column_stack([xy, np.zeros(len(xy))]) @ plane.rotation.T + plane.translation)


def calibration_sizes(table: Calibration) -> dict[str, Any]:
    """The table in SI units, as ``sensing.camera.camera_model.CalibrationError`` takes them."""
    return {
        "roll": math.radians(table.roll_deg),
        "pitch": math.radians(table.pitch_deg),
        "yaw": math.radians(table.yaw_deg),
        "height": 1e-3 * table.height_mm, "lateral": 1e-3 * table.lateral_mm, "focal": 1e-2 * table.focal_percent,
        "principal_point": table.principal_px, "distortion": table.k1,
    }
