"""``ideal-robot simulate --serve``: the simulated cell as devices in a process of its own."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def command(
    scene: Annotated[str, typer.Argument(help="Scene of kind line or force: name of a shipped one, or path (.toml).")],
    serve: Annotated[bool, typer.Option("--serve", help="Play the cell in real time behind its devices.")] = False,
    arm: Annotated[str, typer.Option(help="rsi://host:port where the follower listens for the controller, "
                                     "or rtde://127.0.0.1:port where this controller listens.")
                   ] = "rsi://127.0.0.1:49152",
    host: Annotated[str, typer.Option(help="Address of this computer on which camera and force sensor listen.")
                    ] = "127.0.0.1",
    camera_port: Annotated[int, typer.Option(help="TCP port of the camera's stream.", min=0, max=65535)] = 50001,
    force_port: Annotated[int, typer.Option(help="UDP port of the force sensor (NetFT).", min=0, max=65535)] = 49151,
    relative: Annotated[bool, typer.Option("--relative/--absolute", help="How the controller takes corrections; "
                                           "relative ones go on without an answer (HOLDON 1).")] = False,
    cycle: Annotated[float | None, typer.Option(help="Interpolation cycle [s], e.g. 0.004.")] = None,
    seed: Annotated[int | None, typer.Option(help="Seed instead of the scene's.", min=0)] = None,
    drift: Annotated[float, typer.Option(help="Drift of the devices' clocks [ppm].")] = 20.0,
    offset: Annotated[float, typer.Option(help="Offset between their clocks [ms].", min=0.0)] = 30.0,
    loss: Annotated[float, typer.Option(help="Share of packets that are lost, each way.", min=0.0, max=0.9)] = 0.0,
    doubled: Annotated[float, typer.Option(help="Share of packets that come twice.", min=0.0, max=0.9)] = 0.0,
    late: Annotated[float, typer.Option(help="Share of packets that come late.", min=0.0, max=0.9)] = 0.0,
    late_by: Annotated[float, typer.Option(help="By how much they are late [ms].", min=0.0, max=5000.0)] = 30.0,
    sessions: Annotated[int, typer.Option(help="End after so many sessions; 0: go on until Ctrl-C.", min=0)] = 0,
    json: Annotated[Path | None, typer.Option(help="Write what really happened in the last session to this file.")
                    ] = None,
) -> None:
    """Plays a scene's cell in real time: a controller behind RSI, a camera behind our stream, a NetFT force sensor.

    The arm waits at the start of the scene's path until a follower answers. When the answers stop it is braked, rests,
    and goes back to the start for the next one. Exit code 0 after Ctrl-C or the last session.

    Example: `ideal-robot simulate line --serve` and, in another terminal,
    `ideal-robot follow line --arm rsi://127.0.0.1:49152 --camera stream://127.0.0.1:50001`
    """
    from ideal_robot.errors import InputError
    from scenes.outputs import check_outputs
    from scenes.scene_file import load_scene
    from scenes.scene_files.scene import chosen
    from scenes.serve.cell import Places, serve_scene
    from sensing.stream import host_and_port
    from sim.devices.stream_server import Unkindness

    if not serve:
        raise InputError("simulate plays the cell behind devices: give --serve (to play a scene in one process, use "
                         "run)", field="--serve")
    check_outputs(json=json)
    loaded = chosen(load_scene(scene), seed=seed)
    if cycle is not None:
        loaded = loaded.changed(world={"t_ipo": cycle})
    scheme, _, rest = arm.partition(":")
    ports = {"rsi": 49152, "rtde": 30004}
    if scheme not in ports:
        raise InputError("expected an address such as rsi://127.0.0.1:49152 or rtde://127.0.0.1:30004", field="--arm",
                         value=arm)
    places = Places(host_and_port(rest, "--arm", ports[scheme]), host, camera_port, force_port, relative,
                    scheme == "rtde")
    unkind = Unkindness(drift=1e-6 * drift, offset=1e-3 * offset, loss=loss, doubled=doubled, late=1e-3 * late_by,
                        late_share=late)
    serve_scene(loaded, places, unkind, sessions, json, lambda text: typer.echo(text, err=True))
