"""``ideal-robot check`` and ``compare-results``: verdicts, exit codes, files, and wrong input in one line."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from ideal_robot.errors import InputError
from scenes.regression.comparison import SUITE, bounds_of, compared
from scenes.regression.paired import BETTER, FAILED, NOT_COMPARABLE, SAME, WORSE, Rules, judged, paired, seeds_needed
from scenes.regression.results import Results, RunSet, read_results
from tests.scenes.test_command_line import SHORT as UNCALIBRATED

SHORT = UNCALIBRATED.replace("by_moving = false", "by_moving = false\nroll_deg = 0.01\npitch_deg = 0.02\n"
                             "yaw_deg = 0.02\nheight_mm = 0.2\nlateral_mm = 0.02\nfocal_percent = 0.1\n"
                             "principal_px = 0.05\nk1 = 0.001")
"""Calibrated well enough that nothing else is played to say what the run is worth."""
SUITE_FILE = """
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
    (tmp_path / "suite.toml").write_text(SUITE_FILE.replace("LIMIT", "20 mm"))
    return tmp_path / "suite.toml"


def test_baseline_then_same_then_worse_then_a_missed_bound(program: Any, suite: Path, tmp_path: Path,
                                                           monkeypatch: pytest.MonkeyPatch) -> None:
    # Played in this process, which has loaded the program.
    monkeypatch.setattr("scenes.sweep.work_off", lambda tasks, play, *_: enumerate(map(play, tasks)))
    ended = program("check", "suite.toml", "--update-baseline", "--processes", "1", "--runs", "runs")
    assert ended.code == 0, ended.err
    assert "verdict: bounds kept, no baseline" in ended.out
    baseline = (tmp_path / "suite.baseline.json").read_bytes()
    content = json.loads(baseline)
    assert {"version", "commit", "digest"} == set(content["program"])
    assert {"task_hash", "world_hash", "model_hash"} <= set(content["runs"][0])
    assert not {"real_time_factor", "urdf", "report", "recording"} & set(content["runs"][0])
    parts = {path: path.read_bytes() for path in (tmp_path / "runs").rglob("*.parquet")}
    assert sum(len(pd.read_parquet(path)) for path in parts) == 3
    resumed = program("check", "suite.toml", "--runs", "runs", "--resume", "--time-limit", "0.001")
    assert resumed.code == 0, resumed.err  # nothing was played that could have taken too long
    assert "verdict: same" in resumed.out
    assert {path: path.read_bytes() for path in (tmp_path / "runs").rglob("*.parquet")} == parts
    assert (tmp_path / "out/check_suite/results.json").read_bytes() == baseline
    # A worse model: nothing corrects the path.
    suite.write_text(suite.read_text() + 'methods = ["sensor_path"]\n')
    worse = program("check", "suite.toml", "--processes", "1")
    assert worse.code == 1
    assert "verdict: worse" in worse.out
    _files_say_the_same(tmp_path / "out/check_suite")
    assert program("compare-results", "suite.baseline.json", "out/check_suite").code == 1
    assert (tmp_path / "out/compare_results/report.html").is_file()
    suite.write_text(SUITE_FILE.replace("LIMIT", "1 um"))
    missed = program("check", "suite.toml", "--runs", "runs", "--resume", "--time-limit", "0.001")
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
    assert len(root.findall(".//failure")) == len(worse) == sum(int(testsuite.get("failures", 0)) for testsuite in root)
    assert len(pd.read_parquet(folder / "results.parquet")) == 3
    assert "svg" in (folder / "report.html").read_text()


@pytest.mark.slow
def test_another_number_of_processes_says_the_same_byte_by_byte(program: Any, suite: Path, tmp_path: Path) -> None:
    assert program("check", "suite.toml", "--update-baseline", "--processes", "1").code == 0
    again = program("check", "suite.toml", "--processes", "2")
    assert again.code == 0, again.err
    assert "verdict: same" in again.out
    results = (tmp_path / "out/check_suite/results.json").read_bytes()
    assert results == (tmp_path / "suite.baseline.json").read_bytes()


@pytest.mark.slow
def test_results_of_a_sweep_are_compared_with_those_of_a_check(program: Any, suite: Path, tmp_path: Path) -> None:
    assert program("check", "suite.toml", "--update-baseline", "--processes", "1").code == 0
    swept = program("sweep", "short.toml", "--seeds", "1-3", "--world", "bench", "--processes", "1", "--json", "s.json",
                    "--csv", "s.csv", "--lines", "s.jsonl")
    assert swept.code == 0, swept.err
    swept_results, baseline = (json.loads((tmp_path / name).read_text()) for name in ("s.json", "suite.baseline.json"))
    assert (swept_results["schema"], swept_results["program"]) == (1, baseline["program"])
    assert "control_error_mm.mean" in pd.read_csv(tmp_path / "s.csv")
    for name in ("s.json", "s.csv", "s.jsonl", "suite.baseline.json"):
        done = program("compare-results", name, "s.json")
        assert (done.code, "verdict: same" in done.out) == (0, True), done.err


@pytest.mark.parametrize(("change", "says"), [
    (("short.toml\"", "strait\""), ("suite.toml: case.0.scenes", "did you mean 'straight'?")),
    (("LIMIT", "0.3 N"), ("case.0.bounds", "control_error_mm.mean is bounded in um, µm, mm, m", "'0.3 N'")),
    (("mm.mean\" = \"LIMIT", "mm.mean\" = \"0.3 mm\", \"path_error_mm.delay_ms\" = \"1 mm"),
     ("case.0.bounds", "path_error_mm.delay_ms is bounded in us, ms, s", "'1 mm'")),
    *((("LIMIT", limit), ("suite.toml: case.0.bounds: ", "\"0.3 mm\"", limit))
      for limit in ("1.2.3 mm", ". mm", "1e999 mm", "1e306 m", "mm", "-1 mm")),
    *((("LIMIT\"", f"0.3 mm\", \"{name}\" = {value}"), ("suite.toml: case.0.bounds: ", name))
      for name, value in (("robot", 1), ("seed", 5), ("fields.used", "true"))),
    (("LIMIT\"", "0.3 mm\", \"control_err_mm\" = 3"), ("case.0.bounds", "control_err_mm")),
    (("LIMIT\"", "0.3 mm\", \"fields.used\" = \"70\""), ("such as control_error_mm.p95 (got '70')",)),
    (("1-3", "3-1"), ("suite.toml: case.0.seeds", "range such as")),
    (("world", "wolrd"), ("suite.toml: case.0.wolrd", "unknown key")),
    (("world = \"bench\"", "world = \"mars\""), ("suite.toml: case.0.world", "workshop or bench or cell")),
    (("world = \"bench\"", "methods = [\"magic\"]"), ("suite.toml: case.0.method", "expected one of")),
])
def test_a_wrong_suite_is_one_line(program: Any, suite: Path, change: tuple[str, str], says: tuple[str, ...]) -> None:
    suite.write_text(SUITE_FILE.replace(*change).replace("LIMIT", "0.3 mm"))
    done = program("check", "suite.toml")
    assert done.code == 2
    (line,) = done.lines
    assert all(word in line for word in says), line


def run_of(**changes: Any) -> dict[str, Any]:
    return {"scene": "short", "robot": "kr6", "world": "bench", "speed_m_s": 0.7, "method": "ideal", "seed": 1,
            "failure": None, "control_error_mm": {"mean": 0.1}, **changes}


def test_results_are_read_in_every_form(tmp_path: Path) -> None:
    answers = [run_of(seed=seed, control_error_mm={"mean": 0.1 + 0.01 * seed}) for seed in (1, 2, 3)]
    (tmp_path / "s.json").write_text(json.dumps({"schema": 1, "runs": answers}))
    (tmp_path / "s.jsonl").write_text("\n".join(json.dumps(answer) for answer in answers))
    pd.json_normalize(answers).to_csv(tmp_path / "s.csv", index=False)
    for name in ("s.json", "s.jsonl", "s.csv"):
        results = read_results(tmp_path / name)
        assert len(results.runs) == 3
        assert "control_error_mm.mean" in results.figures
        assert compared(results, read_results(tmp_path / "s.json")).verdict == SAME


@pytest.mark.parametrize(("before", "says"), [
    ({"runs": [run_of(robot="kr15")]}, "another arm (kr15)"),
    ({"runs": [run_of(seed=2)]}, "shares no pair"),
    ({"runs": [run_of(), run_of()]}, "holds a run twice"),
    ({"runs": [{"a": 1}]}, "an entry that is not a run"),
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
    suite.write_text(SUITE_FILE.partition("bounds")[0])
    (tmp_path / "suite.baseline.json").unlink()
    done = program("check", "suite.toml", "--resume", "--baseline", "suite.toml")
    assert done.code == 2
    assert "--runs FOLDER" in done.lines[-1]
    done = program("check", "suite.toml")
    assert done.code == 2
    assert "--update-baseline makes it" in done.lines[-1]


# Verdicts on drawn results whose change is known: unchanged is the same, the spoilt case is named, power holds.

CASES = [("line", 0.7), ("line", 1.5), ("straight", 0.7), ("corner", 0.4)]
SEEDS = 50


def runs(draw: int, *, factor: dict[str, float] | None = None, noise: float = 0.02, **same: Any) -> Results:
    """200 runs; seeds decide most of an error, the draw a noise on top, as of a program that draws otherwise."""
    rng, factor, answers = np.random.default_rng(draw), factor or {}, []
    for scene, speed in CASES:
        of_seed = np.random.default_rng([len(scene), round(10 * speed)]).lognormal(-2.0, 0.3, SEEDS)
        for seed in range(SEEDS):
            mean = float(of_seed[seed] * speed * factor.get(scene, 1.0) * (1.0 + noise * rng.standard_normal()))
            answers.append({"scene": scene, "robot": "kr6", "individual": 1, "world": "bench", "speed_m_s": speed,
                            "method": "ideal", "seed": seed, "failure": None,
                            "control_error_mm": {"mean": mean, "p95": 2.0 * mean, "max": 3.0 * mean}, **same})
    return Results.of(answers)


def test_an_unchanged_program_is_the_same_in_all_of_twelve_draws() -> None:
    rules = Rules(relevant=0.0)
    assert {compared(runs(0), runs(draw), rules=rules).verdict for draw in range(1, 13)} == {SAME}


def test_false_alarms_are_as_rare_as_promised() -> None:
    """Rules of one in five on 300 draws: at most as many, within what chance allows (three standard deviations)."""
    rng, rules, alarms = np.random.default_rng(0), Rules(false_alarms=0.2, relevant=0.0), 0
    for _ in range(300):
        rows = [paired("x", "y_mm", *rng.lognormal(-2.0, 0.3, (2, 10))) for _ in range(8)]
        alarms += any(row.verdict != SAME for row in judged(rows, rules))
    assert alarms <= 300 * 0.2 + 3.0 * np.sqrt(300 * 0.2 * 0.8)


def test_the_spoilt_scene_is_named_and_a_gain_is_seen() -> None:
    spoilt = compared(runs(0), runs(1, factor={"straight": 1.05}))
    assert spoilt.verdict == WORSE
    worse = {row.case.partition(",")[0] for row in spoilt.rows if row.verdict == WORSE and row.case != SUITE}
    assert worse == {"straight"}
    better = compared(runs(0), runs(1, factor={scene: 0.9 for scene, _ in CASES}))
    assert better.verdict == BETTER
    of_suite = [row for row in better.rows if row.case == SUITE]
    assert all(row.difference == pytest.approx(-0.1, abs=4.0 * row.error) for row in of_suite)


def test_a_difference_that_nobody_cares_for_is_the_same_however_sure_it_is() -> None:
    assert compared(runs(0), runs(0, factor={"line": 1.005})).verdict == SAME
    assert compared(runs(0), runs(0, factor={"line": 1.005}), rules=Rules(relevant=0.001)).verdict == WORSE


def test_two_means_and_their_difference_are_those_of_a_paired_t_test() -> None:
    before, after = np.array([1.0, 2.0, 3.0, 4.0]), np.array([1.1, 2.3, 3.2, 4.4])
    row = paired("x", "y_mm", before, after)
    assert (row.before, row.after) == (2.5, 2.75)
    assert row.difference == pytest.approx(0.25)
    assert row.error == pytest.approx(np.std([0.1, 0.3, 0.2, 0.4], ddof=1) / 2.0)
    assert row.p == pytest.approx(0.0305, abs=1e-4)


def test_a_method_against_another_one_is_paired_where_each_side_has_one() -> None:
    comparison = compared(runs(0), runs(1, factor={scene: 0.7 for scene, _ in CASES}, method="adapted"))
    assert comparison.verdict == BETTER
    assert all("adapted" in row.case for row in comparison.rows if row.case != SUITE)


def test_a_new_failure_is_worse_and_its_pair_takes_no_part() -> None:
    after = runs(0)
    after.runs.loc[3, "failure"] = "line lost"
    comparison = compared(runs(0), after)
    assert comparison.verdict == WORSE
    (row,) = (row for row in comparison.rows if row.verdict == WORSE)
    assert (row.case, row.why) == ("line, 0.7 m/s, ideal, bench", "line lost")
    assert compared(after, runs(0)).verdict == BETTER


@pytest.mark.parametrize("name", ["task_hash", "world_hash"])
def test_another_task_or_world_is_not_comparable(name: str) -> None:
    comparison = compared(runs(0, **{name: "a"}), runs(0, **{name: "b"}))
    assert comparison.verdict == NOT_COMPARABLE
    assert "--update-baseline" in comparison.rows[0].why


def test_one_pair_that_differs_cannot_tell() -> None:
    single = [Results(results.runs[results.runs["seed"] == 1]) for results in (runs(0), runs(1, noise=0.2))]
    comparison = compared(*single)
    assert {row.verdict for row in comparison.rows} <= {SAME, NOT_COMPARABLE}
    assert comparison.verdict in (SAME, NOT_COMPARABLE)


def test_what_shares_no_pair_or_is_of_another_arm_or_twice_is_refused() -> None:
    with pytest.raises(InputError, match=r"another arm.*kr15.*--update-baseline"):
        compared(runs(0, robot="kr15"), runs(0))
    with pytest.raises(InputError, match="no pair"):
        compared(Results(runs(0, scene="other").runs.head(10)), runs(0))
    with pytest.raises(InputError, match="twice"):
        compared(runs(0), runs(0, speed_m_s=1.0, scene="line"))


def test_cases_of_one_label_keep_their_own_bounds() -> None:
    results, figure = runs(0), "control_error_mm.mean"
    limits: list[dict[str, float]] = [{figure: 0.01} if i % 2 else {} for i in range(len(results.runs))]
    limits[-1] = {figure: 10.0}
    bounds = bounds_of(results, limits)
    for label in {bound.case for bound in bounds}:
        assert [bound.limit for bound in bounds if bound.case == label].count(0.01) == 1
    assert sum(bound.seeds for bound in bounds) == sum(map(bool, limits))
    assert [bound.seeds for bound in bounds if bound.limit == 10.0] == [1]


def test_a_bound_says_how_many_seeds_it_needs() -> None:
    results = runs(0)
    label = results.runs["scene"] == "corner"
    values = results.runs.loc[label, "control_error_mm.mean"]
    near, far = values.mean() * 1.005, values.mean() * 2.0
    close, wide = (bounds_of(results, [{"control_error_mm.mean": limit}] * len(results.runs))[-1]
                   for limit in (near, far))
    assert (close.kept, wide.kept, wide.remark) == (True, True, "")
    assert "flaky" in close.remark
    assert close.needed is None or close.needed > 100
    with pytest.raises(InputError, match="no run has this figure"):
        bounds_of(results, [{"force_error_N.rms": 1.0}] * len(results.runs))


def test_as_many_seeds_as_are_asked_for_find_the_difference() -> None:
    rng, n = np.random.default_rng(0), seeds_needed(0.5, 0.05)
    assert n == 36
    draws = rng.normal(0.5, 1.0, (4000, n))
    t = draws.mean(axis=1) / draws.std(axis=1, ddof=1) * np.sqrt(n)
    assert np.mean(t > 1.6896) == pytest.approx(0.9, abs=0.02)
    assert seeds_needed(1e-5, 0.01) is None


# Figures and bounds that would switch the check off.

def test_a_figure_that_no_scene_has_is_refused_after_the_first_run(program: Any, suite: Path, tmp_path: Path,
                                                                  monkeypatch: pytest.MonkeyPatch) -> None:
    played: list[Any] = []

    def work_off(tasks: list[Any], *_: Any) -> Any:
        for i, task in enumerate(tasks):
            played.append(task)
            yield i, run_of(scene=task.scene.name, seed=task.seed)

    monkeypatch.setattr("scenes.sweep.work_off", work_off)
    whole = SUITE_FILE.replace("LIMIT", "0.3 mm")
    for wrong, field in ((whole.replace("[[case]]", 'figures = ["control_error_mm.maen"]\n[[case]]'), "figures"),
                         (whole.replace("mm.mean", "mm.maen"), "case.0.bounds")):
        suite.write_text(wrong)
        played.clear()
        done = program("check", "suite.toml", "--update-baseline", "--runs", f"runs_{field}")
        assert done.code == 2
        assert f"suite.toml: {field}: no run of short has this figure; did you mean 'control_error_mm.mean'?" \
            in done.lines[-1]
        assert len(played) == len(RunSet(tmp_path / f"runs_{field}", resume=True).answers) == 1
    assert not (tmp_path / "suite.baseline.json").exists()


def test_a_case_without_any_compared_figure_is_named() -> None:
    other = runs(0, scene="other", speed_m_s=None, force_error_N={"rms": 1.0}).runs.head(3)
    without = other.drop(columns=[name for name in other if name.startswith("control_error_mm")])
    both = Results(pd.concat([runs(0).runs, without], ignore_index=True))
    comparison = compared(both, both, figures=["control_error_mm.mean"])
    assert comparison.verdict == NOT_COMPARABLE
    (row,) = (row for row in comparison.rows if row.verdict != SAME)
    assert row.case.startswith("other")
    assert "none of the figures compared" in row.why


def test_a_suite_whose_runs_all_fail_fails_and_says_why(program: Any, suite: Path, tmp_path: Path,
                                                       monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.setattr("scenes.sweep.work_off", lambda tasks, *_: enumerate(
        {**run_of(seed=task.seed, failure="line lost"), "control_error_mm": {}} for task in tasks))
    suite.write_text(SUITE_FILE.partition("bounds")[0])
    before = Results.of([run_of(seed=seed) for seed in (1, 2, 3)]).write(tmp_path / "suite.baseline.json").read_bytes()
    for words in (["--update-baseline"], []):
        done = program("check", "suite.toml", *words)
        assert done.code == 1
        assert all(text in done.out for text in ("verdict: failed", "line lost"))
        assert ("no baseline was written, as all runs failed of s" in done.err) == bool(words)
        assert (tmp_path / "suite.baseline.json").read_bytes() == before
        folder = tmp_path / "out" / "check_suite"
        (failure,) = ET.parse(folder / "junit.xml").getroot().findall(".//failure")
        assert failure.get("message") == "3 of 3 runs failed: line lost"
        assert all("line lost" in (folder / name).read_text() for name in ("report.html", "comparison.md"))
    suite.write_text(SUITE_FILE.replace("LIMIT", "0.3 mm"))
    assert program("check", "suite.toml").code == 1
    assert "3 of 3 runs gave no figure: line lost" in (tmp_path / "out/check_suite/comparison.md").read_text()


@pytest.mark.parametrize(("change", "verdict"), [
    ({"speed_m_s": 0.5, "failure": "line lost"}, FAILED), ({"task_hash": "another", "failure": "line lost"}, FAILED),
    ({"control_error_mm": {"mean": None}}, WORSE)])
def test_a_run_without_its_figures_is_not_passed_over(change: dict[str, Any], verdict: str) -> None:
    before, after = (Results.of([run_of(scene="o"), run_of(**{"task_hash": "one", **more})]) for more in ({}, change))
    assert (compared(before, after).verdict, compared(after, before).verdict) == (verdict, NOT_COMPARABLE)


def test_runs_that_fail_as_before_are_told_and_the_others_decide() -> None:
    results = runs(0)
    results.runs.loc[3, "failure"] = "line lost"
    comparison = compared(results, results)
    assert comparison.verdict == SAME
    (row,) = (row for row in comparison.rows if row.verdict != SAME)
    assert (row.verdict, row.before, row.after, row.why) == (NOT_COMPARABLE, 1, 1, "line lost")
    results.runs.loc[results.runs["scene"] == "corner", "failure"] = "line lost"
    assert compared(results, results).verdict == compared(runs(0), results).verdict == FAILED


# What was not compared is red.

BARE = """
title = "no bounds"
[[case]]
scenes = ["short.toml"]
seeds = "1-4"
world = "bench"
"""


def answered(monkeypatch: pytest.MonkeyPatch, *, seeded: bool = True) -> list[Any]:
    """Plays of drawn figures in place of simulated ones; returns the list of the jobs that were played."""
    jobs: list[Any] = []

    def work_off(tasks: list[Any], *_: Any) -> Any:
        for i, task in enumerate(tasks):
            jobs.append(task)
            error = 0.1 + (0.01 * task.seed if seeded else 0.0)
            yield i, run_of(scene=task.scene.name, seed=task.seed, control_error_mm={"mean": error})

    monkeypatch.setattr("scenes.sweep.work_off", work_off)
    return jobs


def test_a_check_that_compared_nothing_fails_unless_new_cases_are_allowed(program: Any, suite: Path, tmp_path: Path,
                                                                         monkeypatch: pytest.MonkeyPatch) -> None:
    answered(monkeypatch)
    suite.write_text(BARE)
    assert program("check", "suite.toml").code == 2
    assert program("check", "suite.toml", "--allow-new").code == 0
    assert program("check", "suite.toml", "--update-baseline").code == 0
    assert program("check", "suite.toml").code == 0
    # A case that the baseline does not have, and one that nobody plays any more.
    suite.write_text(BARE + BARE.partition("\n[[case]]")[1] + '\nscenes = ["straight"]\nseeds = "1-3"\n')
    new = program("check", "suite.toml")
    assert new.code == 1
    assert "nothing to compare with: straight" in new.err
    assert program("check", "suite.toml", "--allow-new").code == 0
    assert program("check", "suite.toml", "--update-baseline").code == 0
    suite.write_text(BARE)
    gone = program("check", "suite.toml")
    assert gone.code == 1
    assert "straight" in gone.err
    # A bound is something to be compared with; a case beside it without one is not.
    (tmp_path / "suite.baseline.json").unlink()
    suite.write_text(SUITE_FILE.replace("LIMIT", "1 mm"))
    assert program("check", "suite.toml").code == 0
    suite.write_text(SUITE_FILE.replace("LIMIT", "1 mm") + '[[case]]\nscenes = ["straight"]\nseeds = "1-3"\n')
    assert program("check", "suite.toml").code == 1


@pytest.mark.parametrize("seeded", [True, False])
def test_a_run_in_which_no_seed_enters_is_played_twice_at_most(program: Any, suite: Path,
                                                              monkeypatch: pytest.MonkeyPatch, seeded: bool) -> None:
    jobs = answered(monkeypatch, seeded=seeded)
    suite.write_text(BARE)
    done = program("check", "suite.toml", "--update-baseline")
    assert done.code == 0
    assert [job.seed for job in jobs] == ([1, 2, 3, 4] if seeded else [1, 2])
    assert ("not played: 2 further" in done.out) != seeded
    assert program("check", "suite.toml").code == 0


def test_the_run_that_became_worse_is_named_with_its_seed(program: Any, suite: Path, tmp_path: Path,
                                                         monkeypatch: pytest.MonkeyPatch) -> None:
    answered(monkeypatch)
    suite.write_text(BARE)
    assert program("check", "suite.toml", "--update-baseline").code == 0
    baseline = json.loads((tmp_path / "suite.baseline.json").read_text())
    for run in baseline["runs"]:
        run["control_error_mm.mean"] -= 0.05 if run["seed"] == 3 else 0.04
    (tmp_path / "suite.baseline.json").write_text(json.dumps(baseline))
    worse = program("check", "suite.toml")
    assert worse.code == 1
    assert "ideal-robot run short.toml --method ideal --speed 0.7 --world bench --seed 3" in worse.out
    assert "class=\"bad\"" in (tmp_path / "out/check_suite/report.html").read_text()
