"""``ideal-robot run``: plays a scene."""

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
    tolerance: Annotated[str | None, typer.Option(help="Of a line: play at the fastest speed at which 95 % of the way "
                                                       "lie within this, e.g. 0.2mm.")] = None,
    method: Annotated[str | None, typer.Option(help="How the path is corrected, e.g. none or ideal.")] = None,
    video: Annotated[Path | None, typer.Option(help="Write a film of the run to this file (.mp4 or .gif).")] = None,
    json: Annotated[Path | None, typer.Option(help="Write the figures as JSON to this file.")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder for recording and report; default out/SCENE.")] = None,
) -> None:
    """Plays a scene and writes its recording and a report.

    Example: `ideal-robot run line --speed 0.7 --seed 3 --json line.json --video line.gif`

    Example: `ideal-robot run line --tolerance 0.2mm`
    """
    from ideal_robot.errors import InputError
    from ideal_robot.whole_file import whole_files
    from scenes.commands.common import closed, length
    from scenes.kind import kind_of
    from scenes.line.compare import fastest
    from scenes.line.result import LineResult
    from scenes.outputs import check_outputs, folders_held
    from scenes.report.page import write_json
    from scenes.report.video import check_video, write_video
    from scenes.result import part_of
    from scenes.scene_file import load_scene
    from scenes.scene_files.line_scene import LineScene
    from scenes.scene_files.scene import chosen
    from scenes.terminal import progress_bar

    loaded = chosen(load_scene(scene), speed=speed, seed=seed, individual=individual, n_d=n_d,
                    world=world)
    allowed = None if tolerance is None else length(tolerance, "--tolerance")
    if allowed is not None and not isinstance(loaded, LineScene):
        raise InputError(f"scenes of kind {loaded.kind} have no tolerance", field="--tolerance", value=tolerance)
    if allowed is not None and speed is not None:
        raise InputError("gives the speed itself: leave --speed away", field="--tolerance", value=tolerance)
    folder = out or Path("out") / loaded.name
    check_outputs({"--out": folder}, json=json, video=video)
    kind = kind_of(loaded)
    if video is not None:
        check_video(video)
        if kind.replay is None:
            raise InputError(f"scenes of kind {loaded.kind} have nothing that moves", field="--video", value=str(video))
    with folders_held(), progress_bar(f"{loaded.name}") as progress:
        found = None
        if allowed is not None and isinstance(loaded, LineScene):
            found = fastest(loaded, allowed, method=method, progress=part_of(progress, 0.0, 0.5))
            loaded = chosen(loaded, speed=found.speed)
        played = part_of(progress, 0.0, 1.0 if video is None else 0.5)
        result = kind.run(loaded, method=method, out=folder, progress=played)
        replay = None if video is None or kind.replay is None else kind.replay(result)
        with whole_files(video, json) as (film, figures):
            if replay is not None:
                write_video(replay, film, progress=part_of(progress, 0.5, 0.5))
            if figures is not None:
                write_json(figures, {**result.json(), **({} if found is None else {"fastest": found.json()})})
    if found is not None and isinstance(result, LineResult):
        typer.echo(f"fastest speed within {1e3 * found.tolerance:g} mm: {found.speed:.2f} m/s; 95 % predicted "
                   f"{1e3 * found.predicted:.3f} mm, reached {1e3 * result.control_error.p95:.3f} mm")
    closed(result)
    if replay is not None:
        typer.echo(f"film: {video}")
