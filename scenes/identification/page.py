"""The report page of an identification."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ideal_robot.dynamics.base_parameters import link_labels
from ideal_robot.identification.angles_alone import CommandIdentification
from ideal_robot.identification.controller import ControllerIdentification
from ideal_robot.identification.linear_loop_fit import LinearLoopFit
from ideal_robot.identification.two_step import TwoStep
from ideal_robot.identification.whole_model import IdentificationResult, command_figures, friction_points
from ideal_robot.model.cascade import beside_cascade
from ideal_robot.model.model import Model
from ideal_robot.model.parametrisation import Prediction, joined
from ideal_robot.results import one_unit
from ideal_robot.signals.channels import segments
from ideal_robot.signals.preprocess import preprocess
from ideal_robot.signals.recording import short_names
from scenes.report.call import UNKNOWN, Call
from scenes.report.page import Report
from scenes.verdict import Verdict

MEASURED, PREDICTED, RESIDUAL = "#5b6675", "#e06a00", "#2a6fb0"


def identification_page(analysis: IdentificationResult, call: Call = UNKNOWN, kept: str = "") -> Report:
    """The page of an identification: quality of the model, next steps, and its content folded.

    Args:
        analysis: the identified model.
        call: the first recording and the robot, for the commands of the next steps.
        kept: file of the model; empty where it was not written.
    """
    model, result = analysis.model, analysis.result
    predictions = result.validation if analysis.validation else result.estimation
    errors = joined(predictions).residual_std_percent
    data = "a motion that it was not fitted to" if analysis.validation else "the motion that it was fitted to"
    page = Report(f"Dynamic model of {model.arm.name}",
                  f"The residual is {np.nanmin(errors):.1f} to {np.nanmax(errors):.1f} % of each joint's torque, "
                  f"on {data} (standard deviations).")
    _verdicts(page, analysis)
    page.next(*_next_steps(analysis, call, kept))
    for warning in analysis.warnings:
        page.warning(warning)
    page.heading("Measured and predicted torque")
    shown = [("unseen", *pair) for pair in zip(analysis.validation, result.validation, strict=True)]
    shown += [("estimation", *pair) for pair in zip(analysis.estimation, result.estimation, strict=True)]
    names = short_names([recording.source for _, recording, _ in shown])
    for name, (role, _, prediction) in list(zip(names, shown, strict=True))[:4]:
        page.figure(torque_figure(prediction, model.units("N m")),
                    f"{name} ({role}): measured and predicted torque with two standard "
                    "deviations of the prediction (cut off at reversals, where the angle over which friction turns "
                    "decides), and the residual on the same scale. Above each panel: std(residual) / std(torque).")
    _errors(page, analysis)
    page.heading("Friction", folded=True)
    page.figure(friction_figure(analysis), "Friction over speed. Gray points: what is left of the measured torque "
                "when everything else is subtracted (estimation data). Line: the law at constant speed without load. "
                "Orange points: the whole friction model at the instants of the gray ones.")
    page.table(*friction_spread(analysis), "Why points lie beside the line: friction grows with the torque that the "
               "gear transmits, and turns over a small angle after each reversal. The model knows that where its law "
               "says load or presliding; the line shows it nowhere. What is left in the last column is noise and what "
               "the model misses; diagnose says which. Standard deviations.")
    _friction_choice(page, analysis)
    _warm_up(page, analysis)
    if analysis.two_step is not None:
        _measurements(page, analysis.two_step, model)
    _parameters(page, model)
    _consistency(page, analysis)
    if analysis.controller is not None:
        _controller(page, analysis.controller, model)
    if analysis.linear_loop is not None:
        _linear_loop(page, analysis.linear_loop)
    _commands(page, model)
    page.heading("Data and filters", folded=True)
    _segments(page, analysis)
    filters = model.provenance["filters"]
    page.text(f"Position filter {filters['cutoff']:.4g} Hz (Butterworth of order 4, forwards and backwards), "
              f"decimation filter {filters['cutoff_decimation']:.4g} Hz (half power), the same for torque and every "
              f"regressor column. Condition number {result.solution.condition_number:.4g}, "
              f"{result.solution.condition_number_scaled:.4g} with scaled columns.")
    page.table(["recording", "hash"], [[r["source"], r["hash"]] for r in model.provenance["recordings"]])
    return page


def command_page(analysis: CommandIdentification) -> Report:
    """The page on what commands and angles without torques determine of an arm, and what they cannot."""
    page = Report(f"Commands of {analysis.model.arm.name}", "Which command makes each joint move so, from commands "
                  "and angles alone. precorrect and play use it; diagnosis needs torques.")
    for warning in analysis.warnings:
        page.warning(warning)
    _commands(page, analysis.model, folded=False)
    page.figure(analysis.plot(), "Command minus measured angle of the first recording.")
    page.table(["not in the recordings"], [[text] for text in analysis.missing])
    page.table(["recording", "hash"], [[r["source"], r["hash"]] for r in analysis.model.provenance["recordings"]])
    return page


def _commands(page: Report, model: Model, *, folded: bool = True) -> None:
    figures, units = command_figures(model), model.units("mrad")
    if not figures:
        return
    page.heading("Joint controllers, as seen from command and angle", folded=folded)
    page.table(["joint", "found", "command minus angle", "law leaves", "cascade leaves", "unit"],
               [[f["joint"], f["found"], 1e3 * f["of"], 1e3 * f["left"],
                 None if f["cascade_left"] is None else 1e3 * f["cascade_left"], unit]
                for f, unit in zip(figures, units, strict=True)],
               "The command's law of each joint, in the field's words. Command minus angle: standard deviation over "
               "the recordings. Law leaves: root mean square of what the law, with the model's torque, leaves of it on "
               "blocks that its coefficients were not fitted to. Cascade leaves: angle minus that of the simulated "
               "loop of [G].")


def verdict_table(analysis: IdentificationResult) -> tuple[list[str], list[list[Any]]]:
    """Column titles and rows of the quality of each joint's model."""
    return (["joint", "verdict", "residual torque [%]", "standard error [%]", "why", "motion that determines more"],
            [[v.joint, Verdict(v.verdict), v.left_percent, v.uncertain_percent, v.reason, v.would_tell]
             for v in analysis.verdicts])


def _next_steps(analysis: IdentificationResult, call: Call, kept: str) -> list[tuple[str, str]]:
    """What to do with the model: for each step a sentence and its command."""
    file = shlex.quote(kept or "model.json")
    steps = []
    if any(v.would_tell for v in analysis.verdicts):
        steps.append(("Record a motion that determines more.", f"ideal-robot plan-identification {call.of_robot}"))
    if not analysis.validation:
        steps.append(("Judge the model by a motion that it was not fitted to.",
                      f"ideal-robot identify {call} --validate OTHER --model {file}"))
    elif not kept:
        steps.append(("Keep the model.", f"ideal-robot identify {call} --model {file}"))
    return [*steps, ("Find out what the model lacks.", f"ideal-robot diagnose {call} --model {file}"),
            ("Correct a path with it.",
             f"ideal-robot precorrect PATH.csv {call.of_robot} --model {file} -o corrected.csv")]


def _verdicts(page: Report, analysis: IdentificationResult) -> None:
    columns, rows = verdict_table(analysis)
    said = [i for i in range(len(columns)) if i < 4 or any(row[i] for row in rows)]
    page.table([columns[i] for i in said], [[row[i] for i in said] for row in rows],
               "What the model is worth. Residual torque: relative to the torque, the larger one of estimation and "
               "unseen data. Standard error: of the predicted torque in postures of the whole range, by the standard "
               "deviations of the parameters.")


def _errors(page: Report, analysis: IdentificationResult) -> None:
    page.heading("Errors of each recording", folded=True)
    rows = []
    names = iter(short_names([recording.source for recording in (*analysis.estimation, *analysis.validation)]))
    for role, predictions in (("estimation", analysis.result.estimation), ("unseen", analysis.result.validation)):
        for prediction in predictions:
            name = next(names)
            rows.append([name, role, "std(e) / std(τ) [%]", *prediction.residual_std_percent])
            rows.append([name, role, "‖e‖ / ‖τ‖ [%]", *prediction.relative_error_percent])
    page.table(["recording", "role", "error", *[f"joint {j + 1}" for j in range(analysis.model.n)]], rows,
               "Predicted against measured torque, both through the same filters.")


def _parameters(page: Report, model: Model) -> None:
    page.heading("Parameters", folded=True)
    gravitational = dict(zip(model.base.names, model.base.gravitational, strict=True))
    rows = [[p.name, p.joint, p.value, p.std, p.std_percent, p.unit,
             ("p_g" if gravitational[p.name] else "p_m") if p.name in gravitational else "friction",
             p.meaning] for p in sorted(model.parameters, key=lambda p: p.std_percent)]
    page.table(["name", "joint", "value", "σ", "σ [%]", "unit", "group", "stands for"], rows,
               "σ takes correlated residuals into account, so it is wider than the usual one. p_g act through gravity "
               "too, p_m through inertia only ([G] (6)).", folded=f"All {len(rows)} parameters, the surest first")


def _friction_choice(page: Report, analysis: IdentificationResult) -> None:
    scores = analysis.result.friction_scores
    labels = list(dict.fromkeys(label for joint in scores for label in joint))
    if not labels:
        return
    rows = [[label, *[joint.get(label) for joint in scores]] for label in labels]
    page.table(["law", *[f"joint {j + 1}" for j in range(len(scores))]], rows,
               "Held-out residual of each law (blocks of the estimation data that the fit did not see), in units of "
               "the residual that [G] (1) leaves. Chosen: "
               + "; ".join(f"{j + 1} {law.label}" for j, law in enumerate(analysis.model.friction.laws)) + ".")


def _warm_up(page: Report, analysis: IdentificationResult) -> None:
    rows = [[j + 1, 100.0 * w.surplus, 100.0 * w.surplus_std, w.reference, w.rms_constant, w.rms]
            for j, w in enumerate(analysis.warm_up) if w is not None]
    if rows:
        unit = one_unit(analysis.model.units("N m"))
        page.table(["joint", "more friction 10 K colder [%]", "σ [%]", "law holds at [°C]",
                    f"residual, constant [{unit}]", f"residual, by temperature [{unit}]"], rows,
                   "Friction and gear temperature (cube root law scaled).")


def _measurements(page: Report, two_step: TwoStep, model: Model) -> None:
    page.heading("Operating points", folded=True)
    rows = [[m.joint + 1, m.quantity, m.value, m.std, float(m.row @ model.base_values),
             ", ".join(f"{a:.0f}" for a in np.degrees(m.q))] for m in two_step.measurements]
    page.table(["joint", "quantity", "measured", "σ", "model", "posture [deg]"], rows,
               f"Step 1: gravitational torques [{one_unit(model.units('N m'))}] and moments of inertia "
               f"[{one_unit(model.units('kg m²'))}], measured one axis at a time in "
               f"{two_step.duration:.0f} s of motion; step 2 is the model through them.")


def _linear_loop(page: Report, fit: LinearLoopFit) -> None:
    page.heading("Linear closed loop", folded=True)
    lags = range(min(9, len(fit.loop.g)))
    rows = [[j + 1, m_d, *[float(fit.loop.g[lag, j]) for lag in lags], float(fit.error_percent[j])]
            for j, m_d in enumerate(fit.relative_degree)]
    page.table(["joint", "relative degree", *[f"g({lag})" for lag in lags], "error [%]"], rows,
               f"Impulse response of each joint's closed loop at {1e3 * fit.loop.t_ipo:g} ms, [G] (7), from logged "
               "command to motor position.")


def _segments(page: Report, analysis: IdentificationResult) -> None:
    filters = analysis.model.provenance["filters"]
    kinds = ("rest", "constant", "reversal", "other")
    rows = []
    names = short_names([recording.source for recording in analysis.estimation])
    for name, recording in zip(names, analysis.estimation, strict=True):
        s = preprocess(recording, cutoff=filters["cutoff"], cutoff_decimation=filters["cutoff_decimation"])
        episodes = segments(s)
        for j in range(analysis.model.n):
            share = {kind: sum(x.stop - x.start for x in episodes if x.joint == j and x.kind == kind) for kind in kinds}
            rows.append([name, j + 1, *[100.0 * share[kind] / len(s.t) for kind in kinds]])
    page.table(["recording", "joint", "at rest [%]", "constant velocity [%]", "near a reversal [%]", "other [%]"], rows,
               "What the joints do in the estimation recordings.")


def _consistency(page: Report, analysis: IdentificationResult) -> None:
    model, consistency = analysis.model, analysis.result.consistency
    page.heading("Physical consistency", folded=True)
    page.text("The identified base parameters are " + ("possible as they are." if consistency.was_consistent else
              "not possible for real bodies as they are (the noise allows that); the nearest possible set is kept "
              "beside them and goes into the exported URDF.")
              + f" It lies {np.max(np.abs(consistency.deviation)):.2g} standard deviations away at most.")
    names = ["m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz"]
    full = consistency.full
    layout = model.base.layout
    rotors = dict(zip(layout.own, full[layout.rotors], strict=True))
    rows = [[label, *full[layout.link(i)], rotors.get(i, "-"), *consistency.smallest_eigenvalue[i]]
            for i, label in enumerate(link_labels(model.kinematics))]
    page.table(["link", *names, "Ia", "λ_min before", "λ_min after"], rows,
               "Full parameters, about the joint frames; smallest eigenvalue of each pseudo-inertia matrix.")


def _controller(page: Report, controller: ControllerIdentification, arm: Model) -> None:
    page.heading("Joint controllers, as a P/PI cascade", folded=True)
    model = controller.model
    stiffness, damping, inertia = (one_unit(arm.units(unit)) for unit in ("N m/rad", "N m s/rad", "N m s²/rad"))
    rows = [[j + 1, model.k_p[j], model.k_d[j], model.k_1[j], model.k_2[j], model.k_i[j], controller.k_i_direct[j],
             controller.error_percent[j]] for j in range(len(model.k_p))]
    page.table(["joint", f"k_P [{stiffness}]", f"k_D [{damping}]", f"k_1 [{damping}]", f"k_2 [{inertia}]", "k_I",
                "k_I direct", "error [%]"], rows,
               f"[G] (16), (17) at {1e3 * model.t_cycle:g} ms; the command takes effect "
               f"{1e3 * model.delay:.3g} ms after it is logged.")
    if arm.controller is not None and (words := beside_cascade(arm.controller)):
        page.text(f"At the controllers' own cycle: {words}.")
    page.figure(drift_figure(controller, one_unit(arm.units("N m"))), "Why k_I is found by simulation ([G] Fig. 17): a "
                "value that is best from one step to the next lets errors add up; deviation of the simulated from "
                "the measured torque.")


def torque_figure(prediction: Prediction, units: Sequence[str]) -> Figure:
    """Measured and predicted torque [``units``] and the residual of each joint over time."""
    n = prediction.tau.shape[1]
    figure = Figure(figsize=(11, 1.9 * n + 0.6), layout="constrained")
    axes = figure.subplots(n, 1, sharex=True, squeeze=False)[:, 0]
    for j, axis in enumerate(axes):
        tau, std = prediction.tau[:, j], prediction.std[:, j]
        axis.fill_between(prediction.t, tau - 2 * std, tau + 2 * std, color=PREDICTED, alpha=0.18, linewidth=0)
        axis.plot(prediction.t, prediction.measured[:, j], color=MEASURED, linewidth=1.3, label="measured")
        axis.plot(prediction.t, tau, color=PREDICTED, linewidth=0.9, label="predicted")
        axis.plot(prediction.t, prediction.measured[:, j] - tau, color=RESIDUAL, linewidth=0.7, label="residual")
        axis.set_ylabel(f"τ_{j + 1} [{units[j]}]")
        axis.grid(alpha=0.25)
        axis.margins(x=0)
        # At a reversal the linearised uncertainty of the presliding angle is many times the friction, so the limits
        # leave it out.
        shown = np.concatenate([prediction.measured[:, j], tau, prediction.measured[:, j] - tau])
        room = 0.1 * float(np.ptp(shown)) + 1e-9
        axis.set_ylim(float(shown.min()) - room, float(shown.max()) + room)
        axis.set_title(f"{prediction.residual_std_percent[j]:.1f} %", loc="right", fontsize=9, color="#5b6675")
    axes[0].legend(loc="upper left", ncols=3, fontsize=9, frameon=False, bbox_to_anchor=(0, 1.32))
    axes[-1].set_xlabel("t [s]")
    return figure


def _panels(n: int, height: float, sharex: bool = False) -> tuple[Figure, list[Axes]]:
    """A panel for each of ``n`` joints, three beside each other, ``height`` [inch] each."""
    columns, rows = min(3, n), int(np.ceil(n / min(3, n)))
    figure = Figure(figsize=(3.7 * columns, height * rows), layout="constrained")
    axes = figure.subplots(rows, columns, sharex=sharex, squeeze=False).ravel()
    for axis in axes[n:]:
        axis.set_visible(False)
    return figure, list(axes[:n])


def friction_figure(analysis: IdentificationResult) -> Figure:
    """Figure of each joint's friction over speed: the torque less the rest of the model, and the law's curve."""
    model = analysis.model
    figure, axes = _panels(model.n, 2.9)
    points = friction_points(model, analysis.result)
    thin = max(1, len(points.speed) // 1000)
    for j, axis in enumerate(axes):
        speed, torque = points.speed[::thin, j], points.torque[::thin, j]
        axis.plot(speed, torque, ".", color=MEASURED, markersize=2, alpha=0.35, rasterized=True)
        axis.plot(speed, points.modelled[::thin, j], ".", color=PREDICTED, markersize=1.5, alpha=0.35, rasterized=True)
        v = np.linspace(-np.max(np.abs(speed)), np.max(np.abs(speed)), 401)
        axis.plot(v, model.friction.laws[j].torque(v[:, None])[:, 0], color=PREDICTED, linewidth=1.6)
        axis.set_title(f"joint {j + 1}: {model.friction.laws[j].label}", fontsize=8.5)
        axis.grid(alpha=0.25)
        low, high = np.percentile(torque, [0.5, 99.5])
        axis.set_ylim(low - 0.2 * (high - low), high + 0.2 * (high - low))
    figure.supxlabel(f"speed [{one_unit(model.units('rad/s'))}]", fontsize=9)
    figure.supylabel(f"torque [{one_unit(model.units('N m'))}]", fontsize=9)
    return figure


def friction_spread(analysis: IdentificationResult) -> tuple[list[str], list[list[Any]]]:
    """Table of the deviations of measured friction from the law's curve, and the share that the model explains."""
    model = analysis.model
    points = friction_points(model, analysis.result)
    rows: list[list[Any]] = []
    for j, law in enumerate(model.friction.laws):
        curve = law.torque(points.speed[:, j, None])[:, 0]
        about, unexplained = (float(np.std(points.torque[:, j] - of)) for of in (curve, points.modelled[:, j]))
        rows.append([j + 1, law.label, about, float(np.std(points.modelled[:, j] - curve)), unexplained])
    unit = one_unit(model.units("N m"))
    return ["joint", "law", f"points about the line [{unit}]", f"of that by load and reversals [{unit}]",
            f"left [{unit}]"], rows


def drift_figure(found: ControllerIdentification, unit: str) -> Figure:
    """Deviation of the simulated controller torque [``unit``] with the optimised and the directly estimated k_I."""
    figure, axes = _panels(found.measured.shape[1], 2.6, sharex=True)
    for j, axis in enumerate(axes):
        # Curves with every sample of every joint are rasterised: only axes and text are vectors.
        axis.plot(found.t, found.drifting[:, j] - found.measured[:, j], color=MEASURED, linewidth=0.8,
                  label="k_I estimated directly", rasterized=True)
        axis.plot(found.t, found.simulated[:, j] - found.measured[:, j], color=PREDICTED, linewidth=0.8,
                  label="k_I by simulation", rasterized=True)
        axis.set_title(f"joint {j + 1}", fontsize=9)
        axis.grid(alpha=0.25)
    axes[0].legend(fontsize=8, frameon=False)
    figure.supxlabel("t [s]", fontsize=9)
    figure.supylabel(f"simulated - measured [{unit}]", fontsize=9)
    return figure
