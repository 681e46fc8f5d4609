"""``ideal-robot check`` and ``compare-results``: verdicts, exit codes, files, and wrong input in one line."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from scenes.regression.results import read_results
from tests.scenes.test_command_line import SHORT

SUITE = """
title = "short line"
[[case]]
scenes = ["short.toml"]
seeds = "1-3"
world = "bench"
bounds = {"control_error_mm.mean" = "LIMIT"}
"""
JUNIT = {"testsuites": {"name"}, "testsuite": {"name", "tests", "errors", "failures", "skipped"},
         "testcase": {"classname", "name"}, "failure": {"message"}, "skipped": {"message"}}
"""Elements and attributes of ours that the schema of JUnit files allows (Jenkins' xunit plugin)."""


@pytest.fixture
def suite(tmp_path: Path) -> Path:
    (tmp_path / "short.toml").write_text(SHORT)
    (tmp_path / "suite.toml").write_text(SUITE.replace("LIMIT", "20 mm"))
    return tmp_path / "suite.toml"


def test_baseline_then_same_then_worse_then_a_missed_bound(program: Any, suite: Path, tmp_path: Path) -> None:
    made = program("check", "suite.toml", "--update-baseline", "--processes", "1")
    assert made.code == 0, made.err
    assert "verdict: bounds kept, no baseline" in made.out
    baseline = (tmp_path / "suite.baseline.json").read_bytes()
    told = json.loads(baseline)
    assert {"version", "commit", "digest"} == set(told["program"])
    assert {"task_hash", "world_hash", "model_hash"} <= set(told["runs"][0])
    assert not {"real_time_factor", "urdf", "report", "recording"} & set(told["runs"][0])
    # The same program with another number of processes: byte by byte.
    again = program("check", "suite.toml", "--processes", "2", "--runs", "runs")
    assert again.code == 0, again.err
    assert "verdict: same" in again.out
    parts = {path: path.read_bytes() for path in (tmp_path / "runs").rglob("*.parquet")}
    assert sum(len(pd.read_parquet(path)) for path in parts) == 3
    resumed = program("check", "suite.toml", "--runs", "runs", "--resume", "--time-limit", "0.001")
    assert resumed.code == 0, resumed.err  # nothing was played that could have taken too long
    assert {path: path.read_bytes() for path in (tmp_path / "runs").rglob("*.parquet")} == parts
    assert (tmp_path / "out/check_suite/results.json").read_bytes() == baseline
    # A worse model: nothing corrects the path.
    suite.write_text(suite.read_text() + 'methods = ["sensor_path"]\n')
    worse = program("check", "suite.toml", "--processes", "1")
    assert worse.code == 1
    assert "verdict: worse" in worse.out
    _files_say_the_same(tmp_path / "out/check_suite")
    _results_are_read_in_every_form(program, tmp_path)
    suite.write_text(SUITE.replace("LIMIT", "1 um"))
    missed = program("check", "suite.toml", "--processes", "1")
    assert missed.code == 1
    assert "missed" in missed.out


def _files_say_the_same(folder: Path) -> None:
    comparison = json.loads((folder / "comparison.json").read_text())
    assert comparison["verdict"] == "worse"
    lines = [json.loads(line) for line in (folder / "comparison.jsonl").read_text().splitlines()]
    assert lines == comparison["figures"]
    text = (folder / "comparison.md").read_text()
    assert text.startswith("### Path error: worse")
    assert "short, 0.7 m/s, sensor_path" in text
    root = ET.parse(folder / "junit.xml").getroot()
    for element in root.iter():
        assert set(element.attrib) <= JUNIT[element.tag]
    worse = [row for row in lines if row["verdict"] == "worse"]
    assert len(root.findall(".//failure")) == len(worse) == sum(int(one.get("failures", 0)) for one in root)
    assert len(pd.read_parquet(folder / "results.parquet")) == 3
    assert "svg" in (folder / "report.html").read_text()


def _results_are_read_in_every_form(program: Any, folder: Path) -> None:
    swept = program("sweep", "short.toml", "--seeds", "1-3", "--world", "bench", "--processes", "1", "--json", "s.json",
                    "--csv", "s.csv", "--lines", "s.jsonl")
    assert swept.code == 0, swept.err
    told = json.loads((folder / "s.json").read_text())
    assert (told["schema"], told["program"]) == (1, json.loads((folder / "suite.baseline.json").read_text())["program"])
    assert "control_error_mm.mean" in pd.read_csv(folder / "s.csv")
    for name in ("s.json", "s.csv", "s.jsonl", "suite.baseline.json"):
        found = read_results(folder / name)
        assert len(found.runs) == 3
        assert "control_error_mm.mean" in found.figures
        done = program("compare-results", name, "s.json")
        assert (done.code, "verdict: same" in done.out) == (0, True), done.err
    done = program("compare-results", "suite.baseline.json", "out/check_suite")
    assert done.code == 1
    assert (folder / "out/compare_results/report.html").is_file()


@pytest.mark.parametrize(("change", "says"), [
    (("short.toml\"", "strait\""), ("suite.toml: case.0.scenes", "did you mean 'straight'?")),
    (("LIMIT", "0.3 N"), ("case.0.bounds", "control_error_mm.mean is bounded in um, µm, mm, m", "'0.3 N'")),
    (("LIMIT\"", "0.3 mm\", \"control_err_mm\" = 3"), ("case.0.bounds", "control_err_mm")),
    (("1-3", "3-1"), ("suite.toml: case.0.seeds", "range such as")),
    (("world", "wolrd"), ("suite.toml: case.0.wolrd", "unknown key")),
    (("world = \"bench\"", "world = \"mars\""), ("suite.toml: case.0.world", "workshop or bench")),
    (("world = \"bench\"", "methods = [\"magic\"]"), ("suite.toml: case.0.method", "expected one of")),
])
def test_a_wrong_suite_is_one_line(program: Any, suite: Path, change: tuple[str, str], says: tuple[str, ...]) -> None:
    suite.write_text(SUITE.replace(*change).replace("LIMIT", "0.3 mm"))
    done = program("check", "suite.toml")
    assert done.code == 2
    (line,) = done.lines
    assert all(word in line for word in says), line


def run_of(**changes: Any) -> dict[str, Any]:
    return {"scene": "short", "robot": "kr6", "world": "bench", "speed_m_s": 0.7, "method": "ideal", "seed": 1,
            "failure": None, "control_error_mm": {"mean": 0.1}, **changes}


@pytest.mark.parametrize(("before", "says"), [
    ({"runs": [run_of(robot="kr15")]}, "another arm (kr15)"),
    ({"runs": [run_of(seed=2)]}, "shares no pair"),
    ({"runs": [run_of(), run_of()]}, "holds a run twice"),
    ({"runs": [{"a": 1}]}, "no run"),
    ({"schema": 99, "runs": []}, "newer version"),
    ([1], "holds no runs"),
])
def test_results_that_cannot_be_compared_are_one_line(program: Any, tmp_path: Path, before: Any, says: str) -> None:
    (tmp_path / "a.json").write_text(json.dumps(before))
    (tmp_path / "b.json").write_text(json.dumps({"runs": [run_of()]}))
    done = program("compare-results", "a.json", "b.json")
    assert done.code == 2
    (line,) = done.lines
    assert says in line, line
    assert not (tmp_path / "out").exists()


def test_a_baseline_of_another_arm_and_none_at_all_are_one_line(program: Any, suite: Path, tmp_path: Path) -> None:
    (tmp_path / "suite.baseline.json").write_text(json.dumps({"runs": [run_of(robot="kr15")]}))
    done = program("check", "suite.toml", "--processes", "1")
    assert done.code == 2
    assert "another arm (kr15)" in done.lines[-1]
    assert "--update-baseline" in done.lines[-1]
    suite.write_text(SUITE.partition("bounds")[0])
    (tmp_path / "suite.baseline.json").unlink()
    done = program("check", "suite.toml", "--resume", "--baseline", "suite.toml")
    assert done.code == 2
    assert "--runs FOLDER" in done.lines[-1]
    done = program("check", "suite.toml")
    assert done.code == 2
    assert "--update-baseline makes it" in done.lines[-1]
