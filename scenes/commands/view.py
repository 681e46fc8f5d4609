"""``ideal-robot view``: an arm, a scene or a recording in a browser."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer


def command(
    what: Annotated[str, typer.Argument(help="A scene (name or .toml), a recording (.parquet, .csv) or a robot.")],
    robot: Annotated[str | None, typer.Option(help="Robot or URDF, where a recording does not say it.")] = None,
    port: Annotated[int, typer.Option(help="TCP port on this machine.", min=1, max=65535)] = 8080,
    once: Annotated[bool, typer.Option("--once", help="Set the page up and leave: a check without a browser.")] = False,
) -> None:
    """Shows an arm in a browser: a robot at home, a scene with its line, or a recording played.

    Example: `ideal-robot view out/line/recording.parquet`
    """
    from ideal_robot.robots.robot import SHIPPED, Robot
    from scenes.kind import kind_of
    from scenes.scene_file import load_scene
    from scenes.view.viewer import Viewer, open_recording

    recording = None
    curves: dict = {}
    if Path(what).suffix in (".parquet", ".csv"):
        arm, recording = open_recording(Path(what), robot)
    elif what in SHIPPED or Path(what).suffix == ".urdf":
        arm = Robot.load(what)
    else:
        scene = load_scene(what)
        arm = Robot.load(scene.robot)
        draw = kind_of(scene).curves
        curves = {} if draw is None else draw(scene)
    viewer = Viewer(arm, port)
    colours = ((40, 40, 40), (224, 106, 0), (0, 110, 190))
    for (name, points), colour in zip(curves.items(), colours, strict=False):
        viewer.draw(name, points, colour)
    typer.echo(f"open http://127.0.0.1:{port} in a browser; Ctrl-C ends")
    if once:
        return
    try:
        if recording is not None:
            viewer.play(recording)
        while True:
            time.sleep(1.0)
    except KeyboardInterrupt:
        typer.echo("closed")
