"""``ideal-robot precorrect``: a corrected joint path for a real controller."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from scenes.commands.method_option import completed, method_help


def command(
    path: Annotated[Path, typer.Argument(help="CSV or Parquet with t [s] and q_d_1 … q_d_n (or q_1 … q_n, "
                                              "or q_c_1 … q_c_n) [rad].")],
    model: Annotated[Path, typer.Option("--model", help="Identified model (JSON).")],
    output: Annotated[Path, typer.Option("-o", "--output", help="Where the corrected path goes (CSV or Parquet).")],
    robot: Annotated[str | None, typer.Option("--robot", "--urdf", help="Arm: name of a shipped robot, or path of a "
                                              "URDF; default: the one the model names.")] = None,
    method: Annotated[str, typer.Option(help=method_help("precorrect"), autocompletion=lambda incomplete: completed(
        "precorrect", incomplete))] = "ideal",
    delay: Annotated[bool, typer.Option(help="The standard path planner's delay of one cycle is in force.")] = False,
    rest: Annotated[float, typer.Option(help="Rest added before the path [s], for the gears' deflection.")] = 0.6,
    play: Annotated[bool, typer.Option("--play", help="Play both paths on the simulated arm and say what became of "
                                                      "them.")] = False,
    seed: Annotated[int, typer.Option(help="Seed of the simulated arm's noise.", min=0)] = 1,
    json: Annotated[Path | None, typer.Option(help="Write the figures as JSON to this file.")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder of the report; default out/precorrect.")] = None,
) -> None:
    """Corrects a joint path so that the arm, not the command, follows it.

    The output has `t`, the commands `q_c_i` and the desired `q_d_i` at the interpolation cycle. Limits of position,
    speed and acceleration are checked before anything is written.

    Example: `ideal-robot precorrect path.csv --model scenes/models/kr15.json -o corrected.csv`
    """
    import numpy as np

    from ideal_robot.model.model import Model
    from ideal_robot.whole_file import whole_files
    from scenes.commands.common import show_table
    from scenes.outputs import check_outputs
    from scenes.path.precorrect import played, precorrected_path, robot_of, table, write_page
    from scenes.report.page import write_json
    from scenes.terminal import progress_bar

    folder = out or Path("out") / "precorrect"
    check_outputs({"--out": folder}, output=output, json=json)
    with progress_bar("precorrect") as progress:
        progress(0.1, "")
        result = precorrected_path(path, model, robot=robot, method=method, delay=delay, rest=rest)
        measured = None
        if play:
            progress(0.6, "playing")
            measured = played(result, robot_of(Model.load(model), robot, model), seed, delay=delay)
        progress(0.9, "report")
        report = folder / "report.html"
        with whole_files(output, report, json) as (path_file, page_file, json_file):
            result.recording.write(path_file)
            write_page(result, page_file, measured)
            if json_file is not None:
                errors = {} if measured is None else {"played_rms_error_mrad": {
                    word: 1e3 * np.sqrt(np.mean(error**2, axis=0))
                    for word, error in zip(("corrected", "uncorrected"), measured, strict=True)}}
                write_json(json_file, {**result.to_dict(), **errors, "output": output, "report": report})
    show_table("Correction per joint", *table(result, measured))
    typer.echo(f"corrected path: {output}")
    typer.echo(f"report: {report}")
