"""One turn of run, diagnose, extend, run again on a path."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

from ideal_robot.diagnosis import Diagnosis
from ideal_robot.signals.recording import Recording
from scenes.measured import Measured
from scenes.metrics import PathErrors
from scenes.path.adoption_on_path import Step
from scenes.path.asked_motion import AskedMotion
from scenes.result import ShownTable
from scenes.scene_files.path_scene import PathScene


@dataclass(frozen=True, repr=False)
class CloseLoopResult(ShownTable):
    """One turn of the loop.

    Attributes:
        scene: what was played.
        undeclared: effects that the world holds and the model does not know: name, joint.
        before, after, oracle: path errors with the model as it was, as extended, and with the oracle's.
        diagnosis: what was found.
        recording: what it was found from.
        measured: what the arm measures.
        measured_before: path error with the model as it was, as the arm measures it [m].
        steps: every change that was tried, in order, with its measured error and the reason of a refusal.
        plan: the motion that a diagnosis asked for, when nothing more was taken; None where it asked for none.
    """

    scene: PathScene
    undeclared: tuple[tuple[str, int], ...]
    before: PathErrors
    after: PathErrors
    oracle: PathErrors
    diagnosis: Diagnosis = field(repr=False)
    recording: Recording = field(repr=False)
    measured: Measured = "tcp"
    measured_before: float = float("nan")
    steps: tuple[Step, ...] = ()
    plan: AskedMotion | None = None
    model_path: Path | None = None
    report: Path | None = None

    def json(self) -> dict[str, Any]:
        """The content of ``--json``."""
        before, after, oracle = (e.aligned.E_car for e in (self.before, self.after, self.oracle))
        return {
            "scene": self.scene.name, "undeclared": [{"effect": n, "joint": j} for n, j in self.undeclared],
            "path_error_mm": {"before": self.before.json_mm(), "after": self.after.json_mm(),
                              "oracle": self.oracle.json_mm()},
            "E_car_aligned_mm": {"before": 1e3 * before, "after": 1e3 * after, "oracle": 1e3 * oracle},
            "measured": self.measured, "measured_before_mm": 1e3 * self.measured_before,
            "steps": [{"round": one.round, "tried": one.tried, "taken": one.taken, "refused": one.refused or None,
                       "error": 1e3 * one.error} for one in self.steps],
            "plan": None if self.plan is None else self.plan.json(),
            "after_over_oracle": after / oracle, "diagnosis": self.diagnosis.to_dict(), "model": self.model_path,
            "report": self.report,
        }

    tried_by: ClassVar[str] = "measured E_car mm"
    columns: ClassVar[tuple[str, ...]] = ("model", "E_car timed", "aligned", "geometric", "E_max aligned")

    def rows(self) -> tuple[tuple[str, ...], list[list[Any]]]:
        """The table, for prompt and notebook."""
        return self.columns, self.table()

    def ladder(self) -> list[list[Any]]:
        """One row a change that was tried: round, what, taken, measured error in mm, why not."""
        return [[0, "the model as it was", True, 1e3 * self.measured_before, ""],
                *[[one.round, one.tried, one.taken, 1e3 * one.error, one.refused] for one in self.steps]]

    def table(self) -> list[list[Any]]:
        """One row a model: errors in mm."""
        return [[name, *[1e3 * value for value in (e.time_matched.E_car, e.aligned.E_car, e.geometric.E_car,
                                                   e.aligned.E_max)]]
                for name, e in (("before", self.before), ("after", self.after), ("oracle", self.oracle))]
