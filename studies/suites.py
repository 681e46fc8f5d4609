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
"""Shipped scenes that the adaptive layer is tried on: it needs some seconds to learn."""
SCENES = {
    "short": """kind = "line"
title = "A short line, displaced by chance"
robot = "kr6"
speed = 0.7
[calibration]
by_moving = false
[surface]
origin = [0.98, -0.6, 0.35]
heading_deg = 90.0
[line]
points = [[0.4, 0.0], [0.8, 0.0]]
""",
    "triangle": """kind = "path"
title = "A small triangle"
robot = "kr15"
speed = 0.3
[path]
shape = "triangle"
size_mm = 80.0
centre = [1.05, 0.0, 0.95]
tilt_deg = 45.0
""",
    "ring": """kind = "path"
title = "A small circle"
robot = "manutec_r15"
speed = 0.3
[path]
shape = "circle"
size_mm = 100.0
centre = [0.8, 0.0, 0.75]
tilt_deg = 90.0
heading_deg = 45.0
""",
}
"""Scenes of half a second of motion, so that two hundred runs take a minute."""
SUITE = """title = "two hundred runs"
[[case]]
scenes = ["triangle.toml", "ring.toml"]
speeds = [0.3, 0.4]
seeds = "1-16"
methods = ["ideal", "precorrected_1", "none"]
[[case]]
scenes = ["short.toml"]
world = "bench"
seeds = "1-8"
"""
LAYER = """title = "{method}"
baseline = "layer.json"
[[case]]
scenes = SCENES
seeds = "1-6"
methods = ["{method}"]
""".replace("SCENES", str([f"{name}.toml" for name in PATHS]))


def check_suite(repetitions: int = 20, spoilt: float = 10.0) -> None:
    """A suite of 200 runs: called the same when nothing changed, worse with a spoilt model, better when adapting.

    Every check is a process of its own that plays all of its runs anew; none is kept. The unchanged program is checked
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
    for name, text in SCENES.items():
        (folder / f"{name}.toml").write_text(text, encoding="utf-8")
    (folder / "suite.toml").write_text(SUITE, encoding="utf-8")
    for method in ("ideal", "adapted"):
        (folder / f"{method}.toml").write_text(LAYER.format(method=method), encoding="utf-8")
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
    for name, text in SCENES.items():
        robot = text.partition('robot = "')[2].partition('"')[0]
        model = json.loads(shipped_model(robot).read_text(encoding="utf-8"))
        for law in model["friction"]:
            law["coefficients"] = [[factor * value for value in values] for values in law["coefficients"]]
        (folder / f"{robot}.json").write_text(json.dumps(model), encoding="utf-8")
        (folder / f"{name}.toml").write_text(f'model = "{robot}.json"\n{text}', encoding="utf-8")
