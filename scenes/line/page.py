"""Pages and replay of line-following runs: one run, or several methods compared."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pinocchio as pin
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from ideal_robot.arrays import Array
from ideal_robot.registry import in_words
from planning.path.reference import ReferencePath
from scenes.line.compare import LineComparison
from scenes.line.result import LineResult
from scenes.methods import DIRECT, SENSOR_PATH, WORDS
from scenes.online.log import FieldShown
from scenes.report.page import COLUMNS, Report, world_rows
from scenes.report.replay import Replay, enlarged_alike, sensed_force, sensed_line, shown_motion
from scenes.result import step
from scenes.scene_files.drawn_line import Geometry
from scenes.scene_files.scene import box_edges
from scenes.verdict import BAD, GOOD, Verdict
from sensing.camera.line_polynomial import Polyline
from sim.arm.body import picture

_MARGIN = 0.08
"""What is drawn of the surface beside the line [m]."""


def line_replay(result: LineResult) -> Replay | None:
    """The replay of a run; None where the recording is too short for one."""
    recording = result.recording
    if len(recording.t) < 2:
        return None
    robot = result.scene.arm
    rows, t, q, tool = shown_motion(robot, recording)
    drawn = result.geometry.drawn
    counted = result.control_error
    error = np.full(len(t), np.nan)
    if len(counted.t) > 1:
        error = np.abs(np.interp(t, counted.t, counted.lateral, left=np.nan, right=np.nan))
    curves = {"drawn line": drawn, "reference": result.geometry.reference, **box_edges(result.scene.box)}
    seen = sensed_line(robot, recording)
    if len(seen) > 1:
        curves["line as sensed"] = seen
    return Replay(robot, t, q, tool, nearest(result.geometry, tool), 1e3 * error, "distance from the line",
                  curves=curves, surface=surface_corners(result.geometry), force=sensed_force(robot, recording, rows),
                  pictures=tuple((frame.t, _png(frame)) for frame in result.shown))


def nearest(geometry: Geometry, points: Array) -> Array:
    """The drawn line's points nearest to points ``(N, 3)`` [m], both in the surface."""
    plane = geometry.plane
    up = plane.rotation[:, 2]
    # The height above the surface is not part of the following error.
    height = np.outer((points - plane.translation) @ up, up)
    return np.asarray(Polyline(geometry.drawn).nearest(points - height, up).foot + height)


def surface_corners(geometry: Geometry) -> Array:
    """Corners ``(4, 3)`` [m] of the part of the surface that the line lies on."""
    plane = geometry.plane
    reference = (geometry.reference - plane.translation) @ plane.rotation
    xy = np.vstack([geometry.drawn_xy, reference[:, :2]])
    (x0, y0), (x1, y1) = xy.min(axis=0) - _MARGIN, xy.max(axis=0) + _MARGIN
    corners = np.array([[x0, y0, 0.0], [x1, y0, 0.0], [x1, y1, 0.0], [x0, y1, 0.0]])
    return np.asarray(corners @ plane.rotation.T + plane.translation)


def _png(shown: FieldShown) -> bytes:
    """A camera picture with search windows, points and polynomial."""
    image = cv2.cvtColor(shown.image, cv2.COLOR_GRAY2BGR)
    for window in shown.field.windows:
        cv2.rectangle(image, (window.u, window.v), (window.u + window.width - 1, window.v + window.height - 1),
                      (189, 110, 10), 1)
    curve = shown.polynomial_pixels
    if len(curve):
        cv2.polylines(image, [np.rint(curve[np.isfinite(curve).all(axis=1)]).astype(np.int32).reshape(-1, 1, 2)], False,
                      (0, 106, 224), 1, cv2.LINE_AA)
    for pixel, used in zip(shown.pixels, shown.used, strict=True):
        if np.isfinite(pixel).all():
            cv2.drawMarker(image, (round(pixel[0]), round(pixel[1])), (30, 160, 30) if used else (40, 40, 220),
                           cv2.MARKER_CROSS, 9, 1)
    return bytes(cv2.imencode(".png", image)[1])


INK, SOFT, ACCENT, BLUE, GREEN = "#1c2430", "#8893a1", "#e06a00", "#0a6ebd", "#2b8a3e"
COLOURS = {"none": SOFT, "direct_feedback": BLUE, "sensor_path": GREEN, "ideal": ACCENT, "adapted": "#7d3c98",
           "ideal_points": "#000000"}
NAMED = {**WORDS, SENSOR_PATH: "the sensed path alone", DIRECT: "direct sensor feedback at its best gain"}
PAPER_MEAN_MM, PAPER_SPEED = 0.6, 0.7
"""[L] 5: mean control error at top speed."""


def run_page(result: LineResult, moving: Replay | None) -> Report:
    """The page of one run, with its replay where there is one."""
    scene, error = result.scene, result.control_error
    mm = error.json_mm()
    _, across, turn = result.geometry.displacement
    report = Report(
        f"{scene.title} at {scene.speed:g} m/s: {NAMED.get(result.method, in_words(result.method))}",
        f"The tool stayed {mm['mean']:.3f} mm from the line on average, 95 % of the way within {mm['p95']:.3f} mm.")
    if result.failure:
        report.warning(f"The run ended early: {result.failure}")
    if result.warning:
        report.warning(result.warning)
    report.figures([("mean distance from the line", f"{mm['mean']:.3f} mm"), ("95 % within", f"{mm['p95']:.3f} mm"),
                    ("largest", f"{mm['max']:.3f} mm")])
    report.next(*result.next_steps())
    if moving is not None:
        report.heading("The run")
        report.replay(moving, "Green to red: distance of the tool from the drawn line; the pale part is still to come.")
    report.heading("Errors", folded=True)
    report.text(f"The drawn line was moved {1e3 * abs(across):.1f} mm sideways and turned by "
                f"{np.degrees(abs(turn)):.2f}° from where the scene file puts it; pictures arrived "
                f"{1e3 * scene.camera.latency:.0f} ms late, and {result.fields_used} of {result.fields_seen} were "
                f"used{_why(result)}.")
    report.table(["", "mean mm", "95 % mm", "max mm", "speed m/s"],
                 [[f"this run ({result.method})", mm["mean"], mm["p95"], mm["max"], scene.speed],
                  ["[L] section 5, KUKA KR 6/1", PAPER_MEAN_MM, None, None, PAPER_SPEED]],
                 "Distance from the line, in the surface. [L] reports about 0.6 mm mean control error at 0.7 m/s.")
    _path_errors(report, result)
    if result.assumed:
        report.heading("What was assumed of the arm", folded=True)
        report.text("Its URDF does not say these, or says what no arm of that size has:")
        report.table(["assumed"], [[assumption] for assumption in result.assumed])
    report.heading("The cell", folded=True)
    report.image(_cell(result), "The arm at the middle of the path.")
    report.figure(_from_above(result), "The surface from above with the drawn line, the reference path and where the "
                  "tool truly went.")
    _camera(report, result)
    report.heading("Along the line", folded=True)
    report.figure(_along(result), "Above: deviation from the reference path of the drawn line, and what planning made "
                  "of the camera's fields. Below: signed distance of the true tool centre point from the drawn line "
                  "over its length; the grey part does not count (before 0.3 s after the line is first followed).")
    _timing(report, result)
    _settings(report, result)
    return report


def _why(result: LineResult) -> str:
    """Why the other pictures were not used, in words."""
    reasons = "; ".join(f"{count} × {reason}" for reason, count in result.left_out.items())
    return f". Left out: {reasons}" if reasons else ""


def _path_errors(report: Report, result: LineResult) -> None:
    """How far the tool was from the planned path, in the three ways of [G]."""
    if result.path_errors is None:
        return
    path = result.path_errors.json_mm()
    report.table(["path error against q_d", "E_car mm", "E_max mm"],
                 [[kind.replace("_", "-"), path[kind]["E_car"], path[kind]["E_max"]]
                  for kind in ("time_matched", "aligned", "geometric")],
                 "Another question than the distance from the line: how far the tool was from the planned path in "
                 "the base frame, in all three directions and from rest to rest ([G] (14), (21)). An arm that is "
                 "not where its kinematics say is off here and may still be on the line, because the camera sees "
                 f"both. Aligned: after a delay of {path['delay_ms']:.2f} ms is removed.")


def _camera(report: Report, result: LineResult) -> None:
    """What the camera saw, and what its calibration by moving found."""
    report.heading("What the camera saw", folded=True)
    if result.shown:
        report.figure(_fields(result.shown), "Camera fields along the way: search windows (blue), detected line "
                      "points (orange; grey: left out), and the polynomial through them (green). Inside the "
                      "windows stands what the detector got; the rest of each picture was drawn for this page, by the "
                      "same camera in the middle of the same exposure.")
    else:
        report.text("No field with a detected line was kept.")
    if result.hand_eye is not None:
        report.calibration(result.hand_eye)


def comparison_page(comparison: LineComparison) -> Report:
    """The page that compares the methods on one scene."""
    runs = comparison.runs
    shown = ", ".join(f"{1e3 * runs[method].control_error.mean:.3g} mm with {NAMED[method]}"
                      for method in ("adapted", "ideal", "sensor_path", "direct_feedback", "none") if method in runs)
    report = Report(f"{comparison.scene.title} at {comparison.scene.speed:g} m/s: methods compared",
                    f"Mean distance from the line: {shown}." if shown else "")
    report.next(*next(iter(runs.values())).next_steps()[1:])
    best = next((method for method in ("adapted", "ideal") if method in runs), None)
    others = [method for method in ("direct_feedback", "none") if method in runs][:1]
    if best is not None and others:
        _moving_beside(report, comparison, (*others, best))
    report.heading("All methods")
    columns, rows = comparison.table()
    report.table(columns, rows, "Distance of the true TCP from the line; path errors against the desired path [mm].")
    report.figure(_along_all(comparison), "Distance from the line along the line, one curve a method. The lower "
                  "picture leaves out those that need another scale.")
    if comparison.gains is not None and any(np.isfinite(trial.error) for trial in comparison.tried):
        report.heading("Direct sensor feedback: how much gain?", folded=True)
        report.text(
            f"x_c(k) = x_c(k-1) + K_p Δs(k) + K_d (Δs(k) - Δs(k-1)), [L] (1). A sideways step of 10 mm overshoots by "
            f"more than 5 % from K_p just above {comparison.overshoot_gain:.3g} per cycle on, because corrections are "
            f"repeated until the late camera sees their effect. The best gain on this scene, found by search, is "
            f"K_p = {comparison.gains[0]:.3g}, K_d = {comparison.gains[1]:.3g}.")
        report.figure(_gains(comparison), "Left: mean error on this scene over the gain. Right: overshoot over a "
                      "sideways step over the gain.")
    last = list(runs.values())[-1]
    _timing(report, last)
    _settings(report, last)
    return report


def _moving_beside(report: Report, comparison: LineComparison, methods: tuple[str, ...]) -> None:
    """The replays of two methods beside each other, errors enlarged alike."""
    replays = [line_replay(comparison.runs[method]) for method in methods]
    whole = [replay for replay in replays if replay is not None]
    if len(whole) == len(methods):
        titles = [f"{NAMED[m][:1].upper()}{NAMED[m][1:]}" for m in methods]
        report.heading(f"{titles[-1]}, and {NAMED[methods[0]]}")
        report.replays(list(zip(titles, enlarged_alike(whole), strict=True)),
                       "Green to red: distance of the tool from the drawn line, each up to its own largest; the scale "
                       "is beside the curve.")


def _timing(report: Report, result: LineResult) -> None:
    time = result.timing.json_ms()
    report.heading("Timing", folded=True)
    cycle = 1e3 * result.timing.simulated / max(len(result.timing.cycles), 1)
    fits = [Verdict("within the cycle", GOOD) if ms <= cycle else Verdict("longer than the cycle", BAD)
            for ms in (time["median"], time["p99"], time["max"], time["median_with_field"],
                       time["median_without_field"])]
    report.table(
        ["sensing + planning + feedforward", "ms", f"beside a cycle of {cycle:.0f} ms"],
        [["median of all cycles", time["median"], fits[0]], ["99 %", time["p99"], fits[1]],
         ["largest", time["max"], fits[2]], ["median of cycles with a new picture", time["median_with_field"], fits[3]],
         ["median of cycles without", time["median_without_field"], fits[4]]],
        "On this machine. Rendering and simulation are not part of it. "
        f"{result.timing.simulated:.2f} s were simulated in {result.timing.wall:.2f} s.")


def _settings(report: Report, result: LineResult) -> None:
    scene = result.scene
    report.heading("The world, as it was set", folded=True)
    report.text("Nothing of this is known to sensing, planning or the ideal robot.")
    report.table(COLUMNS, world_rows(result.world), folded="All settings of the simulated arm")
    for title, table in (("camera", scene.camera), ("calibration errors", scene.calibration),
                         ("displacement (sizes)", scene.displacement)):
        rows = [[key, _short(value)] for key, value in table.model_dump().items()]
        report.table([title, "value"], rows, folded=title.capitalize())


def _short(value: Any) -> Any:
    if isinstance(value, (list, tuple)):
        return ", ".join(f"{item:g}" if isinstance(item, (int, float)) else str(item) for item in value)
    return value if isinstance(value, (int, float, str)) else str(value)


def _in_plane(points: Array, plane: pin.SE3) -> Array:
    return np.asarray(((points - plane.translation) @ plane.rotation)[:, :2])


def _cell(result: LineResult) -> bytes:
    """A PNG of the arm at the middle of the path."""
    middle = len(result.recording.t) // 2
    q = result.recording.joints("q", slice(middle, middle + 1))[0]
    robot = result.scene.arm
    tip = robot.fk()(q)
    tool = np.array([tip.translation, tip.act(np.array([0.0, 0.0, -robot.tool_length]))])
    drawn = result.geometry.drawn[::10]  # every 5 mm, about two pixels
    image = picture(robot, q, lines=(drawn, tool, *box_edges(result.scene.box).values()),
                    surface=surface_corners(result.geometry))
    return bytes(cv2.imencode(".png", cv2.cvtColor(image, cv2.COLOR_RGB2BGR))[1])


def _from_above(result: LineResult) -> Figure:
    figure = Figure(figsize=(11, 2.8))
    axes = figure.subplots()
    plane = result.geometry.plane
    drawn, reference = (1e3 * _in_plane(points, plane) for points in (result.geometry.drawn, result.geometry.reference))
    axes.plot(*reference.T, "--", color=BLUE, lw=1.2, label="reference path x_r")
    axes.plot(*drawn.T, color=INK, lw=3.5, alpha=0.75, label="drawn line")
    every = step(len(result.recording.t))
    if all(name in result.recording.columns for name in "xyz"):
        tcp = np.column_stack([result.recording.columns[name][::every] for name in "xyz"])
    else:
        tcp = result.scene.arm.tool_places(result.recording.joints("q", slice(None, None, 5 * every)))
    axes.plot(*(1e3 * _in_plane(tcp, plane)).T, color=ACCENT, lw=1.3, label="tool centre point")
    axes.set(xlabel="x in the surface [mm]", ylabel="y [mm]", aspect="equal")
    axes.margins(y=0.25)
    axes.legend(frameon=False, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.02))
    return _laid_out(figure)


def _fields(shown: tuple[FieldShown, ...]) -> Figure:
    figure = Figure(figsize=(11, 2.6 if len(shown) > 2 else 4))
    for axes, frame in zip(np.atleast_1d(figure.subplots(1, len(shown))), shown, strict=True):
        height, width = frame.image.shape
        axes.imshow(frame.image, cmap="gray", vmin=0, vmax=255)
        for u, v, w, h in frame.field.windows:
            axes.add_patch(Rectangle((u - 0.5, v - 0.5), w, h, fill=False, color=BLUE, lw=0.9))
        axes.plot(*frame.polynomial_pixels.T, color=GREEN, lw=1.0)
        axes.plot(*frame.pixels[~frame.used].T, "x", color=SOFT, ms=6)
        axes.plot(*frame.pixels[frame.used].T, "o", color=ACCENT, ms=4)
        axes.set(xlim=(0, width), ylim=(height, 0), title=f"t = {frame.t:.2f} s")
        axes.set_axis_off()
    figure.tight_layout()
    return figure


def _along(result: LineResult) -> Figure:
    figure = Figure(figsize=(11, 6))
    above, axes = figure.subplots(2, 1)
    plane = result.geometry.plane
    reference = ReferencePath(result.geometry.reference, up=plane.rotation[:, 2], turning=1.0)
    drawn = result.geometry.drawn[::10]
    true = np.array([reference.project(point[None], start) for point, start in
                     zip(drawn, result.scene.reference.run_up + 0.005 * np.arange(len(drawn)), strict=True)])[:, :2, 0]
    above.plot(1e3 * true[:, 0], 1e3 * true[:, 1], color=INK, lw=3.5, alpha=0.6, label="drawn line")
    every = step(len(result.s_reference))
    above.plot(1e3 * result.s_reference[::every], 1e3 * result.believed[::every], color=ACCENT, lw=1.3,
               label="desired path x_d")
    above.plot(1e3 * result.s_reference[::every], 1e3 * result.looked_back[::every], color=GREEN, lw=1.0, ls=":",
               label="line as all fields show it")
    above.axhline(0, color=BLUE, lw=1.0, ls="--", label="reference path x_r")
    above.set(xlabel="along the reference path [mm]", ylabel="deviation Δx_r [mm]")
    above.legend(frameon=False, ncols=4)
    whole, error = result.control_error_from_start, result.control_error
    axes.axhline(0, color=INK, lw=0.8)
    axes.plot(1e3 * whole.s, 1e3 * whole.lateral, color=SOFT, lw=1.2, label="while the line is being found")
    axes.plot(1e3 * error.s, 1e3 * error.lateral, color=ACCENT, lw=1.5, label="counts")
    limit = 3.0 * max(1e3 * error.p95, 0.1) if len(error.s) else 5.0
    axes.set(xlabel="along the line [mm]", ylabel="distance to the left [mm]", ylim=(-limit, limit))
    axes.legend(frameon=False, ncols=2)
    return _laid_out(figure)


def _along_all(comparison: LineComparison) -> Figure:
    figure = Figure(figsize=(11, 5.6))
    upper, lower = figure.subplots(2, 1, sharex=True)
    best = min(run.control_error.p95 for run in comparison.runs.values())
    for method, run in comparison.runs.items():
        whole = run.control_error_from_start
        (colour,) = upper.plot(1e3 * whole.s, 1e3 * whole.lateral, color=COLOURS.get(method),
                               label=in_words(method))
        if run.control_error.p95 < 12 * best:
            lower.plot(1e3 * run.control_error.s, 1e3 * run.control_error.lateral, color=colour.get_color())
    for axes in (upper, lower):
        axes.axhline(0, color=INK, lw=0.8)
        axes.set_ylabel("distance to the left [mm]")
    upper.legend(frameon=False, ncols=4)
    lower.set_xlabel("along the line [mm]")
    return _laid_out(figure)


def _gains(comparison: LineComparison) -> Figure:
    figure = Figure(figsize=(11, 3.4))
    left, right = figure.subplots(1, 2)
    good = [trial for trial in comparison.tried if np.isfinite(trial.error)]
    tried = sorted((trial.k_p, 1e3 * trial.error) for trial in good if trial.k_d == 0.0)
    left.semilogx(*np.array(tried).T, "o-", color=BLUE, label="direct feedback, K_d = 0")
    with_d = [(trial.k_p, 1e3 * trial.error) for trial in good if trial.k_d > 0.0]
    if with_d:
        left.semilogx(*np.array(with_d).T, "s", color=GREEN, label="with K_d")
    if "ideal" in comparison.runs:
        left.axhline(1e3 * comparison.runs["ideal"].control_error.mean, color=ACCENT, label="ideal robot")
    left.set(xlabel="K_p per cycle", ylabel="mean error [mm]", ylim=(0, None))
    left.legend(frameon=False)
    right.semilogx(*np.array([(k, 100 * o) for k, o in comparison.overshoots]).T, "o-", color=BLUE)
    right.axhline(5, color=INK, lw=0.8, ls="--")
    right.set(xlabel="K_p per cycle", ylabel="overshoot [%]")
    return _laid_out(figure)


def _laid_out(figure: Figure) -> Figure:
    """The figure with a grid in each of its axes."""
    for axes in figure.axes:
        axes.grid(alpha=0.25)
    figure.tight_layout()
    return figure
