"""History of a suite: a planted worse version is found with its first version and seed; red where nothing compared."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scenes.regression.history import History, history_of
from scenes.regression.replays import play_and_keep, replay_place, tidy_replays
from scenes.regression.results import RunSet
from scenes.report.replay import KeptReplay
from scenes.sweep import Job

SEEDS = range(1, 13)


def data_set(folder: Path, monkeypatch: pytest.MonkeyPatch, factors: dict[str, float], *, computer: str = "a",
             spoilt: str = "corner", noise: float = 0.003, task: dict[str, str] | None = None) -> Path:
    """Runs of versions ``v0``, ``v1``, …: the spoilt scene's error times each version's factor."""
    for number, (version, factor) in enumerate(factors.items()):
        monkeypatch.setattr("scenes.regression.results.origin", lambda version=version, number=number: {
            "version": "1", "commit": version, "digest": f"d{version}", "computer": computer,
            "when": f"2026-01-{number + 1:02d}T00:00:00+00:00"})
        runs = RunSet(folder, resume=True)
        rng = np.random.default_rng([number, len(spoilt)])
        for scene in ("corner", "straight"):
            for seed in SEEDS:
                of_seed = np.random.default_rng([seed, len(scene)]).lognormal(-2.0, 0.3)
                mean = of_seed * (factor if scene == spoilt else 1.0) * (1.0 + noise * rng.standard_normal())
                answer = {"scene": scene, "robot": "kr6", "individual": 1, "world": "bench", "speed_m_s": 0.7,
                          "method": "ideal", "seed": seed, "failure": None, "task_hash": (task or {}).get(version, "t"),
                          "control_error_mm": {"mean": float(mean), "max": float(3.0 * mean)}}
                runs.add({"scene": scene, "seed": seed, "digest": version + computer}, answer)
        runs.close()
    return folder


def found(history: History) -> set[tuple[str, str]]:
    return {(course.case.partition(",")[0], course.versions[course.since or 0].name) for course in history.worse}


@pytest.mark.parametrize(("first", "spoilt"), [
    (1, "corner"), pytest.param(3, "straight", marks=pytest.mark.slow), (5, "straight")])
def test_the_first_worse_version_is_named_and_only_in_its_scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
                                                               first: int, spoilt: str) -> None:
    factors = {f"v{i}": 1.0 if i < first else 1.08 for i in range(7)}
    history = history_of([data_set(tmp_path / "runs", monkeypatch, factors, spoilt=spoilt)])
    assert found(history) == {(spoilt, f"v{first}")}
    assert f"v{first}" in history.headline


@pytest.mark.slow
def test_unchanged_versions_are_as_good_as_the_best_in_all_of_ten_draws(tmp_path: Path,
                                                                      monkeypatch: pytest.MonkeyPatch) -> None:
    for draw in range(10):
        factors = {f"{draw}v{i}": 1.0 for i in range(6)}
        assert not history_of([data_set(tmp_path / f"runs{draw}", monkeypatch, factors, noise=0.02)]).worse


def test_a_version_that_was_mended_is_no_longer_worse(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    history = history_of([data_set(tmp_path / "runs", monkeypatch, {"v0": 1.0, "v1": 1.5, "v2": 1.0})])
    assert not history.worse
    assert [version.name for version in history.versions] == ["v0", "v1", "v2"]


def test_another_scene_of_the_same_name_is_not_compared(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = data_set(tmp_path / "runs", monkeypatch, {"v0": 1.0, "v1": 1.5, "v2": 1.5}, task={"v0": "other"})
    assert not history_of([folder]).worse


def test_two_computers_are_one_history(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folders = [data_set(tmp_path / computer, monkeypatch, {"v0": 1.0, "v1": 1.1}, computer=computer)
               for computer in ("a", "b")]
    history = history_of(folders)
    assert [version.computers for version in history.versions] == [("a", "b")] * 2
    assert found(history) == {("corner", "v1")}


def test_the_verb_writes_its_page_with_the_replays_beside_each_other(program: Any, tmp_path: Path,
                                                                    monkeypatch: pytest.MonkeyPatch) -> None:
    folder = data_set(tmp_path / "runs", monkeypatch, {"v0": 1.0, "v1": 1.0, "v2": 1.2})
    course = history_of([folder]).worse[0]
    run = course.worst_seed
    for version in ("v0", "v1", "v2"):
        KeptReplay({"of": version}).keep(replay_place(folder, f"d{version}", run))
    best = course.versions[course.best].name
    tidy_replays(folder, {f"d{best}", "dv2"})
    assert sorted(path.name for path in (folder / "replays").iterdir()) == sorted([f"d{best}", "dv2"])
    done = program("history", "runs", "--json", "h.json")
    assert done.code == 1
    page = (tmp_path / "out/history/report.html").read_text()
    assert page.index(f'{{"of":"{best}"}}') < page.index('{"of":"v2"}')
    assert f"--seed {run['seed']:g}" in done.out
    assert "git bisect run" in done.out
    content = json.loads((tmp_path / "h.json").read_text())
    assert [figure["since"] for figure in content["figures"] if figure["verdict"] == "worse"] == ["dv2", "dv2"]


def test_runs_of_no_known_version_and_no_data_set_are_one_line(program: Any, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    done = program("history", "empty")
    assert done.code == 2
    assert "empty: is not a data set of runs" in done.lines[-1]


def test_what_was_played_is_kept_as_a_replay_and_costs_no_figure(tmp_path: Path) -> None:
    job = Job("edge", "none", None, 3)
    answer = play_and_keep(job, folder=tmp_path)
    assert answer["failure"] is None
    (place,) = (tmp_path / "replays").rglob("*.json.gz")
    replay = KeptReplay.read(place)
    assert replay is not None
    assert len(replay.data["t"]) > 100
    (tmp_path / "file").write_text("")
    again = play_and_keep(job, folder=tmp_path / "file")
    assert {**again, **dict.fromkeys(["real_time_factor", "cycle_time_ms"])} == {
        **answer, **dict.fromkeys(["real_time_factor", "cycle_time_ms"])}
