"""``ideal-robot follow``: a line, a surface or both, followed on devices."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def command(
    scene: Annotated[str, typer.Argument(help="Scene of kind line or force: name of a shipped one, or path (.toml); of "
                                         "its tables those of the world are not looked at.")],
    arm: Annotated[str, typer.Option(help="rsi://host:port where this computer listens for the controller, or "
                                     "rtde://host:port of the controller.")] = "rsi://127.0.0.1:49152",
    camera: Annotated[str | None, typer.Option(help="usb:0, rtsp://…, http://… (MJPEG), genicam:producer.cti#serial, "
                                               "stream://host:port or file:film.mp4.")] = None,
    force: Annotated[str | None, typer.Option(help="netft://host?rate=7000&counts_force=1e6&counts_torque=1e6 or "
                                              "stream://host:port.")] = None,
    camera_delay: Annotated[float, typer.Option(help="From mid-exposure to arrival, at least [ms]; stream:// needs "
                                                "none.", min=0.0, max=1000.0)] = 0.0,
    force_delay: Annotated[float, typer.Option(help="From measurement to arrival, at least [ms].", min=0.0,
                                               max=1000.0)] = 0.0,
    calibration: Annotated[Path | None, typer.Option(help="File of the camera's calibration (JSON); where it is not "
                                                     "there, the camera is calibrated by moving first.")] = None,
    method: Annotated[str | None, typer.Option(help="ideal, sensor_path …; default: the scene's.")] = None,
    speed: Annotated[float | None, typer.Option(help="Path speed [m/s] instead of the scene's.")] = None,
    relative: Annotated[bool, typer.Option("--relative/--absolute", help="How an RSI controller takes corrections; "
                                           "relative ones go on without an answer (HOLDON 1).")] = False,
    rsi_config: Annotated[Path | None, typer.Option(help="The controller's RSI ethernet XML.")] = None,
    controller: Annotated[str | None, typer.Option(help="Listen to this address only.")] = None,
    cycle: Annotated[float | None, typer.Option(help="Interpolation cycle [s], e.g. 0.004; default: robot's.")] = None,
    delay: Annotated[bool, typer.Option(help="The standard path planner's delay of one cycle is in force.")] = False,
    bridge: Annotated[float, typer.Option(help="How long packets may be lost in a row [s].", min=0.0, max=1.0)] = 0.1,
    wait: Annotated[float, typer.Option(help="How long to wait for the arm [s].", min=0.1, max=86_400.0)] = 60.0,
    core: Annotated[int | None, typer.Option(help="Processor core to keep to.", min=0)] = None,
    json: Annotated[Path | None, typer.Option(help="Write the figures as JSON to this file.")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder of recording and page; default out/follow/SCENE.")] = None,
) -> None:
    """Follows a scene's line or surface with an arm, a camera and a force sensor that are behind their interfaces.

    The arm has to stand at the start of the path. Ctrl-C, SIGTERM, any limit, a device that falls silent and an arm
    that does not follow bring it to rest on the path. Not yet tried on a real cell: read docs/follow.md first.

    Example: `ideal-robot follow line --arm rsi://127.0.0.1:49152 --camera stream://127.0.0.1:50001`
    """
    from scenes.commands.common import closed
    from scenes.online.devices import Devices
    from scenes.online.run import follow, load_cell
    from scenes.outputs import check_outputs
    from scenes.report.page import write_json
    from scenes.scene_files.scene import chosen
    from scenes.terminal import progress_bar

    loaded = chosen(load_cell(scene), speed=speed)
    folder = out or Path("out") / "follow" / loaded.name
    check_outputs({"--out": folder}, json=json, calibration=calibration)
    devices = Devices(arm=arm, camera=camera, force=force, camera_delay=1e-3 * camera_delay,
                      force_delay=1e-3 * force_delay, relative=relative, rsi_config=rsi_config, controller=controller,
                      cycle=cycle, delay=delay, bridge=bridge, patience=wait, core=core)
    # Drawing takes Python's lock away from the answers now and then.
    with progress_bar(loaded.name, rate=2.0) as progress:
        result = follow(loaded, devices, method=method, calibration=calibration, out=folder, progress=progress)
    if json is not None:
        write_json(json, result.json())
    closed(result)
