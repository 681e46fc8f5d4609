"""``ideal-robot sweep``: many scenes × methods × speeds × seeds."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def command(
    scenes: Annotated[list[str], typer.Argument(help="Scenes, by name or path.")],
    speeds: Annotated[str, typer.Option(help="Speeds [m/s], separated by commas.")] = "",
    seeds: Annotated[str, typer.Option(help="Seeds: a list 1,2,5 or a range 1-10.")] = "",
    individuals: Annotated[str, typer.Option("--individuals", "--individual", help="Arms of the type, each with a "
                                             "model of its own (see prepare): a list 1,2,5 or a range 1-10.")] = "",
    world: Annotated[str | None, typer.Option(help="Where they play instead of the scenes' worlds: workshop or "
                                                   "bench.")] = None,
    methods: Annotated[str, typer.Option(help="Methods, separated by commas.")] = "",
    processes: Annotated[int, typer.Option(help="Local processes.", min=1)] = 2,
    dask: Annotated[str | None, typer.Option(help="Address of a running Dask scheduler instead.")] = None,
    lines: Annotated[Path | None, typer.Option(help="Append each answer to this file as it comes (JSON "
                                                    "lines).")] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with the file of --lines: runs that it holds are not "
                                                          "played again.")] = False,
    json: Annotated[Path | None, typer.Option(help="Write all answers as JSON to this file.")] = None,
    csv: Annotated[Path | None, typer.Option(help="Write the table as CSV to this file.")] = None,
) -> None:
    """Plays many runs and prints one table of their errors; a run that fails is a row, not the end.

    Exit code 1 where no run succeeded.

    Example: `ideal-robot sweep line straight --speeds 0.2,0.7,1.5 --seeds 1-10 --lines runs.jsonl --resume`
    """
    import pandas as pd

    from ideal_robot.errors import InputError
    from ideal_robot.whole_file import whole_files
    from scenes.commands.common import numbers, show_table, whole_numbers
    from scenes.outputs import check_outputs
    from scenes.report.page import write_json
    from scenes.sweep import FIGURES, SweepFile, jobs, sweep
    from scenes.terminal import progress_bar

    work = jobs(scenes, [key.strip() for key in methods.split(",") if key.strip()],
                numbers(speeds, "--speeds"), whole_numbers(seeds, "--seeds"),
                whole_numbers(individuals, "--individuals"), world)
    check_outputs(json=json, csv=csv, lines=lines)
    if resume and lines is None:
        raise InputError("needs --lines FILE, the file to go on with", field="--resume")
    file = None if lines is None else SweepFile(lines, resume=resume)
    with progress_bar(f"{len(work)} runs") as progress:
        answers = sweep(work, processes=processes, dask=dask, file=file,
                        done=lambda count: progress(count / len(work), f"{count} of {len(work)}"))
    frame = pd.json_normalize(answers)
    names = {key: title for key, title in FIGURES.items() if key in frame}
    frame = frame.rename(columns=names)
    shown = ["scene", "method", *(["individual"] if individuals else []), "seed", *names.values(), "failure"]
    kinds = [key for key in ("scene", "method", "m/s") if key in frame]
    figures = [title for title in names.values() if title not in ("m/s",)]
    worst = frame.groupby(kinds, sort=False, dropna=False)[figures].max().reset_index()
    counts = frame.groupby(kinds, sort=False, dropna=False).size().to_numpy()
    show_table("sweep", shown, frame[shown].astype(object).where(frame[shown].notna(), None).to_numpy().tolist())
    rows = [[*row, int(count)] for row, count in zip(worst.astype(object).to_numpy().tolist(), counts, strict=True)]
    show_table("largest of each kind of run", [*kinds, *figures, "runs"], rows)
    # Shown first: what no disk takes is read at least.
    with whole_files(json, csv) as (json_file, csv_file):
        if json_file is not None:
            write_json(json_file, {"runs": answers})
        if csv_file is not None:
            frame[shown].to_csv(csv_file, index=False)
    if all(answer.get("failure") for answer in answers):
        raise typer.Exit(1)
