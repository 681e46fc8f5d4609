"""Verbs on devices: follow, play, simulate, detect, rsi."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ideal_robot.errors import InputError
from ideal_robot.whole_file import whole_files
from scenes.commands.common import (
    Bridge,
    ControllerAddress,
    Core,
    Cycle,
    JsonFigures,
    ModelsRobot,
    PlannerDelay,
    Rest,
    Seed,
    Speed,
    arm_there,
    closed,
    completed,
    progress_bar,
    scenes_there,
    show_table,
    write_signed,
)
from scenes.outputs import check_outputs
from scenes.scene_file import load_scene

if TYPE_CHECKING:
    from ideal_robot.rsi.message import RsiFormat
    from scenes.online.devices import Devices
    from scenes.played_path import PlaySettings
    from scenes.serve.cell import Places
    from scenes.serve.elsewhere import CameraPlaces
    from sim.devices.stream_server import Unkindness


@dataclass(kw_only=True)
class FollowOptions:
    """Options of ``follow``."""

    scene: Annotated[str, typer.Argument(help="Scene of kind line or force: name of a shipped one, or path (.toml); of "
                                         "its tables those of the world are not looked at.",
                                         callback=scenes_there)]
    arm: Annotated[str, typer.Option(help="Address of the arm's interface, see `ideal-robot list interfaces`: "
                                     "rsi://host:port where this computer listens for the controller, "
                                     "rtde://host:port of the controller, …")] = "rsi://127.0.0.1:49152"
    camera: Annotated[str | None, typer.Option(help="usb:0, rtsp://…, http://… (MJPEG), genicam:producer.cti#serial, "
                                               "stream://host:port or file:film.mp4.")] = None
    force: Annotated[str | None, typer.Option(help="netft://host?rate=7000&counts_force=1e6&counts_torque=1e6 or "
                                              "stream://host:port.")] = None
    camera_delay: Annotated[float, typer.Option(help="From mid-exposure to arrival, at least [ms]; stream:// needs "
                                                "none.", min=0.0, max=1000.0)] = 0.0
    force_delay: Annotated[float, typer.Option(help="From measurement to arrival, at least [ms].", min=0.0,
                                               max=1000.0)] = 0.0
    calibration: Annotated[Path | None, typer.Option(help="File of the camera's calibration (JSON); where it is not "
                                                     "there, the camera is calibrated by moving first.")] = None
    method: Annotated[str | None, typer.Option(help="ideal, sensor_path …; default: the scene's.")] = None
    speed: Speed = None
    relative: Annotated[bool, typer.Option("--relative/--absolute", help="How an RSI controller takes corrections; "
                                           "relative ones go on without an answer (HOLDON 1).")] = False
    rsi_config: Annotated[Path | None, typer.Option(help="The controller's RSI ethernet XML.")] = None
    controller: ControllerAddress = None
    cycle: Cycle = None
    delay: PlannerDelay = False
    bridge: Bridge = 0.1
    wait: Annotated[float, typer.Option(help="How long to wait for the arm [s].", min=0.1, max=86_400.0)] = 60.0
    core: Core = None
    check: Annotated[bool, typer.Option("--check/--no-check", help="Before the job test whether this computer holds "
                                        "the cycle, look at the line from several poses above it where the camera is "
                                        "calibrated, and compare tool and contact with the last run's.")] = True
    tool_mass: Annotated[float | None, typer.Option(help="Of all that hangs on the force sensor [kg]: its weight "
                                                    "then gives its gain.", min=0.01, max=100.0)] = None
    json: JsonFigures = None
    out: Annotated[Path | None, typer.Option(help="Folder of recording and page; default out/follow/SCENE.")] = None

    def devices(self) -> Devices:
        """The addresses and delays of the devices."""
        from scenes.online.devices import Devices

        same = ("arm", "camera", "force", "relative", "rsi_config", "controller", "cycle", "delay", "bridge", "core",
                "check", "tool_mass")
        return Devices(camera_delay=1e-3 * self.camera_delay, force_delay=1e-3 * self.force_delay, patience=self.wait,
                       **{name: getattr(self, name) for name in same})


def follow(options: FollowOptions) -> None:
    """Follows a scene's line or surface with an arm, a camera and a force sensor that are behind their interfaces.

    The arm has to stand at the start of the path. Ctrl-C, SIGTERM, any limit, a device that falls silent and an arm
    that does not follow bring it to rest on the path. Not yet tried on a real cell: read docs/follow.md first.

    Example: `ideal-robot simulate line --serve` and, in another terminal,
    `ideal-robot follow line --arm rsi://127.0.0.1:49152 --camera stream://127.0.0.1:50001`
    """
    from scenes.online.run import follow, load_cell
    from scenes.scene_files.scene import chosen

    loaded = chosen(load_cell(options.scene), speed=options.speed)
    folder = options.out or Path("out") / "follow" / loaded.name
    check_outputs({"--out": folder}, json=options.json, calibration=options.calibration)
    # Drawing the bar takes Python's lock and delays answers, so it is drawn rarely.
    with progress_bar(loaded.name, rate=2.0) as progress:
        result = follow(loaded, options.devices(), method=options.method, calibration=options.calibration, out=folder,
                        progress=progress)
    write_signed(options.json, result.json())
    closed(result)


@dataclass(kw_only=True)
class PlayOptions:
    """Options of ``play``."""

    path: Annotated[Path, typer.Argument(help="CSV or Parquet with t [s] and q_c_i, q_d_i or q_i [rad].")]
    arm: Annotated[str, typer.Option(help="Address of the arm's interface, see `ideal-robot list interfaces`.")]
    robot: Annotated[str | None, typer.Option("--robot", "--urdf", help="Arm: name of a shipped robot, or path of a "
                                              "URDF; default: the one that the path's file, or the model, names.",
                                              callback=arm_there)] = None
    method: Annotated[str, typer.Option(
        help="How the path is corrected while it is played: none (the file's commands as they are), ideal, …",
        autocompletion=lambda incomplete: completed("rsi", incomplete))] = "none"
    model: Annotated[Path | None, typer.Option(
        help="Identified model (JSON) for --method, and to see sooner whether the arm follows; default: for a method "
             "that needs one, the shipped one.")] = None
    force: Annotated[str | None, typer.Option(help="Force sensor that guards the motion, netft://… or stream://…: what "
                                              "it feels beyond the tool's weight stops the arm.")] = None
    force_delay: Annotated[float, typer.Option(help="From measurement to arrival, at least [ms].", min=0.0,
                                               max=1000.0)] = 0.0
    most_force: Annotated[float, typer.Option(help="Force that the path may meet [N]; less than 15 is taken as "
                                              "touching nothing.", min=0.0, max=100_000.0)] = 0.0
    compare: Annotated[bool, typer.Option("--compare", help="Play the path as it is desired first, then as it is "
                                          "corrected, and print the errors of both.")] = False
    cycle: Annotated[float | None, typer.Option(help="Interpolation cycle [s]; default: the interface's, or the "
                                                "robot's.")] = None
    rest: Rest = 0.6
    wait: Annotated[float, typer.Option(help="How long to wait for the controller [s].", min=0.1,
                                        max=86_400.0)] = 60.0
    bridge: Bridge = 0.1
    core: Core = None
    relative: Annotated[bool, typer.Option("--relative/--absolute", help="How an RSI controller takes corrections."
                                           )] = False
    rsi_config: Annotated[Path | None, typer.Option(help="The controller's RSI ethernet XML.")] = None
    controller: ControllerAddress = None
    out: Annotated[Path, typer.Option("--out", "-o", help="Recording (CSV or Parquet); with --compare that of the path "
                                      "as it is desired stands beside it, with _before in its name.")
                   ] = Path("out/play/recording.parquet")
    json: JsonFigures = None

    def settings(self) -> PlaySettings:
        """The settings of a path's execution."""
        from scenes.played_path import PlaySettings

        same = ("arm", "robot", "method", "model", "cycle", "rest", "relative", "rsi_config", "controller", "bridge",
                "core", "compare", "force", "most_force")
        return PlaySettings(patience=self.wait, force_delay=1e-3 * self.force_delay,
                            **{name: getattr(self, name) for name in same})


def play(options: PlayOptions) -> None:
    """Plays a joint path on an arm behind its maker's interface: slowly to the start, the path, to rest, recorded.

    The recording has the commands as they were sent and what the controller reported, by the controller's clock. The
    arm is led to the start of the path on the joints' straight way: look that it is free. Ctrl-C, SIGTERM, any limit
    and an arm that does not follow bring it to rest on the path. `plan-identification`, `play`, `identify`,
    `precorrect` and `play --compare` are what makes an arm ideal. Not yet tried on a real controller: read
    docs/interfaces.md first.

    Example, with a controller that listens:
    `ideal-robot play out/plan/commands.csv --robot kr6 --arm rtde://127.0.0.1:30004 -o moved.parquet`
    """
    from ideal_robot.signals.recording import WRITTEN
    from scenes.played_path import planned_path, played_path

    before = options.out.with_stem(f"{options.out.stem}_before")
    check_outputs(out=options.out, json=options.json, before=before if options.compare else None)
    if options.out.suffix not in WRITTEN:
        raise InputError(f"expected a name ending in {' or '.join(WRITTEN)}", field="--out", value=str(options.out))
    settings = options.settings()
    planned = planned_path(options.path, settings)
    for warning in planned.warnings:
        typer.echo(f"warning: {warning}", err=True)
    with progress_bar("play", rate=2.0) as progress:
        done = played_path(planned, settings, progress)
    show_table("", *done.run.table())
    show_table("desired minus measured motor positions", *done.table())
    with whole_files(options.out, before if done.before is not None else None, options.json) as (out, plain, figures):
        done.run.recording.write(out)
        if done.before is not None and plain is not None:
            done.before.recording.write(plain)
        write_signed(figures, {**done.json(), "recording": options.out})
    typer.echo(f"recording: {options.out}")
    if done.failure is not None:
        typer.echo(f"ideal-robot: {done.failure}", err=True)
        raise typer.Exit(1)
    if done.before is None:
        typer.echo(f"next: ideal-robot identify {options.out} --robot {settings.robot or planned.arm.name}")


@dataclass(kw_only=True)
class SimulateOptions:
    """Options of ``simulate``."""

    scene: Annotated[str, typer.Argument(help="Scene of kind line or force: name of a shipped one, or path (.toml).",
                                         callback=scenes_there)]
    serve: Annotated[bool, typer.Option("--serve", help="Play the cell in real time behind its devices.")] = False
    camera_of: Annotated[str | None, typer.Option(help="Instead of --serve: send what the scene's camera would see on "
                                                  "an arm that is somewhere else and whose states are read at this "
                                                  "address, ros2://namespace or rtde://host.")] = None
    topic: Annotated[str | None, typer.Option(help="With --camera-of: publish the pictures on this topic of ROS 2, "
                                              "too, e.g. /camera/image_raw, and camera_info beside it.")] = None
    wait: Annotated[float, typer.Option(help="With --camera-of: how long the arm's states are waited for [s].", min=0.1,
                                        max=86_400.0)] = 10.0
    arm: Annotated[str, typer.Option(help="rsi://host:port or egm://host:port where the follower listens for the "
                                     "controller, rtde://127.0.0.1:port where this controller listens, or "
                                     "ros2://namespace.")
                   ] = "rsi://127.0.0.1:49152"
    host: Annotated[str, typer.Option(help="Address of this computer on which camera and force sensor listen.")
                    ] = "127.0.0.1"
    camera_port: Annotated[int, typer.Option(help="TCP port of the camera's stream.", min=0, max=65535)] = 50001
    force_port: Annotated[int, typer.Option(help="UDP port of the force sensor (NetFT).", min=0, max=65535)] = 49151
    relative: Annotated[bool, typer.Option("--relative/--absolute", help="How the controller takes corrections; "
                                           "relative ones go on without an answer (HOLDON 1).")] = False
    cycle: Annotated[float | None, typer.Option(help="Interpolation cycle [s], e.g. 0.004.")] = None
    seed: Seed = None
    drift: Annotated[float, typer.Option(help="Drift of the devices' clocks [ppm].")] = 20.0
    offset: Annotated[float, typer.Option(help="Offset between their clocks [ms].", min=0.0)] = 30.0
    loss: Annotated[float, typer.Option(help="Share of packets that are lost, each way.", min=0.0, max=0.9)] = 0.0
    doubled: Annotated[float, typer.Option(help="Share of packets that come twice.", min=0.0, max=0.9)] = 0.0
    late: Annotated[float, typer.Option(help="Share of packets that come late.", min=0.0, max=0.9)] = 0.0
    late_by: Annotated[float, typer.Option(help="By how much they are late [ms].", min=0.0, max=5000.0)] = 30.0
    sessions: Annotated[int, typer.Option(help="End after so many sessions; 0: go on until Ctrl-C.", min=0)] = 0
    json: Annotated[Path | None, typer.Option(help="Write what really happened in the last session to this file.")
                    ] = None

    def places(self) -> Places:
        """Addresses where the devices listen; InputError for an arm behind an interface that is not served."""
        from ideal_robot.interfaces import interface_of
        from scenes.serve.cell import CONTROLLERS, Places

        ports = {"rsi": 49152, "rtde": 30004, "egm": 6510}
        _, place = interface_of(self.arm)
        if place.scheme not in CONTROLLERS:
            served = ", ".join(f"{name}://" for name in CONTROLLERS)
            raise InputError(f"expected one of {served}; others have simulators of their own", field="--arm",
                             value=self.arm[:80])
        place.knows()
        at = ("", 0) if place.scheme == "ros2" else place.at(ports[place.scheme], "127.0.0.1")
        return Places(at, self.host, self.camera_port, self.force_port, self.relative, place.scheme,
                      place.host + place.path)

    def camera_places(self, arm: str) -> CameraPlaces:
        """Address of the arm and targets of its pictures; InputError for a topic that cannot be published."""
        from ideal_robot.interfaces import INTERFACES
        from scenes.serve.elsewhere import CameraPlaces

        if self.serve:
            raise InputError("give either --serve or --camera-of: a served cell has its camera", field="--camera-of",
                             value=arm[:80])
        if self.topic is not None:
            INTERFACES.get("ros2").require("--topic")
            if not self.topic.startswith("/") or len(self.topic) < 2:
                raise InputError("expected a topic's full name such as /camera/image_raw", field="--topic",
                                 value=self.topic[:80])
        return CameraPlaces(arm, self.wait, (self.host, self.camera_port), self.topic)

    def unkindness(self) -> Unkindness:
        """The simulated faults of the devices' packets."""
        from sim.devices.stream_server import Unkindness

        return Unkindness(drift=1e-6 * self.drift, offset=1e-3 * self.offset, loss=self.loss, doubled=self.doubled,
                          late=1e-3 * self.late_by, late_share=self.late)


def simulate(options: SimulateOptions) -> None:
    """Plays a scene's cell in real time: a controller behind RSI, RTDE, EGM or ROS 2, camera stream, NetFT sensor.

    The arm waits at the start of the scene's path until a follower answers. When the answers stop it is braked, rests,
    and goes back to the start for the next one. Exit code 0 after Ctrl-C or the last session.

    With `--camera-of` there is no arm here: its states are read where it is, an arm that others simulate or a real one,
    and the camera's pictures of the scene are sent, as a stream and on a topic of ROS 2. Ctrl-C ends it; what the line
    was left by is said then, as far as the reported joints tell it.

    Example: `ideal-robot simulate line --serve` and, in another terminal,
    `ideal-robot follow line --arm rsi://127.0.0.1:49152 --camera stream://127.0.0.1:50001`
    """
    from scenes.scene_files.scene import chosen
    from scenes.serve.cell import serve_scene

    if not options.serve and options.camera_of is None:
        raise InputError("simulate plays the cell behind devices: give --serve (to play a scene in one process, use "
                         "run), or --camera-of ADDRESS for an arm that is somewhere else", field="--serve")
    check_outputs(json=options.json)
    loaded = chosen(load_scene(options.scene), seed=options.seed)
    if options.camera_of is not None:
        from scenes.serve.elsewhere import serve_camera

        serve_camera(loaded, options.camera_places(options.camera_of), options.unkindness(), options.json,
                     options.cycle, lambda text: typer.echo(text, err=True))
        return
    if options.cycle is not None:
        loaded = loaded.changed(world={"t_ipo": options.cycle})
    serve_scene(loaded, options.places(), options.unkindness(), options.sessions, options.json,
                lambda text: typer.echo(text, err=True))


@dataclass(kw_only=True)
class DetectOptions:
    """Options of ``detect``."""

    sources: Annotated[list[str], typer.Argument(help="Pictures, folders of pictures, videos, the number of a camera, "
                                                      "or an rtsp:// or http:// address.")]
    kind: Annotated[str | None, typer.Option(help="What the line is: line, tape, edge, laser or seam (also beads and "
                                                  "cables). Default: any but a single edge.")] = None
    near: Annotated[str | None, typer.Option(help="Pixel U,V that the line passes: a line that does not is none. "
                                                  "Default: any, of several the likeliest."
                                             )] = None
    points: Annotated[int, typer.Option(help="Points along the line.", min=5, max=200)] = 15
    every: Annotated[int, typer.Option(help="Takes one of so many frames of a video or stream.", min=1)] = 1
    most: Annotated[int, typer.Option(help="Ends after so many pictures.", min=1)] = 100
    json: Annotated[Path | None, typer.Option(help="Write the points as JSON to this file.")] = None
    out: Annotated[Path, typer.Option(help="Folder of the page.")] = Path("out/detect")


def detect(options: DetectOptions) -> None:
    """Finds the line in pictures of your own cell, before anything moves: points, widths, probability, why not.

    Width, colour and course of the line are found in the picture, and all pieces of a line that breaks. In a film it is
    followed; what is lost, found again or another line is said. A picture that cannot be read is a row of the table
    with the error. Exit code 1 where no picture shows a line; 2 where none can be read.

    Example, with your pictures in a folder: `ideal-robot detect pictures/ --json line.json`
    """
    from scenes.detection import Detected, Unreadable, detected, detection_page, figures, pixel, table

    place = None if options.near is None else pixel(options.near)
    results: list[Detected | Unreadable] = []
    check_outputs({"--out": options.out}, json=options.json)
    with progress_bar("detect") as progress:
        for result in detected(options.sources, every=options.every, most=options.most, kind=options.kind, near=place,
                               points=options.points):
            progress(min(0.9, len(results) / options.most), result.name)
            results.append(result)
        progress(0.95, "page")
        report = options.out / "report.html"
        with whole_files(report, options.json) as (page_file, json_file):
            detection_page(options.sources, options.kind, results).write(page_file)
            write_signed(json_file, {"source": ", ".join(options.sources), "kind": options.kind,
                                     "pictures": [figures(result) for result in results]})
    show_table("detect", *table(results))
    typer.echo(f"report: {report}")
    if not any(isinstance(result, Detected) and result.found.found for result in results):
        typer.echo("ideal-robot: no picture shows a line", err=True)
        raise typer.Exit(1)


@dataclass(kw_only=True)
class CalibrateOptions:
    """Options of ``calibrate``."""

    poses: Annotated[Path, typer.Argument(help="CSV with picture, x, y, z [m], qx, qy, qz, qw: a picture's file and "
                                               "the tool's pose in the base frame.")]
    mounted: Annotated[str, typer.Option(help="Where the camera is: tool (the target stands in the cell) or cell (the "
                                              "target is on the tool).")] = "tool"
    board: Annotated[str | None, typer.Option(help="A checkerboard's inner corners, e.g. 9x6.")] = None
    square: Annotated[float, typer.Option(help="Side of its squares [mm].", min=0.1, max=1000.0)] = 20.0
    tags: Annotated[Path | None, typer.Option(help="JSON with the corners of AprilTags, see docs/camera.md.",
                                              exists=True, dir_okay=False)] = None
    intrinsics: Annotated[Path | None, typer.Option(help="JSON with width, height, K, distortion. Default: found from "
                                                         "the same pictures.", exists=True, dir_okay=False)] = None
    json: Annotated[Path | None, typer.Option(help="Write poses and covariances as JSON to this file.")] = None


def calibrate(options: CalibrateOptions) -> None:
    """Finds where a camera is, on the tool or beside the cell, from pictures of a checkerboard or AprilTags.

    With covariance: the noise of the pixels and the error of the arm's own poses are found with it. Pictures that
    contradict the others are left out and said. At least four poses, turned about two axes; ten to twenty are better.

    Example, with your pictures and poses: `ideal-robot calibrate poses.csv --board 9x6 --square 20 --json camera.json`
    """
    from scenes.camera_location import board_target, located, tags_target

    if (options.board is None) == (options.tags is None):
        raise InputError("give the target: either --board or --tags", field="--board")
    check_outputs(json=options.json)
    target = board_target(options.board, 1e-3 * options.square) if options.board is not None else tags_target(
        options.tags or Path())
    with progress_bar("calibrate"):
        found = located(options.poses, target, options.mounted, options.intrinsics)
    write_signed(options.json, found.json())
    show_table(f"camera in the {'tool' if found.pose.mounted == 'tool' else 'base'} frame", *found.table())
    for name, used in zip(found.shown, found.pose.used, strict=True):
        if not used:
            typer.echo(f"left out: {name} contradicts the others", err=True)
    if found.without:
        typer.echo(f"no target in {', '.join(found.without)}", err=True)


@dataclass(kw_only=True)
class RsiOptions:
    """Options of ``rsi``."""

    path: Annotated[Path | None, typer.Argument(
        help="CSV or Parquet with t [s] and q_d_1 … q_d_n (or q_1 … q_n) [rad].")] = None
    robot: ModelsRobot = None
    model: Annotated[Path | None, typer.Option(help="Identified model (JSON); default: the shipped one.")] = None
    method: Annotated[str, typer.Option(
        help="How the path is corrected: none, precorrected, ideal, adapted, a setting (precorrected-printed), or a "
             "key of another package.",
        autocompletion=lambda incomplete: completed("rsi", incomplete))] = "ideal"
    host: Annotated[str, typer.Option(help="Address of this computer to listen on.")] = "127.0.0.1"
    port: Annotated[int | None, typer.Option(help="UDP port to listen on; 0 for any free one. Default: that of "
                                             "--rsi-config, else 49152.", min=0, max=65535)] = None
    controller: ControllerAddress = None
    relative: Annotated[bool, typer.Option("--relative/--absolute",
                                           help="How the controller takes corrections: added up, or from the start."
                                           )] = False
    rsi_config: Annotated[Path | None, typer.Option(help="The controller's RSI ethernet XML: tag, sender type, port "
                                                    "and HOLDON are read from it.")] = None
    tag: Annotated[str | None, typer.Option(help="Element with the corrections, e.g. AK (default) or AKorr.")] = None
    sender: Annotated[str | None, typer.Option(help="Type of the answer: SENTYPE, default ImFree.")] = None
    decimals: Annotated[int, typer.Option(help="Decimals of a correction in degrees.", min=1, max=9)] = 6
    cycle: Cycle = None
    delay: PlannerDelay = False
    rest: Rest = 0.6
    wait: Annotated[float, typer.Option(help="How long to wait for the controller [s].", min=0.1,
                                        max=86_400.0)] = 60.0
    bridge: Bridge = 0.1
    core: Core = None
    self_test: Annotated[bool, typer.Option("--self-test", help="Tell which cycle this computer holds, and why.")
                         ] = False
    record: Annotated[Path, typer.Option(help="Recording (CSV or Parquet).")] = Path("out/rsi/recording.parquet")
    json: JsonFigures = None

    def form(self) -> RsiFormat:
        """Names of the parts of the controller's messages; InputError where its configuration cannot be used."""
        from ideal_robot.robots.robot import Robot
        from ideal_robot.rsi.message import RsiFormat

        if self.rsi_config is None:
            return RsiFormat(self.tag or "AK", self.sender or "ImFree", self.decimals)
        axes = Robot.load(self.robot).n if self.robot is not None else 6
        read = RsiFormat.read(self.rsi_config, axes, self.tag)
        return replace(read, sender=self.sender or read.sender, decimals=self.decimals)


def rsi(options: RsiOptions) -> None:
    """Answers a KUKA controller's RSI packets so that the arm, not the command, follows a joint path.

    The arm has to stand at the start of the path. Ctrl-C, SIGTERM, any limit and an arm that does not follow bring it
    to rest on the path. Not yet tried on a real controller: read docs/rsi.md first.

    Example: `ideal-robot rsi --self-test`

    Example, with a controller that sends: `ideal-robot rsi path.csv --robot kr6 --record moved.parquet`
    """
    from ideal_robot.signals.recording import WRITTEN
    from scenes.online.processes import stopping_on_signals
    from scenes.rsi.server import rsi_server

    check_outputs(record=options.record, json=options.json)
    if options.record.suffix not in WRITTEN:
        raise InputError(f"expected a name ending in {' or '.join(WRITTEN)}", field="--record",
                         value=str(options.record))
    if options.self_test:
        _self_test(options)
        return
    if options.path is None:
        raise InputError("give the path to be played", field="PATH")
    form = options.form()
    with rsi_server(options.path, robot=options.robot, model=options.model, method=options.method, cycle=options.cycle,
                    delay=options.delay, rest=options.rest, host=options.host, relative=options.relative, form=form,
                    port=form.port or 49152 if options.port is None else options.port,
                    controller=options.controller, bridge=options.bridge) as server:
        if not server.link.axes.known:
            typer.echo("ideal-robot: the robot's data has no table [rsi]: axes are taken to count as in the URDF; "
                       "see docs/rsi.md", err=True)
        for warning in server.warnings:
            typer.echo(f"warning: {warning}", err=True)
        typer.echo("waiting for the controller on {}:{}".format(*server.link.address), err=True)
        with (stopping_on_signals(server.stop, lambda: server.link.counts.cycles > 0),
              progress_bar("rsi") as progress):
            run = server.play(patience=options.wait, core=options.core, progress=progress)
    # The table is shown first, so that the result is seen even if the disk takes no file.
    show_table("", *run.table())
    with whole_files(options.record, options.json) as (record_file, json_file):
        run.recording.write(record_file)
        write_signed(json_file, {**run.json(), "recording": options.record})
    typer.echo(f"recording: {options.record}")
    if run.failure is not None:
        typer.echo(f"ideal-robot: {run.failure}", err=True)
        raise typer.Exit(1)


def _self_test(options: RsiOptions) -> None:
    from scenes.rsi.self_test import held_cycles

    with progress_bar("self-test") as progress:
        held = held_cycles(robot=options.robot, model=options.model, method=options.method, core=options.core,
                           progress=progress)
    write_signed(options.json, held.json())
    show_table("", *held.table())
    for line in held.reasons():
        typer.echo(line)
    if held.shortest() is None:
        raise typer.Exit(1)
