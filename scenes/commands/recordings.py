"""Verbs on recordings and paths of an arm: identify, diagnose, stiffness, precorrect."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ideal_robot.errors import InputError
from ideal_robot.progress import Steps
from ideal_robot.whole_file import whole_files
from scenes.commands.common import (
    ColumnsMap,
    DriveData,
    JointNames,
    JsonFigures,
    JsonResults,
    ModelsRobot,
    PlannerDelay,
    ReportFolder,
    Rest,
    RobotName,
    StatesTopic,
    completed,
    progress_bar,
    reading_options,
    recording_of,
    show_table,
    write_signed,
)
from scenes.outputs import check_outputs

if TYPE_CHECKING:
    from ideal_robot.arrays import Array
    from ideal_robot.diagnosis import Diagnosis
    from ideal_robot.identification.angles_alone import CommandIdentification
    from ideal_robot.identification.whole_model import IdentificationResult
    from ideal_robot.model.model import Model
    from ideal_robot.robots.robot import Robot

SHARES = {"reading": 0.45, "drawing": 0.55}
"""Measured shares of the time: identification without the controllers' own cycles, and its page."""
SHARES_WITH_CASCADE = {"reading": 0.73, "drawing": 0.27}
"""With them."""


Controller = Annotated[str | None, typer.Option(help="Joint controllers that the recordings do not tell: a file of "
                                                     "data-sheet gains (TOML), or class for what arms usually "
                                                     "have.")]


@dataclass(kw_only=True)
class IdentifyOptions:
    """Options of ``identify``."""

    recordings: Annotated[list[Path], typer.Argument(help="Recordings to identify from (Parquet, CSV, ROS 2 bag or "
                                                          "MCAP).")]
    robot: RobotName
    columns: ColumnsMap = None
    topic: StatesTopic = None
    joints: JointNames = None
    validate: Annotated[list[Path] | None, typer.Option(help="Recording the model is compared with and never fitted "
                                                             "to; may be given several times.")] = None
    method: Annotated[str, typer.Option(help="joint (whole motions at once) or two-step (the program of "
                                             "plan-identification --method two-step).")] = "joint"
    drive_data: DriveData = None
    friction: Annotated[str, typer.Option(help="auto (law and refinements chosen per joint on held-back blocks), "
                                               "viscous_coulomb, cube_root, arctan, stribeck, bell_stribeck or "
                                               "asymmetric.")] = "auto"
    cutoff: Annotated[float | None, typer.Option(help="Position filter [Hz]; default: chosen from the data.")] = None
    decimate_to: Annotated[float | None, typer.Option(help="Decimation filter [Hz]; default: half of the position "
                                                           "filter.")] = None
    without_integrator: Annotated[list[Path] | None, typer.Option(help="Recording with the controllers' integrators "
                                                                       "off, for their gains ([G] 5.2.2).")] = None
    controller: Controller = None
    model: Annotated[Path | None, typer.Option(help="Write the model to this file.")] = None
    export_urdf: Annotated[Path | None, typer.Option(help="Write a URDF with the identified, physically consistent "
                                                          "inertias.")] = None
    json: JsonResults = None
    out: ReportFolder = Path("out/identify")


def _reading(options: IdentifyOptions | DiagnoseOptions) -> tuple[str, ...]:
    return reading_options(options.columns, options.topic, options.joints, options.drive_data)


def identify(options: IdentifyOptions) -> None:
    """Friction, base parameters, rotor inertias, offsets and controllers of an arm, each with its uncertainty.

    Example, after that of `plan-identification`:
    `ideal-robot identify out/plan/recording.parquet --robot kr6 --model model.json`
    """
    from ideal_robot.identification.angles_alone import identify_from_commands, without_torque
    from ideal_robot.identification.whole_model import identify_model, with_given_controller
    from ideal_robot.robots.robot import Robot
    from scenes.identification.page import command_page, identification_page
    from scenes.report.call import Call

    check_outputs({"--out": options.out}, json=options.json, model=options.model, export_urdf=options.export_urdf)
    with progress_bar("identify") as progress:
        steps = Steps(progress, SHARES if options.model is None else SHARES_WITH_CASCADE)
        arm = Robot.load(options.robot, options.drive_data)
        loaded, unseen, pd_only = ([recording_of(path, options.columns, options.topic, options.joints)
                                    for path in paths or []]
                                   for paths in (options.recordings, options.validate, options.without_integrator))
        if without_torque(loaded):
            alone = identify_from_commands(loaded, arm, progress=steps.begin("reading"))
            page = options.out / "report.html"
            with whole_files(page, options.json, options.model) as (page_file, json_file, model_file):
                command_page(alone).write(page_file)
                write_signed(json_file, alone.to_dict())
                if model_file is not None:
                    alone.model.save(model_file)
            return _show_alone(alone, page)
        analysis = identify_model(loaded, arm, validation=unseen, method=options.method, friction=options.friction,
                                  cutoff=options.cutoff, cutoff_decimation=options.decimate_to,
                                  without_integrator=pd_only, cascade=options.model is not None,
                                  progress=steps.begin("reading"))
        if options.controller is not None:
            analysis = with_given_controller(analysis, options.controller, arm)
        steps.begin("drawing")
        content, page = analysis.to_dict(), options.out / "report.html"
        outputs = (page, options.json, options.model, options.export_urdf)
        with whole_files(*outputs) as (page_file, json_file, model_file, urdf_file):
            identification_page(analysis, Call(options.recordings[0], options.robot, reading=_reading(options)),
                                str(options.model or "")).write(page_file)
            write_signed(json_file, content)
            if model_file is not None:
                analysis.model.save(model_file)
            if urdf_file is not None:
                analysis.model.export_urdf(urdf_file)
    _show_identified(analysis, arm, content["recordings"])
    typer.echo(f"report: {page}")


def _show_alone(analysis: CommandIdentification, page: Path) -> None:
    """Prints what commands and angles alone determine, and what they cannot."""
    _show_commands(analysis.model)
    for warning in analysis.warnings:
        typer.echo(f"warning: {warning}", err=True)
    for text in analysis.missing:
        typer.echo(f"not in the recordings: {text}")
    typer.echo(f"report: {page}")


def _show_commands(model: Model) -> None:
    """Prints each joint's controller, and the law's residual of command minus angle on held-out data."""
    from ideal_robot.identification.whole_model import command_figures
    from ideal_robot.model.cascade import beside_cascade

    figures, units = command_figures(model), model.units("mrad")
    if not figures:
        return
    show_table("controllers: command minus angle, and what the law leaves of it on held-out data",
               ["joint", "found", "command minus angle", "law leaves", "unit"],
               [[f["joint"], f["found"], 1e3 * f["of"], 1e3 * f["left"], unit]
                for f, unit in zip(figures, units, strict=True)])
    if model.controller is not None and (words := beside_cascade(model.controller)):
        typer.echo(f"functions of the drives themselves: {words}")
    law = model.command
    if law is not None and law.cascade is not None:
        cascade, own = (1e3 * float((values**2).mean() ** 0.5) for values in (law.cascade, law.residual))
        typer.echo(f"paths are corrected by {'the law' if law.leads else 'the cascade'}: over all joints the cascade "
                   f"leaves {cascade:.2g}, the law {own:.2g} [1e-3 rad or m]")


def _show_identified(analysis: IdentificationResult, arm: Robot, recordings: list[dict[str, Any]]) -> None:
    """Prints errors of each recording, determined parameters, friction laws, warnings and verdicts."""
    from ideal_robot.identification.verdict import told
    from scenes.identification.page import verdict_table

    show_table("std(residual) / std(torque) [%]", ["recording", "role", *[f"joint {j + 1}" for j in range(arm.n)]],
               [[r["source"], r["role"], *r["residual_std_percent"]] for r in recordings])
    parameters = analysis.model.parameters
    clear = [p for p in parameters if told(p)]
    show_table(f"parameters of {arm.name}", ["name", "joint", "value", "σ", "σ [%]", "unit"],
               [[p.name, p.joint, p.value, p.std, p.std_percent, p.unit] for p in clear])
    if len(clear) < len(parameters):
        typer.echo(f"{len(parameters) - len(clear)} more parameters are within two σ of zero; the page and --json "
                   "list them")
    show_table("friction laws", ["joint", "law"],
               [[j + 1, law.label] for j, law in enumerate(analysis.model.friction.laws)])
    _show_commands(analysis.model)
    for warning in analysis.warnings:
        typer.echo(f"warning: {warning}", err=True)
    show_table("verdicts", *verdict_table(analysis))


SHARES_OF_DIAGNOSIS = {"reading": 0.7, "drawing": 0.3}
"""Measured shares of the time: the diagnosis itself, and its page."""


@dataclass(kw_only=True)
class DiagnoseOptions:
    """Options of ``diagnose``."""

    recording: Annotated[Path, typer.Argument(help="Recording to diagnose (Parquet, CSV, ROS 2 bag or MCAP).")]
    robot: RobotName
    columns: ColumnsMap = None
    topic: StatesTopic = None
    joints: JointNames = None
    model: Annotated[Path | None, typer.Option(help="Model to diagnose; without it a baseline (rigid body, Coulomb and "
                                                    "viscous friction, rotors, offsets) is identified first.")] = None
    validate: Annotated[Path | None, typer.Option(help="Another recording of the same arm, for the errors that are "
                                                       "reported; else each block of time is predicted "
                                                       "by the fit to all others.")] = None
    drive_data: DriveData = None
    model_out: Annotated[Path | None, typer.Option(help="Write the extended model to this file.")] = None
    cutoff: Annotated[float | None, typer.Option(help="Position filter [Hz]; default: 20. The band of the torques and "
                                                      "the time left out around reversals follow it.")] = None
    explain: Annotated[bool, typer.Option("--explain", help="Say why each cause was named: what else could stand in "
                                                            "its place, by how much it is worse, and where in the "
                                                            "recording that shows.")] = False
    json: Annotated[Path | None, typer.Option(help="Write the result as JSON to this file.")] = None
    out: ReportFolder = Path("out/diagnose")


def diagnose(options: DiagnoseOptions) -> None:
    """Finds the effect behind a model's residual, adds it, and reports the error before and after on held-out data.

    Example, after that of `identify`:
    `ideal-robot diagnose out/plan/recording.parquet --robot kr6 --model model.json --json diagnosis.json`
    """
    from ideal_robot.diagnosis import diagnose
    from ideal_robot.identification.against_urdf import findings
    from ideal_robot.identification.checks import require_distinct
    from ideal_robot.model.model import Model
    from ideal_robot.robots.robot import Robot
    from ideal_robot.signals.clean import cleaned
    from scenes.diagnosis.page import diagnosis_page, next_steps, summary
    from scenes.report.call import Call

    check_outputs({"--out": options.out}, json=options.json, model_out=options.model_out)
    with progress_bar("diagnose") as progress:
        steps = Steps(progress, SHARES_OF_DIAGNOSIS)
        arm = Robot.load(options.robot, options.drive_data)
        recording = recording_of(options.recording, options.columns, options.topic, options.joints)
        validate = None if options.validate is None else recording_of(options.validate, options.columns, options.topic,
                                                                      options.joints)
        if validate is not None:
            require_distinct([recording, validate])
        model = None if options.model is None else Model.load(options.model)
        done = cleaned(recording, arm)
        contradictions = findings(done.recording, arm, amperes=done.amperes)
        diagnosis = diagnose(recording, arm, model=model, validate=validate, cutoff=options.cutoff,
                             progress=steps.begin("reading"))
        steps.begin("drawing")
        page = options.out / "report.html"
        better = None if diagnosis.model is None else options.model_out
        with whole_files(page, options.json, better) as (page_file, json_file, model_file):
            call = Call(options.recording, options.robot, options.model, _reading(options))
            page_of = diagnosis_page(diagnosis, f"{arm.name}: what its model lacks", call)
            for finding in contradictions:
                page_of.warning(finding.warning)
            page_of.write(page_file)
            write_signed(json_file, {"recording_hash": recording.hash, **diagnosis.to_dict(),
                                     "contradictions": [finding.to_dict() for finding in contradictions]})
            if model_file is not None and diagnosis.model is not None:
                diagnosis.model.save(model_file)
    _show_diagnosed(diagnosis, options.explain)
    for finding in contradictions:
        typer.echo(f"warning: {finding.warning}", err=True)
    typer.echo(summary(diagnosis))
    typer.echo(f"report: {page}")
    for sentence, command in next_steps(diagnosis, call)[:1]:
        typer.echo(f"next: {sentence} {command}")


def _show_diagnosed(diagnosis: Diagnosis, explain: bool) -> None:
    """Prints each channel's errors, added effects and open questions with reasons; the arguments if ``explain``."""
    from scenes.diagnosis.page import unexplained, unused

    show_table(f"verdict: {diagnosis.verdict}; errors on held-out data ({diagnosis.held_out_how})",
               ["channel", "before", "refitted", "after", "noise", "unit", "samples used %"],
               [[c.channel, c.rms_before, c.rms_refit, c.rms_after, c.noise_floor, c.unit, 100.0 * c.counted]
                for c in diagnosis.channels])
    if diagnosis.effects or diagnosis.unknown:
        show_table("what was added",
                   ["effect", "joint", "channel", "without", "with", "nats", "probability", "parameters", "or"],
                   [[e.fitted.name, e.fitted.joint, e.fitted.channel, e.rms_before, e.rms_after,
                     f"{e.nats:.0f} ± {e.nats_std:.0f}", f"{e.probability:.3g}",
                     ", ".join(e.depends_on) or "; ".join(p.text for p in e.fitted.parameters),
                     ", ".join(e.indistinguishable_from)] for e in (*diagnosis.effects, *diagnosis.unknown)])
    for argument in diagnosis.arguments if explain else ():
        typer.echo(argument.text)
    for joint, reason in sorted(diagnosis.undecided.items()):
        typer.echo(f"joint {joint} {reason}", err=True)
    if diagnosis.moved:
        typer.echo(f"parameters that moved: {'; '.join(p.text for p in diagnosis.moved)}", err=True)
    for warning in diagnosis.warnings:
        typer.echo(f"warning: {warning}", err=True)
    if loud := unexplained(diagnosis):
        typer.echo(f"warning: {loud}", err=True)
    if diagnosis.unused:
        typer.echo(f"not used: {unused(diagnosis)}")


@dataclass(kw_only=True)
class StiffnessOptions:
    """Options of ``stiffness``."""

    recordings: Annotated[list[Path], typer.Argument(help="Recordings with the flange clamped, or with payloads "
                                                          "hung on it (Parquet or CSV).")]
    robot: RobotName
    columns: ColumnsMap = None
    topic: StatesTopic = None
    joints: JointNames = None
    method: Annotated[str, typer.Option(help="motor (currents), wrench (force sensor) or both.")] = "both"
    clamp: Annotated[bool | None, typer.Option("--clamp/--no-clamp", help="Estimate the give of clamp and links beside "
                                               "the gears; default: where the recordings allow it.")] = None
    drive_data: DriveData = None
    drive_gain_tolerance: Annotated[float, typer.Option(help="Relative standard deviation of the data sheet's drive "
                                                             "gains.", min=0.0)] = 0.03
    json: JsonResults = None
    out: ReportFolder = Path("out/stiffness")


def stiffness(options: StiffnessOptions) -> None:
    """Joint stiffness of an arm whose flange is clamped to the environment, after Jubien, Abba and Gautier (2014).

    Example: `ideal-robot run clamped_kr500_1` and then
    `ideal-robot stiffness out/clamped_kr500_1/recording.parquet --robot kr500 --method both`
    """
    from ideal_robot.elasticity.stiffness_analysis import analyse_stiffness
    from ideal_robot.robots.robot import Robot
    from scenes.clamped import stiffness_page

    check_outputs({"--out": options.out}, json=options.json)
    with progress_bar("stiffness") as progress:
        arm = Robot.load(options.robot, options.drive_data)
        loaded = [recording_of(path, options.columns, options.topic, options.joints) for path in options.recordings]
        progress(0.1, "synchronising and fitting")
        analysis = analyse_stiffness(loaded, arm, options.method, clamp=options.clamp,
                                     drive_gain=options.drive_gain_tolerance)
        progress(0.7, "drawing")
        page = options.out / "report.html"
        with whole_files(page, options.json) as (page_file, json_file):
            stiffness_page(analysis, title=f"Joint stiffness of {arm.name}").write(page_file)
            write_signed(json_file, analysis.to_dict())
    show_table("stiffness", ["joint", "method", "k [N m/rad]", "offset [N m]", "%σ", "‖Wχ−Y‖/‖Y‖ [%]"],
               [[fit.joint, fit.method, fit.stiffness, fit.offset, fit.std_percent, fit.relative_error_percent]
                for fit in analysis.joints])
    for warning in analysis.warnings:
        typer.echo(f"note: {warning}", err=True)
    typer.echo(f"report: {page}")


@dataclass(kw_only=True)
class PrecorrectOptions:
    """Options of ``precorrect``."""

    path: Annotated[Path, typer.Argument(help="CSV or Parquet with t [s] and q_d_1 … q_d_n (or q_1 … q_n, or q_c_1 … "
                                              "q_c_n) [rad].")]
    model: Annotated[Path, typer.Option("--model", help="Identified model (JSON).")]
    output: Annotated[Path, typer.Option("-o", "--output", help="Where the corrected path goes (CSV or Parquet).")]
    robot: ModelsRobot = None
    method: Annotated[str, typer.Option(
        help="How the path is corrected: none, linear, precorrected, ideal, adapted, a setting of one "
             "(precorrected-printed, learned-model), or a key of another package.",
        autocompletion=lambda incomplete: completed("precorrect", incomplete))] = "ideal"
    delay: PlannerDelay = False
    rest: Rest = 0.6
    controller: Controller = None
    slow: Annotated[bool, typer.Option("--slow", help="Slow the path along itself just where a limit of speed or "
                                                      "acceleration is left.")] = False
    play: Annotated[bool, typer.Option("--play", help="Play both paths on the simulated arm and say what became of "
                                                      "them.")] = False
    seed: Annotated[int, typer.Option(help="Seed of the simulated arm's noise.", min=0)] = 1
    json: JsonFigures = None
    out: Annotated[Path | None, typer.Option(help="Folder of the report; default out/precorrect.")] = None


def precorrect(options: PrecorrectOptions) -> None:
    """Corrects a joint path so that the arm, not the command, follows it.

    The output has `t`, the commands `q_c_i` and the desired `q_d_i` at the interpolation cycle. Limits of position,
    speed and acceleration are checked before anything is written.

    Example, after that of `identify`:
    `ideal-robot precorrect out/plan/commands.csv --model model.json -o corrected.csv`
    """
    from ideal_robot.model.model import Model
    from scenes.path.precorrect import next_step, played, precorrected_path, robot_of, table, write_page

    folder = options.out or Path("out") / "precorrect"
    check_outputs({"--out": folder}, output=options.output, json=options.json)
    if options.output.resolve() == options.path.resolve():
        raise InputError("is the path that is to be corrected; give another file", field="--output",
                         value=str(options.output))
    with progress_bar("precorrect") as progress:
        progress(0.1, "")
        result = precorrected_path(options.path, options.model, robot=options.robot, method=options.method,
                                   delay=options.delay, rest=options.rest, controller=options.controller,
                                   slow=options.slow)
        measured = None
        if options.play:
            progress(0.6, "playing")
            arm = robot_of(Model.load(options.model), options.robot, options.model)
            measured = played(result, arm, options.seed, delay=options.delay)
        progress(0.9, "report")
        report = folder / "report.html"
        with whole_files(options.output, report, options.json) as (path_file, page_file, json_file):
            result.recording.write(path_file)
            write_page(result, page_file, measured, options.output)
            write_signed(json_file, {**result.to_dict(), **_played_errors(measured), "output": options.output,
                                     "report": report})
    show_table("Correction per joint", *table(result, measured))
    if beyond := result.beyond_uncorrected:
        typer.echo(f"warning: within the spread of the controller the corrected path may miss by more than the path "
                   f"itself does in joint {', '.join(map(str, beyond))}; a recording with commands (q_c_i) gives the "
                   "controller", err=True)
    for warning in result.warnings:
        typer.echo(f"warning: {warning}", err=True)
    typer.echo(f"corrected path: {options.output}")
    typer.echo(f"report: {report}")
    typer.echo("next: " + " ".join(next_step(options.output)))


def _played_errors(measured: tuple[Array, Array] | None) -> dict[str, Any]:
    """Root mean square of both plays' errors [mrad]; nothing where neither was played."""
    import numpy as np

    return {} if measured is None else {"played_rms_error_mrad": {
        word: 1e3 * np.sqrt(np.mean(error**2, axis=0))
        for word, error in zip(("corrected", "uncorrected"), measured, strict=True)}}


def validate(
    recording: Annotated[Path, typer.Argument(help="Recording to compare with (Parquet, CSV, ROS 2 bag or MCAP).")],
    mjcf: Annotated[Path, typer.Option(help="MuJoCo model of the arm (MJCF or URDF); needs the extra 'mujoco'.")],
    columns: ColumnsMap = None,
    topic: StatesTopic = None,
    joints: JointNames = None,
    json: Annotated[Path | None, typer.Option(help="Write the result as JSON to this file.")] = None,
    out: ReportFolder = Path("out/validate"),
) -> None:
    """Says how far a MuJoCo model is from a recording in each joint, and which effects it misses.

    Example, after that of `export`: `ideal-robot validate out/plan/recording.parquet --mjcf arm.xml`
    """
    from ideal_robot.diagnosis import diagnose
    from ideal_robot.model.mjcf import arm_of_mjcf
    from scenes.diagnosis.page import summary
    from scenes.diagnosis.validation_page import COLUMNS, rows, validation_page

    check_outputs({"--out": out}, json=json)
    arm = arm_of_mjcf(mjcf)
    loaded = recording_of(recording, columns, topic, joints)
    for text in arm.left_out:
        typer.echo(f"warning: left out of {mjcf.name}: {text}", err=True)
    prediction = arm.model.predict(loaded)
    units = arm.robot.units("N m")
    show_table(f"residual of {mjcf.name} on {recording.name}", COLUMNS, rows(prediction, units))
    with progress_bar("validate") as progress:
        diagnosis = diagnose(loaded, arm.robot, model=arm.model, progress=progress)
        page = out / "report.html"
        with whole_files(page, json) as (page_file, json_file):
            validation_page(mjcf.name, recording, prediction, units, diagnosis).write(page_file)
            write_signed(json_file, {"recording_hash": loaded.hash,
                                     "residual_percent": prediction.relative_error_percent.tolist(),
                                     "left_out": list(arm.left_out), **diagnosis.to_dict()})
    _show_diagnosed(diagnosis, False)
    typer.echo(summary(diagnosis))
    typer.echo(f"report: {page}")
