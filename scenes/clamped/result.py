"""What a clamped scene yields: stiffnesses, and how far they are from the truth."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.elasticity.stiffness_analysis import StiffnessAnalysis
from scenes.clamped.scene import ClampedScene
from scenes.report.page import plain
from scenes.shown import ShownRun
from sim.contact.clamp import ClampTruth


@dataclass(frozen=True, repr=False)
class ClampedResult(ShownRun):
    """One clamped scene played and analysed."""

    scene: ClampedScene
    analysis: StiffnessAnalysis
    truths: tuple[ClampTruth, ...]
    recordings: tuple[Path, ...]
    chosen: Array
    report: Path | None
    failure: str | None = None

    def errors(self) -> list[dict[str, Any]]:
        """How far each result is from the simulated truth, and the wrong drive gain's part in it [%]."""
        found = []
        for one in self.analysis.joints:
            truth = float(self.truths[0].stiffness[one.joint - 1])
            # The data sheet's gain times the recorded current is the true torque over the true gain's factor.
            gain = 100 * (float(np.mean([1 / t.gain_factor[one.joint - 1] for t in self.truths])) - 1)
            found.append({"joint": one.joint, "method": one.method, "truth": truth,
                          "error_percent": 100 * (one.stiffness / truth - 1),
                          "from_drive_gain_percent": gain if one.method == "motor" else 0.0,
                          "covered": one.interval[0] <= truth <= one.interval[1]})
        return found

    def json(self) -> dict[str, Any]:
        """The content of ``--json``."""
        content: dict[str, Any] = plain({
            "scene": self.scene.name, "seed": self.scene.seed, **self.analysis.to_dict(),
            "against_truth": self.errors(),
            "configurations": self.chosen, "recording": next(iter(self.recordings), None),
            "recording_files": list(self.recordings),
            "report": self.report})
        return content

    def summary(self) -> list[tuple[str, str]]:
        """Joint and method with stiffness, %σ and error."""
        return [(f"joint {one.joint}, {one.method}",
                 f"{one.stiffness:.4g} N m/rad, %σ {one.std_percent:.2f}, error {error['error_percent']:+.2f} %")
                for one, error in zip(self.analysis.joints, self.errors(), strict=True)]

    def table(self) -> tuple[list[str], list[list[Any]]]:
        """One row a joint and method."""
        return (["joint", "method", "k [N m/rad]", "%σ", "error [%]"],
                [[one.joint, one.method, one.stiffness, one.std_percent, error["error_percent"]]
                 for one, error in zip(self.analysis.joints, self.errors(), strict=True)])
