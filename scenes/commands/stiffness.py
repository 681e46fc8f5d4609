"""``ideal-robot stiffness``: joint stiffness from clamped recordings."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def command(
    recordings: Annotated[list[Path], typer.Argument(help="Recordings with the flange clamped, or with payloads "
                                                          "hung on it (Parquet or CSV).")],
    robot: Annotated[str, typer.Option("--robot", "--urdf", help="Arm: name of a shipped robot, or path of a "
                                                                 "URDF.")],
    method: Annotated[str, typer.Option(help="motor (currents), wrench (force sensor) or both.")] = "both",
    clamp: Annotated[bool | None, typer.Option("--clamp/--no-clamp", help="Estimate the give of clamp and links beside "
                                               "the gears; default: where the recordings allow it.")] = None,
    drive_gain_tolerance: Annotated[float, typer.Option(help="Relative standard deviation of the data sheet's drive "
                                                             "gains.", min=0.0)] = 0.03,
    json: Annotated[Path | None, typer.Option(help="Write the results as JSON to this file.")] = None,
    out: Annotated[Path, typer.Option(help="Folder of the report.")] = Path("out/stiffness"),
) -> None:
    """Joint stiffness of an arm whose flange is clamped to the environment, after Jubien, Abba and Gautier (2014).

    Example: `ideal-robot stiffness out/clamped_kr500_1/recording.parquet --robot kr500 --method both`
    """
    from ideal_robot.elasticity.stiffness_analysis import analyse_stiffness
    from ideal_robot.robots.robot import Robot
    from ideal_robot.signals.recording import Recording
    from ideal_robot.whole_file import whole_files
    from scenes.clamped.page import stiffness_page
    from scenes.commands.common import show_table
    from scenes.outputs import check_outputs
    from scenes.report.page import write_json
    from scenes.terminal import progress_bar

    check_outputs({"--out": out}, json=json)
    with progress_bar("stiffness") as progress:
        arm = Robot.load(robot)
        loaded = [Recording.read(path) for path in recordings]
        progress(0.1, "synchronising and fitting")
        analysis = analyse_stiffness(loaded, arm, method, clamp=clamp, drive_gain=drive_gain_tolerance)
        progress(0.7, "drawing")
        page = out / "report.html"
        with whole_files(page, json) as (page_file, json_file):
            stiffness_page(analysis, title=f"Joint stiffness of {arm.name}").write(page_file)
            if json_file is not None:
                write_json(json_file, analysis.to_dict())
    show_table("stiffness", ["joint", "method", "k [N m/rad]", "offset [N m]", "%σ", "‖Wχ−Y‖/‖Y‖ [%]"],
               [[one.joint, one.method, one.stiffness, one.offset, one.std_percent, one.relative_error_percent]
                for one in analysis.joints])
    for warning in analysis.warnings:
        typer.echo(f"note: {warning}", err=True)
    typer.echo(f"report: {page}")
