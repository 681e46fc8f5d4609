"""``ideal-robot identify``: a dynamic model from recordings."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

SHARES = {"reading": 0.45, "drawing": 0.55}
"""Measured shares of the time: identification without the controllers' own cycles, and its page."""
SHARES_WITH_CASCADE = {"reading": 0.73, "drawing": 0.27}
"""With them."""


def command(
    recordings: Annotated[list[Path], typer.Argument(help="Recordings to identify from (Parquet, CSV, ROS 2 bag or "
                                                          "MCAP).")],
    robot: Annotated[str, typer.Option("--robot", "--urdf", help="Arm: name of a shipped robot, or path of a "
                                                                 "URDF.")],
    validate: Annotated[list[Path] | None, typer.Option(help="Recording the model is compared with and never fitted "
                                                             "to; may be given several times.")] = None,
    method: Annotated[str, typer.Option(help="joint (whole motions at once) or two-step (the program of "
                                             "plan-identification --method two-step).")] = "joint",
    drive_data: Annotated[Path | None, typer.Option(help="Drive data of the arm (TOML): gains, rotor inertias, "
                                                         "cycles; default: beside the URDF.")] = None,
    friction: Annotated[str, typer.Option(help="auto (law and refinements chosen per joint on held-back blocks), "
                                               "viscous_coulomb, cube_root, arctan, stribeck, "
                                               "bell_stribeck or asymmetric.")] = "auto",
    cutoff: Annotated[float | None, typer.Option(help="Position filter [Hz]; default: chosen from the data.")] = None,
    decimate_to: Annotated[float | None, typer.Option(help="Decimation filter [Hz]; default: half of the position "
                                                           "filter.")] = None,
    without_integrator: Annotated[list[Path] | None, typer.Option(help="Recording with the controllers' integrators "
                                                                       "off, for their gains ([G] 5.2.2).")] = None,
    model: Annotated[Path | None, typer.Option(help="Write the model to this file.")] = None,
    export_urdf: Annotated[Path | None, typer.Option(help="Write a URDF with the identified, physically consistent "
                                                          "inertias.")] = None,
    json: Annotated[Path | None, typer.Option(help="Write the results as JSON to this file.")] = None,
    out: Annotated[Path, typer.Option(help="Folder of the report.")] = Path("out/identify"),
) -> None:
    """Friction, base parameters, rotor inertias, offsets and controllers of an arm, each with its uncertainty.

    Example: `ideal-robot identify free_50s.parquet free_30s.parquet --robot ur10e.urdf --validate free_20s.parquet`
    """
    from ideal_robot.identification.whole_model import identify_model
    from ideal_robot.progress import Steps
    from ideal_robot.robots.robot import Robot
    from ideal_robot.signals.recording import Recording
    from ideal_robot.whole_file import whole_files
    from scenes.commands.common import show_table
    from scenes.identification.page import identification_page
    from scenes.outputs import check_outputs
    from scenes.report.page import write_json
    from scenes.terminal import progress_bar

    check_outputs({"--out": out}, json=json, model=model, export_urdf=export_urdf)
    with progress_bar("identify") as progress:
        steps = Steps(progress, SHARES if model is None else SHARES_WITH_CASCADE)
        arm = Robot.load(robot, drive_data)
        loaded, unseen, pd_only = ([Recording.read(path) for path in paths or []]
                                   for paths in (recordings, validate, without_integrator))
        analysis = identify_model(loaded, arm, validation=unseen, method=method, friction=friction, cutoff=cutoff,
                           cutoff_decimation=decimate_to, without_integrator=pd_only,
                           cascade=model is not None, progress=steps.begin("reading"))
        steps.begin("drawing")
        content, page = analysis.to_dict(), out / "report.html"
        with whole_files(page, json, model, export_urdf) as (page_file, json_file, model_file, urdf_file):
            identification_page(analysis).write(page_file)
            if json_file is not None:
                write_json(json_file, content)
            if model_file is not None:
                analysis.model.save(model_file)
            if urdf_file is not None:
                analysis.model.export_urdf(urdf_file)
    show_table("std(residual) / std(torque) [%]", ["recording", "role", *[f"joint {j + 1}" for j in range(arm.n)]],
               [[r["source"], r["role"], *r["residual_std_percent"]]
                for r in content["recordings"]])
    show_table(f"parameters of {arm.name}", ["name", "joint", "value", "σ", "σ [%]", "unit"],
               [[p.name, p.joint, p.value, p.std, p.std_percent, p.unit] for p in analysis.model.parameters])
    show_table("friction laws", ["joint", "law"],
               [[j + 1, law.label] for j, law in enumerate(analysis.model.friction.laws)])
    for warning in analysis.warnings:
        typer.echo(f"warning: {warning}", err=True)
    typer.echo(f"report: {page}")
