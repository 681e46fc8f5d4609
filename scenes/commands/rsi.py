"""``ideal-robot rsi``: the ideal robot as a KUKA RSI server."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from scenes.commands.method_option import completed, method_help


def command(
    path: Annotated[Path | None, typer.Argument(
        help="CSV or Parquet with t [s] and q_d_1 … q_d_n (or q_1 … q_n) [rad].")] = None,
    robot: Annotated[str | None, typer.Option("--robot", "--urdf", help="Arm: name of a shipped robot, or path of a "
                                              "URDF; default: the one the model names.")] = None,
    model: Annotated[Path | None, typer.Option(help="Identified model (JSON); default: the shipped one.")] = None,
    method: Annotated[str, typer.Option(help=method_help("rsi"), autocompletion=lambda incomplete: completed(
        "rsi", incomplete))] = "ideal",
    host: Annotated[str, typer.Option(help="Address of this computer to listen on.")] = "127.0.0.1",
    port: Annotated[int | None, typer.Option(help="UDP port to listen on; 0 for any free one. Default: that of "
                                             "--rsi-config, else 49152.", min=0, max=65535)] = None,
    controller: Annotated[str | None, typer.Option(help="Listen to this address only.")] = None,
    relative: Annotated[bool, typer.Option("--relative/--absolute",
                                           help="How the controller takes corrections: added up, or from the start."
                                           )] = False,
    rsi_config: Annotated[Path | None, typer.Option(help="The controller's RSI ethernet XML: tag, sender type, port "
                                                    "and HOLDON are read from it.")] = None,
    tag: Annotated[str | None, typer.Option(help="Element with the corrections, e.g. AK (default) or AKorr.")] = None,
    sender: Annotated[str | None, typer.Option(help="Type of the answer: SENTYPE, default ImFree.")] = None,
    decimals: Annotated[int, typer.Option(help="Decimals of a correction in degrees.", min=1, max=9)] = 6,
    cycle: Annotated[float | None, typer.Option(help="Interpolation cycle [s], e.g. 0.004; default: robot's.")] = None,
    delay: Annotated[bool, typer.Option(help="The standard path planner's delay of one cycle is in force.")] = False,
    rest: Annotated[float, typer.Option(help="Rest added before the path [s], for the gears' deflection.")] = 0.6,
    wait: Annotated[float, typer.Option(help="How long to wait for the controller [s].", min=0.1,
                                        max=86_400.0)] = 60.0,
    bridge: Annotated[float, typer.Option(help="How long packets may be lost in a row [s].", min=0.0, max=1.0)] = 0.1,
    core: Annotated[int | None, typer.Option(help="Processor core to keep to.", min=0)] = None,
    self_test: Annotated[bool, typer.Option("--self-test", help="Tell which cycle this computer holds, and why.")
                         ] = False,
    record: Annotated[Path, typer.Option(help="Recording (CSV or Parquet).")] = Path("out/rsi/recording.parquet"),
    json: Annotated[Path | None, typer.Option(help="Write the figures as JSON to this file.")] = None,
) -> None:
    """Answers a KUKA controller's RSI packets so that the arm, not the command, follows a joint path.

    The arm has to stand at the start of the path. Ctrl-C, SIGTERM, any limit and an arm that does not follow bring it
    to rest on the path. Not yet tried on a real controller: read docs/rsi.md first.

    Example: `ideal-robot rsi path.csv --robot kr6 --record moved.parquet`
    """
    from ideal_robot.errors import InputError
    from ideal_robot.robots.robot import Robot
    from ideal_robot.rsi.message import RsiFormat
    from ideal_robot.signals.recording import WRITTEN
    from ideal_robot.whole_file import whole_files
    from scenes.commands.common import show_table
    from scenes.online.processes import stopping_on_signals
    from scenes.outputs import check_outputs
    from scenes.report.page import write_json
    from scenes.rsi.setup import rsi_server
    from scenes.terminal import progress_bar

    check_outputs(record=record, json=json)
    if record.suffix not in WRITTEN:
        raise InputError(f"expected a name ending in {' or '.join(WRITTEN)}", field="--record", value=str(record))
    if self_test:
        _self_test(robot, model, method, core, json)
        return
    if path is None:
        raise InputError("give the path to be played", field="PATH")
    form = RsiFormat(tag or "AK", sender or "ImFree", decimals)
    if rsi_config is not None:
        axes = Robot.load(robot).n if robot is not None else 6
        read = RsiFormat.read(rsi_config, axes, tag)
        form = replace(read, sender=sender or read.sender, decimals=decimals)
    with rsi_server(path, robot=robot, model=model, method=method, cycle=cycle, delay=delay, rest=rest, host=host,
                    port=form.port or 49152 if port is None else port, relative=relative, form=form,
                    controller=controller, bridge=bridge) as server:
        if not server.link.axes.known:
            typer.echo("ideal-robot: the robot's data has no table [rsi]: axes are taken to count as in the URDF; "
                       "see docs/rsi.md", err=True)
        typer.echo("waiting for the controller on {}:{}".format(*server.link.address), err=True)
        with (stopping_on_signals(server.stop, lambda: server.link.counts.cycles > 0),
              progress_bar("rsi") as progress):
            run = server.play(patience=wait, core=core, progress=progress)
    # Shown first: the arm has moved, and what no disk takes is read at least.
    show_table("", *run.table())
    with whole_files(record, json) as (record_file, json_file):
        run.recording.write(record_file)
        if json_file is not None:
            write_json(json_file, {**run.json(), "recording": record})
    typer.echo(f"recording: {record}")
    if run.failure is not None:
        typer.echo(f"ideal-robot: {run.failure}", err=True)
        raise typer.Exit(1)


def _self_test(robot: str | None, model: Path | None, method: str, core: int | None, json: Path | None) -> None:
    from scenes.commands.common import show_table
    from scenes.report.page import write_json
    from scenes.rsi.self_test import held_cycles
    from scenes.terminal import progress_bar

    with progress_bar("self-test") as progress:
        held = held_cycles(robot=robot, model=model, method=method, core=core, progress=progress)
    if json is not None:
        write_json(json, held.json())
    show_table("", *held.table())
    for line in held.reasons():
        typer.echo(line)
    if held.shortest() is None:
        raise typer.Exit(1)
