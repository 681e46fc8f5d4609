"""Verbs on files: list, new, export, fetch, view, and twin, which makes a scene's file of recordings."""

from __future__ import annotations

import time
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ideal_robot.errors import InputError
from ideal_robot.progress import part_of
from ideal_robot.robots import SHIPPED, urdf_of
from ideal_robot.whole_file import whole_files, write_text
from scenes.commands.common import (
    ColumnsMap,
    JointNames,
    JsonResults,
    RobotName,
    Seed,
    StatesTopic,
    arm_there,
    progress_bar,
    recording_of,
    scenes_there,
    show_table,
    write_signed,
)
from scenes.commands.recordings import Controller
from scenes.outputs import check_outputs
from scenes.scene_file import library, load_scene

if TYPE_CHECKING:
    from ideal_robot.arrays import Array
    from ideal_robot.robots.robot import Robot
    from ideal_robot.signals.recording import Recording
    from scenes.report.replay import Replay


class What(StrEnum):
    """What the verb ``list`` can list."""

    SCENES = "scenes"
    ROBOTS = "robots"
    METHODS = "methods"
    EFFECTS = "effects"
    DETECTORS = "detectors"
    INTERFACES = "interfaces"
    KEYS = "keys"


def list_(
    what: Annotated[What, typer.Argument(help="scenes, robots, methods, effects, detectors, "
                                             "interfaces, or keys of scene files.")],
    kind: Annotated[str, typer.Option(help="With keys: of which kind of scene.")] = "line",
    json: Annotated[Path | None, typer.Option(help="Write the list as JSON to this file; with keys, the JSON Schema.",
                                              )] = None,
) -> None:
    """Lists scenes, robots, methods, effects, detectors and arms' interfaces, those of other packages included.

    Example: `ideal-robot list scenes`
    """
    from scenes.report.page import write_json
    from scenes.schema import catalogue, json_schema

    columns, rows = catalogue(what.value, kind)
    show_table(what.value, columns, rows)
    if json is not None:
        write_json(json, json_schema(kind) if what is What.KEYS
                   else {what.value: [dict(zip(columns, row, strict=True)) for row in rows]})


def new(
    name: Annotated[str, typer.Argument(help="Name of the scene; the file is NAME.toml in this folder.")],
    kind: Annotated[str, typer.Option(help="Kind of scene: line, path, force, clamped or close_clamped.")] = "line",
    robot: Annotated[str | None, typer.Option("--robot", "--urdf", help="Of a line: name of a shipped robot, or path "
                                              "of a URDF; surface, line and speed are chosen for it.",
                                              callback=arm_there)] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace a file of that name.")] = False,
) -> None:
    """Writes a scene file that can be played at once and says in comments which keys there are besides.

    Example: `ideal-robot new weld_seam --kind line`

    Example: `ideal-robot new my_line --robot my_arm.urdf`
    """
    from scenes.kind import KINDS
    from scenes.scene_files.scene import NAME
    from scenes.schema import commented_scene

    if not NAME.fullmatch(name):
        raise InputError("expected letters, digits and _ - + . ( ) or spaces", field="NAME", value=name)
    KINDS.get(kind)
    path = Path(f"{name}.toml")
    if path.exists() and not force:
        raise InputError("there is such a file already; take another name, or --force", file=path)
    examples = {"line": "line", "path": "iso9283_1", "force": "force_wave", "clamped": "clamped_kr500_1",
                "close_clamped": "close_clamped"}
    shipped = examples.get(kind)
    if shipped is None:
        raise InputError("no shipped scene is of that kind; see the documentation of the package that added it",
                         field="--kind", value=kind)
    example = (library() / f"{shipped}.toml").read_text(encoding="utf-8")
    if robot is not None:
        example = _for_arm(example, kind, robot)
    write_text(path, commented_scene(name, kind, example))
    load_scene(f"./{path}")
    typer.echo(f"written: {path}")
    typer.echo(f"play it: ideal-robot run ./{path}")


def _for_arm(example: str, kind: str, robot: str) -> str:
    """A shipped scene's text with the line where an arm of the user's reaches it; says what was chosen and assumed."""
    from scenes.placing import place_line, scene_text
    from scenes.scene_files.line_scene import LineScene

    scene = load_scene("line").changed(robot=robot, model="own")
    if kind != "line" or not isinstance(scene, LineScene):
        raise InputError("only scenes of kind line can be placed for an arm; leave --robot out", field="--robot",
                         value=robot)
    for assumption in scene.arm.assumed:
        typer.echo(f"assumed: {assumption}")
    place = place_line(scene)
    x, y, z = place.origin
    tool = f", with a tool of {place.tool_mm:g} mm" if place.tool_mm else ""
    tool += f", tool and camera turned by {place.tool_turn_deg:g}° on the flange" if place.tool_turn_deg else ""
    typer.echo(f"line of {place.length:g} m from ({x:g}, {y:g}, {z:g}) m at {place.speed:g} m/s{tool}")
    return scene_text(example, robot, place)


def examples(
    to: Annotated[str, typer.Argument(metavar="DIR", help="Folder to write them to; made where it is missing.")],
) -> None:
    """Writes the shipped examples: Python scripts that run alone, with the files that they read.

    Example: `ideal-robot examples my_examples`, then `python my_examples/follow_line.py`
    """
    from ideal_robot.whole_file import whole_file
    from scenes.program import example_files

    folder, files = Path(to), example_files()
    if here := [file.name for file in files if (folder / file.name).exists()]:
        raise InputError(f"holds {', '.join(here[:3])} already; give a new folder", field="DIR", value=str(folder))
    for file in files:
        with whole_file(folder / file.name) as partial:
            partial.write_bytes(file.read_bytes())
    scripts = [file for file in files if file.suffix == ".py"]
    first = [file.read_text(encoding="utf-8").split('"""')[1].splitlines()[0].replace("``", "") for file in scripts]
    show_table("examples", ["file", "shows"], [[file.name, line] for file, line in zip(scripts, first, strict=True)])
    typer.echo(f"next: python {folder / 'follow_line.py'}")


def export(
    source: Annotated[Path, typer.Argument(help="Recording (Parquet, CSV, ROS 2 bag or MCAP), or identified model "
                                                "(JSON).")],
    mcap: Annotated[Path | None, typer.Option(help="MCAP file with ROS 2 messages, for Foxglove.")] = None,
    rosbag2: Annotated[Path | None, typer.Option(help="Folder of a ROS 2 bag.")] = None,
    rerun: Annotated[Path | None, typer.Option(help="Rerun file (.rrd); needs the extra 'rerun'.")] = None,
    csv: Annotated[Path | None, typer.Option(help="CSV file.")] = None,
    parquet: Annotated[Path | None, typer.Option(help="Parquet file.")] = None,
    mjcf: Annotated[Path | None, typer.Option(help="Of a model: MuJoCo file (.xml) with bodies, rotors, friction and "
                                                   "joint controllers; needs the extra 'mujoco'.")] = None,
    as_urdf: Annotated[Path | None, typer.Option("--urdf", help="Of a model: URDF with bodies and friction.")] = None,
    like: Annotated[Path | None, typer.Option(help="With --mjcf: MJCF or URDF of the arm that is kept in all "
                                                   "else.")] = None,
    columns: ColumnsMap = None,
    topic: StatesTopic = None,
    joints: JointNames = None,
) -> None:
    """Writes a recording as MCAP, ROS 2 bag, Rerun file, CSV or Parquet, or a model as MJCF or URDF.

    Example, after that of `run`: `ideal-robot export out/line/recording.parquet --mcap line.mcap`

    Example, after that of `identify`: `ideal-robot export model.json --mjcf arm.xml`
    """
    of_recording = {"--rerun": rerun, "--mcap": mcap, "--rosbag2": rosbag2, "--csv": csv, "--parquet": parquet}
    of_model = {"--mjcf": mjcf, "--urdf": as_urdf}
    is_model = source.suffix == ".json"
    for option, path in (of_recording if is_model else of_model).items():
        if path is not None:
            raise InputError(f"is for {'recordings' if is_model else 'models (JSON)'}", field=option, value=str(path))
    requested = {option: path for option, path in (of_model if is_model else of_recording).items() if path is not None}
    if not requested:
        raise InputError(f"say which format: {', '.join(of_model if is_model else of_recording)}", field="export")
    for option, path, ending in (("--mcap", mcap, ".mcap"), ("--rerun", rerun, ".rrd"), ("--csv", csv, ".csv"),
                                 ("--parquet", parquet, ".parquet"), ("--mjcf", mjcf, ".xml"),
                                 ("--urdf", as_urdf, ".urdf")):
        if path is not None and path.suffix != ending:
            raise InputError(f"expected a name ending in {ending}", field=option, value=str(path))
    if rosbag2 is not None and rosbag2.exists():
        raise InputError("a bag is a new folder; choose a name that does not exist", field="--rosbag2",
                         value=str(rosbag2))
    check_outputs({"--rosbag2": rosbag2}, mcap=mcap, rerun=rerun, csv=csv, parquet=parquet, mjcf=mjcf, urdf=as_urdf)
    if is_model:
        _export_model(source, mjcf, as_urdf, like)
    else:
        _export_recording(recording_of(source, columns, topic, joints), requested)


def _export_recording(loaded: Recording, requested: dict[str, Path]) -> None:
    """Writes a recording in each format that was asked for."""
    from ideal_robot.signals.export import write_mcap, write_rerun, write_rosbag2
    from ideal_robot.signals.plausible import text_columns
    from ideal_robot.signals.recording import Recording

    writers = {"--rerun": write_rerun, "--mcap": write_mcap, "--rosbag2": write_rosbag2, "--csv": Recording.write,
               "--parquet": Recording.write}
    for text in (*loaded.meta.get("reading", ()), *text_columns(loaded)):
        typer.echo(f"warning: {text}", err=True)
    with progress_bar("export") as progress:
        # The format that needs an extra comes first, so that nothing is written where the extra is missing.
        for i, (option, path) in enumerate(requested.items()):
            progress(i / len(requested), option[2:])
            typer.echo(f"written: {writers[option](loaded, path)}")


def _export_model(source: Path, mjcf: Path | None, urdf: Path | None, like: Path | None) -> None:
    """Writes a model for other simulators, and says what their formats cannot."""
    from ideal_robot.model.mjcf import export_mjcf, urdf_with_dynamics
    from ideal_robot.model.model import Model

    model = Model.load(source)
    if mjcf is not None:
        unsaid = export_mjcf(model, mjcf, like)
        typer.echo(f"written: {mjcf}")
        for text in unsaid:
            typer.echo(f"an MJCF cannot say: {text}")
        typer.echo(f"compare it with a recording: ideal-robot validate RECORDING --mjcf {mjcf}")
    if urdf is not None:
        write_text(urdf, urdf_with_dynamics(model))
        typer.echo(f"written: {urdf}")


def fetch(
    name: Annotated[str | None, typer.Argument(help="Which data set; without it they are listed.")] = None,
    file: Annotated[Path | None, typer.Option(help="The original file, where it was downloaded by hand.")] = None,
    out: Annotated[Path, typer.Option(help="Folder of the recording.")] = Path("data"),
    json: Annotated[Path | None, typer.Option(help="Write what was fetched, or the list, as JSON to this file.",
                                              )] = None,
) -> None:
    """Gets a public data set by its address, compares it with a checksum, and writes it as a recording.

    None of them is part of this package: each has its own licence, which is written beside the recording.

    Example: `ideal-robot fetch` says which there are.

    Example: `ideal-robot fetch ur10e_ptp`
    """
    from scenes.data_sets import data_sets, fetch
    from scenes.report.page import write_json

    if name is None:
        rows = [[data_set.name, data_set.title, data_set.licence, data_set.page] for data_set in data_sets().values()]
        show_table("public data sets", ["name", "what", "licence", "page"], rows)
        if json is not None:
            write_json(json, {"data_sets": [dict(zip(("name", "title", "licence", "page"), row, strict=True))
                                            for row in rows]})
        return
    check_outputs({"--out": out}, json=json)
    path = fetch(name, out, file=file)
    one = data_sets()[name]
    if json is not None:
        write_json(json, {"name": name, "recording": path, "licence": one.licence, "cite": one.cite, "page": one.page})
    typer.echo(f"{one.title}\nlicence: {one.licence}\ncite: {one.cite}\nrecording: {path}")


def _there(what: str) -> str:
    """The given name, if there is such a recording, robot or scene to show."""
    suffix = Path(what).suffix
    if suffix not in (".parquet", ".csv"):
        urdf_of(what) if what in SHIPPED or suffix == ".urdf" else scenes_there(what)
    elif not Path(what).exists():
        raise InputError("no such recording", file=what)
    return what


def view(
    what: Annotated[str, typer.Argument(help="A scene (name or .toml), a recording (.parquet, .csv) or a robot.",
                                        callback=_there)],
    robot: Annotated[str | None, typer.Option("--robot", "--urdf", help="Arm: name of a shipped robot, or path of a "
                                              "URDF; needed where a recording does not say it.",
                                              callback=arm_there)] = None,
    port: Annotated[int, typer.Option(help="TCP port on this machine; the next free one where it is taken.", min=1,
                                      max=65535)] = 8080,
    live: Annotated[Path | None, typer.Option(help="Folder of a run on devices that goes on or is about to begin, "
                                              "such as out/follow/line; WHAT is its scene.")] = None,
    once: Annotated[bool, typer.Option("--once", help="Set the page up and leave: a check without a browser.")] = False,
) -> None:
    """Shows an arm in a browser: a recording played, a scene played first and then shown, or a robot at home.

    With --live a run of `ideal-robot follow` is shown while it goes on, from the journal it writes.

    Example, after that of `run`: `ideal-robot view out/line/recording.parquet`
    """
    from scenes.view.viewer import Player, Viewer

    if live is not None:
        _view_live(what, live, robot, port, once)
        return
    arm, replay, curves = _shown(what, robot, play=not once)
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


def _view_live(what: str, live: Path, robot: str | None, port: int, once: bool) -> None:
    """Shows a run on devices while it goes on."""
    from ideal_robot.robots.robot import Robot
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


def _shown(what: str, robot: str | None, play: bool) -> tuple[Robot, Replay | None, dict[str, Array]]:
    """The arm of what is to be shown, what moves, and curves to draw where nothing does."""
    from ideal_robot.robots.robot import Robot
    from scenes.arms import arm_of
    from scenes.kind import kind_of
    from scenes.view.viewer import open_recording, recorded_replay

    if Path(what).suffix in (".parquet", ".csv"):
        arm, recording = open_recording(Path(what), robot)
        return arm, recorded_replay(Path(what), arm, recording), {}
    if what in SHIPPED or Path(what).suffix == ".urdf":
        return Robot.load(what), None, {}
    scene = load_scene(what)
    kind, arm = kind_of(scene), arm_of(scene.robot)
    if kind.replay is not None and play:
        with progress_bar(scene.name) as progress:
            return arm, kind.replay(kind.run(scene, progress=progress)), {}
    return arm, None, {} if kind.curves is None else kind.curves(scene)


# Makes a simulated arm from recordings.

def twin(
    recordings: Annotated[list[Path], typer.Argument(help="Recordings of free motion (Parquet, CSV, ROS 2 bag or "
                                                          "MCAP).")],
    robot: RobotName,
    output: Annotated[Path, typer.Option("-o", "--output", help="Where the twin goes (.toml): a scene with its "
                                                                "world.")],
    controller: Controller = None,
    draws: Annotated[int, typer.Option(help="Follow the scene's line with that many of the twin's individuals, and say "
                                            "what accuracy to expect; ten take some twenty "
                                            "minutes.", min=0, max=100)] = 0,
    seed: Seed = None,
    columns: ColumnsMap = None,
    topic: StatesTopic = None,
    joints: JointNames = None,
    json: JsonResults = None,
) -> None:
    """Makes a simulated arm of recordings, so that scenes tell what accuracy to expect on the recorded one.

    What the recordings tell is identified: masses, rotors, friction, controllers, gears, noise and the residual with
    its spectrum. For the rest a class's values are taken, with their spread: each individual draws its own. The twin
    plays the recorded motion, and its torques are shown beside the measured ones.

    Example, after that of `plan-identification`:
    `ideal-robot twin out/plan/recording.parquet --robot kr6 -o my_arm.toml`
    """
    from ideal_robot.identification.whole_model import identify_model, with_given_controller
    from scenes.arms import arm_of
    from scenes.identification.twin_play import make_twin, twin_text
    from scenes.scene_files.scene import NAME

    if output.suffix != ".toml" or not NAME.fullmatch(output.stem):
        raise InputError("expected a file name of letters and digits that ends in .toml", field="--output",
                         value=str(output))
    check_outputs(output=output, json=json)
    with progress_bar("twin") as progress:
        arm = arm_of(robot)
        loaded = [recording_of(path, columns, topic, joints) for path in recordings]
        analysis = identify_model(loaded, arm, progress=part_of(progress, 0.0, 0.5))
        if controller is not None:
            analysis = with_given_controller(analysis, controller, arm)
        result = make_twin(loaded, robot, analysis=analysis, seed=1 if seed is None else seed, progress=progress)
        with whole_files(output, json) as (scene_file, json_file):
            if scene_file is not None:
                scene_file.write_text(twin_text(result.twin, robot, output), encoding="utf-8")
            write_signed(json_file, {**result.to_dict(), "output": output})
    show_table(f"twin of {robot} along the recorded motion", result.columns, result.rows())
    for line in (*(f"recorded: {s}" for s in result.twin.seen), *(f"assumed: {s}" for s in result.twin.assumed)):
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
    work: list[Any] = [job for k in range(1, draws + 1) for job in jobs([_place(scene)], [], [], [k], [k])]
    with progress_bar(f"{draws} individuals") as progress:
        answers = sweep(work, done=lambda count, _: progress(count / len(work), f"{count} of {len(work)}"))
    errors = [answer["control_error_mm"] for answer in answers if not answer.get("failure") and
              "control_error_mm" in answer]
    if not errors:
        typer.echo(f"none of the {draws} individuals reached the end of the line; view one run", err=True)
        raise typer.Exit(1)
    mean, p95 = (np.array([error[key] for error in errors]) for key in ("mean", "p95"))
    typer.echo(f"to expect on this arm: {mean.mean():.3f} mm on average ({mean.min():.3f} to {mean.max():.3f}), 95 % "
               f"within {p95.min():.3f} to {p95.max():.3f} mm; {len(errors)} of {draws} individuals")
