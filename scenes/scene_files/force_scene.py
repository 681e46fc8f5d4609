"""The files of force scenes: unknown surface, tip, force sensor, desired motion and assumptions."""

from __future__ import annotations

from typing import Any, ClassVar, Literal

import pydantic

from ideal_robot.errors import InputError
from planning.force.contact import TOGETHER, StopLimits
from scenes.scene_files.drawn_line import Calibration, CameraTable, Displacement, Line, Reference, Surface, check_clock
from scenes.scene_files.scene import ARM, Box, Scene, Span, Table


class WaveTable(Table):
    """One sine of the surface."""

    amplitude_mm: float
    wavelength_mm: float = pydantic.Field(gt=5)
    heading_deg: float = 0.0
    phase_deg: float = 0.0


class UnknownSurface(Surface):
    """Nominal plane, and how the real surface differs from it."""

    offset_mm: float = 0.0
    slope: tuple[float, float] = (0.0, 0.0)
    """Of the surface against its nominal plane, along and across."""
    curvature: float = 0.0
    """Of a cylinder about the plane's y axis, positive for a hill [1/m]."""
    crest_mm: float = 0.0
    wave: tuple[WaveTable, ...] = ()


class TipTable(Table):
    """The tool's elastic tip."""

    stiffness: float = pydantic.Field(default=4000.0, gt=0)
    damping: float = pydantic.Field(default=8.0, ge=0)
    friction: float = pydantic.Field(default=0.15, ge=0, le=2)


class SensorTable(Table):
    """The force sensor and the tool that it carries."""

    rate: float = pydantic.Field(default=250.0, ge=0.1, le=10_000)
    latency: float = pydantic.Field(default=0.02, ge=0, le=0.4)
    """From measurement to arrival [s]; on devices no older reading counts. From 0.3 s on contact is lost, or not felt
    where it begins."""
    jitter: float = pydantic.Field(default=0.0005, ge=0, le=0.5)
    """Standard deviation of the latency [s]. What arrives together is fused as one: six of it on the path, at the
    scene's speed, are 60 mm at most."""
    noise: tuple[float, float] = (0.3, 0.02)
    bias: tuple[float, float] = (3.0, 0.1)
    mass: float = pydantic.Field(default=0.8, ge=0, le=20)
    com: tuple[float, float, float] = (0.0, 0.01, -0.08)
    drift: tuple[float, ...] = ()
    """What the bias has changed by since calibration, six components [N, N m]."""
    lie: Span = ()
    """From and to [s]: it tells nonsense."""

    @pydantic.field_validator("noise")
    @classmethod
    def _are_deviations(cls, noise: tuple[float, float]) -> tuple[float, float]:
        if min(noise) < 0.0:
            raise ValueError("expected standard deviations [N, N m], zero or positive")
        return noise


class Assumed(Table):
    """The planner's assumptions, as ratios to the calibrated values; 1 is right."""

    elasticity_ratio: float = pydantic.Field(default=1.0, gt=0)
    distance_ratio: float = pydantic.Field(default=1.0, gt=0)
    elasticity_estimated: bool = True
    distance_estimated: bool = True
    """Whether they are corrected on the way, from how the sensor values go with the arm's motion."""


class Emergency(Table):
    """Limits at which the arm stops on the path."""

    force: float = pydantic.Field(default=80.0, gt=0)
    lost: float = pydantic.Field(default=0.1, gt=0)
    share: float = pydantic.Field(default=1.0, gt=0, le=2)

    def limits(self) -> StopLimits:
        """The limits as an object for the stop conditions."""
        return StopLimits(**self.model_dump())


class CameraTrouble(Table):
    """Faults of the camera during the run; times are from the beginning of the travel [s]."""

    loss: Span = ()
    """From and to: nothing arrives."""
    garbage: Span = ()
    """From and to: fields arrive that show something else."""
    garbage_mm: float = 8.0
    """How far beside the line that is."""


_SEEN: dict[str, tuple[str, ...]] = {"displacement": (), "camera": (), "calibration": (), "trouble": (),
                                     "assumed": ("distance_ratio", "distance_estimated")}
"""Tables that count only where a camera looks for a line, and which of their keys if not all."""


class ForceScene(Scene):
    """An arm presses its tip on a surface and moves along it."""

    workshop: ClassVar[dict[str, dict[str, Any]]] = {"world": ARM}
    kind: Literal["force"]
    task: Literal["surface", "contour", "glue"] = "surface"
    """Only ``glue`` looks for a drawn line: displacement, camera, calibration, trouble and assumed.distance_* count for
    it alone."""
    speed: float = pydantic.Field(default=0.2, gt=0, le=2)
    method: str = "adapted"
    force: float = pydantic.Field(default=20.0, gt=0)
    """Wanted normal force [N], below ``emergency.force``."""
    surface: UnknownSurface
    box: tuple[Box, ...] = ()
    """Boxes in the cell, each a table ``[[box]]``."""
    line: Line = Line(formula="0*x", length=0.8)
    """The path on the surface; for ``glue`` also what is drawn on it."""
    reference: Reference = Reference(run_up=0.03, run_out=0.03, acceleration=2.0)
    tip: TipTable = TipTable()
    sensor: SensorTable = SensorTable()
    emergency: Emergency = Emergency()
    assumed: Assumed = Assumed()
    gains: tuple[float, float] | None = None
    """K_p [m/N] and K_d [m/N] of direct feedback, found by search beforehand; None: searched now."""
    displacement: Displacement = Displacement(lateral_mm=0.0, along_mm=0.0, turn_deg=0.0)
    camera: CameraTable = CameraTable()
    calibration: Calibration = Calibration()
    trouble: CameraTrouble = CameraTrouble()

    @pydantic.model_validator(mode="after")
    def _below_the_stop(self) -> ForceScene:
        if not self.force < self.emergency.force:
            raise InputError(f"expected less than emergency.force = {self.emergency.force:g} N, where the arm stops; "
                             "lower it, or raise emergency.force", field="force", value=self.force)
        return self

    @pydantic.model_validator(mode="after")
    def _arrive_together(self) -> ForceScene:
        """Refuses samples that overtake each other by more than what a measurement may stretch over."""
        most = TOGETHER / (6.0 * self.speed)
        if self.sensor.jitter > most:
            raise InputError(f"expected at most {most:.2g} s at {self.speed:g} m/s: samples that arrive together must "
                             f"lie within {1e3 * TOGETHER:g} mm of the path; lower it, or the speed",
                             field="sensor.jitter", value=self.sensor.jitter)
        return self

    @pydantic.model_validator(mode="after")
    def _counts(self) -> ForceScene:
        """Refuses what the task does not look at."""
        if self.task == "glue":
            check_clock(self.camera, self.calibration)
            return self
        for table, keys in _SEEN.items():
            settings, usual = getattr(self, table), type(self).model_fields[table].default
            # A table with any key gets all its defaults; keys of the file are named first.
            for key in sorted(keys or type(usual).model_fields, key=lambda key: key not in settings.model_fields_set):
                if getattr(settings, key) != getattr(usual, key):
                    raise InputError(f'is used only with task = "glue"; leave it out with "{self.task}"',
                                     field=f"{table}.{key}", value=getattr(settings, key))
        return self
