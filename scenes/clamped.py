"""Scenes of kind ``clamped``: the flange is clamped, the motors push, and stiffness is identified ([J] 4)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from ideal_robot.arrays import Array
from ideal_robot.elasticity.clamped_signals import ClampedSignals
from ideal_robot.elasticity.configurations import ClampLimits, choose_configurations
from ideal_robot.elasticity.stiffness import JointStiffness, Method, joint_torque
from ideal_robot.elasticity.stiffness_analysis import CLAMPED_METHODS, StiffnessAnalysis, analyse_stiffness
from ideal_robot.errors import InputError
from ideal_robot.results import plain
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from scenes.arms import arm_of
from scenes.kind import SceneKind
from scenes.methods import method_of
from scenes.outputs import whole_folder
from scenes.report.page import Report
from scenes.result import Progress, ShownRun, silent
from scenes.scene_files.clamped_scene import ClampedScene
from sim.contact.clamp import ClampedArm, ClampTruth, hang_payloads
from sim.contact.clamp_world import ClampWorld

SHARES = (0.5, 1.0, 0.5, 0.0, -0.5, -1.0, -0.5, 0.0)
"""Levels of a motor's shift as shares of the largest allowed one; each from both sides, so that friction cancels."""


def configurations(scene: ClampedScene, robot: Robot, rng: np.random.Generator) -> Array:
    """The scene's clamped configurations, or optimised ones, ``(c, n)`` [rad].

    Args:
        scene: the scene; its own configurations come first [rad].
        robot: the arm, with its limits.
        rng: draws the candidates that configurations are chosen from.
    """
    if scene.clamp.configurations:
        angles = np.array(scene.clamp.configurations)
        if angles.ndim != 2 or angles.shape[1] != robot.n:
            raise InputError(f"expected lists of {robot.n} joint angles", field="clamp.configurations")
        return angles
    return choose_configurations(robot, ClampLimits.of(robot), rng, most=scene.clamp.most).q


def record(scene: ClampedScene, robot: Robot, world: ClampWorld, postures: Array, rng: np.random.Generator
           ) -> tuple[list[Recording], list[ClampTruth]]:
    """Simulates the pushes in every posture, and the payloads where the scene has them.

    Args:
        scene, robot: the scene, and the arm.
        world: gears, clamp and drives as they are.
        postures: joint angles in which the flange is clamped ``(c, n)`` [rad].
        rng: draws noise and drive gains.
    """
    table, limits = scene.clamp, ClampLimits.of(robot)
    gain_seed = int(rng.integers(2**31))
    recordings, truths = [], []
    for number, posture in enumerate(postures):
        arm = ClampedArm(robot, world, posture)
        if table.push == "tool_z":
            up = np.array(table.forces)
            pushes, approach = [arm.press(np.concatenate([up, up[-2::-1]]), rng)], 0.005
        else:
            pushes, approach = [arm.guarded(axis, np.array(SHARES), torque=limits.torque_share * robot.tau_max,
                                            force=limits.force, moment=limits.moment) for axis in np.eye(robot.n)], 0.0
        recording, truth = arm.play(pushes, rng, gain_rng=np.random.default_rng(gain_seed), hold=table.hold,
                                    components=table.components, approach=approach)
        recordings.append(Recording(recording.columns, recording.meta, f"configuration {number + 1}"))
        truths.append(truth)
    if table.payloads:
        lever = np.array([0.2, 0.1, -0.1])
        recordings.append(hang_payloads(robot, world, postures, np.array([0.0, *table.payloads]), lever, rng))
    return recordings, truths


@dataclass(frozen=True, repr=False)
class ClampedResult(ShownRun):
    """The recordings and the analysis of one clamped scene."""

    scene: ClampedScene
    analysis: StiffnessAnalysis
    truths: tuple[ClampTruth, ...]
    recordings: tuple[Path, ...]
    chosen: Array
    report: Path | None
    failure: str | None = None

    def errors(self) -> list[dict[str, Any]]:
        """Error of each result against the simulated truth, and the share of the wrong drive gain in it [%]."""
        rows = []
        for result in self.analysis.joints:
            truth = float(self.truths[0].stiffness[result.joint - 1])
            # Torque by the data sheet's gain is the true torque divided by the true gain's factor.
            gain = 100 * (float(np.mean([1 / t.gain_factor[result.joint - 1] for t in self.truths])) - 1)
            rows.append({"joint": result.joint, "method": result.method, "truth": truth,
                         "error_percent": 100 * (result.stiffness / truth - 1),
                         "from_drive_gain_percent": gain if result.method == "motor" else 0.0,
                         "covered": result.interval[0] <= truth <= result.interval[1]})
        return rows

    def json(self) -> dict[str, Any]:
        """The content of ``--json``."""
        return plain({
            "scene": self.scene.name, "seed": self.scene.seed, **self.analysis.to_dict(),
            "against_truth": self.errors(),
            "configurations": self.chosen, "recording": next(iter(self.recordings), None),
            "recording_files": list(self.recordings),
            "report": self.report})

    def plot(self) -> Figure:
        """Stiffness of each joint with its interval."""
        return self.analysis.plot()

    def summary(self) -> list[tuple[str, str]]:
        """Joint and method with stiffness, %σ and error."""
        return [(f"joint {result.joint}, {result.method}",
                 f"{result.stiffness:.4g} N m/rad, %σ {result.std_percent:.2f}, error {error['error_percent']:+.2f} %")
                for result, error in zip(self.analysis.joints, self.errors(), strict=True)]

    def table(self) -> tuple[list[str], list[list[Any]]]:
        """The results as a table: titles, and one row per joint and method."""
        return (["joint", "method", "k [N m/rad]", "%σ", "error [%]"],
                [[result.joint, result.method, result.stiffness, result.std_percent, error["error_percent"]]
                 for result, error in zip(self.analysis.joints, self.errors(), strict=True)])


# The page of a stiffness identification: [J] figures 3 to 5 and tables 3 to 7.

ORANGE, BLUE, GREY = "#e06000", "#1f5fa8", "#808080"


def stiffness_page(analysis: StiffnessAnalysis, *, title: str, truth: Array | None = None) -> Report:
    """The page of a stiffness analysis.

    Args:
        analysis, title: the analysis to show, and the page's title.
        truth: true stiffness ``(n,)`` [N m/rad], for the comparison that only a simulation allows.
    """
    report = Report(title, _summary(analysis, truth))
    for warning in analysis.warnings:
        report.warning(warning)
    report.next(("See what stiffness from such recordings brings on a path.", "ideal-robot close-loop close_clamped"))
    report.heading("Stiffness")
    columns = ["joint", "method", "k [N m/rad]", "offset [N m]", "%σ", "%σ offset", "‖Wχ−Y‖/‖Y‖ [%]", "95 % interval"]
    rows = []
    for fit in analysis.joints:
        row = [fit.joint, fit.method, fit.stiffness, fit.offset, fit.std_percent, fit.offset_std_percent,
               fit.relative_error_percent, f"{fit.interval[0]:.3g} … {fit.interval[1]:.3g}"]
        if truth is not None:
            row += [float(truth[fit.joint - 1]), 100 * (fit.stiffness / float(truth[fit.joint - 1]) - 1)]
        rows.append(row)
    report.table(columns + (["truth", "error [%]"] if truth is not None else []), rows,
                 "%σ after [J] (15)–(17) holds for white residuals; the interval allows for correlated ones, for the "
                 "tolerance of drive gains and sensor, and for elasticity that is not the gear's.")
    if analysis.clamp_estimated:
        report.text("The give of the clamp and the bending of the links were estimated from the wrench and taken away "
                    "from the motor angles: they move all joints together, a gear only its own.")
    differences = analysis.differences()
    if differences:
        report.table(["joint", "motor against wrench [%]"],
                     [[difference["joint"], difference["difference_percent"]] for difference in differences],
                     "[J] table 7. The motor method takes its torques from the data sheet's drive gains; an error of "
                     "the gain goes into the stiffness in full.")
    report.heading("Recordings")
    for signals in analysis.signals[:6]:
        report.figure(_time_figure(signals, analysis.robot), f"{Path(signals.source).name}: motor angle, torques and "
                      "wrench over time, on one clock ([J] figure 3).")
    for method in CLAMPED_METHODS:
        results = analysis.by(method)
        if results:
            number = 4 if method == "motor" else 5
            report.figure(_line_figure(analysis.signals, analysis.robot, method, list(results.values())),
                          f"Torque over motor angle with the identified lines, method {method} ([J] figure {number}).")
    return report


def _summary(analysis: StiffnessAnalysis, truth: Array | None) -> str:
    methods = sorted({result.method for result in analysis.joints})
    found = "; ".join(f"joint {joint} " + ", ".join(f"{fit.stiffness:.3g} N m/rad ({fit.method})"
                                                     for fit in analysis.joints if fit.joint == joint)
                      for joint in sorted({result.joint for result in analysis.joints}))
    text = f"Stiffness of {analysis.robot.name}: {found}."
    if truth is not None:
        worst = {m: max(abs(100 * (fit.stiffness / truth[fit.joint - 1] - 1)) for fit in analysis.by(m).values())
                 for m in methods}
        errors = ", ".join(f"{method} {error:.1f} %" for method, error in worst.items())
        text += f" Largest error against the simulated truth: {errors}."
    return text


def _time_figure(signals: ClampedSignals, robot: Robot) -> Figure:
    load = signals.wrench if signals.wrench is not None else signals.tau
    tau = signals.tau if signals.tau is not None else joint_torque(signals, robot, "wrench")[0]
    assert load is not None
    joint = int(np.argmax(np.ptp(tau[signals.clamped], axis=0)))
    figure = Figure(figsize=(9, 6.2), layout="constrained")
    axes = figure.subplots(3, 1, sharex=True)
    axes[0].plot(signals.t, 1e3 * (signals.q_m[:, joint] - signals.q_0[joint]), color=BLUE)
    axes[0].set_ylabel(f"q_m{joint + 1} − q_0 [mrad]")
    if signals.tau is not None:
        axes[1].plot(signals.t, signals.tau[:, joint] / 1e3, color=BLUE, label="motor")
    if signals.wrench is not None:
        external = joint_torque(signals, robot, "wrench")[0][:, joint]
        axes[1].plot(signals.t, external / 1e3, color=ORANGE, label="external, JᵀF")
        for i, (name, colour) in enumerate(zip(("fx", "fy", "fz"), (GREY, BLUE, ORANGE), strict=True)):
            if name in signals.measured:
                axes[2].plot(signals.t, signals.wrench[:, i] / 1e3, color=colour, label=name)
        axes[2].legend(frameon=False, ncols=3, loc="lower right", bbox_to_anchor=(1.0, 1.0))
    axes[1].set_ylabel(f"τ_{joint + 1} [kN m]")
    axes[1].legend(frameon=False, ncols=2, loc="lower right", bbox_to_anchor=(1.0, 1.0))
    axes[2].set(xlabel="t [s]", ylabel="force [kN]")
    for axis in axes:
        axis.grid(alpha=0.3)
    return figure


def _line_figure(signals: tuple[ClampedSignals, ...], robot: Robot, method: Method,
                 results: list[JointStiffness]) -> Figure:
    columns = min(3, len(results))
    rows = -(-len(results) // columns)
    figure = Figure(figsize=(3.6 * columns + 1, 3.0 * rows), layout="constrained")
    for axis, result in zip(np.ravel(figure.subplots(rows, columns, squeeze=False)), results, strict=False):
        j = result.joint - 1
        for recording in signals:
            if recording.source not in result.recordings:
                continue
            try:
                tau, use = joint_torque(recording, robot, method)
            except InputError:
                continue
            # Offsets differ from recording to recording; the slope is common.
            x, y = recording.q_m[use, j] - recording.q_m[use, j].mean(), tau[use, j] - tau[use, j].mean()
            axis.plot(1e3 * x, y / 1e3, "o", ms=3, mfc="none", color=BLUE, alpha=0.5)
            ends = np.array([x.min(), x.max()])
            axis.plot(1e3 * ends, result.stiffness * ends / 1e3, color=ORANGE)
        axis.set_title(f"joint {result.joint}: k = {result.stiffness:.3g} N m/rad, %σ = {result.std_percent:.2g}",
                       fontsize=9)
        axis.set(xlabel="q_m − mean [mrad]", ylabel="τ − mean [kN m]")
        axis.grid(alpha=0.3)
    return figure


# The functions of the kind ``clamped``: clamp, push, record and identify, by one method or both.

METHODS = ("motor", "wrench", "both")


def run(scene: ClampedScene, *, method: Any = None, out: Path | None = None,
        progress: Progress = silent) -> ClampedResult:
    """Clamps, pushes, records and identifies, by ``motor``, ``wrench`` or ``both`` (default); see ``Play.__call__``."""
    chosen = method_of(method or "both", METHODS).key
    robot = arm_of(scene.robot)
    world = ClampWorld.from_table(robot, scene.arm_world, scene.source)
    rng = np.random.default_rng(scene.seed)
    progress(0.05, "choosing configurations")
    postures = configurations(scene, robot, rng)
    recordings, truths = record(scene, robot, world, postures, rng)
    progress(0.4, "identifying")
    analysis = analyse_stiffness(recordings, robot, chosen)
    progress(0.7, "drawing")
    files: tuple[Path, ...] = ()
    page = None
    if out is not None:
        names = ["recording.parquet", *(f"recording_{i}.parquet" for i in range(2, len(recordings) + 1))]
        with whole_folder(out) as new:
            for recording, name in zip(recordings, names, strict=True):
                recording.write(new / name)
            stiffness_page(analysis, title=scene.title, truth=world.stiffness).write(new / "report.html")
        files, page = tuple(out / name for name in names), out / "report.html"
    return ClampedResult(scene, analysis, tuple(truths), files, postures, page)


def compare(scene: ClampedScene, *, methods: Sequence[Any] | None = None, out: Path | None = None,
            progress: Progress = silent) -> ClampedResult:
    """Compares the methods, and payloads where the scene has them; see ``Compare.__call__``."""
    return run(scene, method=methods[0] if methods and len(methods) == 1 else "both", out=out, progress=progress)


CLAMPED = SceneKind(ClampedScene, lambda: METHODS, run, compare)
