"""The main job over wires beside the same job in one process, on loopback, in real time.

    python benchmarks/follow_loopback.py [--runs 20] [--only line,line_4ms] [--json FILE]

Each run starts `ideal-robot follow` against `ideal-robot simulate --serve`, two processes and the camera's. The camera
of line scenes is calibrated by moving over the same wires once. Mean error is the distance of the true tool from the
drawn line, or the RMS error of the true normal force. A quiet computer with two cores is wanted; the program says what
load there was.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from scenes import run_scene
from scenes.scene_file import library, load_scene
from tests.scenes.follow.pair import children, served

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
    file.write_text(f"{text}\n[camera]\nrate = {case.camera_rate}\n", encoding="utf-8")
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


def memory(pid: int) -> float:
    """Largest resident memory of a process so far [MiB]; NaN where the system does not tell."""
    try:
        text = Path(f"/proc/{pid}/status").read_text()
        return next(float(line.split()[1]) / 1024 for line in text.splitlines() if line.startswith("VmHWM"))
    except (OSError, StopIteration):
        return float("nan")


def finished(follower: subprocess.Popen[str]) -> tuple[int, str, dict[str, float]]:
    """Waits for a follower; exit code, what it said, and memory of its processes [MiB]."""
    most = {"follower": 0.0, "camera": 0.0}
    while follower.poll() is None:
        own = memory(follower.pid)
        below = max((memory(child) for child in children(follower.pid)), default=0.0)
        most = {"follower": max(most["follower"], own if own == own else 0.0),
                "camera": max(most["camera"], below if below == below else 0.0)}
        time.sleep(0.25)
    return follower.returncode, follower.communicate()[1], most


def calibrated(folder: Path) -> Path:
    """File of the line's camera, calibrated by moving over the wires."""
    file = folder / "camera.json"
    with served("line", folder) as cell:
        follower = cell.follow("line", "--calibration", str(file))
        follower.communicate(timeout=400.0)
    return file


def measured(case: Case, runs: int, camera: Path | None, folder: Path) -> dict[str, Any]:
    """All runs of a case against one served cell."""
    scene = scene_of(case, folder)
    options = (*case.follow, *(("--calibration", str(camera)) if camera is not None and case.scene == "line" else ()))
    rows: list[dict[str, Any]] = []
    with served(scene, folder, *case.simulate) as cell:
        for session in range(1, runs + 1):
            code, said, most = finished(cell.follow(case.scene if scene == case.scene else scene, *options))
            try:
                truth = cell.truth(session, 30.0)
            except TimeoutError:
                rows.append({"failure": said[-300:], "code": code})
                break
            figures = cell.figures() if (folder / "follow.json").exists() else {}
            link, timing = figures.get("devices", {}).get("arm", {}).get("link", {}), figures.get("timing", {})
            rows.append({"code": code, "error": error_of(truth), "share": truth["largest_acceleration_share"],
                         "late": link.get("late", 0), "lost": link.get("lost", 0), "cycles": figures.get("cycles", 0),
                         "processor": timing.get("processor_share", np.nan), "memory": most,
                         "answer_p99_ms": timing.get("answer_ms", {}).get("p99", np.nan),
                         "slipped": truth["slipped"], "failure": figures.get("failure")})
    own = in_process(case, scene)
    errors = np.array([row["error"] for row in rows if "error" in row])
    errors = errors[np.isfinite(errors)]
    mean = float(errors.mean()) if len(errors) else float("nan")
    answered = sum(row.get("cycles", 0) for row in rows)
    return {"case": case.name, "runs": rows, "in_process": own, "mean": mean,
            "worst": float(errors.max()) if len(errors) else float("nan"),
            "allowed": case.allowed if case.absolute else case.allowed * own,
            "ended_early": sum(row["code"] != 0 for row in rows),
            "late_share": sum(row.get("late", 0) for row in rows) / max(answered, 1),
            "largest_acceleration_share": max((row.get("share", np.nan) for row in rows), default=np.nan),
            "processor_share": float(np.mean([row.get("processor", np.nan) for row in rows])),
            "memory_MiB": {key: max((row["memory"][key] for row in rows if "memory" in row), default=np.nan)
                           for key in ("follower", "camera")}}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--only", default=",".join(case.name for case in CASES))
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    found = []
    print(f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores; {given.runs} runs each")
    print(f"{'case':12} {'wires':>8} {'worst':>8} {'process':>8} {'allowed':>8} {'early':>5} {'late %':>7} {'acc.':>5} "
          f"{'cpu %':>6} {'MiB':>5} {'camera':>6}")
    with tempfile.TemporaryDirectory(prefix="follow_loopback_") as name:
        folder = Path(name)
        wanted = [case for case in CASES if case.name in given.only.split(",")]
        camera = calibrated(folder) if any(case.scene == "line" for case in wanted) else None
        for case in wanted:
            own = folder / case.name
            own.mkdir()
            row = measured(case, given.runs, camera, own)
            found.append(row)
            print(f"{case.name:12} {row['mean']:8.3f} {row['worst']:8.3f} {row['in_process']:8.3f} "
                  f"{row['allowed']:8.3f} {row['ended_early']:5d} {1e2 * row['late_share']:7.3f} "
                  f"{row['largest_acceleration_share']:5.2f} "
                  f"{1e2 * row['processor_share']:6.1f} {row['memory_MiB']['follower']:5.0f} "
                  f"{row['memory_MiB']['camera']:6.0f}", flush=True)
            for run in row["runs"]:
                if run["code"] != 0:
                    print(f"    exit code {run['code']}: {run['failure']}", flush=True)
    if given.json is not None:
        given.json.write_text(json.dumps(found, indent=2), encoding="utf-8")


if __name__ == "__main__":
    main()
