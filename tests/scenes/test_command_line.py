"""The command line: exit codes, one clear line for bad input, and what --json holds."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from scenes.cli import main

SHORT = """
kind = "line"
title = "short"
speed = 0.7
[calibration]
by_moving = false
[surface]
origin = [0.98, -0.6, 0.35]
heading_deg = 90.0
[line]
points = [[0.4, 0.0], [0.8, 0.0]]
"""


def program(*words: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-m", "scenes.cli", *words], cwd=cwd, capture_output=True, text=True,
                          check=False)


def test_run_writes_what_json_names(tmp_path: Path) -> None:
    (tmp_path / "short.toml").write_text(SHORT)
    done = program("run", "short", "--json", "figures.json", "--seed", "4", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    figures = json.loads((tmp_path / "figures.json").read_text())
    assert figures["scene"] == "short"
    assert figures["seed"] == 4
    assert figures["method"] == "ideal"
    assert set(figures["control_error_mm"]) == {"mean", "p95", "max"}
    for alignment in ("time_matched", "aligned", "geometric"):
        assert set(figures["path_error_mm"][alignment]) == {"E_car", "E_max"}
    assert {"seen", "used"} <= set(figures["fields"])
    assert {"median", "p99", "max"} <= set(figures["cycle_time_ms"])
    assert (tmp_path / figures["recording"]).is_file()
    assert Path(figures["urdf"]).is_file()
    assert figures["real_time_factor"] > 0


@pytest.mark.parametrize(
    ("change", "words", "says"),
    [
        (("[surface]", "[surface]\ntilt = 3"), (), ("surface.tilt", "unknown key", "tilt_deg")),
        (("[surface]", "[world]\nstifness = 3\n[surface]"), (), ("short.toml: world.stifness", "unknown key")),
        (("[surface]", "[world]\ndamping = -1\n[surface]"), (), ("short.toml: world.damping", "negative")),
        (("[line]", "[line]\nsvg = 'M 0 0 L 1 1'"), (), ("line", "exactly one")),
        (("speed = 0.7", "speed = -1"), (), ("speed", "greater than 0")),
        (("[surface]", "[camera]\nlatency = -0.02\n[surface]"), (), ("camera.latency", "greater than or equal")),
        (("0.98", "9.98"), (), ("out of reach", "kr6")),
        (("kind", "kind = 'line'\nkind"), (), ("not a readable scene",)),
        (("", ""), ("--speed", "9"), ("speed",)),
        (("", ""), ("--speed", "-2"), ("--speed", "positive")),
        (("", ""), ("--method", "magic"), ("method", "expected one of")),
    ],
)
def test_bad_input_ends_with_two_and_one_clear_line(
    tmp_path: Path, change: tuple[str, str], words: tuple[str, ...], says: tuple[str, ...],
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str],
) -> None:
    (tmp_path / "short.toml").write_text(SHORT.replace(*change) if change[0] else SHORT)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["ideal-robot", "run", "short", *words])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    lines = [line for line in capfd.readouterr().err.splitlines() if line.strip()]
    assert len(lines) == 1
    for word in says:
        assert word in lines[0]
    assert not (tmp_path / "out").exists()


def test_two_scenes_of_one_name_are_refused(tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / f"{name}.toml").write_text('name = "twin"\n' + SHORT)
    done = program("run", "twin", cwd=tmp_path)
    assert done.returncode == 2
    assert "two scenes" in done.stderr
    assert "a.toml" in done.stderr
    assert "b.toml" in done.stderr


def test_a_scene_that_does_not_exist_names_those_that_do(tmp_path: Path) -> None:
    done = program("run", "lime", cwd=tmp_path)
    assert done.returncode == 2
    assert "straight" in done.stderr


def test_a_run_that_loses_the_line_ends_with_one_and_keeps_its_recording(tmp_path: Path) -> None:
    lost = SHORT.replace("[0.8, 0.0]]", "[1.1, 0.0]]") + '[[feature]]\nkind = "gap"\nat_mm = 450\nlength_mm = 500\n'
    (tmp_path / "lost.toml").write_text(lost)
    done = program("run", "lost", cwd=tmp_path)
    assert done.returncode == 1
    assert "line lost" in done.stderr
    assert (tmp_path / "out" / "lost" / "recording.parquet").is_file()
    assert (tmp_path / "out" / "lost" / "report.html").is_file()


@pytest.mark.parametrize("verb", ["run", "compare", "sweep", "view"])
def test_help_has_an_example(tmp_path: Path, verb: str) -> None:
    done = program(verb, "--help", cwd=tmp_path)
    assert done.returncode == 0
    assert "Example" in done.stdout


@pytest.mark.parametrize("verb", ["rsi", "precorrect"])
def test_the_help_lists_the_methods_of_the_registry(verb: str, tmp_path: Path) -> None:
    from scenes.commands.method_option import completed, methods_of

    done = program(verb, "--help", cwd=tmp_path)
    told = " ".join(done.stdout.replace("│", " ").split())
    assert ", ".join(methods_of(verb)) in told
    assert completed(verb, "id") == ["ideal"]


@pytest.mark.parametrize("words", [("identify", "r.csv", "--robot", "kr6", "--decimate-to", "nan"),
                                   ("run", "line", "--speed", "inf")])
def test_numbers_that_are_none_are_refused_by_every_verb(words: tuple[str, ...], tmp_path: Path) -> None:
    done = program(*words, cwd=tmp_path)
    assert done.returncode == 2
    assert "no finite number" in done.stderr
