"""What playing a known path yields."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ideal_robot.signals.recording import Recording
from scenes.metrics import PathErrors
from scenes.path.player import Play
from scenes.path.scene import JointPath, PathScene
from scenes.shown import ShownRun


@dataclass(frozen=True, repr=False)
class PathResult(ShownRun):
    """One path played with one method.

    Attributes:
        scene, method: what was played.
        path: the path in joint space.
        played: errors, motion, commands and timing.
        urdf: file of the arm.
        world: the world's settings.
        recording_path, report: files written, if any.
    """

    scene: PathScene
    method: str
    path: JointPath = field(repr=False)
    played: Play = field(repr=False)
    urdf: Path
    world: dict[str, Any] = field(repr=False, default_factory=dict)
    failure: str | None = None
    recording_path: Path | None = None
    report: Path | None = None

    @property
    def errors(self) -> PathErrors:
        """Errors of the true TCP, three ways."""
        return self.played.errors

    @property
    def recording(self) -> Recording:
        """What the controller logged, with desired and externally measured angles."""
        return self.played.recording

    def json(self) -> dict[str, Any]:
        """The content of ``--json``."""
        times = 1e3 * self.played.cycle_times
        return {
            **self.scene.played(),
            "speed_m_s": self.scene.speed,
            "method": self.method,
            "failure": self.failure,
            "path_error_mm": self.errors.json_mm(),
            "motor_path_error_mm": self.played.motor_errors.json_mm(),
            "recording": self.recording_path,
            "recording_hash": self.recording.hash,
            "urdf": self.urdf,
            "report": self.report,
            "real_time_factor": float(self.path.t[-1] / self.played.wall),
            "cycle_time_ms": {"median": float(np.median(times)), "p99": float(np.quantile(times, 0.99)),
                              "max": float(np.max(times))},
        }

    def summary(self) -> list[tuple[str, str]]:
        """The few figures a person wants first."""
        rows = [("method", self.method), ("speed", f"{self.scene.speed:g} m/s")]
        for name, error in (("time-matched", self.errors.time_matched), ("aligned", self.errors.aligned),
                            ("geometric", self.errors.geometric)):
            rows.append((f"E_car {name}", f"{1e3 * error.E_car:.3f} mm"))
            rows.append((f"E_max {name}", f"{1e3 * error.E_max:.3f} mm"))
        return [*rows, ("delay", f"{1e3 * self.errors.delay:.2f} ms")]
