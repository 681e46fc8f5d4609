"""The main job over wires beside the same job in one process, on loopback, in real time.

    python benchmarks/follow_loopback.py [--runs 20] [--only line,line_4ms] [--json FILE]

Each run starts `ideal-robot follow` against `ideal-robot simulate --serve`, two processes and the camera's. The camera
of `line` and of `glue` is calibrated by moving over the same wires once. Mean error is the distance of the true tool
from the drawn line, or the RMS error of the true normal force. A quiet computer with two cores is wanted; the program
says what load there was.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from scenes import run_scene
from scenes.scene_file import library, load_scene
from tests.scenes.follow.pair import Cell, served

UNKIND = ("--loss", "0.02", "--late", "0.003", "--late-by", "30", "--drift", "50")


@dataclass(frozen=True)
class Case:
    """One way of doing the job.

    Attributes:
        name: in the table.
        scene: shipped scene.
        allowed: of the error over wires: times that in one process, or [mm] where it is absolute.
        follow, simulate: options of both verbs.
        camera_rate: pictures a second instead of the scene's [Hz].
        absolute: whether ``allowed`` is in mm.
    """

    name: str
    scene: str
    allowed: float
    follow: tuple[str, ...] = ()
    simulate: tuple[str, ...] = ()
    camera_rate: float | None = None
    absolute: bool = False


CASES = (
    Case("line", "line", 1.3),
    Case("line_4ms", "line", 1.5, ("--cycle", "0.004"), ("--cycle", "0.004")),
    Case("line_unkind", "line", 0.3, (), UNKIND, 10.0, True),
    Case("force_wave", "force_wave", 1.3),
    Case("contour", "contour", 1.3),
    Case("glue", "glue", 1.3),
)


def scene_of(case: Case, folder: Path) -> str:
    """The shipped scene, or a copy of it with another camera rate."""
    if case.camera_rate is None:
        return case.scene
    file = folder / f"{case.name}.toml"
    text = (library() / f"{case.scene}.toml").read_text(encoding="utf-8")
    # Two pictures in a row may be lost: three periods of travel without one.
    gap = 3.5 * load_scene(case.scene).speed / case.camera_rate
    file.write_text(f"max_gap = {gap:.3f}\n{text}\n[camera]\nrate = {case.camera_rate}\n", encoding="utf-8")
    return str(file)


def error_of(figures: dict[str, Any]) -> float:
    """Mean distance [mm] where there is a line, RMS force error [N] otherwise."""
    found = figures["control_error_mm"]["mean"] if "control_error_mm" in figures else figures["force_N"]["rms_error"]
    return float("nan") if found is None else float(found)


def in_process(case: Case, scene: str) -> float:
    """The same in one process."""
    result = run_scene(load_scene(scene))
    if case.scene == "line":
        return 1e3 * float(result.control_error.mean)
    if case.scene == "glue":
        return float(result.lateral["control_error_mm"]["mean"])
    return float(result.figures.rms)


SEEN = ("line", "glue")
"""Scenes with a camera."""


def calibrated(scene: str, folder: Path) -> Path:
    """File of a scene's camera, calibrated by moving over the wires."""
    file = folder / f"camera_{scene}.json"
    with served(scene, folder) as cell:
        follower = cell.follow(scene, "--calibration", str(file))
        _, said = follower.communicate(timeout=400.0)
        if follower.returncode:
            raise SystemExit(f"calibration of {scene}: {said[-400:]}")
    return file


def played(cell: Cell, case: Case, scene: str, options: tuple[str, ...], session: int) -> dict[str, Any]:
    """One run: what really happened, by the simulated cell, and what the follower said of itself."""
    follower = cell.follow(scene, *options)
    try:
        _, said = follower.communicate(timeout=400.0)
        truth = cell.truth(session, 30.0)
    except (subprocess.TimeoutExpired, TimeoutError) as error:
        follower.kill()
        return {"code": -1, "failure": str(error)[-300:]}
    figures = cell.figures() if (cell.folder / "follow.json").exists() else {}
    link, timing = figures.get("devices", {}).get("arm", {}).get("link", {}), figures.get("timing", {})
    code = follower.returncode
    return {"code": code, "failure": figures.get("failure", said[-300:] if code else None),
            "error": error_of(truth), "share": truth["largest_acceleration_share"], "slipped": truth["slipped"],
            "held_up": truth.get("held_up", 0), "late": link.get("late", 0), "lost": link.get("lost", 0),
            "cycles": figures.get("cycles", 0), "answer_ms": timing.get("answer_ms", {}),
            "processor": timing.get("processor_share", {}), "memory": timing.get("peak_memory_MB", {}),
            "together": timing.get("memory_together_MB"), "at_start": timing.get("memory_at_start_MB")}


def summed_up(case: Case, rows: list[dict[str, Any]], own: float) -> dict[str, Any]:
    """What the runs of a case say together."""
    def all_of(key: str) -> list[float]:
        return [row[key] for row in rows if row.get(key) is not None]

    errors = np.array([value for value in all_of("error") if np.isfinite(value)])
    processor = [sum(row["processor"].values()) for row in rows if row.get("processor")]
    answered = sum(all_of("cycles"))
    return {"case": case.name, "in_process": own, "mean": float(errors.mean()) if len(errors) else float("nan"),
            "worst": float(errors.max()) if len(errors) else float("nan"),
            "allowed": case.allowed if case.absolute else case.allowed * own,
            "ended_early": sum(row["code"] != 0 for row in rows), "late_share": sum(all_of("late")) / max(answered, 1),
            "largest_acceleration_share": max(all_of("share"), default=float("nan")),
            "processor_share": max(processor, default=float("nan")),
            "memory_MB": {key: max((row["memory"][key] for row in rows if key in row.get("memory", {})),
                                   default=float("nan")) for key in ("follower", "camera")},
            "together_MB": max(all_of("together"), default=float("nan")), "runs": rows}


HEAD = (f"{'case':12} {'runs':>4} {'wires':>7} {'worst':>7} {'process':>7} {'allowed':>7} {'early':>5} {'late %':>7} "
        f"{'acc.':>5} {'cpu %':>6} {'arm MB':>6} {'camera':>6} {'both':>5}")


def line_of(found: dict[str, Any]) -> str:
    """A case as a row of the table."""
    memory = found["memory_MB"]
    return (f"{found['case']:12} {len(found['runs']):4d} {found['mean']:7.3f} {found['worst']:7.3f} "
            f"{found['in_process']:7.3f} {found['allowed']:7.3f} {found['ended_early']:5d} "
            f"{1e2 * found['late_share']:7.3f} {found['largest_acceleration_share']:5.2f} "
            f"{1e2 * found['processor_share']:6.1f} {memory['follower']:6.0f} {memory['camera']:6.0f} "
            f"{found['together_MB']:5.0f}")


def measured(case: Case, runs: int, camera: Path | None, folder: Path, keep: Callable[[dict[str, Any]], None]
             ) -> dict[str, Any]:
    """All runs of a case against one served cell; what there is so far is kept after each."""
    scene = scene_of(case, folder)
    options = (*case.follow, *(("--calibration", str(camera)) if camera is not None else ()))
    own = in_process(case, scene)
    rows: list[dict[str, Any]] = []
    session = 0
    while len(rows) < runs:
        with served(scene, folder, *case.simulate) as cell:
            (folder / "truth.json").unlink(missing_ok=True)
            for session in range(1, runs - len(rows) + 1):
                row = played(cell, case, scene, options, session)
                rows.append(row)
                keep(summed_up(case, rows, own))
                print(f"    {case.name} {len(rows):2d}: error {row.get('error', np.nan):.3f}, "
                      f"late {row.get('late', 0)} of {row.get('cycles', 0)}, "
                      f"held up by the cell {row.get('held_up', 0)}"
                      + (f", exit code {row['code']}: {row['failure']}" if row["code"] else ""), flush=True)
                if row["code"] == -1:
                    # Whatever it is that hangs, the next run begins with a fresh cell.
                    break
    return summed_up(case, rows, own)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--only", default=",".join(case.name for case in CASES))
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    found: list[dict[str, Any]] = []

    def keep(row: dict[str, Any]) -> None:
        if given.json is not None:
            given.json.write_text(json.dumps([*found, row], indent=2), encoding="utf-8")

    print(f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores; {given.runs} runs each", flush=True)
    with tempfile.TemporaryDirectory(prefix="follow_loopback_") as name:
        folder = Path(name)
        wanted = [case for case in CASES if case.name in given.only.split(",")]
        cameras = {scene: calibrated(scene, folder) for scene in SEEN if any(case.scene == scene for case in wanted)}
        for case in wanted:
            own = folder / case.name
            own.mkdir()
            row = measured(case, given.runs, cameras.get(case.scene), own, keep)
            found.append(row)
            print(HEAD, line_of(row), sep="\n", flush=True)
    print(f"\nload {os.getloadavg()[0]:.1f}; error: mm or N; late: answers the controller did not get in time; "
          "acc.: largest commanded\nacceleration as a share of the limits; cpu: both processes, of one core; MB: "
          "largest while following",
          HEAD, *map(line_of, found), sep="\n")


if __name__ == "__main__":
    main()
