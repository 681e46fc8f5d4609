"""``ideal-robot compare``: one scene, every method that applies, one table and one picture."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def command(
    scene: Annotated[str, typer.Argument(help="Name of a shipped scene, or path of a scene file (.toml).")],
    speed: Annotated[float | None, typer.Option(help="Path speed [m/s] instead of the scene's.")] = None,
    seed: Annotated[int | None, typer.Option(help="Seed instead of the scene's.", min=0)] = None,
    individual: Annotated[int | None, typer.Option(help="Arm of the type, with a model of its own (see "
                                                        "prepare).", min=0)] = None,
    world: Annotated[str | None, typer.Option(help="Where it plays instead of the scene's world: workshop or "
                                                   "bench.")] = None,
    n_d: Annotated[int | None, typer.Option("--n-d", help="Desired positions the feedforward is given, from 1 "
                                                          "up.")] = None,
    json: Annotated[Path | None, typer.Option(help="Write the figures as JSON to this file.")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder of the report; default out/compare_SCENE.")] = None,
) -> None:
    """Plays a scene with every method that applies and compares them: one table, one picture.

    Example: `ideal-robot compare line --speed 0.7`
    """
    from scenes.commands.common import show_table
    from scenes.kind import kind_of
    from scenes.outputs import check_outputs, folders_held
    from scenes.report.page import write_json
    from scenes.scene_file import load_scene
    from scenes.scene_files.scene import chosen
    from scenes.terminal import progress_bar

    loaded = chosen(load_scene(scene), speed=speed, seed=seed, individual=individual, n_d=n_d,
                    world=world)
    folder = out or Path("out") / f"compare_{loaded.name}"
    check_outputs({"--out": folder}, json=json)
    with folders_held(), progress_bar(f"{loaded.name}") as progress:
        result = kind_of(loaded).compare(loaded, out=folder, progress=progress)
        if json is not None:
            write_json(json, result.json())
    columns, rows = result.table()
    show_table(f"{loaded.title}", columns, rows)
    if result.report is not None:
        typer.echo(f"report: {result.report}")
