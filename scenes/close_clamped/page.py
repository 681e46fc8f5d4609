"""The page: what the clamped flange said of the gears, and what that is worth on the path."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from ideal_robot.model.model import Model
from ideal_robot.signals.recording import Recording
from scenes.close_clamped.result import CloseClampedResult
from scenes.outputs import whole_folder
from scenes.report.page import Report


def write_close_clamped(result: CloseClampedResult, extended: Model, recordings: Sequence[Recording],
                        folder: Path) -> CloseClampedResult:
    """Writes clamped recordings, model and report; returns the result with their places.

    Args:
        result: what was found.
        extended: the model with the stiffness of the clamped recordings.
        recordings: the clamped ones.
        folder: of the files; it appears whole or not at all.
    """
    aligned = {name: 1e3 * one.aligned.E_car for name, one in result.errors.items()}
    page = Report(f"{result.scene.title or result.scene.name}: from the clamp to the path",
                  f"Without stiffness in the model the path error is {aligned['before']:.3g} mm, with what "
                  f"{len(recordings)} recordings with the flange clamped say of the gears {aligned['after']:.3g} mm. "
                  f"With the arm angles of a tracker it is {aligned['tracker']:.3g} mm, with the true stiffness "
                  f"{aligned['oracle']:.3g} mm. Motor angles, currents"
                  + (" and the wrench at the clamp" if result.measured == "tcp" else "") + " were all it took.")
    page.heading("Path error before and after")
    page.table(["stiffness", "E_car time-matched mm", "E_car aligned mm", "E_car geometric mm", "E_max aligned mm"],
               result.table(), "[G] (14) and (21), of the true TCP.")
    page.figure(_deviations(result), "Deviation of the true TCP along the path, aligned: without stiffness (red), with "
                "that of the clamp (blue), with a tracker (grey).")
    page.heading("Stiffness")
    said = {(one.joint, one.method): one for one in result.analysis.joints}
    page.table(["joint", "clamp, motor", "clamp, wrench", "taken", "tracker", "true N m/rad"],
               [[j + 1, *(said[j + 1, method].stiffness if (j + 1, method) in said else None
                          for method in ("motor", "wrench")),
                 *(float(result.stiffness[name][j]) for name in ("after", "tracker", "oracle"))]
                for j in range(len(result.stiffness["oracle"]))],
               "[J] (15)-(17); of the two methods the one with the narrower interval is taken.")
    for warning in result.analysis.warnings:
        page.warning(warning)
    with whole_folder(folder) as new:
        for number, one in enumerate(recordings, start=1):
            one.write(new / f"clamped_{number}.parquet")
        extended.save(new / "extended_model.json")
        page.write(new / "report.html")
    return dataclasses.replace(result, model_path=folder / "extended_model.json", report=folder / "report.html")


def _deviations(result: CloseClampedResult) -> Figure:
    figure = Figure(figsize=(5.4, 3.0), layout="constrained")
    axes = figure.subplots()
    for name, colour in (("before", "#b0413e"), ("tracker", "#8893a1"), ("after", "#2f6690")):
        deviation = 1e3 * result.errors[name].aligned.deviation
        axes.plot(np.linspace(0.0, 100.0, len(deviation)), deviation, color=colour, lw=1.1, label=name)
    axes.set_xlabel("share of the path's time [%]")
    axes.set_ylabel("deviation [mm]")
    axes.set_ylim(bottom=0.0)
    axes.legend(frameon=False, ncols=3)
    axes.grid(alpha=0.3)
    return figure
