"""The verb that makes a world of recordings: twin."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from scenes.commands.common import JsonResults, RobotName, Seed, progress_bar, show_table, write_signed
from scenes.commands.recordings import Controller

Recorded = Annotated[list[Path], typer.Argument(help="Recordings of free motion (Parquet, CSV, ROS 2 bag or MCAP).")]
World = Annotated[Path, typer.Option("-o", "--output", help="Where the twin goes (.toml): a scene with its world.")]
Draws = Annotated[int, typer.Option(help="Follow the scene's line with that many of the twin's individuals, and say "
                                         "what accuracy to expect; ten take some twenty minutes.", min=0, max=100)]


def twin(
    recordings: Recorded,
    robot: RobotName,
    output: World,
    controller: Controller = None,
    draws: Draws = 0,
    seed: Seed = None,
    json: JsonResults = None,
) -> None:
    """Makes a simulated arm of recordings, so that scenes tell what accuracy to expect on the recorded one.

    What the recordings tell is identified: masses, rotors, friction, controllers, gears, noise and the residual with
    its spectrum. For the rest a class's values are taken, with their spread: each individual draws its own. The twin
    plays the recorded motion, and its torques are shown beside the measured ones.

    Example, after that of `plan-identification`:
    `ideal-robot twin out/plan/recording.parquet --robot kr6 -o my_arm.toml`
    """
    from ideal_robot.errors import InputError
    from ideal_robot.identification.whole_model import identify_model, with_given_controller
    from ideal_robot.progress import part_of
    from ideal_robot.signals.recording import Recording
    from ideal_robot.whole_file import whole_files
    from scenes.arms import arm_of
    from scenes.identification.twin_play import COLUMNS, make_twin, twin_text
    from scenes.outputs import check_outputs
    from scenes.scene_files.scene import NAME

    if output.suffix != ".toml" or not NAME.fullmatch(output.stem):
        raise InputError("expected a file name of letters and digits that ends in .toml", field="--output",
                         value=str(output))
    check_outputs(output=output, json=json)
    with progress_bar("twin") as progress:
        arm = arm_of(robot)
        loaded = [Recording.read(path) for path in recordings]
        analysis = identify_model(loaded, arm, progress=part_of(progress, 0.0, 0.5))
        if controller is not None:
            analysis = with_given_controller(analysis, controller, arm)
        found = make_twin(loaded, robot, analysis=analysis, seed=1 if seed is None else seed, progress=progress)
        with whole_files(output, json) as (scene_file, json_file):
            if scene_file is not None:
                scene_file.write_text(twin_text(found.twin, robot, output.stem), encoding="utf-8")
            write_signed(json_file, {**found.to_dict(), "output": output})
    show_table("the twin along the recorded motion", COLUMNS, found.rows())
    for line in (*(f"told: {one}" for one in found.twin.seen), *(f"assumed: {one}" for one in found.twin.assumed)):
        typer.echo(line)
    typer.echo(f"twin: {output}")
    _expected(output, arm.n, draws)


def _place(scene: Path) -> str:
    """The path as verbs take it: one without a folder would be the name of a shipped scene."""
    return str(scene) if scene.is_absolute() or scene.parent != Path() else f"./{scene}"


def _expected(scene: Path, joints: int, draws: int) -> None:
    """Says what line error the twin's individuals make, or how to ask for it."""
    import numpy as np

    from scenes.sweep import jobs, sweep

    if joints < 5:
        typer.echo("an arm of fewer than five joints follows no line: the file holds its world alone")
        return
    if not draws:
        typer.echo(f"what accuracy to expect: ideal-robot sweep {_place(scene)} --individuals 1-10")
        return
    work: list[Any] = [one for k in range(1, draws + 1) for one in jobs([_place(scene)], [], [], [k], [k])]
    with progress_bar(f"{draws} individuals") as progress:
        answers = sweep(work, done=lambda count: progress(count / len(work), f"{count} of {len(work)}"))
    errors = [answer["control_error_mm"] for answer in answers if not answer.get("failure") and
              "control_error_mm" in answer]
    if not errors:
        typer.echo("none of them reached the end of the line", err=True)
        raise typer.Exit(1)
    mean, p95 = (np.array([one[key] for one in errors]) for key in ("mean", "p95"))
    typer.echo(f"to expect on this arm: {mean.mean():.3f} mm on average ({mean.min():.3f} to {mean.max():.3f}), 95 % "
               f"within {p95.min():.3f} to {p95.max():.3f} mm; {len(errors)} of {draws} individuals")
