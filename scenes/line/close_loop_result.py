"""One turn of run, diagnose, extend, run again along a line whose camera is wrong."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

from ideal_robot.diagnosis import Diagnosis
from ideal_robot.signals.recording import Recording
from scenes.line.result import ControlError
from scenes.result import ShownTable
from scenes.scene_files.line_scene import LineScene
from scenes.sensor_loop import Trial


@dataclass(frozen=True, repr=False)
class CloseLineResult(ShownTable):
    """One turn of the loop.

    Attributes:
        scene: what was played.
        undeclared: effects by which the camera differs from what its follower knew.
        before, after, oracle, true: distance of the tool from the line with the model as it was, as extended, with the
            oracle's numbers, and with the true camera and stamps.
        latency: of the stamps, assumed in each of them [s].
        diagnosis: what was found at first.
        recording: what it was found from.
        spread: of the seen points about one smooth curve with the model as it was [m].
        steps: every change that was tried, with the spread it left and the reason of a refusal; of a change of the arm
            how far the tool was from where the follower wanted it.
        arm: effects, with their joints, by which the arm differed from its model.
    """

    scene: LineScene
    undeclared: tuple[str, ...]
    before: ControlError
    after: ControlError
    oracle: ControlError
    true: ControlError
    latency: dict[str, float]
    diagnosis: Diagnosis = field(repr=False)
    recording: Recording = field(repr=False)
    spread: float = float("nan")
    steps: tuple[Trial, ...] = ()
    arm: tuple[tuple[str, int], ...] = ()
    model_path: Path | None = None
    report: Path | None = None

    @property
    def errors(self) -> dict[str, ControlError]:
        """The four runs by name."""
        return {"before": self.before, "after": self.after, "oracle": self.oracle, "true": self.true}

    def json(self) -> dict[str, Any]:
        """The content of ``--json``."""
        return {
            "scene": self.scene.name, "undeclared": [{"effect": name, "joint": joint} for name, joint in
                                                       (*((name, 0) for name in self.undeclared), *self.arm)],
            "path_error_mm": {name: {"mean": 1e3 * e.mean, "p95": 1e3 * e.p95, "max": 1e3 * e.max}
                              for name, e in self.errors.items()},
            "latency_ms": {name: 1e3 * value for name, value in self.latency.items()},
            "steps": [one.json(1e3) for one in self.steps], "plan": None,
            "after_over_oracle": self.after.mean / self.oracle.mean, "diagnosis": self.diagnosis.to_dict(),
            "model": self.model_path, "report": self.report,
        }

    tried_by: ClassVar[str] = "spread of seen points mm"
    columns: ClassVar[tuple[str, ...]] = ("model", "latency ms", "mean mm", "95 % mm", "max mm")

    def rows(self) -> tuple[tuple[str, ...], list[list[Any]]]:
        """The table, for prompt and notebook."""
        return self.columns, self.table()

    def ladder(self) -> list[list[Any]]:
        """One row a change that was tried: round, what, stays, spread of the seen points in mm, why not."""
        return [[0, "the camera as it was believed", True, 1e3 * self.spread, ""],
                *[[one.round, one.tried, one.taken, 1e3 * one.error, one.refused] for one in self.steps]]

    def table(self) -> list[list[Any]]:
        """One row a model: latency in ms and errors in mm."""
        return [[name, 1e3 * self.latency[name], 1e3 * e.mean, 1e3 * e.p95, 1e3 * e.max]
                for name, e in self.errors.items()]
