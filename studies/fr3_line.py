"""A line that is followed with an FR3 that others simulate, behind libfranka's protocol, by a camera over ROS 2."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from itertools import product
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from ideal_robot.errors import IdealRobotError, InputError
from ideal_robot.signals.recording import Recording
from scenes.commands.common import whole_numbers
from scenes.line.cell import set_up
from scenes.line.page import nearest, surface_corners
from scenes.report.replay import Replay, shown_motion
from scenes.report.video import check_video, write_video
from scenes.scene_file import load_scene
from scenes.scene_files.line_scene import LineScene
from scenes.serve.elsewhere import least_delay
from studies.other_arms import write_fr3
from studies.report import head, row
from studies.slow_clock import environment

HOST, NAMESPACE, TOPIC = "127.0.0.77", "fr3", "/fr3/camera/image_raw"
CYCLE = 0.008
"""In which it is identified and followed [s]: with the cycle the way of a command to the controller changes."""
SCENE = """kind = "line"
title = "A line followed with an FR3"
robot = "fr3.urdf"
model = "model.json"
speed = {speed}
seed = {seed}
tool_turn_deg = -135.0

[surface]
origin = [0.5, -0.3, 0.3]
heading_deg = 90.0

[line]
formula = "0.02*sin(2*pi*x/0.5)"
length = 0.6

[displacement]
lateral_mm = 3.0
along_mm = 2.0
turn_deg = 0.5

[camera]
rate = {rate}
"""
"""As every line scene it plays in the workshop, with a camera mounted by hand and a surface that is not where it should
be. The line is displaced by less than in `line`: an arm that lags by 0.1 s needs more of its acceleration for the way
to a line that has just been seen."""
_SLOW, _BESIDE = 1.5, 0.3
"""How many times slower than the arm the film plays, and what it shows before and behind the line [s]."""
_STARTS = 120.0
"""Time within which a process is there, by this computer's clock [s]."""


def fr3_line(seeds: str = "1-5", speeds: str = "0.25,0.5", slowed: float = 3.0, rate: float = 25.0,
             folder: Annotated[Path, typer.Option(help="Where models, recordings and figures are kept.")
                               ] = Path("out/fr3-line"),
             film: Annotated[Path | None, typer.Option(help="Film of the first run, e.g. a .webp.")] = None) -> None:
    """A line followed with an FR3 in franky-sim, seen by the rendered camera over ROS 2: distance of the tool from it.

    The arm is identified by three of the five commands. Then franky-sim publishes its joint states, ``simulate
    --camera-of`` sends what the scene's camera would see, and ``follow`` calibrates that camera by moving, before a
    seed's first run, and follows the line: processes of their own, on clocks that are slower by --slowed. What the
    folder holds is not played again.

    Args:
        seeds: first and last: where the line and the camera are, and their noise.
        speeds: of the tool [m/s].
        slowed: how many times as long a second takes.
        rate: pictures a second [Hz].
        folder: where models, recordings and figures are kept.
        film: of the first run; its name ends in ``.webp``, ``.gif`` or ``.mp4``. None for none.
    """
    if film is not None:
        check_video(film)
    missing = [name for name in ("franky_sim", "pylibfranka", "rclpy") if find_spec(name) is None]
    if missing:
        raise InputError(f"not played: {', '.join(missing)} not installed; pip install "
                         "'ideal-robot[franka,ros2,simulators]'", field="fr3-line")
    folder = folder.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    write_fr3(folder)
    env = environment(folder, slowed)
    # Nobody else on this computer shall be heard.
    env["ROS_DOMAIN_ID"] = str(1 + os.getpid() % 100)
    if not (folder / "model.json").is_file():
        _identified(folder)
    head("speed [m/s]", "seed", "mean [mm]", "95 % below", "largest", "cycles lost", "pictures left out",
         "remark")
    means: dict[float, list[float]] = {}
    for speed, seed in product(map(float, speeds.split(",")), whole_numbers(seeds, "--seeds")):
        figures = _figures(folder, env, speed, seed, rate)
        error = figures["control_error_mm"] or {}
        means.setdefault(speed, []).append(error.get("mean") or np.nan)
        row(f"{speed:g}", str(seed), *(f"{error.get(key) or np.nan:.3f}" for key in ("mean", "p95", "max")),
            f"{figures['lost']} of {figures['cycles']}", str(figures["pictures_left_out"]), figures["failure"] or "")
    if film is not None:
        first = float(speeds.split(",")[0]), whole_numbers(seeds, "--seeds")[0]
        write_video(_shown(folder, *first), film, slow=_SLOW)
    for speed, all_means in means.items():
        row(f"{speed:g}", "all", f"{np.mean(all_means):.3f}, at most {np.max(all_means):.3f}", "", "", "", "", "")


def _identified(folder: Path) -> None:
    """The model of the arm, from a motion that is planned for it; milliseconds begin when those before are answered."""
    urdf = str(folder / "fr3.urdf")
    _command(folder, None, "plan-identification", "--robot", urdf, "--out", "plan")
    with _process(folder, None, "fr3", "-m", "studies.other_arms", "fr3", HOST, "0", says="ready"):
        _command(folder, None, "play", "plan/commands.csv", "--robot", urdf, "--arm", f"franka://{HOST}?waits=1",
                 "--cycle", str(CYCLE), "-o", "moved.parquet")
    _command(folder, None, "identify", "moved.parquet", "--robot", urdf, "--model", "model.json")


def _figures(folder: Path, env: dict[str, str], speed: float, seed: int, rate: float) -> dict[str, Any]:
    """Figures of one run; played where they are not there yet."""
    own = folder / f"{seed}_{speed:g}"
    file = own / "figures.json"
    if not file.is_file():
        own.mkdir(exist_ok=True)
        scene = folder / f"line_{seed}_{speed:g}.toml"
        scene.write_text(SCENE.format(speed=speed, seed=seed, rate=rate), encoding="utf-8")
        done = _played(folder, env, scene, own, folder / f"camera_{seed}.json")
        file.write_text(json.dumps(done), encoding="utf-8")
    found: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    return found


def _played(folder: Path, env: dict[str, str], scene: Path, own: Path, camera: Path) -> dict[str, Any]:
    """Follows once, with an arm that stands at the start of the path."""
    loaded = load_scene(scene)
    assert isinstance(loaded, LineScene)
    start = ",".join(f"{angle:.6f}" for angle in set_up(loaded).known.follower.q_start)
    truth, told = own / "camera.json", own / "follow.json"
    for old in (truth, told):
        old.unlink(missing_ok=True)
    arm = ("-m", "studies.other_arms", "fr3", HOST, "1", start, NAMESPACE)
    eye = ("-c", "from scenes.cli import main; main()", "simulate", str(scene), "--camera-of", f"ros2://{NAMESPACE}",
           "--camera-port", "0", "--topic", TOPIC, "--wait", "30", "--json", str(truth))
    with _process(folder, env, "fr3", *arm, says="ready"), _process(own, env, "camera", *eye, says="the path starts"):
        _command(own, env, "follow", str(scene), "--arm", f"franka://{HOST}", "--cycle", str(CYCLE), "--camera",
                 f"ros2://{TOPIC}", "--camera-delay", f"{1e3 * least_delay(loaded.camera):g}", "--calibration",
                 str(camera), "--json", str(told), "--out", str(own / "out"), fails=False)
    seen = json.loads(truth.read_text(encoding="utf-8"))
    follow = json.loads(told.read_text(encoding="utf-8")) if told.is_file() else {}
    link = follow.get("devices", {}).get("arm", {}).get("link", {})
    said = (own / "follow.txt").read_text(encoding="utf-8").strip().splitlines()
    return {**seen, "failure": follow.get("failure", said[-1] if said else "nothing was said"),
            "lost": link.get("lost"), "cycles": follow.get("cycles")}


def _shown(folder: Path, speed: float, seed: int) -> Replay:
    """What a film of a run shows: the arm as it reported where it was, and how far its tool was from the drawn line."""
    scene = load_scene(folder / f"line_{seed}_{speed:g}.toml")
    assert isinstance(scene, LineScene)
    cell, recording = set_up(scene), Recording.read(folder / f"{seed}_{speed:g}" / "out" / "recording.parquet")
    _, t, q, tool = shown_motion(scene.arm, recording)
    s, lateral = cell.line.beside(tool)
    on = (s > 0.0) & (s < cell.line.length)
    error = np.where(on, 1e3 * np.abs(lateral), np.nan)
    # The last visit of the line: the camera was looked at before.
    last = int(np.flatnonzero(on)[-1])
    first = int(np.flatnonzero(~on[:last])[-1]) if not on[:last].all() else 0
    shown = (t > t[first] - _BESIDE) & (t < t[last] + _BESIDE)
    return Replay(scene.arm, t[shown], q[shown], tool[shown], nearest(cell.geometry, tool[shown]), error[shown],
                  "distance from the line", curves={"drawn line": cell.geometry.drawn},
                  surface=surface_corners(cell.geometry))


@contextmanager
def _process(folder: Path, env: dict[str, str] | None, name: str, *words: str, says: str) -> Iterator[None]:
    """A process in a folder, which is ready when it has said something; it is interrupted at the end of the block."""
    log = folder / f"{name}.log"
    with log.open("w", encoding="utf-8") as file:
        process = subprocess.Popen([sys.executable, *words], cwd=folder, env=env, stdout=file, stderr=file)
        try:
            begun = time.monotonic()
            while says not in log.read_text(encoding="utf-8"):
                if process.poll() is not None or time.monotonic() - begun > _STARTS:
                    raise IdealRobotError(f"{name} does not begin: {log.read_text(encoding='utf-8')[-300:]}")
                time.sleep(0.1)
            yield
        finally:
            process.send_signal(signal.SIGINT)
            try:
                process.wait(60.0)
            except subprocess.TimeoutExpired:
                process.kill()


def _command(folder: Path, env: dict[str, str] | None, *words: str, fails: bool = True) -> None:
    """A verb of the command line in a folder; raises IdealRobotError where it fails and ``fails`` is set."""
    print(f"ideal-robot {' '.join(words)}", file=sys.stderr, flush=True)
    done = subprocess.run([sys.executable, "-c", "from scenes.cli import main; main()", *words], cwd=folder, env=env,
                          text=True, capture_output=True, check=False)
    (folder / f"{words[0]}.txt").write_text(done.stdout + done.stderr, encoding="utf-8")
    if done.returncode and fails:
        raise IdealRobotError(f"{words[0]}: {(done.stderr.strip().splitlines() or ['failed'])[-1]}")
