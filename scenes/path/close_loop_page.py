"""The page of a closed loop on a path: error before, after and with an oracle, and the diagnosis that led there."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from ideal_robot.model.model import Model
from scenes.diagnosis.page import diagnosis_page
from scenes.outputs import whole_folder
from scenes.path.close_loop_result import CloseLoopResult


def write_circle(result: CloseLoopResult, extended: Model, folder: Path) -> CloseLoopResult:
    """Writes recording, extended model and report; returns the result with their places."""
    page = diagnosis_page(result.diagnosis, f"{result.scene.title or result.scene.name}: the loop closed")
    before, after, oracle = (1e3 * e.aligned.E_car for e in (result.before, result.after, result.oracle))
    hidden = " and ".join(f"{name.replace('_', ' ')} in joint {joint}" for name, joint in result.undeclared)
    page.summary = (f"The world held {hidden}, which the model did not know. With the model as it was the path "
                    f"error is {before:.3g} mm, with what the diagnosis added {after:.3g} mm, with an oracle that was "
                    f"told name and joint {oracle:.3g} mm. " + page.summary)
    page.heading("Path error before and after")
    page.table(["model", "E_car time-matched mm", "E_car aligned mm", "E_car geometric mm", "E_max aligned mm"],
               result.table(), "[G] (14) and (21), of the true TCP.")
    with whole_folder(folder) as new:
        result.recording.write(new / "diagnostic_motion.parquet")
        extended.save(new / "extended_model.json")
        page.write(new / "report.html")
    return dataclasses.replace(result, model_path=folder / "extended_model.json", report=folder / "report.html")
