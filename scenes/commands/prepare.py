"""``ideal-robot prepare``: what an arm needs once, a model of its own."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def command(
    scene: Annotated[str, typer.Argument(help="Name of a shipped scene, or path of a scene file (.toml).")],
    individual: Annotated[int | None, typer.Option(help="Arm of the type instead of the scene's.", min=0)] = None,
    json: Annotated[Path | None, typer.Option(help="Write the figures as JSON to this file.")] = None,
    out: Annotated[Path | None, typer.Option(help="Copy the model to this file.")] = None,
) -> None:
    """Moves the scene's simulated arm for its identification and keeps the model, as one does with a real arm once.

    The model is kept in the user's cache folder (`IDEAL_ROBOT_CACHE`) under what it depends on, and `run`, `compare`
    and `sweep` take it with `--individual`, preparing it where that has not been done. The camera is calibrated by
    moving at the beginning of each run.

    Example: `ideal-robot prepare line --individual 3`
    """
    from ideal_robot.model.model import Model
    from ideal_robot.robots.robot import Robot
    from scenes.commands.common import show_table
    from scenes.models import prepared_model
    from scenes.outputs import check_outputs
    from scenes.report.page import write_json
    from scenes.scene_file import load_scene
    from scenes.scene_files.scene import chosen
    from scenes.terminal import progress_bar
    from sim.arm.world import World

    loaded = chosen(load_scene(scene), individual=individual)
    check_outputs(json=json, out=out)
    world = World.from_table(loaded.robot, loaded.arm_world, loaded.source)
    with progress_bar(f"{loaded.robot} {world.individual}") as progress:
        prepared = prepared_model(Robot.load(loaded.robot), world, progress)
    model = Model.load(prepared.path)
    path = prepared.path if out is None else model.save(out)
    if json is not None:
        write_json(json, {"robot": loaded.robot, "individual": world.individual, "model": path,
                          "identified_now": prepared.fresh, "noise_std_N_m": model.noise_std})
    show_table("", ["figure", "value"], [
        ["arm", f"{loaded.robot}, individual {world.individual}"],
        ["identified", "now" if prepared.fresh else "before"],
        ["torque left, N m", ", ".join(f"{one:.3g}" for one in model.noise_std)]])
    typer.echo(f"model: {path}")
