"""The pytest plugin in a folder of a user's: from the checkout in a second, from the wheel and with xdist."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.scenes.test_command_line import SHORT
from tests.sources import ROOT
from tests.test_wheel import installed

__all__ = ["installed"]

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


def misses_its_baseline(folder: Path, path: Path, *words: str) -> None:
    """What is missing is said, with the remedy."""
    without = run_tests(folder, path, *words)
    assert "--update-path-errors writes it" in without.stdout, without.stdout + without.stderr
    assert "did you mean 'straight'?" in without.stdout
    assert "say which scene is played" in without.stdout
    assert "2 failed, 2 errors" in without.stdout


def test_in_a_users_folder(folder: Path) -> None:
    misses_its_baseline(folder, ROOT, "-p", "scenes.pytest_plugin", "-p", "no:xdist")
    # Three seeds; both tests share them, whose scene is the same.
    assert len(list((folder / ".pytest_cache" / "d" / "ideal_robot").glob("*.json"))) == 3


@pytest.mark.slow
@pytest.mark.parametrize("words", [(), ("-n", "2")], ids=["alone", "xdist"])
def test_from_the_wheel(installed: Path, folder: Path, words: tuple[str, ...]) -> None:
    """Baseline, the same from the cache, and worse against a baseline that was better."""
    misses_its_baseline(folder, installed, *words)
    run_tests(folder, installed, "--update-path-errors", *words)
    kept = sorted((folder / "baselines").iterdir())
    assert len(kept) == 2
    same = run_tests(folder, installed, *words)
    assert "2 passed, 2 errors" in same.stdout, same.stdout
    for file in kept:
        told = json.loads(file.read_text())
        # By as much for each seed: three seeds tell no change that scatters with them.
        by = 0.2 * min(run["control_error_mm.mean"] for run in told["runs"])
        for run in told["runs"]:
            run["control_error_mm.mean"] -= by
        file.write_text(json.dumps(told))
    worse = run_tests(folder, installed, *words)
    assert "Path error: worse" in worse.stdout
    assert "2 failed, 2 errors" in worse.stdout
