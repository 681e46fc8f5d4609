"""Verbs that play scenes: run, compare, sweep, close-loop, prepare."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from scenes.commands.common import (
    Horizon,
    Individual,
    JsonFigures,
    SceneName,
    Seed,
    Speed,
    TimeLimit,
    WorldName,
    closed,
    length,
    numbers,
    progress_bar,
    show_table,
    whole_numbers,
)
from scenes.workers import TIME_LIMIT

if TYPE_CHECKING:
    import pandas as pd


def run(
    scene: SceneName,
    speed: Speed = None,
    seed: Seed = None,
    individual: Individual = None,
    world: WorldName = None,
    n_d: Horizon = None,
    tolerance: Annotated[str | None, typer.Option(help="Of a line: play at the fastest speed at which 95 % of the way "
                                                       "lie within this, e.g. 0.2mm.")] = None,
    method: Annotated[str | None, typer.Option(help="How the path is corrected, e.g. none or ideal.")] = None,
    video: Annotated[Path | None, typer.Option(help="Write a film of the run to this file (.mp4 or .gif).")] = None,
    json: JsonFigures = None,
    out: Annotated[Path | None, typer.Option(help="Folder for recording and report; default out/SCENE.")] = None,
) -> None:
    """Plays a scene and writes its recording and a report.

    Example: `ideal-robot run line --speed 0.7 --seed 3 --json line.json --video line.gif`

    Example: `ideal-robot run line --tolerance 0.2mm`
    """
    from ideal_robot.errors import InputError
    from ideal_robot.whole_file import whole_files
    from scenes.kind import kind_of
    from scenes.line.compare import fastest
    from scenes.line.result import LineResult
    from scenes.outputs import check_outputs, folders_held
    from scenes.program import signed
    from scenes.report.page import write_json
    from scenes.report.video import check_video, write_video
    from scenes.result import part_of
    from scenes.scene_file import load_scene
    from scenes.scene_files.line_scene import LineScene
    from scenes.scene_files.scene import chosen

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
                write_json(figures, signed({**result.json(),
                                            **({} if found is None else {"fastest": found.json()})}))
    if found is not None and isinstance(result, LineResult):
        typer.echo(f"fastest speed within {1e3 * found.tolerance:g} mm: {found.speed:.2f} m/s; 95 % predicted "
                   f"{1e3 * found.predicted:.3f} mm, reached {1e3 * result.control_error.p95:.3f} mm")
    closed(result)
    if replay is not None:
        typer.echo(f"film: {video}")


def compare(
    scene: SceneName,
    speed: Speed = None,
    seed: Seed = None,
    individual: Individual = None,
    world: WorldName = None,
    n_d: Horizon = None,
    json: JsonFigures = None,
    out: Annotated[Path | None, typer.Option(help="Folder of the report; default out/compare_SCENE.")] = None,
) -> None:
    """Plays a scene with every method that applies and compares them: one table, one picture.

    Example: `ideal-robot compare line --speed 0.7`
    """
    from scenes.kind import kind_of
    from scenes.outputs import check_outputs, folders_held
    from scenes.program import signed
    from scenes.report.page import write_json
    from scenes.scene_file import load_scene
    from scenes.scene_files.scene import chosen

    loaded = chosen(load_scene(scene), speed=speed, seed=seed, individual=individual, n_d=n_d,
                    world=world)
    folder = out or Path("out") / f"compare_{loaded.name}"
    check_outputs({"--out": folder}, json=json)
    with folders_held(), progress_bar(f"{loaded.name}") as progress:
        result = kind_of(loaded).compare(loaded, out=folder, progress=progress)
        if json is not None:
            write_json(json, signed(result.json()))
    columns, rows = result.table()
    show_table(f"{loaded.title}", columns, rows)
    if result.report is not None:
        typer.echo(f"report: {result.report}")


def sweep(
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
    runs: Annotated[Path | None, typer.Option(help="Folder of a Parquet data set of the answers, partitioned by scene, "
                                                   "which grows as they come and can be queried meanwhile.")] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with what --lines or --runs hold: such runs of this "
                                                          "version are not played again.")] = False,
    time_limit: TimeLimit = TIME_LIMIT,
    json: Annotated[Path | None, typer.Option(help="Write all answers as JSON to this file.")] = None,
    csv: Annotated[Path | None, typer.Option(help="Write the table as CSV to this file.")] = None,
) -> None:
    """Plays many runs and prints one table of their errors; a run that fails is a row, not the end.

    A run whose process or worker was lost is not played: it stands in the table, not in what `--lines` or `--runs`
    keep, and `--resume` plays it. Exit code 1 where runs were not played, or none succeeded.

    Example: `ideal-robot sweep straight --speeds 0.4,0.7 --seeds 1-2 --lines runs.jsonl --resume`
    """
    from ideal_robot.errors import InputError
    from ideal_robot.whole_file import inert, whole_files
    from scenes.outputs import check_outputs
    from scenes.program import signed
    from scenes.report.page import write_json
    from scenes.run_set import RunSet
    from scenes.sweep import Kept, SweepFile, jobs, sweep

    work = jobs(scenes, [key.strip() for key in methods.split(",") if key.strip()],
                numbers(speeds, "--speeds"), whole_numbers(seeds, "--seeds"),
                whole_numbers(individuals, "--individuals"), world)
    check_outputs({"--runs": runs}, json=json, csv=csv, lines=lines)
    if resume and lines is None and runs is None:
        raise InputError("needs --lines FILE or --runs FOLDER, what to go on with", field="--resume")
    if lines is not None and runs is not None:
        raise InputError("keeps the same answers as --lines; give one of them", field="--runs", value=str(runs))
    file: Kept | None = None if lines is None else SweepFile(lines, resume=resume)
    file = file if runs is None else RunSet(runs, resume=resume)
    with progress_bar(f"{len(work)} runs") as progress:
        answers = sweep(work, processes=processes, dask=dask, file=file, limit=time_limit,
                        done=lambda count: progress(count / len(work), f"{count} of {len(work)}"))
    table = _show_swept(answers, with_arm=bool(individuals))
    # Shown first: what no disk takes is read at least.
    with whole_files(json, csv) as (json_file, csv_file):
        if json_file is not None:
            write_json(json_file, signed({"runs": answers}))
        if csv_file is not None:
            table.map(lambda value: inert(value) if isinstance(value, str) else value).to_csv(csv_file, index=False)
    missing = sum("not_played" in answer for answer in answers)
    if missing:
        typer.echo(f"{missing} of {len(answers)} runs were not played; with --lines FILE and --resume the next sweep "
                   "plays them alone", err=True)
    if missing or all(answer.get("failure") for answer in answers):
        raise typer.Exit(1)


def _show_swept(answers: list[dict[str, Any]], *, with_arm: bool) -> pd.DataFrame:
    """Prints every run and the largest figures of each kind of run; returns the table of the runs, named as JSON."""
    import pandas as pd

    from scenes.sweep import FIGURES

    frame = pd.json_normalize(answers)
    names = {key: title for key, title in FIGURES.items() if key in frame}
    frame = frame.rename(columns=names)
    shown = ["scene", "method", *(["individual"] if with_arm else []), "seed", *names.values(), "failure"]
    kinds = [key for key in ("scene", "method", "m/s") if key in frame]
    figures = [title for title in names.values() if title not in ("m/s",)]
    worst = frame.groupby(kinds, sort=False, dropna=False)[figures].max().reset_index()
    counts = frame.groupby(kinds, sort=False, dropna=False).size().to_numpy()
    show_table("sweep", shown, frame[shown].astype(object).where(frame[shown].notna(), None).to_numpy().tolist())
    rows = [[*row, int(count)] for row, count in zip(worst.astype(object).to_numpy().tolist(), counts, strict=True)]
    show_table("largest of each kind of run", [*kinds, *figures, "runs"], rows)
    return frame[shown].rename(columns={title: key for key, title in names.items()})


def close_loop(
    scene: Annotated[str, typer.Argument(help="Scene that holds an effect which its model lacks, e.g. "
                                              "close_elastic, close_stribeck, close_latency, close_camera, "
                                              "close_force, close_clamped.")],
    seed: Seed = None,
    individual: Individual = None,
    speed: Speed = None,
    measured: Annotated[str, typer.Option(help="What the arm measures: motor (angles and currents), arm (arm angles "
                                               "too) or tcp (the tool's place too).")] = "tcp",
    json: JsonFigures = None,
    out: Annotated[Path | None, typer.Option(help="Folder of recording, model and report; default out/SCENE.")] = None,
) -> None:
    """Plays a scene, finds what its model misses from a diagnostic motion, extends the model and plays it again.

    Example: `ideal-robot close-loop close_elastic --json circle.json`
    """
    from scenes.diagnosis.page import summary
    from scenes.outputs import check_outputs, folders_held
    from scenes.play import close_scene
    from scenes.program import signed
    from scenes.report.page import write_json
    from scenes.scene_file import load_scene
    from scenes.scene_files.scene import chosen

    loaded = chosen(load_scene(scene), speed=speed, seed=seed, individual=individual)
    folder = out or Path("out") / loaded.name
    check_outputs({"--out": folder}, json=json)
    with folders_held(), progress_bar(f"{loaded.name}") as progress:
        result = close_scene(loaded, measured=measured, out=folder, progress=progress)
        if json is not None:
            write_json(json, signed(result.json()))
    for title, (columns, rows) in (("what was tried", result.ladder()), ("before and after", result.rows())):
        show_table(title, list(columns), rows)
    if (asked := result.json().get("plan")) is not None:
        told = sum(pair["told_apart"] for pair in asked.get("pairs", []))
        typer.echo(f"asked for in round {asked['round']}: "
                   + (f"a motion of {asked['duration_s']:.0f} s, played, that tells {told} of "
                      f"{len(asked['pairs'])} pairs" if asked["played"] else str(asked["reason"])))
    if result.diagnosis is not None:
        typer.echo(summary(result.diagnosis))
    typer.echo(f"report: {result.report}")
    for refused in result.refusals():
        typer.echo(refused)


def prepare(
    scene: SceneName,
    individual: Annotated[int | None, typer.Option(help="Arm of the type instead of the scene's.", min=0)] = None,
    json: JsonFigures = None,
    out: Annotated[Path | None, typer.Option(help="Copy the model to this file.")] = None,
) -> None:
    """Moves the scene's simulated arm for its identification and keeps the model, as one does with a real arm once.

    The model is kept in the user's cache folder (`IDEAL_ROBOT_CACHE`) under what it depends on, and `run`, `compare`
    and `sweep` take it with `--individual`, preparing it where that has not been done. The camera is calibrated by
    moving at the beginning of each run.

    Example: `ideal-robot prepare line --individual 3`
    """
    from ideal_robot.model.model import Model
    from scenes.arms import arm_of
    from scenes.models import prepared_model
    from scenes.outputs import check_outputs
    from scenes.program import signed
    from scenes.report.page import write_json
    from scenes.scene_file import load_scene
    from scenes.scene_files.scene import chosen
    from sim.arm.world import World

    loaded = chosen(load_scene(scene), individual=individual)
    check_outputs(json=json, out=out)
    world = World.from_table(loaded.robot, loaded.arm_world, loaded.source)
    with progress_bar(f"{loaded.robot} {world.individual}") as progress:
        prepared = prepared_model(arm_of(loaded.robot), world, progress)
    model = Model.load(prepared.path)
    path = prepared.path if out is None else model.save(out)
    if json is not None:
        write_json(json, signed({"robot": loaded.robot, "individual": world.individual, "model": path,
                          "identified_now": prepared.fresh, "noise_std_N_m": model.noise_std}))
    show_table("", ["figure", "value"], [
        ["arm", f"{loaded.robot}, individual {world.individual}"],
        ["identified", "now" if prepared.fresh else "before"],
        ["torque left, N m", ", ".join(f"{one:.3g}" for one in model.noise_std)]])
    typer.echo(f"model: {path}")
