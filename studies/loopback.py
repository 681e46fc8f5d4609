"""The main job over wires beside the same job in one process, on loopback, in real time."""

from __future__ import annotations

import json
import os
import re
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from scenes import run_scene
from scenes.commands.common import whole_numbers
from scenes.online.processes import memory_together
from scenes.scene_file import library, load_scene
from scenes.scene_files.force_scene import ForceScene
from scenes.scene_files.line_scene import LineScene
from studies.report import head, keep, plays_in, row, scene_of
from tests.scenes.follow.pair import Cell, children, served
from tests.sources import ROOT

UNKIND = ("--loss", "0.02", "--late", "0.003", "--late-by", "30", "--drift", "50")
SEEN = ("line", "glue")
"""Scenes with a camera."""


@dataclass(frozen=True)
class Case:
    """One way of doing the job.

    Attributes:
        title: in the table.
        scene: shipped scene.
        allowed: of the error over wires: times that in one process, or [mm] where it is absolute.
        follow, simulate: options of both verbs.
        camera_rate: pictures a second instead of the scene's [Hz].
        absolute: whether ``allowed`` is in mm.
    """

    title: str
    scene: str
    allowed: float
    follow: tuple[str, ...] = ()
    simulate: tuple[str, ...] = ()
    camera_rate: float | None = None
    absolute: bool = False


FAST = ("--cycle", "0.004")
CASES = {
    "line": Case("`line`, 12 ms", "line", 1.3), "line_4ms": Case("`line`, 4 ms", "line", 1.5, FAST, FAST),
    "line_unkind": Case("`line`, 12 ms, 2 % lost each way, stalls of 30 ms, 50 ppm, camera 10 Hz", "line", 0.3, (),
                        UNKIND, 10.0, True),
    "force_wave": Case("`force_wave`", "force_wave", 1.3), "contour": Case("`contour`", "contour", 1.3),
    "glue": Case("`glue`, calibrated by moving", "glue", 1.3),
}


def loopback(runs: int = 20, only: str = ",".join(CASES), lines: Path | None = None) -> None:
    """`follow` against `simulate --serve`, two processes and the camera's, beside the same scene in one process.

    The camera of `line` and of `glue` is calibrated by moving over the same wires once. Error: mean distance of the
    true tool from the drawn line [mm], or RMS error of the true normal force [N]: mean, worst, and in brackets in one
    process. Late: answers the controller did not get in time; acceleration: largest commanded one as a share of the
    limits; processor: both processes, of one core. A quiet computer with two cores is wanted; the load is said. Every
    run is appended to --lines, if given.
    """
    print(f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores; {runs} runs each\n", flush=True)
    head("", "runs", "error", "allowed", "ended early", "late %", "acceleration", "processor %",
         "memory MB: arm + camera = together")
    with tempfile.TemporaryDirectory(prefix="follow_loopback_") as name:
        folder = Path(name)
        cases = {key: case for key, case in CASES.items() if key in only.split(",")}
        cameras = {scene: _calibrated(scene, folder) for scene in SEEN
                   if any(case.scene == scene for case in cases.values())}
        for key, case in cases.items():
            own = folder / key
            own.mkdir()
            row(case.title, *_cells(case, *_measured(key, runs, cameras.get(case.scene), own, lines)))
    print(f"\nload {os.getloadavg()[0]:.1f}")


def _scene_of(key: str, folder: Path) -> str:
    """The shipped scene, or a copy of it with another camera rate."""
    case = CASES[key]
    if case.camera_rate is None:
        return case.scene
    file = folder / f"{key}.toml"
    text = (library() / f"{case.scene}.toml").read_text(encoding="utf-8")
    # Two pictures in a row may be lost: three periods of travel without one.
    gap = 3.5 * scene_of(LineScene, case.scene).speed / case.camera_rate
    file.write_text(f"max_gap = {gap:.3f}\n{text}\n[camera]\nrate = {case.camera_rate}\n", encoding="utf-8")
    return str(file)


def _error_of(figures: dict[str, Any]) -> float:
    """Mean distance [mm] where there is a line, RMS force error [N] otherwise."""
    error = figures["control_error_mm"]["mean"] if "control_error_mm" in figures else figures["force_N"]["rms_error"]
    return float("nan") if error is None else float(error)


def _in_process(case: Case, scene: str) -> float:
    result = run_scene(load_scene(scene))
    if case.scene == "line":
        return 1e3 * float(result.control_error.mean)
    return float(result.lateral["control_error_mm"]["mean"] if case.scene == "glue" else result.figures.rms)


def _calibrated(scene: str, folder: Path) -> Path:
    """File of a scene's camera, calibrated by moving over the wires."""
    file = folder / f"camera_{scene}.json"
    with served(scene, folder) as cell:
        follower = cell.follow(scene, "--calibration", str(file))
        _, message = follower.communicate(timeout=400.0)
        if follower.returncode:
            raise SystemExit(f"calibration of {scene}: {message[-400:]}")
    return file


def _played(cell: Cell, scene: str, options: tuple[str, ...], session: int) -> dict[str, Any]:
    """One run: what really happened, by the simulated cell, and what the follower said of itself."""
    follower, message = cell.follow(scene, *options), ""
    try:
        _, message = follower.communicate(timeout=400.0)
        truth = cell.truth(session, 30.0)
    except (subprocess.TimeoutExpired, TimeoutError) as error:
        follower.kill()
        return {"code": -1, "failure": (message or str(error))[-300:]}
    figures = cell.figures() if (cell.folder / "follow.json").exists() else {}
    link, timing = figures.get("devices", {}).get("arm", {}).get("link", {}), figures.get("timing", {})
    code = follower.returncode
    return {"code": code, "failure": figures.get("failure", message[-300:] if code else None),
            "error": _error_of(truth), "share": truth["largest_acceleration_share"],
            "held_up": truth.get("held_up", 0), "late": link.get("late", 0), "cycles": figures.get("cycles", 0),
            "answer_ms": timing.get("answer_ms", {}), "processor": sum(timing.get("processor_share", {}).values()),
            "memory": timing.get("peak_memory_MB", {}), "together": timing.get("memory_together_MB")}


def _measured(key: str, runs: int, camera: Path | None, folder: Path,
              lines: Path | None) -> tuple[list[dict[str, Any]], float]:
    """All runs of a case against one served cell, and the error in one process."""
    case, scene = CASES[key], _scene_of(key, folder)
    options = (*case.follow, *(("--calibration", str(camera)) if camera is not None else ()))
    own, results = _in_process(case, scene), list[dict[str, Any]]()
    while len(results) < runs:
        with served(scene, folder, *case.simulate) as cell:
            (folder / "truth.json").unlink(missing_ok=True)
            for session in range(1, runs - len(results) + 1):
                results.append(_played(cell, scene, options, session))
                keep(lines, {"case": key, "in_process": own, **results[-1]})
                if results[-1]["code"] == -1:
                    # Whatever it is that hangs, the next run begins with a fresh cell.
                    break
    return results, own


def _cells(case: Case, runs: list[dict[str, Any]], own: float) -> list[str]:
    """What the runs of a case say together."""
    def all_of(key: str) -> list[Any]:
        return [run[key] for run in runs if run.get(key) is not None]

    errors = np.array([value for value in all_of("error") if np.isfinite(value)] or [np.nan])
    memory = [max((usage[key] for usage in all_of("memory") if key in usage), default=np.nan)
              for key in ("follower", "camera")]
    return [str(len(runs)), f"{errors.mean():.3f}, {errors.max():.3f} ({own:.3f})",
            f"{case.allowed if case.absolute else case.allowed * own:.3f}", str(sum(run["code"] != 0 for run in runs)),
            f"{1e2 * sum(all_of('late')) / max(sum(all_of('cycles')), 1):.2f}",
            f"{max(all_of('share'), default=np.nan):.2f}", f"{1e2 * max(all_of('processor'), default=np.nan):.0f}",
            " + ".join("–" if np.isnan(megabytes) else f"{megabytes:.0f}" for megabytes in memory)
            + f" = {max(all_of('together'), default=np.nan):.0f}"]


# Cells that nobody has seen, each followed once.

def wires(scenes: str = "line", seeds: str = "1-10", offsets: str = "", stiffnesses: str = "",
          lines: Path | None = None) -> None:
    """Sound cells followed over wires in real time, over seeds: jobs done, largest force, errors, the machine's load.

    Each play has processes of its own, and a camera calibrates itself by moving first. The surface of a force scene is
    off by each of ``--offsets`` [mm, with commas] from where it is told, with a tip of each of ``--stiffnesses``
    [N/mm]; empty: as the scene has it. Plays that the file of --lines holds are not repeated. Exit code 1 where one is
    not done.
    """
    played = plays_in(lines)
    tips = list(product(offsets.split(","), stiffnesses.split(",")))
    table = defaultdict(list)
    for scene, seed in product(scenes.split(","), whole_numbers(seeds, "--seeds")):
        for offset, stiffness in tips:
            of = [scene, offset, stiffness, seed]
            run = next((run for run in played if run["of"] == of), None)
            if run is None:
                load = os.getloadavg()[0]
                with tempfile.TemporaryDirectory(prefix="follow_wires_") as folder:
                    run = {"of": of, "load": load, **_one(scene, seed, offset, stiffness, Path(folder))}
                print(run, file=sys.stderr, flush=True)
                keep(lines, run)
            table[scene, offset, stiffness].append(run)
    head("scene", "surface off by [mm]", "tip [N/mm]", "seeds", "done", "largest force [N]",
         "error [mm or N]: median, worst", "late %, worst", "acceleration / allowed", "load")
    for cell, runs in table.items():
        done = [run for run in runs if run["code"] == 0]
        errors = [run["error"] for run in done] or [np.nan]
        late = [1e2 * run["late"] / max(run["cycles"], 1) for run in runs if "late" in run] or [np.nan]
        force = [run["largest"] for run in runs if run.get("largest") is not None]
        row(*cell, len(runs), len(done), f"{max(force):.1f}" if force else "",
            f"{np.median(errors):.3f}, {max(errors):.3f}", f"{max(late):.2f}",
            f"{max((run['share'] for run in runs if 'share' in run), default=np.nan):.2f}",
            f"{max(run['load'] for run in runs):.1f}")
    if any(run["code"] != 0 for runs in table.values() for run in runs):
        sys.exit(1)


def _one(scene: str, seed: int, offset: str, stiffness: str, folder: Path) -> dict[str, Any]:
    """A cell served, and followed once; see ``wires``."""
    file, text = folder / f"{scene}.toml", (library() / f"{scene}.toml").read_text(encoding="utf-8")
    if offset:
        text = re.sub(r"(?m)^offset_mm = .*$", f"offset_mm = {offset}", text)
    if stiffness:
        text += f"\n[tip]\nstiffness = {1e3 * float(stiffness)}\n"
    file.write_text(text, encoding="utf-8")
    camera = ("--calibration", str(folder / "camera.json")) if scene in SEEN else ()
    with served(str(file), folder, "--seed", str(seed)) as cell:
        # A calibration is a session of its own.
        run = _played(cell, str(file), camera, 2 if camera else 1)
    truth = folder / "truth.json"
    force = json.loads(truth.read_text()).get("force_N", {}) if truth.exists() else {}
    return {**run, "largest": force.get("largest")}


# An hour in one go, with a camera that is switched off and on again.

AWAY = 2.0
"""Time for which the camera is gone [s]."""
TOLD = 60
"""Times that the memory is looked at."""


def follow_hour(minutes: float = 60.0, cycle: float = 0.012, scene: str = "glue",
                relay: Annotated[str, typer.Option(hidden=True)] = "") -> None:
    """A scene so slowly that it lasts an hour, in real time; the camera is gone for two seconds at half of it.

    Processes of their own: the arm's controller with the force sensor (250 Hz), the camera (50 Hz), the wire to it, the
    follower, the evaluation of pictures. Memory is that of the follower's two, what they share counted once. Exit code
    1 where the path was not completed. A camera is calibrated before.
    """
    if relay:
        _relayed(*map(int, relay.split(":")))
        return
    with tempfile.TemporaryDirectory(prefix="follow-hour-") as name:
        folder, text = Path(name), (library() / f"{scene}.toml").read_text(encoding="utf-8")
        file = folder / f"{scene}.toml"
        file.write_text(f"max_duration = 7200.0\n{text}", encoding="utf-8")
        camera = ("--calibration", str(_calibrated(scene, folder))) if scene in SEEN else ()
        length = float(scene_of(ForceScene, scene).line.length or 1.0)
        print(f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores", flush=True)
        with served(str(file), folder, "--cycle", str(cycle)) as cell, _through(cell) as wire:
            follower = cell.follow(str(file), *camera, "--cycle", str(cycle),
                                   "--speed", str(length / (60.0 * minutes)))
            memory, begun, gone = list[float](), time.monotonic(), False
            while follower.poll() is None:
                with suppress(subprocess.TimeoutExpired):
                    follower.wait(60.0 * minutes / TOLD)
                memory.append(memory_together([follower.pid, *children(follower.pid)]))
                if not gone and time.monotonic() - begun > 30.0 * minutes:
                    gone = True
                    wire()
            code, message = follower.returncode, follower.communicate()[1][-400:]
            if not (folder / "follow.json").exists():
                raise SystemExit(message)
            truth, figures = cell.truth(1, 60.0), cell.figures()
    link, timing = figures["devices"]["arm"]["link"], figures["timing"]
    print(f"{figures['cycles']} cycles of {1e3 * cycle:g} ms in {timing['seconds']:.0f} s; ended with {code} {message}")
    print(f"late {link['late']}, lost {link['lost']}, held up in the controller {truth['held_up']}; answer after [ms] "
          f"{timing['answer_ms']}, computing [ms] {timing['computing_ms']}")
    print(f"fields {figures['fields']}, camera gone {int(gone)} times for {AWAY:g} s; true error {truth['force_N']}, "
          f"{truth['control_error_mm']}")
    held = [megabytes for megabytes in memory[2:-2] if np.isfinite(megabytes)] or [float("nan")]
    print(f"memory [MB]: {held[0]:.0f} at first, {max(held):.0f} at most, {held[-1]:.0f} at last; load "
          f"{os.getloadavg()[0]:.1f}")
    raise typer.Exit(code != 0)


@contextmanager
def _through(cell: Cell) -> Iterator[Any]:
    """Puts a process between camera and follower; yields what kills it and starts another one ``AWAY`` later."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        ports = f"{free.getsockname()[1]}:{cell.ports['camera']}"
    cell.ports["camera"] = int(ports.partition(":")[0])

    def begun() -> subprocess.Popen[bytes]:
        return subprocess.Popen([sys.executable, "-m", "studies", "follow-hour", "--relay", ports],
                                env={**os.environ, "PYTHONPATH": str(ROOT)})

    parts = [begun()]

    def again() -> None:
        parts[-1].kill()
        parts[-1].wait()
        time.sleep(AWAY)
        parts.append(begun())

    try:
        yield again
    finally:
        parts[-1].kill()
        parts[-1].wait()


def _relayed(own: int, other: int) -> None:
    """Hands on whatever comes, both ways."""
    def hand_on(source: socket.socket, sink: socket.socket) -> None:
        with suppress(OSError):
            while piece := source.recv(65536):
                sink.sendall(piece)
        for end in (source, sink):
            with suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)

    with socket.create_server(("127.0.0.1", own)) as listener:
        while True:
            here = listener.accept()[0]
            there = _connected(other)
            for ends in ((here, there), (there, here)):
                ends[0].setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                threading.Thread(target=hand_on, args=ends, daemon=True).start()


def _connected(port: int) -> socket.socket:
    while True:
        with suppress(ConnectionRefusedError):
            return socket.create_connection(("127.0.0.1", port))
        time.sleep(0.2)
