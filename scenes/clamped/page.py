"""The pictures and the page of a stiffness identification: [J] figures 3 to 5 and tables 3 to 7."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from ideal_robot.arrays import Array
from ideal_robot.elasticity.clamped_signals import ClampedSignals
from ideal_robot.elasticity.stiffness import JointStiffness, Method, joint_torque
from ideal_robot.elasticity.stiffness_analysis import CLAMPED_METHODS, StiffnessAnalysis
from ideal_robot.errors import InputError
from ideal_robot.robots.robot import Robot
from scenes.report.page import Report

ORANGE, BLUE, GREY = "#e06000", "#1f5fa8", "#808080"


def stiffness_page(analysis: StiffnessAnalysis, *, title: str, truth: Array | None = None) -> Report:
    """The page.

    Args:
        analysis: what is shown.
        title: of the page.
        truth: true stiffness ``(n,)`` [N m/rad], for the comparison that only a simulation allows.
    """
    report = Report(title, _summary(analysis, truth))
    for warning in analysis.warnings:
        report.warning(warning)
    report.heading("Stiffness")
    columns = ["joint", "method", "k [N m/rad]", "offset [N m]", "%σ", "%σ offset", "‖Wχ−Y‖/‖Y‖ [%]", "95 % interval"]
    rows = []
    for one in analysis.joints:
        row = [one.joint, one.method, one.stiffness, one.offset, one.std_percent, one.offset_std_percent,
               one.relative_error_percent, f"{one.interval[0]:.3g} … {one.interval[1]:.3g}"]
        if truth is not None:
            row += [float(truth[one.joint - 1]), 100 * (one.stiffness / float(truth[one.joint - 1]) - 1)]
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
                     [[one["joint"], one["difference_percent"]] for one in differences],
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
    methods = sorted({one.method for one in analysis.joints})
    joints = ", ".join(str(joint) for joint in sorted({one.joint for one in analysis.joints}))
    text = f"{analysis.robot.name}: stiffness of joint {joints} by {', '.join(methods)}."
    if truth is not None:
        worst = {m: max(abs(100 * (one.stiffness / truth[one.joint - 1] - 1)) for one in analysis.by(m).values())
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
        axes[2].legend(loc="upper right")
    axes[1].set_ylabel(f"τ_{joint + 1} [kN m]")
    axes[1].legend(loc="upper right")
    axes[2].set_ylabel("force [kN]")
    axes[2].set_xlabel("t [s]")
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
        for one in signals:
            if one.source not in result.recordings:
                continue
            try:
                tau, use = joint_torque(one, robot, method)
            except InputError:
                continue
            # Offsets differ from recording to recording; the slope is what they share.
            x, y = one.q_m[use, j] - one.q_m[use, j].mean(), tau[use, j] - tau[use, j].mean()
            axis.plot(1e3 * x, y / 1e3, "o", ms=3, mfc="none", color=BLUE, alpha=0.5)
            ends = np.array([x.min(), x.max()])
            axis.plot(1e3 * ends, result.stiffness * ends / 1e3, color=ORANGE)
        axis.set_title(f"joint {result.joint}: k = {result.stiffness:.3g} N m/rad, %σ = {result.std_percent:.2g}",
                       fontsize=9)
        axis.set_xlabel("q_m − mean [mrad]")
        axis.set_ylabel("τ − mean [kN m]")
        axis.grid(alpha=0.3)
    return figure
