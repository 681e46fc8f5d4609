"""The page of a closed loop: path error before, after and with an oracle, and the diagnosis that led there."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from ideal_robot.model import Model
from scenes.close_loop import CloseLoopResult
from scenes.diagnosis_report import diagnosis_page


def write_circle(result: CloseLoopResult, extended: Model, folder: Path) -> CloseLoopResult:
    """Writes recording, extended model and report; returns the result with their places."""
    result.recording.write(folder / "diagnostic_motion.parquet")
    model_path = extended.save(folder / "extended_model.json")
    page = diagnosis_page(result.diagnosis, f"{result.scene.title or result.scene.name}: the loop closed")
    before, after, oracle = (1e3 * e.aligned.E_car for e in (result.before, result.after, result.oracle))
    hidden = " and ".join(f"{name.replace('_', ' ')} in joint {joint}" for name, joint in result.undeclared)
    page.summary = (f"The world held {hidden}, of which the model was not told. With the model as it was the path "
                    f"error is {before:.3g} mm, with what the diagnosis added {after:.3g} mm, with an oracle that was "
                    f"told name and joint {oracle:.3g} mm. " + page.summary)
    page.heading("Path error before and after")
    page.table(["model", "E_car time-matched mm", "E_car aligned mm", "E_car geometric mm", "E_max aligned mm"],
               result.table(), "[G] (14) and (21), of the true TCP.")
    return dataclasses.replace(result, model_path=model_path, report=page.write(folder / "report.html"))
