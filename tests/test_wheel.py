"""The ten examples run from an installed wheel in another folder, in at most ten lines of code each."""

from __future__ import annotations

import ast
import fcntl
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("ideal_robot", "planning", "scenes", "sensing", "sim", "trials")
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
SHOWS = {
    "diagnose_plot": "stribeck in tau_4", "identify_frame": "controller", "own_driver": "played to its end",
    "own_effect": "air_drag in tau_1", "own_feedforward": "OneCycleAhead", "own_robot": "expected rms error",
    "own_sensor": "(47, 47)", "own_svg": "LineResult('svg')", "precorrect_arrays": "expected rms error",
    "sweep": "worst mean",
}
"""What each of them prints."""
LONG = ("diagnose_plot", "own_feedforward")
"""Those that take longer than a quarter of a minute."""


@pytest.fixture(scope="session")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder into which the wheel is installed; built once for all processes of the tests."""
    own = tmp_path_factory.getbasetemp()
    shared = (own.parent if "PYTEST_XDIST_WORKER" in os.environ else own) / "wheel"
    shared.mkdir(exist_ok=True)
    with (shared / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (shared / "done").exists():
            build(shared)
            (shared / "done").touch()
    return shared / "target"


def build(folder: Path) -> None:
    """Builds the wheel from a copy of the sources, so that nothing is left among them, and installs it."""
    source, pip = folder / "source", [sys.executable, "-m", "pip", "-q", "--disable-pip-version-check"]
    source.mkdir()
    for name in PACKAGES:
        shutil.copytree(ROOT / name, source / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    run([*pip, "wheel", "--no-deps", "--no-build-isolation", "-w", str(folder), str(source)], folder)
    [wheel] = folder.glob("*.whl")
    run([*pip, "install", "--no-deps", "--target", str(folder / "target"), str(wheel)], folder)
    carry_compiled(folder / "target")


def carry_compiled(target: Path) -> None:
    """Gives the installed sources the compiled code of these, which takes a minute to make; their times tell it."""
    for path in (path for name in PACKAGES for path in (ROOT / name).rglob("*")):
        there, times = target / path.relative_to(ROOT), path.stat()
        if path.suffix == ".nbc":
            there.parent.mkdir(exist_ok=True)
            shutil.copy2(path, there)
        elif path.suffix == ".py":
            os.utime(there, ns=(times.st_atime_ns, times.st_mtime_ns))


def run(command: list[str], folder: Path, path: Path | None = None) -> str:
    """Runs a command in a folder, with packages from ``path`` first; returns what it printed."""
    environment = {**os.environ, "PYTHONPATH": "" if path is None else str(path)}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False,
                          timeout=600)
    assert done.returncode == 0, done.stderr
    return done.stdout


def lines_of_code(text: str) -> int:
    """Lines that hold code: without blank lines, comments and docstrings."""
    tree, lines = ast.parse(text), set()
    for node in ast.walk(tree):
        if isinstance(node, ast.stmt) and not (isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)):
            body = [inner.lineno for inner in getattr(node, "body", []) if isinstance(inner, ast.stmt)]
            lines |= set(range(node.lineno, min(body, default=(node.end_lineno or 0) + 1)))
    return len({n for n in lines if text.splitlines()[n - 1].strip()} - set(docstrings(tree)))


def docstrings(tree: ast.AST) -> list[int]:
    """Numbers of the lines that docstrings take."""
    return [line for node in ast.walk(tree)
            if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
            for line in range(node.lineno, (node.end_lineno or 0) + 1)]


def test_there_are_ten() -> None:
    assert [example.stem for example in EXAMPLES] == sorted(SHOWS)


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_short_and_through_the_doors(example: Path) -> None:
    text = example.read_text(encoding="utf-8")
    ours = set()
    for node in ast.walk(ast.parse(text)):
        names = ([alias.name for alias in node.names] if isinstance(node, ast.Import)
                 else [node.module or ""] if isinstance(node, ast.ImportFrom) else [])
        ours |= {name for name in names if name.split(".")[0] in PACKAGES}
    assert ours <= {"ideal_robot", "scenes"}
    assert lines_of_code(text) <= 10


def test_the_wheel_holds_everything(installed: Path, tmp_path: Path) -> None:
    tracked = [path.relative_to(ROOT) for name in PACKAGES for path in (ROOT / name).rglob("*")
               if path.is_file() and "__pycache__" not in path.parts]
    assert [str(path) for path in tracked if not (installed / path).is_file()] == []
    program = f"import {', '.join(PACKAGES)}; print({', '.join(f'{name}.__file__' for name in PACKAGES)}, sep='\\n')"
    places = run([sys.executable, "-c", program], tmp_path, installed).split()
    assert [place for place in places if not Path(place).is_relative_to(installed)] == []


@pytest.mark.parametrize("example", [pytest.param(one, marks=pytest.mark.slow if one.stem in LONG else ())
                                     for one in EXAMPLES], ids=lambda path: path.stem)
def test_runs_from_the_wheel(example: Path, installed: Path, tmp_path: Path) -> None:
    assert SHOWS[example.stem] in run([sys.executable, str(example)], tmp_path, installed)
