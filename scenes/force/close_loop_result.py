"""One turn of run, diagnose, extend, run again with a force sensor."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

from ideal_robot.diagnosis import Diagnosis
from ideal_robot.signals.recording import Recording
from scenes.force.result import ForceFigures
from scenes.result import ShownTable
from scenes.scene_files.force_scene import ForceScene
from scenes.sensor_loop import Trial


@dataclass(frozen=True, repr=False)
class CloseForceResult(ShownTable):
    """One turn of the loop.

    Attributes:
        scene: what was played.
        undeclared: effects by which sensor and contact differ from what the controller assumes.
        before, after, oracle, true: how well the force was kept with the model as it was, as extended, with the
            oracle's numbers, and with sensor and contact known.
        diagnosis: what was found.
        recording: what it was found from.
        found: what that is worth at the wanted force [N].
        steps: what was tried, with what was found after it, and the reason of a refusal.
    """

    scene: ForceScene
    undeclared: tuple[str, ...]
    before: ForceFigures
    after: ForceFigures
    oracle: ForceFigures
    true: ForceFigures
    diagnosis: Diagnosis = field(repr=False)
    recording: Recording = field(repr=False)
    found: float = float("nan")
    steps: tuple[Trial, ...] = ()
    model_path: Path | None = None
    report: Path | None = None

    tried_by: ClassVar[str] = "left in that run N"
    columns: ClassVar[tuple[str, ...]] = ("model", "RMS force error N", "mean force N", "largest N", "contact lost ms")

    @property
    def figures(self) -> dict[str, ForceFigures]:
        """The four runs by name."""
        return {"before": self.before, "after": self.after, "oracle": self.oracle, "true": self.true}

    def json(self) -> dict[str, Any]:
        """The content of ``--json``."""
        return {
            "scene": self.scene.name, "undeclared": [{"effect": name, "joint": 0} for name in self.undeclared],
            "force_error_N": {name: {"rms": f.rms, "mean": f.mean, "largest": f.largest, "lost_s": f.lost}
                              for name, f in self.figures.items()},
            "steps": [one.json(1.0) for one in self.steps], "plan": None,
            "after_over_oracle": self.after.rms / self.oracle.rms, "diagnosis": self.diagnosis.to_dict(),
            "model": self.model_path, "report": self.report,
        }

    def rows(self) -> tuple[tuple[str, ...], list[list[Any]]]:
        """The table, for prompt and notebook."""
        return self.columns, self.table()

    def ladder(self) -> list[list[Any]]:
        """One row a change that was tried: round, what, stays, what was still found with it, why not."""
        return [[0, "sensor and contact as they were assumed", True, self.found, ""],
                *[[one.round, one.tried, one.taken, one.error, one.refused] for one in self.steps]]

    def table(self) -> list[list[Any]]:
        """One row a model."""
        return [[name, f.rms, f.mean, f.largest, 1e3 * f.lost] for name, f in self.figures.items()]
