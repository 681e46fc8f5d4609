"""The examples run from an installed wheel in another folder, each alone and through the two doors."""

from __future__ import annotations

import ast
import fcntl
import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pinocchio
import pytest

from tests.conftest import in_part
from tests.scenes.regression.test_check import SHORT
from tests.sources import ROOT

PACKAGES = ("ideal_robot", "planning", "scenes", "sensing", "sim")
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
SHOWS = {
    "clamped_stiffness": "within its interval", "compare_methods": "smallest error: ideal",
    "follow_line": "along the line", "inspect_recording": "joints (3,)", "keep_force": "RMS force error",
    "diagnose_plot": "stribeck in tau_4", "identify_frame": "controller", "own_driver": "played to its end",
    "own_effect": "air_drag in tau_1", "own_feedforward": "OneCycleAhead", "own_robot": "expected rms error",
    "own_sensor": "(47, 47)", "own_svg": "LineResult('svg')", "precorrect_arrays": "expected rms error",
    "sweep": "fastest within 0.2 mm", "close_loop": "added: joint_elasticity in joint 2",
}
"""What each of them prints."""

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
    shutil.copytree(ROOT / "examples", source / "examples")
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    run([*pip, "wheel", "--no-deps", "--no-build-isolation", "-w", str(folder), str(source)], folder)
    [wheel] = folder.glob("*.whl")
    # Not compiled: what has other times than it had then is compiled again.
    run([*pip, "install", "--no-deps", "--no-compile", "--target", str(folder / "target"), str(wheel)], folder)
    carry_compiled(folder / "target")


def carry_compiled(target: Path) -> None:
    """Gives the installed sources the compiled code of these, which takes a minute to make; their times tell it."""
    for path in (path for name in PACKAGES for path in (ROOT / name).rglob("*")):
        copy, times = target / path.relative_to(ROOT), path.stat()
        if path.suffix == ".nbc":
            copy.parent.mkdir(exist_ok=True)
            shutil.copy2(path, copy)
        elif path.suffix == ".py":
            os.utime(copy, ns=(times.st_atime_ns, times.st_mtime_ns))


def run(command: list[str], folder: Path, path: Path | None = None) -> str:
    """Runs a command in a folder, with packages from ``path`` first; returns what it printed."""
    environment = {**os.environ, "PYTHONPATH": "" if path is None else str(path)}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False,
                          timeout=600)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_each_is_played() -> None:
    assert [example.stem for example in EXAMPLES] == sorted(SHOWS)


def test_the_verb_writes_them_from_the_wheel(installed: Path, tmp_path: Path) -> None:
    said = run([sys.executable, "-m", "scenes.cli", "examples", "mine"], tmp_path, installed)
    shipped = {path.name: path.read_bytes() for path in (ROOT / "examples").iterdir() if path.is_file()}
    assert {path.name: path.read_bytes() for path in (tmp_path / "mine").iterdir()} == shipped
    assert all(example.name in said for example in EXAMPLES)
    again = subprocess.run([sys.executable, "-m", "scenes.cli", "examples", "mine"], cwd=tmp_path, capture_output=True,
                           text=True, check=False, env={**os.environ, "PYTHONPATH": str(installed)})
    assert again.returncode == 2


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_goes_through_the_doors(example: Path) -> None:
    text = example.read_text(encoding="utf-8")
    ours = set()
    for node in ast.walk(ast.parse(text)):
        names = ([alias.name for alias in node.names] if isinstance(node, ast.Import)
                 else [node.module or ""] if isinstance(node, ast.ImportFrom) else [])
        ours |= {name for name in names if name.split(".")[0] in PACKAGES}
    assert ours <= {"ideal_robot", "scenes"}


def test_the_wheel_holds_everything(installed: Path, tmp_path: Path) -> None:
    tracked = [path.relative_to(ROOT) for name in PACKAGES for path in (ROOT / name).rglob("*")
               if path.is_file() and "__pycache__" not in path.parts]
    assert [str(path) for path in tracked if not (installed / path).is_file()] == []
    program = f"import {', '.join(PACKAGES)}; print({', '.join(f'{name}.__file__' for name in PACKAGES)}, sep='\\n')"
    places = run([sys.executable, "-c", program], tmp_path, installed).split()
    assert [place for place in places if not Path(place).is_relative_to(installed)] == []


@pytest.mark.slow
@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_runs_from_the_wheel(example: Path, installed: Path, tmp_path: Path) -> None:
    assert SHOWS[example.stem] in run([sys.executable, str(example)], tmp_path, installed)


def test_folders_of_the_users_that_have_our_names(installed: Path, tmp_path: Path) -> None:
    """The program finds its own; a script that starts beside them is told in a line what hides what."""
    for name in ("sim", "planning"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").touch()
    found = "from scenes.program import find_ours_first as f; f(); import sim.arm, planning.path; print(sim.__file__)"
    assert str(installed) in run([sys.executable, "-c", found], tmp_path, installed)
    done = subprocess.run([sys.executable, "-c", "from scenes import run_scene"], cwd=tmp_path, capture_output=True,
                          text=True, check=False, env={**os.environ, "PYTHONPATH": str(installed)})
    assert str(tmp_path / "planning") in done.stderr.splitlines()[-1]
    assert "hides the package planning of ideal-robot" in done.stderr.splitlines()[-1]


# The image is built and started by commands that README and Makefile have too; Docker itself is not needed here.

LINES = [line for line in (ROOT / "Dockerfile").read_text(encoding="utf-8").splitlines() if line.strip()]
STEPS = [tuple(line.split(maxsplit=1)) for line in LINES if not line.startswith("#")]
README = (ROOT / "README.md").read_text(encoding="utf-8")
MAKEFILE = (ROOT / "Makefile").read_text(encoding="utf-8")


def test_it_has_only_known_instructions_and_a_python_the_package_takes() -> None:
    assert {step for step, _ in STEPS} <= {"FROM", "RUN", "WORKDIR", "COPY", "ENV", "USER", "CMD"}
    image = re.fullmatch(r"python:(\d+)\.(\d+)-slim", STEPS[0][1])
    assert image is not None
    required = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["requires-python"]
    assert (int(image[1]), int(image[2])) >= tuple(map(int, required.removeprefix(">=").split(".")))


def test_what_it_makes_are_targets_of_the_makefile_and_what_it_starts_is_readmes_first_command() -> None:
    targets = set(re.findall(r"^([.\w/-]+):", MAKEFILE, re.M))
    goals = [word for step, text in STEPS if step == "RUN" for word in re.findall(r"\bmake ([.\w/-]+)", text)]
    assert goals == [".venv/installed"]
    assert set(goals) <= targets
    start = json.loads(next(text for step, text in STEPS if step == "CMD"))
    first = re.search(r"```sh\n(make \w+)", README)
    assert first is not None
    assert " ".join(start) == first[1]


def test_the_environment_of_the_image_is_the_one_that_is_installed() -> None:
    folder = next(text for step, text in STEPS if step == "WORKDIR")
    assert any(line.startswith(f"ENV PATH={folder}/.venv/bin:$PATH") for line in LINES)
    assert "BIN := .venv/bin" in MAKEFILE


def test_what_wheels_need_of_the_system_is_installed() -> None:
    """Debian's slim image has the C and C++ libraries, but not OpenMP's, which Pinocchio's wheel does not bring."""
    compiled = next(Path(pinocchio.__path__[0]).glob("pinocchio_pywrap_default*.so")).read_bytes()
    bundled = [path for path in Path(pinocchio.__path__[0]).parents[2].glob("libgomp*")]
    if b"libgomp.so.1\0" in compiled and not bundled:
        assert any("libgomp1" in text.split() for step, text in STEPS if step == "RUN")


def test_readme_says_the_commands_of_its_heading_and_nothing_private_goes_in() -> None:
    commands = [line.removeprefix("#").strip() for line in LINES if line.startswith("#   ")]
    assert len(commands) == 2
    assert all(command in README for command in commands)
    left_out = (ROOT / ".dockerignore").read_text(encoding="utf-8").split()
    assert {".git", ".venv", "out"} <= set(left_out)


# The slow tests in parts: each is in exactly one, and the Makefile goes through all of them.

def test_every_test_is_in_one_part() -> None:
    names = [f"tests/test_{i}.py::test" for i in range(500)]
    memberships = [[part for part in range(20) if in_part(name, part, 20)] for name in names]
    assert all(len(parts) == 1 for parts in memberships)
    assert {parts[0] for parts in memberships} == set(range(20))
    assert in_part(names[0], memberships[0][0] + 20, 20)


def test_continuous_integration_runs_both_targets_and_the_part_changes_with_the_commit() -> None:
    script = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    assert re.findall(r"^make ([\w-]+)", script, flags=re.MULTILINE) == ["test", "test-part"]
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    assert re.search(r"^test-part:.*\n(?:\t.*\n)*\t.*--part \$\$\(git rev-list --count HEAD", makefile,
                     flags=re.MULTILINE)


# The pytest plugin in a folder of a user's: from the checkout in a second, from the wheel and with xdist.

TESTS = """
import pytest

@pytest.mark.ideal_scene("short.toml", world="bench")
@pytest.mark.parametrize("speed", [0.5, 0.7])
def test_follows(path_error, baseline, speed):
    runs = path_error(seeds=[1, 2, 3])
    assert runs.mean("control_error_mm.mean") < 20.0
    baseline(runs)

@pytest.mark.ideal_scene("strait")
def test_no_such_scene(path_error):
    path_error()

def test_no_marker(path_error):
    path_error()
"""


def run_tests(folder: Path, path: Path, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-m", "pytest", "-q", *words], cwd=folder, capture_output=True, text=True,
                          check=False, env={**os.environ, "PYTHONPATH": str(path), "PYTEST_ADDOPTS": ""})


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A user's tests and their scene."""
    (tmp_path / "short.toml").write_text(SHORT)
    (tmp_path / "test_own.py").write_text(TESTS)
    return tmp_path


def misses_its_baseline(said: str) -> None:
    """What is missing is said, with the remedy."""
    assert "--update-path-errors writes it" in said, said
    assert "did you mean 'straight'?" in said
    assert "During handling" not in said
    assert "say which scene is played" in said
    assert "2 failed, 2 errors" in said


def test_in_a_users_folder(folder: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(folder)
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.setitem(sys.modules, "test_own", None)  # whatever stands there is taken away afterwards
    monkeypatch.delitem(sys.modules, "test_own")
    (folder / "test_own.py").write_text(TESTS.replace("[1, 2, 3]", "[1]"))
    # Others' plugins, which this process has imported, would warn of it.
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")
    pytest.main(["-q", "-p", "scenes.pytest_plugin"])
    misses_its_baseline(capfd.readouterr().out)
    # Both tests share the run, whose scene is the same.
    assert len(list((folder / ".pytest_cache" / "d" / "ideal_robot").glob("*.json"))) == 1


@pytest.mark.slow
@pytest.mark.parametrize("words", [(), ("-n", "2")], ids=["alone", "xdist"])
def test_from_the_wheel(installed: Path, folder: Path, words: tuple[str, ...]) -> None:
    """Baseline, the same from the cache, and worse against a baseline that was better."""
    misses_its_baseline(run_tests(folder, installed, *words).stdout)
    run_tests(folder, installed, "--update-path-errors", *words)
    baselines = sorted((folder / "baselines").iterdir())
    assert len(baselines) == 2
    same = run_tests(folder, installed, *words)
    assert "2 passed, 2 errors" in same.stdout, same.stdout
    for file in baselines:
        baseline = json.loads(file.read_text())
        # By as much for each seed: three seeds tell no change that scatters with them.
        by = 0.2 * min(run["control_error_mm.mean"] for run in baseline["runs"])
        for run in baseline["runs"]:
            run["control_error_mm.mean"] -= by
        file.write_text(json.dumps(baseline))
    worse = run_tests(folder, installed, *words)
    assert "Path error: worse" in worse.stdout
    assert "2 failed, 2 errors" in worse.stdout
