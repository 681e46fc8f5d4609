"""Verbs that play scenes: run, compare, sweep, close-loop, prepare."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ideal_robot.deadline import TIME_LIMIT
from ideal_robot.errors import InputError
from ideal_robot.progress import part_of
from ideal_robot.whole_file import inert, whole_files
from scenes.commands.common import (
    Individual,
    JsonFigures,
    SceneName,
    Seed,
    Speed,
    TimeLimit,
    closed,
    length,
    numbers,
    progress_bar,
    scenes_there,
    show_table,
    whole_numbers,
    write_signed,
)
from scenes.outputs import check_outputs, folders_held
from scenes.scene_file import load_scene

if TYPE_CHECKING:
    import pandas as pd

    from scenes.scene_files.scene import Scene


@dataclass(kw_only=True)
class PlayedScene:
    """Options that name a scene and replace values of its file."""

    scene: SceneName
    speed: Speed = None
    seed: Seed = None
    individual: Individual = None
    world: Annotated[str | None, typer.Option(help="World that it runs in instead of the scene's: workshop, cell or "
                                                   "bench.")] = None
    n_d: Annotated[int | None, typer.Option("--n-d", help="Desired positions the feedforward is given, from 1 "
                                                          "up.")] = None

    def load(self) -> Scene:
        """Loads the scene with these values."""
        from scenes.scene_files.scene import chosen

        return chosen(load_scene(self.scene), speed=self.speed, seed=self.seed, individual=self.individual,
                      n_d=self.n_d, world=self.world)


@dataclass(kw_only=True)
class RunOptions(PlayedScene):
    """Options of ``run``."""

    tolerance: Annotated[str | None, typer.Option(help="Of a line: play at the fastest speed at which 95 % of the way "
                                                       "lie within this, e.g. 0.2mm.")] = None
    method: Annotated[str | None, typer.Option(help="How the path is corrected, e.g. none or ideal.")] = None
    video: Annotated[Path | None, typer.Option(help="Write a film of the run here (.mp4, .gif or .webp).")] = None
    json: JsonFigures = None
    out: Annotated[Path | None, typer.Option(help="Folder for recording and report; default out/SCENE.")] = None

    def allowed(self, scene: Scene) -> float | None:
        """Tolerance for 95 % of the path [m], if given; InputError for no length, no line, or a speed beside it."""
        from scenes.scene_files.line_scene import LineScene

        if self.tolerance is None:
            return None
        error = length(self.tolerance, "--tolerance")
        if not isinstance(scene, LineScene):
            raise InputError(f"only scenes of kind line have a tolerance, not of kind {scene.kind}; leave it out",
                             field="--tolerance", value=self.tolerance)
        if self.speed is not None:
            raise InputError("chooses the speed itself: leave --speed out", field="--tolerance", value=self.tolerance)
        return error


def run(options: RunOptions) -> None:
    """Runs a scene and writes its recording and a report.

    Example: `ideal-robot run line --speed 0.7 --seed 3 --json line.json --video line.gif`

    Example: `ideal-robot run line --tolerance 0.2mm`
    """
    from scenes.kind import kind_of
    from scenes.line.compare import fastest
    from scenes.line.result import LineResult
    from scenes.report.video import check_video, write_video
    from scenes.scene_files.line_scene import LineScene
    from scenes.scene_files.scene import chosen

    loaded = options.load()
    allowed, kind = options.allowed(loaded), kind_of(loaded)
    folder = options.out or Path("out") / loaded.name
    check_outputs({"--out": folder}, json=options.json, video=options.video)
    if options.video is not None:
        check_video(options.video)
        if kind.replay is None:
            raise InputError(f"scenes of kind {loaded.kind} have no motion to show", field="--video",
                             value=str(options.video))
    with folders_held(), progress_bar(f"{loaded.name}") as progress:
        quickest = None
        if allowed is not None and isinstance(loaded, LineScene):
            quickest = fastest(loaded, allowed, method=options.method, progress=part_of(progress, 0.0, 0.5))
            loaded = chosen(loaded, speed=quickest.speed)
        played = part_of(progress, 0.0, 1.0 if options.video is None else 0.5)
        result = kind.run(loaded, method=options.method, out=folder, progress=played)
        replay = None if options.video is None or kind.replay is None else kind.replay(result)
        with whole_files(options.video, options.json) as (film, figures):
            if replay is not None:
                write_video(replay, film, progress=part_of(progress, 0.5, 0.5))
            write_signed(figures, {**result.json(),
                                   **({} if quickest is None else {"fastest": quickest.json()})})
    if quickest is not None and isinstance(result, LineResult):
        typer.echo(f"fastest speed within {1e3 * quickest.tolerance:g} mm: {quickest.speed:.2f} m/s; 95 % predicted "
                   f"{1e3 * quickest.predicted:.3f} mm, reached {1e3 * result.control_error.p95:.3f} mm")
    closed(result)
    if replay is not None:
        typer.echo(f"film: {options.video}")


@dataclass(kw_only=True)
class CompareOptions(PlayedScene):
    """Options of ``compare``."""

    methods: Annotated[str, typer.Option(help="Methods, separated by commas, with their settings where wanted "
                                              "(precorrected-printed); default: all methods that apply.")] = ""
    json: JsonFigures = None
    out: Annotated[Path | None, typer.Option(help="Folder of the report; default out/compare_SCENE.")] = None


def compare(options: CompareOptions) -> None:
    """Plays a scene with every method that applies and compares them: one table, one picture.

    Example: `ideal-robot compare line --speed 0.7`
    """
    from scenes.kind import kind_of

    loaded = options.load()
    folder = options.out or Path("out") / f"compare_{loaded.name}"
    check_outputs({"--out": folder}, json=options.json)
    with folders_held(), progress_bar(f"{loaded.name}") as progress:
        keys = [key.strip() for key in options.methods.split(",") if key.strip()]
        result = kind_of(loaded).compare(loaded, methods=keys or None, out=folder, progress=progress)
        write_signed(options.json, result.json())
    columns, rows = result.table()
    show_table(f"{loaded.title}", columns, rows)
    if result.report is not None:
        typer.echo(f"report: {result.report}")


@dataclass(kw_only=True)
class SweepOptions:
    """Options of ``sweep``."""

    scenes: Annotated[list[str], typer.Argument(help="Scenes, by name or path.", callback=scenes_there)]
    speeds: Annotated[str, typer.Option(help="Speeds [m/s], separated by commas.")] = ""
    seeds: Annotated[str, typer.Option(help="Seeds: a list 1,2,5 or a range 1-10.")] = ""
    individuals: Annotated[str, typer.Option("--individuals", "--individual", help="Arms of the type, each with a "
                                             "model of its own (see prepare): a list 1,2,5 or a range 1-10.")] = ""
    world: Annotated[str | None, typer.Option(help="Where they play instead of the scenes' worlds: workshop, cell or "
                                                   "bench.")] = None
    methods: Annotated[str, typer.Option(help="Methods, separated by commas.")] = ""
    processes: Annotated[int, typer.Option(help="Local processes.", min=1)] = 2
    dask: Annotated[str | None, typer.Option(help="Address of a running Dask scheduler instead.")] = None
    lines: Annotated[Path | None, typer.Option(help="Append each answer to this file as it comes (JSON "
                                                    "lines).")] = None
    runs: Annotated[Path | None, typer.Option(help="Folder of a Parquet data set of the answers, partitioned by scene, "
                                                   "which grows as they come and can be queried meanwhile.")] = None
    resume: Annotated[bool, typer.Option("--resume", help="Go on with what --lines or --runs hold: such runs of this "
                                                          "version are not played again.")] = False
    time_limit: TimeLimit = TIME_LIMIT
    json: Annotated[Path | None, typer.Option(help="Write all answers as JSON to this file.")] = None
    csv: Annotated[Path | None, typer.Option(help="Write the table as CSV to this file.")] = None


def sweep(options: SweepOptions) -> None:
    """Plays many runs and prints one table of their errors; a run that fails is a row, not the end.

    A run whose process or worker was lost is not played: it stands in the table, not in what `--lines` or `--runs`
    keep, and `--resume` plays it. Exit code 1 where runs were not played, or none succeeded.

    Example: `ideal-robot sweep straight --speeds 0.4,0.7 --seeds 1-2 --lines runs.jsonl --resume`
    """
    from scenes.regression.history_page import run_command
    from scenes.regression.results import RunSet
    from scenes.sweep import FIGURES, Kept, SweepFile, jobs, sweep

    work = jobs(options.scenes, [key.strip() for key in options.methods.split(",") if key.strip()],
                numbers(options.speeds, "--speeds"), whole_numbers(options.seeds, "--seeds"),
                whole_numbers(options.individuals, "--individuals"), options.world)
    check_outputs({"--runs": options.runs}, json=options.json, csv=options.csv, lines=options.lines)
    if options.resume and options.lines is None and options.runs is None:
        raise InputError("needs --lines FILE or --runs FOLDER, with the runs to be continued", field="--resume")
    if options.lines is not None and options.runs is not None:
        raise InputError("keeps the same answers as --lines; give one of them", field="--runs", value=str(options.runs))
    file: Kept | None = None if options.lines is None else SweepFile(options.lines, resume=options.resume)
    file = file if options.runs is None else RunSet(options.runs, resume=options.resume)
    with progress_bar(f"{len(work)} runs") as progress:
        answers = sweep(work, processes=options.processes, dask=options.dask, file=file, limit=options.time_limit,
                        done=lambda count, _: progress(count / len(work), f"{count} of {len(work)}"))
    table = _show_swept(answers, with_arm=bool(options.individuals))
    # The table is shown first, so that the result is seen even if the disk takes no file.
    with whole_files(options.json, options.csv) as (json_file, csv_file):
        write_signed(json_file, {"runs": answers})
        if csv_file is not None:
            table.map(lambda value: inert(value) if isinstance(value, str) else value).to_csv(csv_file, index=False)
    named = {load_scene(scene).name: scene for scene in options.scenes}
    if (key := next((key for key in [*FIGURES][1:] if key in table and table[key].notna().any()), None)) is not None:
        worst = answers[int(table[key].astype(float).argmax())]
        typer.echo(f"next: Look at the run with the largest {FIGURES[key]}. "
                   f"{run_command(worst, named.get(str(worst['scene'])))}")
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
    figures = [title for title in names.values() if title != "m/s"]
    groups = frame.groupby(kinds, sort=False, dropna=False)
    worst, counts = groups[figures].max().reset_index(), groups.size().to_numpy()
    show_table("sweep", shown, frame[shown].astype(object).where(frame[shown].notna(), None).to_numpy().tolist())
    rows = [[*row, int(count)] for row, count in zip(worst.astype(object).to_numpy().tolist(), counts, strict=True)]
    show_table("largest of each kind of run", [*kinds, *figures, "runs"], rows)
    return frame[shown].rename(columns={title: key for key, title in names.items()})


def close_loop(
    scene: Annotated[str, typer.Argument(help="Scene that holds an effect which its model lacks, e.g. "
                                              "close_elastic, close_stribeck, close_latency, close_camera, "
                                              "close_force, close_clamped.", callback=scenes_there)],
    seed: Seed = None,
    individual: Individual = None,
    speed: Speed = None,
    measured: Annotated[str, typer.Option(help="What the arm measures: motor (angles and currents), arm (arm angles "
                                               "too) or tcp (the tool's place too).")] = "tcp",
    world: Annotated[str | None, typer.Option(help="World that it runs in instead of the scene's: workshop, bench or "
                                                   "cell, where drives do what no model knows.")] = None,
    json: JsonFigures = None,
    out: Annotated[Path | None, typer.Option(help="Folder of recording, model and report; default out/SCENE.")] = None,
) -> None:
    """Plays a scene, finds what its model misses from a diagnostic motion, extends the model and plays it again.

    Example: `ideal-robot close-loop close_elastic --json circle.json`, `ideal-robot close-loop line --world cell`
    """
    from scenes.play import close_scene
    from scenes.scene_files.scene import chosen

    loaded = chosen(load_scene(scene), speed=speed, seed=seed, individual=individual, world=world)
    folder = out or Path("out") / loaded.name
    check_outputs({"--out": folder}, json=json)
    with folders_held(), progress_bar(f"{loaded.name}") as progress:
        result = close_scene(loaded, measured=measured, out=folder, progress=progress)
        write_signed(json, result.json())
    for title, (columns, rows) in (("what was tried", result.ladder()), ("before and after", result.rows())):
        show_table(title, list(columns), rows)
    if (plan := result.json().get("plan")) is not None:
        separated = sum(pair["told_apart"] for pair in plan.get("pairs", []))
        typer.echo(f"requested in round {plan['round']}: "
                   + (f"a motion of {plan['duration_s']:.0f} s, played, that tells {separated} of "
                      f"{len(plan['pairs'])} pairs" if plan["played"] else str(plan["reason"])))
    for refused in result.refusals():
        typer.echo(refused)
    typer.echo(result.answer())
    typer.echo(f"report: {result.report}")


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
    from ideal_robot.results import one_unit
    from scenes.arms import arm_of
    from scenes.models import prepared_model
    from scenes.scene_files.scene import boxes_of, chosen
    from sim.arm.world import World

    loaded = chosen(load_scene(scene), individual=individual)
    check_outputs(json=json, out=out)
    world = World.from_table(loaded.robot, loaded.arm_world, loaded.source)
    with progress_bar(f"{loaded.robot} {world.individual}") as progress:
        prepared = prepared_model(arm_of(loaded.robot), world, progress, boxes_of(loaded))
    model = Model.load(prepared.path)
    path = prepared.path if out is None else model.save(out)
    write_signed(json, {"robot": loaded.robot, "individual": world.individual, "model": path,
                 "identified_now": prepared.fresh, "noise_std_N_m": model.noise_std})
    show_table("", ["figure", "value"], [
        ["arm", f"{loaded.robot}, individual {world.individual}"],
        ["identified", "now" if prepared.fresh else "before"],
        ["torque left, " + one_unit(model.units("N m")), ", ".join(f"{std:.3g}" for std in model.noise_std)]])
    typer.echo(f"model: {path}")
