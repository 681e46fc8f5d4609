"""What clamping was worth on the path."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.elasticity.stiffness_analysis import StiffnessAnalysis
from scenes.close_clamped.scene import CloseClampedScene
from scenes.metrics import PathErrors
from scenes.report.page import plain
from scenes.result import ShownTable


@dataclass(frozen=True, repr=False)
class CloseClampedResult(ShownTable):
    """A path before and after the flange was clamped.

    Attributes:
        scene: what was played.
        before, after: path errors with a model without stiffness, and with that of the clamped recordings.
        tracker: with the stiffness that an external device's arm angles give on a motion in the same world.
        oracle: with the true one.
        stiffness: ``(n,)`` [N m/rad] in each of the last three; ``inf`` where a gear counts as rigid.
        analysis: of the clamped recordings.
        measured: ``motor`` for motor angles and currents alone, ``tcp`` where the wrench at the clamp is sensed.
    """

    scene: CloseClampedScene
    before: PathErrors
    after: PathErrors
    tracker: PathErrors
    oracle: PathErrors
    stiffness: dict[str, Array]
    analysis: StiffnessAnalysis = field(repr=False)
    measured: str = "tcp"
    model_path: Path | None = None
    report: Path | None = None

    tried_by: ClassVar[str] = "E_car mm"
    columns: ClassVar[tuple[str, ...]] = ("stiffness", "E_car timed", "aligned", "geometric", "E_max aligned")
    diagnosis: ClassVar[None] = None
    """Nothing is diagnosed: what is missing is known."""

    @property
    def errors(self) -> dict[str, PathErrors]:
        """The four plays by name."""
        return {"before": self.before, "after": self.after, "tracker": self.tracker, "oracle": self.oracle}

    def json(self) -> dict[str, Any]:
        """The content of ``--json``."""
        aligned = {name: 1e3 * one.aligned.E_car for name, one in self.errors.items()}
        values: dict[str, Any] = plain({
            **self.scene.played(), "path_error_mm": {name: one.json_mm() for name, one in self.errors.items()},
            "E_car_aligned_mm": aligned, "after_over_tracker": aligned["after"] / aligned["tracker"],
            "after_over_oracle": aligned["after"] / aligned["oracle"],
            "stiffness": {name: [None if not np.isfinite(k) else float(k) for k in values]
                          for name, values in self.stiffness.items()},
            "clamped": self.analysis.to_dict(), "measured": self.measured, "steps": [], "plan": None,
            "model": self.model_path, "report": self.report})
        return values

    def rows(self) -> tuple[tuple[str, ...], list[list[Any]]]:
        """The table, for prompt and notebook."""
        return self.columns, self.table()

    def ladder(self) -> list[list[Any]]:
        """Nothing is tried one by one: all gears are measured at once."""
        return []

    def table(self) -> list[list[Any]]:
        """One row a source of the stiffness: errors in mm."""
        words = {"before": "none", "after": "clamped flange", "tracker": "arm angles of a tracker", "oracle": "true"}
        return [[words[name], *[1e3 * value for value in (e.time_matched.E_car, e.aligned.E_car, e.geometric.E_car,
                                                          e.aligned.E_max)]] for name, e in self.errors.items()]
