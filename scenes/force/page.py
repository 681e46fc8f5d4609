"""The pages of force scenes: force and surface over time, and the methods side by side."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from ideal_robot.registry import in_words
from ideal_robot.row_log import let_go
from scenes.arms import arm_of
from scenes.force.cell import scene_curves
from scenes.force.compare import ForceComparison
from scenes.force.play import ForceResult
from scenes.methods import DIRECT, SENSOR_PATH, WORDS
from scenes.report.page import Report
from scenes.report.replay import Replay, sensed_force, shown_motion
from scenes.result import extremes, step
from scenes.scene_files.scene import box_edges


def force_replay(result: ForceResult) -> Replay | None:
    """The replay of a run; None where it is too short for one."""
    recording = result.recording
    if len(recording.t) < 2:
        return None
    robot = arm_of(result.scene.robot)
    rows, t, q, tool = shown_motion(robot, recording)
    travel = result.log.travel
    force = np.interp(t, result.history["t"], result.history["normal"])
    let_go(result.history["t"], result.history["normal"])
    error = np.full(len(t), np.nan)
    if travel:
        counts = (t >= travel[0]) & (t <= travel[-1])
        error[counts] = np.abs(force - result.scene.force)[counts]
    # The force determines the tool's place, so there is no position error to be enlarged.
    curves = scene_curves(result.scene) | box_edges(result.scene.box)
    return Replay(robot, t, q, tool, tool, error, "difference from the wanted force", "N", curves=curves, enlarged=1.0,
                  force=sensed_force(robot, recording, rows))


_NAMED = {**WORDS, SENSOR_PATH: "the path from the force alone", DIRECT: "direct force feedback at its best gain"}
COLOURS = {"ideal": "#e06000", "adapted": "#7d3c98", "sensor_path": "#1f5fa8", "direct_feedback": "#808080"}


def run_page(result: ForceResult, moving: Replay | None) -> Report:
    """The page of one run, with its replay where there is one."""
    f, scene = result.figures, result.scene
    line = result.lateral.get("control_error_mm")
    beside = f", mean distance from the line {line['mean']:.3f} mm" if line else ""
    page = Report(scene.title, f"The force differed by {f.rms:.2f} N (RMS) from the wanted {scene.force:g} N; the "
                  f"largest was {f.largest:.1f} N{beside}. The tool moved at {scene.speed:g} m/s.")
    if result.failure is not None:
        page.warning(result.failure)
    page.figures(result.summary())
    page.next(*result.next_steps())
    if moving is not None:
        page.heading("The run")
        page.replay(moving, "Green to red: how far the true force is from the wanted one while the tool travels.")
    page.heading("Force and surface")
    page.figure(_run_figure(result), "Top: true normal force (every 0.5 ms) and the force that was wanted; shaded: the "
                "travel, which is evaluated. Bottom: height of the true surface and of the undeformed tip, which has "
                "to be F/E below it.")
    if result.control_error is not None:
        page.heading("Line")
        page.figure(_line_figure(result), "Distance of the tip from the drawn line, and how many points "
                    "of each field were used.")
        page.text(_camera_story(result))
    page.heading("Scene", folded=True)
    page.text(scene.description)
    page.heading("What was calibrated by moving", folded=True)
    assumed, std, true = result.elasticity
    page.table(["", "found", "true"], [["elasticity E [N/m]", f"{assumed:.0f} ± {std:.0f}", f"{true:.0f}"],
                                       ["mass of the tool [kg]", result.tool["mass"], scene.sensor.mass]],
               "E is that of the whole chain, tip and gears.")
    if result.hand_eye is not None:
        page.calibration(result.hand_eye)
    return page


def comparison_page(comparison: ForceComparison) -> Report:
    """The page that compares the methods on one scene."""
    scene = comparison.scene
    shown = ", ".join(f"{run.figures.rms:.2f} N with {_NAMED.get(method, in_words(method))}"
                      for method, run in reversed(comparison.runs.items()))
    page = Report(f"{scene.title}: methods compared", f"RMS difference from the wanted force: {shown}.")
    page.next(("Press on a surface of your own.", "ideal-robot new my_surface --kind force"))
    columns, rows = comparison.table()
    if not any(row[-1] for row in rows):
        columns, rows = columns[:-1], [row[:-1] for row in rows]
    page.table(columns, rows)
    page.figure(forces_figure(comparison), "True normal force, a panel for each method on the same scale; dashed: the "
                f"{scene.force:g} N that are wanted. The table has the travel, without touching down and "
                "lifting off.")
    if comparison.troubles:
        page.heading("The camera in trouble")
        page.text("The same scene with the ideal robot: the map carries the tool on, and what contradicts it or itself "
                  "is left out.")
        page.table(["camera", "mean distance from the line [mm]", "largest [mm]", "RMS force error [N]", "fields used",
                    "fields left out"],
                   [[name, run.lateral["control_error_mm"]["mean"], run.lateral["control_error_mm"]["max"],
                     run.figures.rms, run.lateral["fields"]["used"], sum(run.lateral["fields"]["left_out"].values())]
                    for name, run in comparison.troubles])
    if comparison.trials:
        page.heading("Search for the best direct feedback", folded=True)
        page.table(["K_p [µm/N per cycle]", "K_d [µm/N]", "RMS force error [N]"],
                   [[1e6 * trial.k_p, 1e6 * trial.k_d, trial.error] for trial in comparison.trials],
                   "Each line is a play; the best gains are those of direct_feedback above. –: ended early.")
    return page


def forces_figure(comparison: ForceComparison) -> Figure:
    """Figure of the true normal force of each method, one panel each, so that the best one stays visible."""
    runs, wanted = comparison.runs, comparison.scene.force
    figure = Figure(figsize=(4.8, 0.5 + 1.35 * len(runs)), layout="constrained")
    axes = figure.subplots(len(runs), sharex=True, sharey=True, squeeze=False).ravel()
    for axis, (method, run) in zip(axes, runs.items(), strict=True):
        axis.axhline(wanted, color="black", lw=0.7, ls="--")
        rows = extremes(run.history["normal"])
        axis.plot(run.history["t"][rows], run.history["normal"][rows], lw=0.9,
                  color=COLOURS.get(method, "#2b8a3e"))
        axis.set_title(f"{in_words(method)}: {run.figures.rms:.2f} N RMS", loc="left", fontsize=9)
        axis.grid(alpha=0.25)
    highest = max(float(np.max(run.history["normal"])) for run in runs.values())
    axes[0].set_ylim(0.0, min(1.1 * highest, 3.0 * wanted))
    axes[-1].set_xlabel("t [s]")
    figure.supylabel("normal force [N]", fontsize=10)
    return figure


def _camera_story(result: ForceResult) -> str:
    """What the camera went through, and what was made of it."""
    scene = result.scene
    story = [f"The camera took {scene.camera.rate:g} fields a second."]
    for span, what in ((scene.trouble.loss, "showed nothing"), (scene.trouble.garbage, "reported garbage")):
        if len(span) == 2:
            story.append(f"It {what} from {span[0]:g} s to {span[1]:g} s after the beginning of the travel.")
    if reasons := result.log.why_left_out():
        story.append(f"Left out: {reasons}.")
    return " ".join(story)


def _run_figure(result: ForceResult) -> Figure:
    history, log = result.history, result.log
    figure = Figure(figsize=(9, 5.5), layout="constrained")
    top, bottom = figure.subplots(2, 1, sharex=True)
    rows = extremes(history["normal"])
    top.plot(history["t"][rows], history["normal"][rows], color=COLOURS["ideal"], lw=0.9, label="true")
    top.axhline(result.scene.force, color="black", lw=0.7, label="wanted")
    if travel := log.travel:
        top.axvspan(travel[0], travel[-1], color="#1f5fa8", alpha=0.07)
    top.set_ylim(0, min(3.2 * result.scene.force, 1.15 * max(result.figures.largest, 1.0)))
    top.set_ylabel("normal force [N]")
    # The legend stands above the picture, where it covers no curve.
    top.legend(frameon=False, ncols=2, loc="lower right", bbox_to_anchor=(1.0, 1.0))
    every = step(len(history["t"]))
    seconds = history["t"][::every]
    bottom.plot(seconds, 1e3 * history["height"][::every], color="black", lw=0.9, label="surface")
    bottom.plot(seconds, 1e3 * history["tip"][::every, 2], color=COLOURS["ideal"], lw=0.9, label="undeformed tip")
    bottom.set(xlabel="t [s]", ylabel="height over nominal plane [mm]")
    bottom.legend(frameon=False, ncols=2, loc="lower right", bbox_to_anchor=(1.0, 1.0))
    let_go(*history.values())
    for axis in (top, bottom):
        axis.grid(alpha=0.3)
    return figure


def _line_figure(result: ForceResult) -> Figure:
    figure = Figure(figsize=(9, 4.5), layout="constrained")
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    assert result.control_error is not None
    top.plot(result.control_error.t, 1e3 * result.control_error.lateral, color=COLOURS["ideal"], lw=0.9)
    top.set_ylabel("distance from the line [mm]")
    fields = result.log.fields
    bottom.plot([field[0] for field in fields], [field[1] for field in fields], ".", color="#1f5fa8")
    bottom.set(xlabel="t [s]", ylabel="points used")
    for axis in (top, bottom):
        axis.grid(alpha=0.3)
    return figure
