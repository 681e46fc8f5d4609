"""Tables of a scene file for a line on a plane: its nominal place, its true place, its appearance."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, Protocol

import numpy as np
import pinocchio as pin
import pydantic

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from scenes.scene_files.scene import Table
from scenes.scene_files.shape import STEP, Shape
from sensing.camera.camera_model import CalibrationError, CameraModel, default_mount
from sensing.camera.line_search import DetectionSettings

_HALL = 100.0
"""How far from the base a surface may be [m]; much farther, numbers of a path have no digits left for its points."""


class Surface(Table):
    """The plane on which the line is drawn."""

    origin: tuple[float, float, float]
    """Where the line's own origin lies in the base frame [m]."""
    heading_deg: float = 0.0
    """Direction of the line's own x axis in the surface, from the base's x axis."""
    tilt_deg: tuple[float, float] = (0.0, 0.0)
    """Tilt of the surface about the base's x and y axis."""

    @pydantic.field_validator("origin")
    @classmethod
    def _in_the_hall(cls, origin: tuple[float, float, float]) -> tuple[float, float, float]:
        if max(map(abs, origin)) > _HALL:
            raise ValueError(f"expected a place within {_HALL:g} m of the base")
        return origin

    def pose(self) -> pin.SE3:
        """Pose of the plane: x along the heading, z out of the surface."""
        tilt = pin.rpy.rpyToMatrix(math.radians(self.tilt_deg[0]), math.radians(self.tilt_deg[1]), 0.0)
        return pin.SE3(tilt @ pin.rpy.rpyToMatrix(0.0, 0.0, math.radians(self.heading_deg)), np.array(self.origin))


class Line(Shape):
    """The drawn line: its shape and its appearance."""

    width_mm: float = pydantic.Field(default=3.0, gt=0, le=50)
    gray: float = pydantic.Field(default=40.0, ge=0, le=255)
    background: float = pydantic.Field(default=200.0, ge=0, le=255)
    edge_mm: float = pydantic.Field(default=1.0, gt=0)

    @property
    def detection(self) -> DetectionSettings:
        """Width and contrast of the line as settings of the detector."""
        return DetectionSettings.of(1e-3 * self.width_mm, self.background - self.gray)


class Feature(Table):
    """Something that makes the line hard to see."""

    kind: Literal["gap", "crossing", "parallel", "scratch", "glare", "shade"]
    at_mm: float = pydantic.Field(ge=0)
    """Along the drawn line, up to its length."""
    length_mm: float = pydantic.Field(default=30.0, gt=0)
    offset_mm: float = 0.0
    angle_deg: float = 90.0
    width_mm: float = pydantic.Field(default=3.0, gt=0)
    gray: float | None = pydantic.Field(default=None, ge=0, le=255)


class Displacement(Table):
    """Sizes of the drawn line's displacement from its reference; the seed draws half to whole of each, with sign."""

    lateral_mm: float = pydantic.Field(default=10.0, ge=0, le=60)
    along_mm: float = pydantic.Field(default=5.0, ge=0, le=60)
    turn_deg: float = pydantic.Field(default=1.0, ge=0, le=20)
    height_mm: float = pydantic.Field(default=0.0, ge=0, le=30)
    """Of the surface against where the reference has it, along its normal."""
    tilt_deg: float = pydantic.Field(default=0.0, ge=0, le=10)
    """Of the surface against the reference, about each of its axes in the line's middle."""

    def draw(self, rng: np.random.Generator) -> tuple[float, float, float]:
        """Shift along and across [m], turn about the line's middle [rad]."""
        size = np.array([1e-3 * self.along_mm, 1e-3 * self.lateral_mm, math.radians(self.turn_deg)])
        along, across, turn = size * rng.uniform(0.5, 1.0, 3) * rng.choice([-1.0, 1.0], 3)
        return float(along), float(across), float(turn)

    def draw_plane(self, rng: np.random.Generator, middle: Array) -> pin.SE3:
        """Draws the true surface's pose in the nominal plane's frame; ``middle (2,)`` is that of the line [m]."""
        size = np.array([1e-3 * self.height_mm, math.radians(self.tilt_deg), math.radians(self.tilt_deg)])
        height, about_x, about_y = size * rng.uniform(0.5, 1.0, 3) * rng.choice([-1.0, 1.0], 3)
        about = pin.SE3(np.eye(3), np.array([*middle, 0.0]))
        moved = pin.SE3(pin.rpy.rpyToMatrix(about_x, about_y, 0.0), np.array([0.0, 0.0, height]))
        return about * moved * about.inverse()


class Reference(Table):
    """The reference path: the line's nominal shape unless another is given, longer than the line at both ends."""

    shape: Shape | None = None
    run_up: float = pydantic.Field(default=0.15, ge=0.0, le=2)
    """Straight piece before the line, on which the arm gets up to speed and finds it [m]."""
    run_out: float = pydantic.Field(default=0.05, ge=0.0, le=2)
    """Straight piece behind the line [m]."""
    acceleration: float = pydantic.Field(default=4.0, gt=0, le=50)
    """Along the path [m/s²]."""


class LineTables(Protocol):
    """The tables of a scene that say where reference and drawn line are."""

    @property
    def surface(self) -> Surface:
        """The plane that the line is drawn on."""

    @property
    def line(self) -> Line:
        """The drawn line."""

    @property
    def reference(self) -> Reference:
        """The path of the arm without corrections by a camera."""

    @property
    def displacement(self) -> Displacement:
        """Displacement of the drawn line from its nominal place."""

    @property
    def folder(self) -> Path | None:
        """Folder of the scene file, where files that it names are looked for."""


@dataclass(frozen=True)
class Geometry:
    """Places of surface, drawn line and reference in the base frame.

    Attributes:
        plane: pose of the surface, where it really is.
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


def geometry(scene: LineTables, rng: np.random.Generator) -> Geometry:
    """Reference path and drawn line of a scene; ``rng`` draws the line's true place."""
    nominal = _nominal(scene)
    along, across, turn = scene.displacement.draw(rng)
    chord = nominal[-1] - nominal[0]
    # "Along" and "across" are the line's own directions, start to end; a closed line takes its x axis.
    length = float(np.linalg.norm(chord))
    u = chord / length if length > 0.1 * STEP * len(nominal) else np.array([1.0, 0.0])
    c, s = math.cos(turn), math.sin(turn)
    middle = nominal.mean(axis=0)
    turned = (nominal - middle) @ np.array([[c, -s], [s, c]]).T + middle
    drawn = turned + along * u + across * np.array([-u[1], u[0]])
    true = scene.surface.pose() * scene.displacement.draw_plane(rng, middle)
    return Geometry(true, reference_points(scene), _lifted(drawn, true), drawn, (along, across, turn))


def reference_points(scene: LineTables) -> Array:
    """Points of the reference path with run-up and run-out ``(N, 3)`` [m]."""
    points = _nominal(scene) if scene.reference.shape is None else scene.reference.shape.curve(scene.folder)
    ends = [_straight(points[0], points[0] - points[1], scene.reference.run_up)[::-1], points,
            _straight(points[-1], points[-1] - points[-2], scene.reference.run_out)]
    return _lifted(np.vstack(ends), scene.surface.pose())


def _nominal(scene: LineTables) -> Array:
    return Shape(**{key: getattr(scene.line, key) for key in Shape.model_fields}).curve(scene.folder)


def _straight(start: Array, direction: Array, length: float) -> Array:
    """Points every half millimetre straight on from ``start``, which is left out."""
    unit = direction / np.linalg.norm(direction)
    return np.asarray(start + STEP * np.arange(1, int(length / STEP) + 1)[:, None] * unit)


def _lifted(xy: Array, plane: pin.SE3) -> Array:
    return np.asarray(np.column_stack([xy, np.zeros(len(xy))]) @ plane.rotation.T + plane.translation)


class CameraTable(Table):
    """The camera with the errors of its picture and time stamps."""

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
    """Standard deviation of the sensor's gray noise, the same at all levels."""
    full_well: float = pydantic.Field(default=0.0, ge=0)
    """Electrons of a pixel that is just white: noise grows with the root of the light; 0 for none that does."""
    mosaic: bool = False
    """Whether the gray values are made of a sensor's red, green and blue pixels: noise and edges of neighbours."""
    defocus_px: float = pydantic.Field(default=0.0, ge=0, le=20)
    """Radius of the disc that a point becomes out of focus [px]."""
    vignetting: float = pydantic.Field(default=0.0, ge=0, lt=1)
    """Share of the light that the lens loses in the picture's corners."""
    jpeg_quality: int = pydantic.Field(default=0, ge=0, le=100)
    """Of the file that the camera sends; 0 for pictures that are not compressed."""
    latency: float = pydantic.Field(default=0.04, ge=0, le=2)
    jitter: float = pydantic.Field(default=0.001, ge=0, le=0.5)
    stamp_offset: float = pydantic.Field(default=0.0, ge=-0.03, le=0.03)
    """By how much the time stamps are late [s]; where a tool is in time that lies further ahead, nobody knows."""
    stamp_drift: float = pydantic.Field(default=0.0, ge=-0.01, le=0.01)
    """By how much the clock of the time stamps runs fast [s/s]; needs calibration.by_moving = false."""
    stamp_noise: float = pydantic.Field(default=0.00005, ge=0, le=0.002)
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
    """Sizes of the errors between the true camera and its assumed calibration; the seed draws their signs."""

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


def check_clock(camera: CameraTable, calibration: Calibration) -> None:
    """Raises InputError for a clock that drifts where the camera is calibrated by moving."""
    if camera.stamp_drift != 0.0 and calibration.by_moving:
        raise InputError("a clock that drifts is followed only with calibration.by_moving = false",
                         field="camera.stamp_drift", value=camera.stamp_drift)


def believed_camera(table: CameraTable, told: Calibration | None = None) -> CameraModel:
    """The camera with its nominal mounting and the readout time of its data sheet."""
    mounted = CameraModel.default(table.width, table.height, table.focal_px, table.distortion,
                                  default_mount(table.mount_height, table.mount_ahead))
    rolling_ms = None if told is None else told.rolling_ms
    return replace(mounted, readout=1e-3 * (table.rolling_ms if rolling_ms is None else rolling_ms))


def true_camera(believed: CameraModel, table: Calibration, rng: np.random.Generator) -> CameraModel:
    """The true camera: the assumed one with errors of the table's sizes.

    Args:
        believed, table: the camera as it is calibrated, and the sizes of its errors, in the units of their keys.
        rng: draws their signs.
    """
    sizes = CalibrationError(math.radians(table.roll_deg), math.radians(table.pitch_deg), math.radians(table.yaw_deg),
                             1e-3 * table.height_mm, 1e-3 * table.lateral_mm, 1e-2 * table.focal_percent,
                             table.principal_px, table.k1)
    return believed.perturbed(**sizes.signed(rng))
