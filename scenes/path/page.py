"""The pages of path scenes: one method, and all methods compared."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ideal_robot.arrays import interpolated
from scenes.arms import arm_of
from scenes.methods import DELAY, WORDS
from scenes.path.cell import PathResult, path_methods
from scenes.path.compare import PathComparison
from scenes.report.page import COLUMNS, Report, world_rows
from scenes.report.replay import Replay, enlarged_alike
from scenes.scene_files.scene import box_edges


def path_replay(result: PathResult) -> Replay | None:
    """The replay of a run; None where it is too short for one."""
    path, played = result.path, result.played
    if len(path.t) < 2:
        return None
    robot = arm_of(result.scene.robot)
    q = played.q_a[: len(path.t)]
    t = path.t[: len(q)]
    # The desired position of a cycle is to be reached at its time stamp, so it is interpolated.
    tool = interpolated(t, played.t, played.tcp)
    counts = path.counts[: len(q)]
    error = np.where(counts, np.linalg.norm(tool - path.x_d[: len(q)], axis=1), np.nan)
    return Replay(robot, t, q, tool, path.x_d[: len(q)], 1e3 * error, "distance from the path at the time",
                  curves={"desired path": path.x_d, **box_edges(result.scene.box)})


INK, SOFT = "#1c2430", "#8893a1"
COLOURS = {"none": SOFT, "linear": "#6b4fa0", "trained": "#b8860b", "precorrected-printed": "#7fb2dd",
           "precorrected": "#0a6ebd", "learned-model": "#2b8a3e", "learned": "#c2255c", "ideal": "#e06a00",
           "adapted": "#1c2430"}
"""Colours of the methods on every page."""
DRAWN = ("none", "trained", "precorrected-printed", "precorrected", "learned", "ideal")
"""Methods whose deviation over time is drawn; the rest stand in the table."""
TRACED = ("none", "precorrected-printed", "precorrected", "ideal")
"""Methods whose path is drawn."""
_MOVING = "Green to red: how far the tool is from where it should be at the time; the pale part is still to come."
MAGNIFIED = 50
"""Factor on deviations in pictures of paths."""
_KINDS = ("Time-matched: against the desired position at the same instant. Aligned: after removing one constant delay. "
          "Geometric: distance to the path.")
DEFINITION = (
    f"{_KINDS} 'Less %' is the reduction against no correction without delay, of the weaker of "
    "time-matched and aligned; 'motors' E_car less %' is that of the aligned E_car that motor angles show, which is "
    "what the paper could measure: elastic gears are invisible to it.")
_SHORT = ("E_car is a root mean square, E_max the largest deviation of the tool; aligned: one constant delay removed. "
          "E_car less: against no correction. The motors' errors are those that motor angles show, which is what the "
          "paper measured: they do not see what elastic gears do to the tool, and a correction for the tool can make "
          "them larger.")


def run_page(result: PathResult, moving: Replay | None) -> Report:
    """The page of one run, with its replay where there is one."""
    e = result.errors
    report = Report(f"{result.scene.title}: {WORDS.get(result.method, result.method)}",
                    f"The tool was {1e3 * e.time_matched.E_car:.3f} mm from where it should have been at the time "
                    f"(root mean square), at most {1e3 * e.time_matched.E_max:.3f} mm.")
    report.figures([*result.summary()[2:]])
    report.text(f"E_car is a root mean square, E_max the largest deviation of the tool. {_KINDS}")
    report.next(*result.next_steps())
    if moving is not None:
        report.heading("The run")
        report.replay(moving, _MOVING)
    report.heading("Path and deviation", folded=True)
    report.figure(path_figure([result]), f"The path, deviations drawn {MAGNIFIED} times their size.")
    report.figure(deviation_figure([result], "time_matched"), "Deviation over time.")
    report.heading("World", folded=True)
    report.table(COLUMNS, world_rows(result.world), folded="All settings of the simulated world")
    return report


def comparison_page(comparison: PathComparison) -> Report:
    """The page of all methods on one path."""
    scene, runs = comparison.scene, comparison.runs
    none = comparison.reference.errors
    first = next(iter(runs)) if "none" not in runs else "no correction"
    summary = ("Root mean square of the distance from the path, one delay removed: "
               f"{1e3 * none.aligned.E_car:.3g} mm with {first}")
    if "ideal" in runs:
        summary += (f", {1e3 * runs['ideal'].errors.aligned.E_car:.3g} mm with the ideal robot, which learned nothing "
                    "on it")
    report = Report(f"{scene.title}: several methods", f"{summary}.")
    report.next(*comparison.reference.next_steps()[1:])
    played = [path_replay(runs[method]) for method in ("none", "ideal") if method in runs]
    moving = [replay for replay in played if replay is not None]
    if len(moving) == 2:
        report.heading("The ideal robot, and without correction")
        titles = ("Without correction", "The ideal robot")
        report.replays(list(zip(titles, enlarged_alike(moving), strict=True)), _MOVING)
    report.heading("Errors of all methods")
    columns, rows = comparison.table()
    late = [row for row in rows if str(row[0]).endswith(DELAY)]
    report.table(columns, [row for row in rows if row not in late], _SHORT)
    columns, rows = comparison.full_table()
    report.table(columns, rows, f"{DEFINITION} Paper: {scene.paper.source}.",
                 folded="All errors and reductions, also with the standard path planner's delay in force")
    report.figure(path_figure(_chosen(runs, TRACED, "")),
                  f"The path, deviations drawn {MAGNIFIED} times their size, aligned.")
    for suffix, text in (("", "Aligned deviation over time, without the planner's delay."),
                         (DELAY, "The same with the standard path planner's delay in force.")):
        if shown := _chosen(runs, DRAWN, suffix):
            report.figure(deviation_figure(shown, "aligned"), text)
    if comparison.learning_criterion:
        report.figure(learning_figure(comparison), "What learning saw, play by play.")
    report.heading("World", folded=True)
    report.text("The model is identified from recordings of this world; nothing is read from the world itself.")
    report.table(COLUMNS, world_rows(comparison.reference.world), folded="All settings of the simulated world")
    return report


def _chosen(runs: dict[str, PathResult], methods: tuple[str, ...], suffix: str) -> list[PathResult]:
    """Those of the methods that were played, and all of the user's own; all where none of them was."""
    own = [key for key in runs if key not in path_methods() and not suffix]
    results = [runs[key] for key in (*(method + suffix for method in methods), *own) if key in runs]
    return results or ([] if suffix else list(runs.values()))


def path_figure(results: list[PathResult]) -> Figure:
    """Desired path and magnified deviations in the plane of the path."""
    # Small enough for its letters to be read on a phone's width.
    figure = Figure(figsize=(4.6, 4.8), layout="constrained")
    axes = figure.add_subplot()
    path = results[0].path
    x_d, t = path.x_d[path.counts], path.t[path.counts]
    centre = x_d.mean(axis=0)
    # The plane of the path, seen from the robot: right, and up or ahead.
    normal = np.linalg.svd(x_d - centre, full_matrices=False)[2][2]
    normal *= np.sign(normal[2]) if abs(normal[2]) > 1e-6 else -np.sign(normal[0])
    right = np.array([0.0, -1.0, 0.0]) + normal * normal[1]
    plane = np.array([right, np.cross(normal, right)]) / np.linalg.norm(right)
    flat = (x_d - centre) @ plane.T
    axes.plot(*(1e3 * flat.T), color=INK, lw=2.5, alpha=0.35, label="desired")
    for result in results:
        actual = interpolated(t + result.errors.delay, result.played.t, result.played.tcp)
        drawn = flat + MAGNIFIED * (actual - x_d) @ plane.T
        axes.plot(*(1e3 * drawn.T), color=_colour(result), lw=1, label=result.method)
    axes.set_aspect("equal")
    axes.set(xlabel="in the plane of the path, to the right [mm]", ylabel="across [mm]")
    axes.legend(fontsize=9, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, frameon=False)
    _plain(axes)
    return figure


def deviation_figure(results: list[PathResult], kind: str) -> Figure:
    """Deviation over time of several methods, like [G] Figs 9 and 18."""
    figure = Figure(figsize=(9.0, 3.6))
    axes = figure.add_subplot()
    for result in results:
        path = result.path
        t = path.t[path.counts]
        deviation = 1e3 * getattr(result.errors, kind).deviation
        axes.semilogy(t - t[0], np.maximum(deviation, 1e-3), color=_colour(result), lw=1.1, label=result.method)
    axes.set(xlabel="time [s]", ylabel="deviation [mm]")
    axes.set_ylim(bottom=5e-3)
    axes.yaxis.set_major_formatter("{x:g}")
    axes.legend(fontsize=9, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, frameon=False)
    _plain(axes)
    return figure


def learning_figure(comparison: PathComparison) -> Figure:
    """Figure of the error of each learning run, beside those of the model-based methods."""
    figure = Figure(figsize=(4.6, 3.2))
    axes = figure.add_subplot()
    plays = ["none", *(f"learned-{p}" for p in range(1, 4)), "learned"]
    values = [1e3 * comparison.runs[method].errors.time_matched.E_car for method in plays if method in comparison.runs]
    axes.semilogy(range(len(values)), values, "o-", color=COLOURS["learned"], label="learning on the arm")
    axes.yaxis.set_major_formatter("{x:g}")
    for method in (key for key in ("precorrected", "learned-model", "ideal") if key in comparison.runs):
        axes.axhline(1e3 * comparison.runs[method].errors.time_matched.E_car, color=COLOURS[method], lw=1, ls="--",
                     label=method)
    axes.set_xticks(range(len(values)))
    axes.set(xlabel="learning steps on the arm", ylabel="E_car, time-matched [mm]")
    axes.legend(fontsize=9, frameon=False)
    _plain(axes)
    return figure


def _colour(result: PathResult) -> str:
    return COLOURS.get(result.method.removesuffix(DELAY), INK)


def _plain(axes: Axes) -> None:
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=9)
