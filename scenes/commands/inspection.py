"""The verb that looks at a recording before anything is identified from it: inspect."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ideal_robot.whole_file import whole_files
from scenes.commands.common import (
    ColumnsMap,
    DriveData,
    JointNames,
    JsonResults,
    ReportFolder,
    RobotName,
    StatesTopic,
    progress_bar,
    reading_options,
    recording_of,
    show_table,
    write_signed,
)
from scenes.outputs import check_outputs

if TYPE_CHECKING:
    from ideal_robot.identification.inspection import Inspection


@dataclass(kw_only=True)
class InspectOptions:
    """Options of ``inspect``."""

    recording: Annotated[Path, typer.Argument(help="Recording (Parquet, CSV, ROS bag or MCAP).")]
    robot: RobotName
    columns: ColumnsMap = None
    topic: StatesTopic = None
    joints: JointNames = None
    drive_data: DriveData = None
    json: JsonResults = None
    out: ReportFolder = Path("out/inspect")


def inspect(options: InspectOptions) -> None:
    """Shows what a recording holds: what was read as what, rates, gaps, ranges, and what does not fit the URDF.

    Signs, units and order of the torques and the direction of gravity are compared with the rigid body of the URDF.

    Example, after that of `plan-identification`: `ideal-robot inspect out/plan/recording.parquet --robot kr6`
    """
    from ideal_robot.identification.inspection import inspect
    from ideal_robot.robots.robot import Robot
    from scenes.identification.inspection_page import inspection_page

    check_outputs({"--out": options.out}, json=options.json)
    with progress_bar("inspect") as progress:
        arm = Robot.load(options.robot, options.drive_data)
        recording = recording_of(options.recording, options.columns, options.topic, options.joints)
        progress(0.2, "comparing with the URDF")
        found = inspect(recording, arm)
        progress(0.7, "drawing")
        page = options.out / "report.html"
        with whole_files(page, options.json) as (page_file, json_file):
            inspection_page(found, arm, _next(found, options)).write(page_file)
            write_signed(json_file, found.to_dict())
    _show(found)
    typer.echo(f"report: {page}")
    typer.echo("next: " + " ".join(filter(None, _next(found, options))))


def _show(found: Inspection) -> None:
    """The tables and sentences of an inspection on the terminal."""
    from scenes.identification.inspection_page import ranges_table

    show_table("", ["", ""], [list(pair) for pair in found.summary()])
    if found.ranges:
        show_table("ranges", *ranges_table(found))
    for text in (*found.acts, *(finding.warning for finding in found.channels)):
        typer.echo(f"read: {text}")
    if found.unused:
        typer.echo(f"kept and not used: {', '.join(found.unused[:12])}"
                   + (f" and {len(found.unused) - 12} more" if len(found.unused) > 12 else ""))
    for finding in found.contradictions:
        typer.echo(f"does not fit: {finding.warning}", err=True)
    if found.refused:
        typer.echo(f"cannot be used: {found.refused}", err=True)


def _next(found: Inspection, options: InspectOptions) -> tuple[str, str]:
    """What to do after an inspection: a sentence and its command."""
    from ideal_robot.signals.bag import SUFFIXES
    from scenes.report.call import Call

    call = Call(options.recording, options.robot,
                reading=reading_options(options.columns, options.topic, options.joints, options.drive_data))
    if found.usable:
        return "Identify the arm's model from it.", f"ideal-robot identify {call}"
    if options.recording.is_dir() or options.recording.suffix.lower() in SUFFIXES:
        how = "" if options.joints else " --joints JOINTS"
        return "Mend what does not fit, or choose, and inspect again.", f"ideal-robot inspect {call}{how}"
    how = "" if options.columns else " --columns MAP"
    return "Mend what does not fit, or map it, and inspect again.", f"ideal-robot inspect {call}{how}"
