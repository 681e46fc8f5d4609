"""``ideal-robot plan-identification``: the motion to identify an arm with."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def command(
    robot: Annotated[str, typer.Option("--robot", "--urdf", help="Arm: name of a shipped robot, or path of a "
                                                                 "URDF.")],
    drive_data: Annotated[Path | None, typer.Option(help="Drive data of the arm (TOML): gains, rotor inertias, "
                                                         "cycles; default: beside the URDF.")] = None,
    method: Annotated[str, typer.Option(help="joint (optimised Fourier series) or two-step (trapezoidal moves at "
                                             "operating points, [G] 3.1.2).")] = "joint",
    period: Annotated[float, typer.Option(help="Period of the Fourier motion [s].", min=1.0)] = 20.0,
    points: Annotated[int, typer.Option(help="Operating points of the two-step method.", min=2)] = 10,
    seed: Annotated[int, typer.Option(help="Seed of the search.", min=0)] = 1,
    z_min: Annotated[float | None, typer.Option(help="Lowest height of tool and links [m]; default: 0.15, less for "
                                                     "arms that reach less than 1 m or stand low.")] = None,
    play: Annotated[bool, typer.Option("--play", help="Play it on the simulated arm and record it.")] = False,
    json: Annotated[Path | None, typer.Option(help="Write the plan and its figures as JSON to this file.")] = None,
    out: Annotated[Path, typer.Option(help="Folder of program, commands and recording.")] = Path("out/plan"),
) -> None:
    """Plans an identification motion within the limits, writes it out, and on request plays it in simulation.

    Writes `commands.csv` (joint angles every interpolation cycle) and, for the two-step method, the program of moves as
    `program.txt` and `program.json`. Look at the motion before it goes to a real arm: only limits, floor and base
    column are known here, no cell.

    Example: `ideal-robot plan-identification --robot kr15 --method two-step --play --out out/kr15`
    """
    from dataclasses import replace

    from ideal_robot.identification.excitation import Workspace
    from ideal_robot.robots.robot import Robot
    from scenes.commands.common import show_table
    from scenes.identification.plan import plan, play_plan
    from scenes.outputs import check_outputs, folders_held, whole_folder
    from scenes.report.page import write_json
    from scenes.terminal import progress_bar

    check_outputs({"--out": out}, json=json)
    arm = Robot.load(robot, drive_data)
    workspace = Workspace.of(arm)
    if z_min is not None:
        workspace = replace(workspace, z_min=z_min)
    with progress_bar("plan") as progress:
        planned = plan(arm, method, seed=seed, period=period, points=points, workspace=workspace)
        progress(0.2, "playing" if play else "")
        content = planned.json()
        recording = play_plan(planned, arm, seed,
                              lambda share: progress(0.2 + 0.8 * share, "playing")) if play else None
        with folders_held():
            with whole_folder(out) as new:
                files = [out / file.name for file in planned.write(new)]
                if recording is not None:
                    files.append(out / recording.write(new / "recording.parquet").name)
                    content["recording"] = str(files[-1])
            if json is not None:
                write_json(json, content)
    show_table(f"identification motion of {arm.name}", ["figure", "value"],
               [[key, value] for key, value in content.items() if isinstance(value, (int, float, str))])
    for path in files:
        typer.echo(f"written: {path}")
