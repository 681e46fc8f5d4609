"""The page of a closed loop along a line: distance before, after and with the truth, and the diagnosis between."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from matplotlib.figure import Figure

from ideal_robot.model.model import Model
from scenes.diagnosis.page import add_diagnosis, summary
from scenes.line.close_loop_result import CloseLineResult
from scenes.outputs import whole_folder
from scenes.report.page import Report


def write_line_circle(result: CloseLineResult, extended: Model, folder: Path) -> CloseLineResult:
    """Writes recording, extended model and report of a line; returns the result with their places.

    Args:
        result: what was found.
        extended: the model with what the diagnosis added.
        folder: of the files; it appears whole or not at all.
    """
    page = Report(f"{result.scene.title or result.scene.name}: the loop closed", summary(result.diagnosis))
    before, after, oracle = (1e3 * e.mean for e in (result.before, result.after, result.oracle))
    names = dict.fromkeys([*result.undeclared, *(name for name, _ in result.arm)])
    hidden = " and ".join(name.replace("_", " ") for name in names)
    page.summary = (f"Camera or arm were wrong ({hidden}), which the line follower did not know. With the model as it "
                    f"was the tool is {before:.3g} mm beside the line in the mean, with what the diagnosis of that run "
                    f"added {after:.3g} mm, with an oracle that knows what is wrong {oracle:.3g} mm. " + page.summary)
    page.heading("Distance from the line before and after")
    page.table(["model", "latency assumed ms", "mean mm", "95 % mm", "max mm"], result.table(),
               "Of the true TCP, in the surface; the last row knows the true camera and its time stamps.")
    page.figure(_distances(result), "Distance of the true TCP from the line, over its arc length.")
    page.heading("What was tried, and what stays")
    page.table(["round", "change of the model", "stays", "spread of the seen points mm", "why not"], result.ladder(),
               "How far the line's points, as the camera saw them from many poses, lie from one smooth curve: all that "
               "the cell itself measures of its camera.")
    page.heading("The diagnosis between")
    add_diagnosis(page, result.diagnosis)
    with whole_folder(folder) as new:
        result.recording.write(new / "recording.parquet")
        extended.save(new / "extended_model.json")
        page.write(new / "report.html")
    return dataclasses.replace(result, model_path=folder / "extended_model.json", report=folder / "report.html")


def _distances(result: CloseLineResult) -> Figure:
    figure = Figure(figsize=(9.0, 3.2))
    axes = figure.subplots()
    for name, style in (("before", "C3-"), ("oracle", "C7-"), ("after", "C0-")):
        error = result.errors[name]
        axes.plot(error.s, 1e3 * error.lateral, style, lw=1.2, label=name)
    axes.set_xlabel("arc length of the line [m]")
    axes.set_ylabel("distance [mm]")
    axes.legend()
    axes.grid(alpha=0.3)
    return figure
