"""What a force scene yields: forces, what was felt of the surface, the recording, the timing."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.row_log import let_go
from ideal_robot.signals.recording import Recording
from planning.force.contact import Phase
from scenes.online.force_task import ForceLog
from scenes.result import ShownRun
from scenes.scene_files.force_scene import ForceScene

AT_A_TIME = 1_000_000
"""Values of which squares are taken at a time."""


@dataclass(frozen=True)
class ForceFigures:
    """How well the force was kept, from the beginning of the travel to its end, start and end included.

    Attributes:
        rms, mean: of the true normal force's error, and its mean [N].
        largest: true normal force over the whole run, touch-down included [N].
        least: during the travel [N].
        lost: time without contact during the travel [s].
        travel: length of the travel [s].
    """

    rms: float
    mean: float
    largest: float
    least: float
    lost: float
    travel: float


@dataclass(frozen=True, repr=False)
class ForceResult(ShownRun):
    """One force scene played with one method."""

    scene: ForceScene
    method: str
    figures: ForceFigures
    elasticity: tuple[float, float, float]
    """E assumed, its standard deviation from calibration, and the truth [N/m]."""
    tool: dict[str, float]
    history: dict[str, Array] = field(repr=False)
    log: ForceLog = field(repr=False)
    recording: Recording = field(repr=False)
    urdf: Path
    real_time_factor: float
    lateral: dict[str, Any] = field(default_factory=dict)
    """For ``glue``: distance from the drawn line."""
    lateral_series: tuple[Array, Array] = field(default=(np.empty(0), np.empty(0)), repr=False)
    """For ``glue``: instants [s] and signed distances from the line [m]."""
    failure: str | None = None
    recording_path: Path | None = None
    report: Path | None = None

    def json(self) -> dict[str, Any]:
        """The content of ``--json``."""
        f = self.figures
        return {
            **self.scene.played(), "task": self.scene.task, "speed_m_s": self.scene.speed,
            "method": self.method, "failure": self.failure, "desired_force_N": self.scene.force,
            "force_error_N": {"rms": f.rms, "mean": f.mean - self.scene.force},
            "max_force_N": f.largest, "max_force_ratio": f.largest / self.scene.force, "min_force_N": f.least,
            "contact_lost_s": f.lost, "travel_s": f.travel,
            "elasticity_N_m": {"assumed": self.elasticity[0], "std": self.elasticity[1], "true": self.elasticity[2]},
            "tool": self.tool, **self.lateral,
            "recording": self.recording_path, "recording_hash": self.recording.hash, "urdf": self.urdf,
            "report": self.report, "real_time_factor": self.real_time_factor,
            "cycle_time_ms": {"median": 1e3 * float(np.median(self.log.cycles)),
                              "p99": 1e3 * float(np.quantile(self.log.cycles, 0.99))},
        }

    def summary(self) -> list[tuple[str, str]]:
        """The few figures a person wants first."""
        f = self.figures
        rows = [("method", self.method), ("speed", f"{self.scene.speed:g} m/s"),
                ("RMS force error", f"{f.rms:.2f} N of {self.scene.force:g} N"),
                ("largest force", f"{f.largest:.1f} N"), ("contact lost", f"{1e3 * f.lost:.0f} ms")]
        if "control_error_mm" in self.lateral:
            rows.append(("mean distance from the line", f"{self.lateral['control_error_mm']['mean']:.3f} mm"))
        rows.append(("real-time factor", f"{self.real_time_factor:.1f}"))
        return rows


def force_figures(scene: ForceScene, history: dict[str, Array], log: ForceLog) -> ForceFigures:
    """How well the force was kept.

    Args:
        scene: what was wanted.
        history: true normal force ``normal (N,)`` [N] at ``t (N,)`` [s], every 0.5 ms.
        log: of the play.
    """
    moving = [t for t, phase in zip(log.t, log.phase, strict=True) if phase == Phase.TRAVEL.value]
    largest = float(history["normal"].max(initial=0.0))
    if len(moving) < 2:
        return ForceFigures(float("nan"), float("nan"), largest, float("nan"), float("nan"), 0.0)
    first, last = np.searchsorted(history["t"], moving[0]), np.searchsorted(history["t"], moving[-1], side="right")
    force = history["normal"][first:last]
    squares = sum(float(np.sum((part - scene.force) ** 2)) for part in
                  (force[begin : begin + AT_A_TIME] for begin in range(0, len(force), AT_A_TIME)))
    figures = ForceFigures(float(np.sqrt(squares / len(force))), float(force.mean()), largest, float(force.min()),
                           float(np.count_nonzero(force <= 0) * 0.0005), moving[-1] - moving[0])
    let_go(history["t"], force)
    return figures
