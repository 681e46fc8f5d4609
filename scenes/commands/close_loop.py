"""``ideal-robot close-loop``: run, diagnose, extend the model, run again."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def command(
    scene: Annotated[str, typer.Argument(help="Scene that holds an effect which its model lacks, e.g. "
                                              "close_elastic, close_stribeck, close_latency, close_camera, "
                                              "close_force, close_clamped.")],
    seed: Annotated[int | None, typer.Option(help="Seed instead of the scene's.", min=0)] = None,
    individual: Annotated[int | None, typer.Option(help="Arm of the type, with a model of its own (see "
                                                        "prepare).", min=0)] = None,
    speed: Annotated[float | None, typer.Option(help="Path speed [m/s] instead of the scene's.")] = None,
    measured: Annotated[str, typer.Option(help="What the arm measures: motor (angles and currents), arm (arm angles "
                                               "too) or tcp (the tool's place too).")] = "tcp",
    json: Annotated[Path | None, typer.Option(help="Write the figures as JSON to this file.")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder of recording, model and report; default out/SCENE.")] = None,
) -> None:
    """Plays a scene, finds what its model misses from a diagnostic motion, extends the model and plays it again.

    Example: `ideal-robot close-loop close_elastic --json circle.json`
    """
    from scenes.commands.common import show_table
    from scenes.diagnosis.page import summary
    from scenes.outputs import check_outputs, folders_held
    from scenes.play import close_scene
    from scenes.report.page import write_json
    from scenes.scene_file import load_scene
    from scenes.scene_files.scene import chosen
    from scenes.terminal import progress_bar

    loaded = chosen(load_scene(scene), speed=speed, seed=seed, individual=individual)
    folder = out or Path("out") / loaded.name
    check_outputs({"--out": folder}, json=json)
    with folders_held(), progress_bar(f"{loaded.name}") as progress:
        result = close_scene(loaded, measured=measured, out=folder, progress=progress)
        if json is not None:
            write_json(json, result.json())
    if rows := result.ladder():
        show_table("what was tried", ["round", "change of the model", "stays", result.tried_by, "why not"], rows)
    show_table("before and after", list(result.columns), result.table())
    if (asked := result.json().get("plan")) is not None:
        told = sum(pair["told_apart"] for pair in asked.get("pairs", []))
        typer.echo(f"asked for in round {asked['round']}: "
                   + (f"a motion of {asked['duration_s']:.0f} s, played, that tells {told} of "
                      f"{len(asked['pairs'])} pairs" if asked["played"] else str(asked["reason"])))
    if result.diagnosis is not None:
        typer.echo(summary(result.diagnosis))
    typer.echo(f"report: {result.report}")
