"""``ideal-robot view``: an arm, a scene or a recording in a browser."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer


def command(
    what: Annotated[str, typer.Argument(help="A scene (name or .toml), a recording (.parquet, .csv) or a robot.")],
    robot: Annotated[str | None, typer.Option("--robot", "--urdf", help="Arm: name of a shipped robot, or path of a "
                                              "URDF; needed where a recording does not say it.")] = None,
    port: Annotated[int, typer.Option(help="TCP port on this machine; the next free one where it is taken.", min=1,
                                      max=65535)] = 8080,
    live: Annotated[Path | None, typer.Option(help="Folder of a run on devices that goes on or is about to begin, "
                                              "such as out/follow/line; WHAT is its scene.")] = None,
    once: Annotated[bool, typer.Option("--once", help="Set the page up and leave: a check without a browser.")] = False,
) -> None:
    """Shows an arm in a browser: a recording played, a scene played first and then shown, or a robot at home.

    With --live a run of `ideal-robot follow` is shown while it goes on, from the journal it writes.

    Example: `ideal-robot view out/line/recording.parquet`
    """
    from ideal_robot.robots.robot import SHIPPED, Robot
    from scenes.kind import kind_of
    from scenes.scene_file import load_scene
    from scenes.terminal import progress_bar
    from scenes.view.viewer import Player, Viewer, open_recording, recorded_replay

    if live is not None:
        from scenes.online.run import load_cell
        from scenes.scene_files.drawn_line import reference_points
        from scenes.view.live import watch

        cell = load_cell(what)
        page = watch(Robot.load(robot or cell.robot), live, port, {"reference": reference_points(cell)})  # type: ignore[arg-type]
        typer.echo(f"open http://127.0.0.1:{page.viewer.port} in a browser; Ctrl-C ends")
        try:
            while not once:
                page.update()
                time.sleep(0.1)
        except KeyboardInterrupt:
            typer.echo("closed")
        page.viewer.server.stop()
        return
    replay = None
    curves: dict = {}
    if Path(what).suffix in (".parquet", ".csv"):
        arm, recording = open_recording(Path(what), robot)
        replay = recorded_replay(Path(what), arm, recording)
    elif what in SHIPPED or Path(what).suffix == ".urdf":
        arm = Robot.load(what)
    else:
        scene = load_scene(what)
        kind = kind_of(scene)
        arm = Robot.load(scene.robot)
        if kind.replay is not None and not once:
            with progress_bar(scene.name) as progress:
                replay = kind.replay(kind.run(scene, progress=progress))
        elif kind.curves is not None:
            curves = kind.curves(scene)
    viewer = Viewer(arm, port)
    for (name, points), colour in zip(curves.items(), ((40, 40, 40), (224, 106, 0), (0, 110, 190)), strict=False):
        viewer.draw(name, points, colour)
    player = None if replay is None else Player(viewer, replay)
    typer.echo(f"open http://127.0.0.1:{viewer.port} in a browser; Ctrl-C ends")
    if once:
        viewer.server.stop()
        return
    try:
        if player is not None:
            player.play()
        while True:
            time.sleep(1.0)
    except KeyboardInterrupt:
        typer.echo("closed")
