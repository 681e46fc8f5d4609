"""The page of a closed loop with a force sensor: force error before, after and with the truth."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from ideal_robot.model.model import Model
from scenes.diagnosis.page import add_diagnosis, summary
from scenes.force.close_loop_result import CloseForceResult
from scenes.outputs import whole_folder
from scenes.report.page import Report


def write_force_circle(result: CloseForceResult, extended: Model, folder: Path) -> CloseForceResult:
    """Writes recording, extended model and report; returns the result with their places.

    Args:
        result: what was found.
        extended: the model with what the diagnosis added.
        folder: of the files; it appears whole or not at all.
    """
    hidden = " and ".join(name.replace("_", " ") for name in result.undeclared)
    page = Report(f"{result.scene.title or result.scene.name}: the loop closed",
                  f"Sensor and contact were wrong ({hidden}), which the force controller did not know. With the model "
                  f"as it was the RMS force error is {result.before.rms:.2f} N of {result.scene.force:g} N, with what "
                  f"the diagnosis of that run added {result.after.rms:.2f} N, with an oracle that knows what is wrong "
                  f"{result.oracle.rms:.2f} N, with sensor and contact known {result.true.rms:.2f} N. "
                  + summary(result.diagnosis))
    page.heading("Force before and after")
    page.table(list(result.columns), result.table(), "Of the true normal force while the tip travels.")
    page.heading("What was tried, and what stays")
    page.table(["round", "change of the model", "stays", "left in that run N", "why not"], result.ladder(),
               "What is left of it in the run, at the wanted force: the cell's own reading holds the error, so "
               "that a force error of its own would say nothing.")
    page.heading("The diagnosis between")
    add_diagnosis(page, result.diagnosis)
    with whole_folder(folder) as new:
        result.recording.write(new / "recording.parquet")
        extended.save(new / "extended_model.json")
        page.write(new / "report.html")
    return dataclasses.replace(result, model_path=folder / "extended_model.json", report=folder / "report.html")
