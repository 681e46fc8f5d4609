"""``ideal-robot rsi``: the ideal robot as a KUKA RSI server."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def command(
    path: Annotated[Path, typer.Argument(help="CSV or Parquet with t [s] and q_d_1 … q_d_n (or q_1 … q_n) [rad].")],
    robot: Annotated[str | None, typer.Option(help="Shipped robot or URDF; default: the one the model names.")] = None,
    model: Annotated[Path | None, typer.Option(help="Identified model (JSON); default: the shipped one.")] = None,
    method: Annotated[str, typer.Option(help="ideal, precorrected or none.")] = "ideal",
    host: Annotated[str, typer.Option(help="Address of this computer to listen on.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(help="UDP port to listen on; 0 for any free one.", min=0, max=65535)] = 49152,
    relative: Annotated[bool, typer.Option("--relative/--absolute",
                                           help="How the controller takes AK: added up, or from the start.")] = False,
    cycle: Annotated[float | None, typer.Option(help="Interpolation cycle [s], e.g. 0.004; default: robot's.")] = None,
    delay: Annotated[bool, typer.Option(help="The standard path planner's delay of one cycle is in force.")] = False,
    rest: Annotated[float, typer.Option(help="Rest added before the path [s], for the gears' deflection.")] = 0.6,
    wait: Annotated[float, typer.Option(help="How long to wait for the controller [s].", min=0.1)] = 60.0,
    record: Annotated[Path, typer.Option(help="Recording (CSV or Parquet).")] = Path("out/rsi/recording.parquet"),
    json: Annotated[Path | None, typer.Option(help="Write the figures as JSON to this file.")] = None,
) -> None:
    """Answers a KUKA controller's RSI packets so that the arm, not the command, follows a joint path.

    The arm has to stand at the start of the path. Ctrl-C and any limit bring it to rest on the path. Not yet tried on a
    real controller: read docs/rsi.md first.

    Example: `ideal-robot rsi path.csv --robot kr6 --record moved.parquet`
    """
    import signal
    import sys

    from scenes.commands.common import progress_bar, show_table
    from scenes.outputs import check_outputs
    from scenes.report.page import write_json
    from scenes.rsi.setup import rsi_server

    check_outputs(record=record, json=json)
    with rsi_server(path, robot=robot, model=model, method=method, host=host, port=port, relative=relative, cycle=cycle,
                    delay=delay, rest=rest) as server:
        if not server.link.axes.known:
            typer.echo("ideal-robot: the robot's data has no table [rsi]: axes are taken to count as in the URDF; "
                       "see docs/rsi.md", err=True)
        typer.echo("waiting for the controller on {}:{}".format(*server.link.address), err=True)

        def interrupt(*_: object) -> None:
            if server.link.counts.cycles == 0:
                raise KeyboardInterrupt
            server.stop("stopped by the user")

        before, interval = signal.signal(signal.SIGINT, interrupt), sys.getswitchinterval()
        # The progress bar's thread must not hold up an answer for longer than this [s].
        sys.setswitchinterval(1e-4)
        try:
            with progress_bar("rsi") as progress:
                run = server.play(patience=wait, progress=progress)
        finally:
            signal.signal(signal.SIGINT, before)
            sys.setswitchinterval(interval)
    run.recording.write(record)
    if json is not None:
        write_json(json, {**run.json(), "recording": record})
    show_table("", *run.table())
    typer.echo(f"recording: {record}")
    if run.failure is not None:
        typer.echo(f"ideal-robot: {run.failure}", err=True)
        raise typer.Exit(1)
