"""The result of following a line: errors in SI units, the recording, the timing."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ideal_robot.arrays import Array
from ideal_robot.results import over_time
from ideal_robot.signals.recording import Recording
from scenes.metrics import ControlError, PathErrors, spread_ms
from scenes.online.log import FieldShown
from scenes.result import ShownRun
from scenes.scene_file import as_typed
from scenes.scene_files.drawn_line import Geometry
from scenes.scene_files.line_scene import LineScene
from sensing.camera.hand_eye import HandEye

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FAR = 1e-3
"""Mean distance from the line above which it is not followed but lost sight of [m]."""
DOUBTFUL = 0.5e-3
"""Mean distance from which it is worth playing the scene without correction, to see what the correction gives [m]."""
GAIN = 0.5
"""Share of what is left without correction that the ideal robot leaves at most where its model fits the arm."""


def far_from_line(mean: float) -> str:
    """A warning for a mean distance from the line [m] that is too large for use; empty for a small one."""
    if not mean > FAR:
        return ""
    return (f"the tool stayed {1e3 * mean:.1f} mm from the line on average, which is more than {1e3 * FAR:g} mm: check "
            "the arm's model (identify), its speed and the camera's calibration before this is used")


def little_gained(mean: float, none: float) -> str:
    """A warning where the mean distance from the line [m] is over half of that without correction; else empty."""
    if not mean > GAIN * none:
        return ""
    return (f"the correction leaves {1e3 * mean:.2f} mm of {1e3 * none:.2f} mm that are there without it: the model "
            "does not fit the arm; identify it anew, or diagnose the recording")


@dataclass(frozen=True)
class Timing:
    """Computing time of sensing, planning and feedforward, and of the whole run.

    Attributes:
        cycles: per interpolation cycle ``(K,)`` [s].
        with_field: whether a new field was worked on in that cycle ``(K,)``.
        wall: the run from the first to the last cycle, simulation and rendering included, set-up not [s].
        simulated: simulated time [s].
    """

    cycles: Array
    with_field: NDArray[np.bool_]
    wall: float
    simulated: float

    @property
    def real_time_factor(self) -> float:
        """Simulated over elapsed time."""
        return self.simulated / self.wall if self.wall > 0 else float("nan")

    def json_ms(self) -> dict[str, Any]:
        """Computing time [ms]: median, 99 % and maximum of all cycles; medians with a new field, and without one."""
        return {**spread_ms(self.cycles), "median_with_field": spread_ms(self.cycles[self.with_field])["median"],
                "median_without_field": spread_ms(self.cycles[~self.with_field])["median"]}


@dataclass(frozen=True, repr=False)
class LineResult(ShownRun):
    """One run along a drawn line with one method.

    Attributes:
        control_error: distance of the true TCP from the drawn line while it is followed.
        control_error_from_start: the same from the line's first point on.
        path_errors: true TCP against the desired path, three ways; None where the run was too short.
        fields_seen, fields_used: camera fields that arrived, and those that gave a measurement.
        left_out: why the others gave none, each with how many.
        recording: what a controller would have logged, plus desired angles and line points.
        shown: fields for the report.
        world: the world's settings.
        hand_eye: how the camera was calibrated before the run, if it was.
        warning: why it was not, if it should have been, and where the line was not followed as it could be.
        assumed: values used where the arm's URDF has none, or implausible ones.
        s_reference, believed: arc length of the reference at each cycle and the desired deviation there, x_d - x_r [m].
        looked_back: the deviation of the line as all fields of the run show it, smoothed; NaN where it is not kept [m].
        plan_error_mm: mean and largest distance of the desired path from it.
        sensors: values that each further sensor gave, and how many of them were fused.
    """

    scene: LineScene
    method: str
    control_error: ControlError
    control_error_from_start: ControlError = field(repr=False)
    path_errors: PathErrors | None
    fields_seen: int
    fields_used: int
    recording: Recording = field(repr=False)
    timing: Timing = field(repr=False)
    geometry: Geometry = field(repr=False)
    failure: str | None
    urdf: Path
    shown: tuple[FieldShown, ...] = field(repr=False, default=())
    world: dict[str, Any] = field(repr=False, default_factory=dict)
    hand_eye: HandEye | None = field(repr=False, default=None)
    warning: str = ""
    assumed: tuple[str, ...] = ()
    s_reference: Array = field(repr=False, default_factory=lambda: np.empty(0))
    believed: Array = field(repr=False, default_factory=lambda: np.empty(0))
    sensors: dict[str, tuple[int, int]] = field(default_factory=dict)
    left_out: dict[str, int] = field(default_factory=dict)
    looked_back: Array = field(repr=False, default_factory=lambda: np.empty(0))
    plan_error_mm: dict[str, float | None] = field(default_factory=dict)
    recording_path: Path | None = None
    report: Path | None = None

    def beside_none(self, none: LineResult) -> LineResult:
        """The result, with a warning added where the run without correction is hardly worse."""
        warning = little_gained(self.control_error.mean, none.control_error.mean)
        return replace(self, warning="; ".join(filter(None, [self.warning, warning])))

    def json(self) -> dict[str, Any]:
        """The content of ``--json``."""
        nothing = {"E_car": None, "E_max": None}
        errors = self.path_errors
        return {
            **self.scene.played(),
            "speed_m_s": self.scene.speed,
            "method": self.method,
            "failure": self.failure,
            "warning": self.warning or None,
            "assumed": list(self.assumed),
            "control_error_mm": self.control_error.json_mm(),
            "path_error_mm": errors.json_mm() if errors is not None
            else {"time_matched": nothing, "aligned": nothing, "geometric": nothing},
            "plan_error_mm": self.plan_error_mm,
            "camera_sigma_mm": None if self.hand_eye is None else 1e3 * self.hand_eye.across(),
            "fields": {"seen": self.fields_seen, "used": self.fields_used, "left_out": self.left_out},
            "sensors": {name: {"values": values, "used": used} for name, (values, used) in self.sensors.items()},
            "recording": self.recording_path,
            "recording_hash": self.recording.hash,
            "urdf": self.urdf,
            "report": self.report,
            "real_time_factor": self.timing.real_time_factor,
            "cycle_time_ms": self.timing.json_ms(),
        }

    def plot(self) -> Figure:
        """Signed distance of the true tool from the drawn line, along the line."""
        error = self.control_error_from_start
        return over_time(1e3 * error.s, [("to the left [mm]", [(self.method, 1e3 * error.lateral)])], self.scene.title,
                         "along the line [mm]")

    def next_steps(self) -> list[tuple[str, str]]:
        """The next steps, each a sentence and its command line; see ``ShownRun.next_steps``."""
        name = as_typed(self.scene)
        if self.failure:
            return [("Play it more slowly.", f"ideal-robot run {name} --speed {0.5 * self.scene.speed:.2g}")]
        return [("See what each part of the correction is worth.", f"ideal-robot compare {name}"),
                ("Find the highest speed within a tolerance.", f"ideal-robot run {name} --tolerance 0.2mm"),
                ("Let your own arm follow a line.", "ideal-robot new my_line --robot my_arm.urdf")]

    def summary(self) -> list[tuple[str, str]]:
        """The main figures as rows of label and value."""
        error = self.control_error
        warned = [("warning", self.warning)] if self.warning else []
        camera = [] if self.hand_eye is None else [
            ("camera across the travel, known to", f"± {1e3 * self.hand_eye.across():.3f} mm")]
        return [
            *warned,
            ("speed", f"{self.scene.speed:g} m/s"),
            ("method", self.method),
            ("mean distance from the line", f"{1e3 * error.mean:.3f} mm"),
            ("95 % below", f"{1e3 * error.p95:.3f} mm"),
            ("largest", f"{1e3 * error.max:.3f} mm"),
            *camera,
            ("camera pictures that showed the line", f"{self.fields_used} of {self.fields_seen}"),
            ("speed of the simulation", f"{self.timing.real_time_factor:.1f} × real time"),
        ]
