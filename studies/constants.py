"""Which numbers of the modules matter: each is halved and doubled in a copy of the checkout that jobs are played by.

A number is what a module gives a name in capitals. Played are jobs that the number's package has a part in, with the
arms, seeds and disturbances of ``PLAYS``: what no disturbance there calls for (limits, gates, waits for devices that
fail) is without influence here whatever it is, and is judged by the studies of robustness. Numbers of simulated
physics, pages, protocols and of the diagnosis are left out.
"""

from __future__ import annotations

import ast
import contextlib
import importlib
import io
import json
import os
import shutil
import tempfile
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from studies.line import LENGTH, freehand
from studies.mutants import ROOT, Copy, compiled_with, in_child, one_stamp, ours_of
from studies.report import head, row

_DRAWN = {"line": {"formula": None, "length": None, "points": freehand(0.025, np.random.default_rng(1))},
          "reference": {"shape": {"points": [[0.0, 0.0], [LENGTH, 0.0]]}}}
PLAYS: dict[str, tuple[str, dict[str, Any]]] = {
    "knocked": ("line", {"world": "bench", "seed": 2, "camera": {"knock_deg": 1.0}}),
    "fast": ("line", {"seed": 3, "speed": 1.5}),
    "drawn": ("line", _DRAWN), "cluttered": ("cluttered", {"world": "bench"}), "force": ("force_wave", {}),
    "glue": ("glue", {}), "contour": ("contour", {}), "path": ("iso9283_1", {"method": "adapted"}),
    "identify": ("", {}),
}
"""Jobs: the scene and what is changed in it. Figures are the mean distance from a line [mm], the force's RMS error [N],
a path's E_car [mm] and, of two recordings of a KR 6, what the model of one leaves of the other's torque [%]."""
MEETS = {
    "planning/force": ("force", "contour"), "planning/force/line_": ("glue",),
    "planning/line": ("knocked", "drawn", "force"),
    "planning/path": ("fast", "path"),
    "sensing/camera": ("knocked", "cluttered"), "sensing/force": ("force",), "sensing": ("knocked", "force"),
    "ideal_robot/feedforward": ("fast", "path"), "ideal_robot/friction": ("fast", "path"),
    "ideal_robot/elasticity": ("fast", "path"), "ideal_robot/execution": ("fast", "force"),
    "ideal_robot/loop": ("path",), "ideal_robot/identification": ("identify",), "ideal_robot/signals": ("identify",),
    "ideal_robot/signals/bag": (), "ideal_robot/signals/export": (), "ideal_robot/signals/table_file": (),
    "ideal_robot/model": ("identify", "path"), "ideal_robot/dynamics": ("identify", "path"),
    "scenes/line": ("knocked",), "scenes/force": ("force",), "scenes/path": ("path",),
    "scenes/online/line_": ("knocked",), "scenes/online/force_": ("force", "glue"),
    "scenes/online/cycle": ("knocked", "force"),
}
"""Beginnings of files' names, and the jobs that their numbers meet; the longest beginning counts."""
SECONDS = 400.0
"""Processor time of a trial, compiling included, behind which it counts as failed."""


@dataclass(frozen=True)
class Number:
    """A number of a module.

    Attributes:
        file: module, relative to the root.
        name: its name.
        start, end: bytes of the file in which its value stands.
        value: what stands there.
    """

    file: str
    name: str
    start: int
    end: int
    value: str

    def times(self, factor: float, source: bytes) -> bytes:
        """The file with the number times a factor; of a tuple each of its numbers, whole ones rounded up."""
        scaled = _scaled(ast.parse(self.value, mode="eval").body, factor)
        return source[: self.start] + scaled.encode() + source[self.end:]


def _scaled(node: ast.expr, factor: float) -> str:
    match node:
        case ast.Constant(value=int(whole)):
            return repr(int(np.ceil(whole * factor)))
        case ast.Constant(value=float(value)):
            return repr(value * factor)
        case ast.Tuple(elts=parts) | ast.List(elts=parts):
            inner = ", ".join(_scaled(part, factor) for part in parts)
            return f"({inner},)" if isinstance(node, ast.Tuple) else f"[{inner}]"
    return f"({ast.unparse(node)}) * {factor!r}"


def _is_number(value: ast.expr) -> bool:
    """Whether numbers stand there, and neither texts nor names of other numbers."""
    parts = list(ast.walk(value))
    kinds = {type(part.value) for part in parts if isinstance(part, ast.Constant)}
    return bool(kinds) and kinds <= {int, float} and {part.id for part in parts if isinstance(part, ast.Name)} <= {"np"}


def numbers_of(root: Path, file: str) -> Iterator[Number]:
    """Numbers of a module, those that are given together each for itself."""
    source = (root / file).read_bytes()
    starts = np.cumsum([0, *map(len, source.splitlines(keepends=True))])
    for node in ast.parse(source).body:
        if not isinstance(node, ast.Assign | ast.AnnAssign) or node.value is None:
            continue
        target = node.targets[0] if isinstance(node, ast.Assign) else node.target
        pairs = [(target, node.value)]
        if isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple):
            pairs = list(zip(target.elts, node.value.elts, strict=True))
        for name, value in pairs:
            if isinstance(name, ast.Name) and name.id.lstrip("_").isupper() and _is_number(value):
                start = int(starts[value.lineno - 1]) + value.col_offset
                end = start + len((ast.get_source_segment(source.decode(), value) or "").encode())
                yield Number(file, name.id, start, end, source[start:end].decode())


def _is_compiled(number: Number) -> bool:
    """Whether a compiled function has the number in it."""
    functions = [node for module in compiled_with(number.file)
                 for node in ast.parse((ROOT / f"{module}.py").read_bytes()).body if isinstance(node, ast.FunctionDef)]
    return any(isinstance(part, ast.Name) and part.id == number.name for node in functions
               if any("jit" in ast.dump(mark) for mark in node.decorator_list) for part in ast.walk(node))


def jobs_of(file: str) -> tuple[str, ...]:
    """Jobs that a file's numbers meet."""
    return MEETS.get(max((place for place in MEETS if file.startswith(place)), key=len, default=""), ())


def _verb(*words: str) -> None:
    importlib.import_module("scenes.cli").app(list(words), standalone_mode=False)


def _figure(play: str) -> float:
    """What a job leaves, played by the modules that are imported in this process."""
    if play == "identify":
        _verb("identify", "plan/recording.parquet", "--robot", "kr6", "--validate", "other/recording.parquet",
              "--json", "found.json")
        answer = json.loads(Path("found.json").read_text(encoding="utf-8"))
        return float(np.mean([verdict["left_percent"] for verdict in answer["verdicts"]]))
    scene, changes = PLAYS[play]
    scenes = importlib.import_module("scenes")
    result = scenes.run_scene(scenes.load_scene(scene), **changes)
    if result.failure is not None:
        return float("nan")
    if hasattr(result, "figures"):
        return float(result.figures.rms)
    content = result.json()
    return float(content["control_error_mm"]["mean"] if "control_error_mm" in content
                 else content["path_error_mm"]["aligned"]["E_car"])


def _played(root: Path, plays: tuple[str, ...]) -> dict[str, float]:
    """Figures of jobs by the code of a copy, in a process of its own; those that failed are left out."""
    answer = root / "answer.json"
    answer.unlink(missing_ok=True)

    def job() -> int:
        ours_of(root)
        figures: dict[str, float] = {}
        for play in plays:
            figures[play] = _figure(play)
            answer.write_text(json.dumps(figures), encoding="utf-8")
        return 0

    in_child(job, SECONDS)
    figures = json.loads(answer.read_text(encoding="utf-8")) if answer.is_file() else {}
    return {play: value for play, value in figures.items() if np.isfinite(value)}


_copy: Copy
"""The copy of this process, in which numbers are changed."""


def _begin(recordings: str) -> None:
    """Gives a process its copy, and compiles it."""
    global _copy
    one_stamp()
    folder = Path(tempfile.mkdtemp(dir=recordings))
    _copy = Copy(folder)
    for name in ("plan", "other"):
        shutil.copytree(Path(recordings) / name, folder / name)
    _played(folder, tuple(PLAYS))


def _trial(number: Number, factor: float) -> dict[str, float]:
    with _copy.changed(number.file, partial(number.times, factor), _is_compiled(number)):
        return _played(_copy.root, jobs_of(number.file))


def _planned(folder: str) -> None:
    """Two recordings of a KR 6, of two motions."""
    for name, seed in (("plan", "1"), ("other", "2")):
        _verb("plan-identification", "--robot", "kr6", "--seed", seed, "--out", f"{folder}/{name}", "--play")


def constants(limit: float = 10.0, only: str = "") -> None:
    """Numbers of the modules that change a job's figure by more than --limit % when they are halved or doubled.

    Numbers of files alone whose names have one of the texts of ``--only``, separated by commas.
    """
    files = [str(path.relative_to(ROOT)) for path in sorted(ROOT.rglob("*.py"))]
    numbers = [number for file in files if jobs_of(file) and any(text in file for text in only.split(","))
               for number in numbers_of(ROOT, file)]
    counts: dict[str, list[bool]] = {}
    with tempfile.TemporaryDirectory() as folder:
        with contextlib.redirect_stdout(io.StringIO()):
            _planned(folder)
        with ProcessPoolExecutor(os.cpu_count(), initializer=_begin, initargs=(folder,)) as pool:
            base = pool.submit(_as_it_is).result()
            head("file", "number", "value", "halved", "doubled")
            trials = [[pool.submit(_trial, number, factor) for factor in (0.5, 2.0)] for number in numbers]
            for number, pair in zip(numbers, trials, strict=True):
                changes = [_changes(base, trial.result(), jobs_of(number.file)) for trial in pair]
                matters = any(abs(value) > limit for change in changes for value in change.values())
                counts.setdefault(str(Path(number.file).parent), []).append(matters)
                if matters:
                    row(f"`{number.file}`", f"`{number.name}`", " ".join(number.value.split()),
                        *(_said(change, limit) for change in changes))
    print()
    head("package", "numbers", f"that change a figure by more than {limit:g} %")
    for package, matter in sorted(counts.items()):
        row(f"`{package}`", len(matter), sum(matter))


def _as_it_is() -> dict[str, float]:
    return _played(_copy.root, tuple(PLAYS))


def _changes(base: dict[str, float], found: dict[str, float], plays: tuple[str, ...]) -> dict[str, float]:
    """By how many percent each job's figure changes; infinite where it failed."""
    return {play: 100.0 * (found[play] / base[play] - 1.0) if play in found else float("inf") for play in plays}


def _said(changes: dict[str, float], limit: float) -> str:
    return ", ".join(f"{play} {value:+.0f} %" if np.isfinite(value) else f"{play} fails"
                     for play, value in changes.items() if abs(value) > limit)
