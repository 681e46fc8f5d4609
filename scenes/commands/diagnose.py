"""``ideal-robot diagnose``: which physical effect a model misses in a recording, where, and what it is worth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

SHARES = {"reading": 0.7, "drawing": 0.3}
"""Measured shares of the time: the diagnosis itself, and its page."""


def command(
    recording: Annotated[Path, typer.Argument(help="Recording to diagnose (Parquet, CSV, ROS 2 bag or MCAP).")],
    robot: Annotated[str, typer.Option("--robot", "--urdf", help="Arm: name of a shipped robot, or path of a "
                                                                 "URDF.")],
    model: Annotated[Path | None, typer.Option(help="Model to diagnose; without it a baseline (rigid body, Coulomb and "
                                                    "viscous friction, rotors, offsets) is identified first.")] = None,
    validate: Annotated[Path | None, typer.Option(help="Another recording of the same arm, for the errors that are "
                                                       "reported; else every fourth block of time is kept "
                                                       "apart.")] = None,
    drive_data: Annotated[Path | None, typer.Option(help="Drive data of the arm (TOML): gains, rotor inertias, "
                                                         "cycles; default: beside the URDF.")] = None,
    model_out: Annotated[Path | None, typer.Option(help="Write the extended model to this file.")] = None,
    cutoff: Annotated[float | None, typer.Option(help="Position filter [Hz]; default: 20. The band of the torques and "
                                                      "the time left out around reversals follow it.")] = None,
    seed: Annotated[int, typer.Option(help="Seed of the null distributions.")] = 0,
    json: Annotated[Path | None, typer.Option(help="Write the result as JSON to this file.")] = None,
    out: Annotated[Path, typer.Option(help="Folder of the report.")] = Path("out/diagnose"),
) -> None:
    """Finds the effect behind a model's residual, adds it, and reports the error before and after on held-out data.

    Example: `ideal-robot diagnose estimation.parquet --robot arm.urdf --validate other.parquet --model-out better.json`
    """
    from ideal_robot.diagnosis import diagnose
    from ideal_robot.model.model import Model
    from ideal_robot.progress import Steps
    from ideal_robot.robots.robot import Robot
    from ideal_robot.signals.recording import Recording
    from ideal_robot.whole_file import whole_files
    from scenes.commands.common import show_table
    from scenes.diagnosis.page import diagnosis_page, summary, unexplained, unused
    from scenes.outputs import check_outputs
    from scenes.report.page import write_json
    from scenes.terminal import progress_bar

    check_outputs({"--out": out}, json=json, model_out=model_out)
    with progress_bar("diagnose") as progress:
        steps = Steps(progress, SHARES)
        arm = Robot.load(robot, drive_data)
        found = diagnose(Recording.read(recording), arm, model=None if model is None else Model.load(model),
                         validate=None if validate is None else Recording.read(validate), seed=seed, cutoff=cutoff,
                         progress=steps.begin("reading"))
        steps.begin("drawing")
        page = out / "report.html"
        better = None if found.model is None else model_out
        with whole_files(page, json, better) as (page_file, json_file, model_file):
            diagnosis_page(found, f"Diagnosis of {recording.name}").write(page_file)
            if json_file is not None:
                write_json(json_file, found.to_dict())
            if model_file is not None and found.model is not None:
                found.model.save(model_file)
    show_table(f"verdict: {found.verdict}; errors on held-out data ({found.held_out_how})",
               ["channel", "before", "refitted", "after", "noise", "unit", "samples that counted %"],
               [[c.channel, c.rms_before, c.rms_refit, c.rms_after, c.noise_floor, c.unit, 100.0 * c.counted]
                for c in found.channels])
    if found.effects or found.unknown:
        show_table("what was added", ["effect", "joint", "channel", "before", "after", "p", "parameters", "or"],
                   [[e.fitted.name, e.fitted.joint, e.fitted.channel, e.rms_before, e.rms_after, f"{e.p_value:.0e}",
                     ", ".join(e.depends_on) or "; ".join(p.text for p in e.fitted.parameters),
                     ", ".join(e.indistinguishable_from)] for e in (*found.effects, *found.unknown)])
    for d in found.not_transferred:
        typer.echo(f"not added: {d.effect} in {d.channel} (p {d.p_value:.0e}); {d.reason}", err=True)
    for joint, reason in sorted(found.undecided.items()):
        typer.echo(f"undecided: joint {joint} {reason}", err=True)
    for refit in found.refitted:
        typer.echo(f"explained by refitting alone: joint {refit.joint}: {refit.text}", err=True)
    for warning in found.warnings:
        typer.echo(f"warning: {warning}", err=True)
    if loud := unexplained(found):
        typer.echo(f"warning: {loud}", err=True)
    if found.unused:
        typer.echo(f"not used: {unused(found)}")
    typer.echo(summary(found))
    typer.echo(f"report: {page}")
