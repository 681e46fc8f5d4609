"""The page of a closed loop on a path: error before, after and with an oracle, and the diagnosis that led there."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from ideal_robot.model.model import Model
from scenes.diagnosis.page import add_diagnosis, summary
from scenes.outputs import whole_folder
from scenes.path.close_loop_result import CloseLoopResult
from scenes.path.last_good import NAME
from scenes.report.page import Report

SEES = {"motor": "motor angles and currents", "arm": "motor and arm angles, and currents",
        "tcp": "motor and arm angles, currents, and the place of its tool"}
"""What is measured, in words."""


def write_circle(result: CloseLoopResult, extended: Model, folder: Path) -> CloseLoopResult:
    """Writes recording, extended model and report; returns the result with their places.

    Args:
        result: what was found.
        extended: the model with what the diagnosis added.
        folder: of the files; it appears whole or not at all.
    """
    page = Report(f"{result.scene.title or result.scene.name}: the loop closed", summary(result.diagnosis))
    before, after, oracle = (1e3 * e.aligned.E_car for e in (result.before, result.after, result.oracle))
    hidden = " and ".join(f"{name.replace('_', ' ')} in joint {joint}" for name, joint in result.undeclared)
    page.summary = (f"The world held {hidden}, which the model did not know. With the model as it was the path "
                    f"error is {before:.3g} mm, with what the diagnosis added {after:.3g} mm, with an oracle that "
                    f"knows name and joint {oracle:.3g} mm. " + page.summary)
    page.heading("Path error before and after")
    page.table(["model", "E_car time-matched mm", "E_car aligned mm", "E_car geometric mm", "E_max aligned mm"],
               result.table(), "[G] (14) and (21), of the true TCP.")
    page.figure(_deviations(result), "Deviation of the true TCP along the path, aligned: with the model as it was "
                "(red), with what the diagnosis added (blue), with an oracle (grey).")
    page.heading("What was tried, and what stays")
    page.table(["round", "change of the model", "stays", "measured E_car mm", "why not"], result.ladder(),
               f"Path error, aligned, as an arm measures it that knows: {SEES[result.measured]}.")
    if result.plan is not None:
        page.heading("The motion that the diagnosis asked for")
        page.table(["cause", "or", "recorded σ", "planned σ", "told apart"], result.plan.table(),
                   result.plan.reason or f"In round {result.plan.round} nothing was taken, and these were open. σ: "
                   "expected distance of the two causes in standard deviations of the noise, by the motion that was "
                   "recorded and by the one that was planned, played and diagnosed.")
    page.heading("The diagnosis between")
    add_diagnosis(page, result.diagnosis)
    with whole_folder(folder) as new:
        result.recording.write(new / "diagnostic_motion.parquet")
        extended.save(new / NAME)
        page.write(new / "report.html")
    return dataclasses.replace(result, model_path=folder / NAME, report=folder / "report.html")


def _deviations(result: CloseLoopResult) -> Figure:
    figure = Figure(figsize=(5.4, 3.0), layout="constrained")
    axes = figure.subplots()
    for name, errors, colour in (("before", result.before, "#b0413e"), ("oracle", result.oracle, "#8893a1"),
                                 ("after", result.after, "#2f6690")):
        deviation = 1e3 * errors.aligned.deviation
        axes.plot(np.linspace(0.0, 100.0, len(deviation)), deviation, color=colour, lw=1.1, label=name)
    axes.set_xlabel("share of the path's time [%]")
    axes.set_ylabel("deviation [mm]")
    axes.set_ylim(bottom=0.0)
    axes.legend(frameon=False, ncols=3)
    axes.grid(alpha=0.3)
    return figure
