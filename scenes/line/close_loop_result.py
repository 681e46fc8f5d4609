"""One turn of run, diagnose, extend, run again along a line whose camera's time stamps are wrong."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

from ideal_robot.diagnosis import Diagnosis
from ideal_robot.signals.recording import Recording
from scenes.line.result import ControlError
from scenes.line.scene import LineScene
from scenes.shown import ShownTable

EFFECT = "camera_latency"


@dataclass(frozen=True, repr=False)
class CloseLineResult(ShownTable):
    """One turn of the loop.

    Attributes:
        scene: what was played.
        before, after, oracle, true: distance of the tool from the line with the model as it was, as extended, with the
            oracle's latency, and with the true one.
        latency: assumed in each of them [s].
        diagnosis: what was found.
        recording: what it was found from.
    """

    scene: LineScene
    before: ControlError
    after: ControlError
    oracle: ControlError
    true: ControlError
    latency: dict[str, float]
    diagnosis: Diagnosis = field(repr=False)
    recording: Recording = field(repr=False)
    model_path: Path | None = None
    report: Path | None = None

    @property
    def errors(self) -> dict[str, ControlError]:
        """The four runs by name."""
        return {"before": self.before, "after": self.after, "oracle": self.oracle, "true": self.true}

    def json(self) -> dict[str, Any]:
        """The content of ``--json``."""
        return {
            "scene": self.scene.name, "undeclared": [{"effect": EFFECT, "joint": 0}],
            "path_error_mm": {name: {"mean": 1e3 * e.mean, "p95": 1e3 * e.p95, "max": 1e3 * e.max}
                              for name, e in self.errors.items()},
            "latency_ms": {name: 1e3 * value for name, value in self.latency.items()},
            "after_over_oracle": self.after.mean / self.oracle.mean, "diagnosis": self.diagnosis.to_dict(),
            "model": self.model_path, "report": self.report,
        }

    columns: ClassVar[tuple[str, ...]] = ("model", "latency ms", "mean", "95 %", "max")

    def rows(self) -> tuple[tuple[str, ...], list[list[Any]]]:
        """The table, for prompt and notebook."""
        return self.columns, self.table()

    def ladder(self) -> list[list[Any]]:
        """Nothing is tried one by one: the camera's time stamps are all that a line scene closes."""
        return []

    def table(self) -> list[list[Any]]:
        """One row a model: latency in ms and errors in mm."""
        return [[name, 1e3 * self.latency[name], 1e3 * e.mean, 1e3 * e.p95, 1e3 * e.max]
                for name, e in self.errors.items()]
