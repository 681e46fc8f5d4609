"""The nightly check put to the test: does it call an unchanged program the same, and a changed one by its name?"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import typer

from scenes.model_files import shipped_model
from scenes.scene_file import library
from studies.report import head, row
from studies.sweeps import cluster

PATHS = ("iso9283_2", "iso9283_3", "vertical_circle")
SHORT = """kind = "line"
title = "A short line across the path, displaced by chance"
speed = 0.7
[calibration]
by_moving = false
[surface]
origin = [0.98, -0.6, 0.35]
heading_deg = 90.0
[line]
points = [[0.4, 0.0], [0.8, 0.0]]
"""
SUITE = """title = "two hundred runs"
[[case]]
scenes = ["iso9283_2.toml", "iso9283_3.toml", "vertical_circle.toml"]
speeds = [0.5, 0.63]
seeds = "1-9"
methods = ["ideal", "precorrected_1", "none"]
[[case]]
scenes = ["short.toml"]
world = "bench"
seeds = "1-19"
methods = ["ideal", "none"]
"""
LAYER = """title = "{title}"
baseline = "layer.json"
[[case]]
scenes = ["iso9283_2.toml", "iso9283_3.toml", "vertical_circle.toml"]
speeds = [0.5, 0.63]
seeds = "1-9"
methods = ["{method}"]
"""
"""The same path scenes with one method each time."""


def check_suite(repetitions: int = 20, spoilt: float = 10.0) -> None:
    """A suite of 200 runs: called the same when nothing changed, worse with a spoilt model, better when adapting.

    Every check is a process of its own that plays all of its runs anew; no run is kept. The unchanged program is checked
    --repetitions times, with one process, two, and two workers of Dask in turns. Then all coefficients of the model's
    friction are --spoilt percent too large, and then the adaptive layer is on. Exit code 1 where a verdict is wrong.
    """
    with tempfile.TemporaryDirectory(prefix="check-suite-") as name:
        folder = Path(name)
        _write(folder)
        (folder / "cluster").mkdir()
        right = [_checked(folder, "suite", ["--update-baseline", "--processes", "2"], "baseline", "")]
        with cluster(folder / "cluster", 2) as (address, _):
            workers = {"1 process": ["--processes", "1"], "2 processes": ["--processes", "2"],
                       "2 workers of Dask": ["--dask", address]}
            for number in range(repetitions):
                where = list(workers)[number % len(workers)]
                right.append(_checked(folder, "suite", workers[where], f"unchanged, {where}", "same"))
        _checked(folder, "ideal", ["--update-baseline"], "baseline of ideal", "")
        right.append(_checked(folder, "adapted", [], "adaptive layer on", "better"))
        _spoil(folder, 1.0 + spoilt / 100.0)
        right.append(_checked(folder, "suite", [], f"friction {spoilt:g} % too large", "worse"))
    raise typer.Exit(not all(right))


def _write(folder: Path) -> None:
    for path in PATHS:
        shutil.copy(library() / f"{path}.toml", folder / f"{path}.toml")
    (folder / "short.toml").write_text(SHORT, encoding="utf-8")
    (folder / "suite.toml").write_text(SUITE, encoding="utf-8")
    for method in ("ideal", "adapted"):
        (folder / f"{method}.toml").write_text(LAYER.format(title=f"with {method}", method=method), encoding="utf-8")
    head("what", "runs", "lasted", "verdict", "wanted", "cases worse", "better", "same results, bit by bit")


def _checked(folder: Path, suite: str, options: list[str], what: str, wanted: str) -> bool:
    """Checks a suite as a user does and prints what was found; whether it is what was wanted."""
    begun = time.monotonic()
    done = subprocess.run([sys.executable, "-m", "scenes.cli", "check", f"{suite}.toml", *options], cwd=folder,
                          capture_output=True, text=True, check=False,
                          env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[1])})
    out = folder / "out" / f"check_{suite}"
    if not (out / "comparison.json").is_file():
        raise SystemExit(done.stdout + done.stderr)
    told = json.loads((out / "comparison.json").read_text())
    results, baseline = (json.loads(path.read_text())["runs"] for path in
                         (out / "results.json", folder / ("suite.baseline.json" if suite == "suite" else "layer.json")))
    verdict = told["verdict"] if wanted else ""
    row(what, len(results), f"{time.monotonic() - begun:.0f} s", verdict, wanted, _cases(told, "worse"),
        _cases(told, "better"), "yes" if results == baseline else "no")
    return verdict == wanted and done.returncode == (wanted == "worse")


def _cases(told: dict[str, Any], verdict: str) -> str:
    return "; ".join(dict.fromkeys(one["case"] for one in told["figures"] if one["verdict"] == verdict))


def _spoil(folder: Path, factor: float) -> None:
    """Gives all scenes the shipped model of their arm with friction times ``factor``."""
    for robot in ("kr6", "kr15", "manutec_r15"):
        model = json.loads(shipped_model(robot).read_text(encoding="utf-8"))
        for law in model["friction"]:
            law["coefficients"] = [[factor * value for value in values] for values in law["coefficients"]]
        (folder / f"{robot}.json").write_text(json.dumps(model), encoding="utf-8")
    for name in (*PATHS, "short"):
        text = (folder / f"{name}.toml").read_text(encoding="utf-8")
        robot = next((line.split('"')[1] for line in text.splitlines() if line.startswith("robot")), "kr6")
        (folder / f"{name}.toml").write_text(f'model = "{robot}.json"\n{text}', encoding="utf-8")
