"""Verdicts on drawn results whose change is known: unchanged is the same, the spoilt case is named, power holds."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from ideal_robot.errors import InputError
from scenes.regression.comparison import SUITE, bounds_of, compared
from scenes.regression.paired import BETTER, NOT_COMPARABLE, SAME, WORSE, Rules, judged, paired, seeds_needed
from scenes.regression.results import Results

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


def test_an_unchanged_program_is_the_same_in_all_of_twenty_draws() -> None:
    rules = Rules(relevant=0.0)
    assert {compared(runs(0), runs(draw), rules=rules).verdict for draw in range(1, 21)} == {SAME}


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
    found = compared(runs(0), runs(1, factor={scene: 0.7 for scene, _ in CASES}, method="adapted"))
    assert found.verdict == BETTER
    assert all("adapted" in row.case for row in found.rows if row.case != SUITE)


def test_a_new_failure_is_worse_and_its_pair_takes_no_part() -> None:
    after = runs(0)
    after.runs.loc[3, "failure"] = "line lost"
    found = compared(runs(0), after)
    assert found.verdict == WORSE
    (row,) = (row for row in found.rows if row.verdict == WORSE)
    assert (row.case, row.why) == ("line, 0.7 m/s, ideal, bench", "line lost")
    assert compared(after, runs(0)).verdict == BETTER


@pytest.mark.parametrize("name", ["task_hash", "world_hash"])
def test_another_task_or_world_is_not_comparable(name: str) -> None:
    found = compared(runs(0, **{name: "a"}), runs(0, **{name: "b"}))
    assert found.verdict == NOT_COMPARABLE
    assert "--update-baseline" in found.rows[0].why


def test_one_pair_that_differs_cannot_tell() -> None:
    one = [Results(results.runs[results.runs["seed"] == 1]) for results in (runs(0), runs(1, noise=0.2))]
    found = compared(*one)
    assert {row.verdict for row in found.rows} <= {SAME, NOT_COMPARABLE}
    assert found.verdict in (SAME, NOT_COMPARABLE)


def test_what_shares_no_pair_or_is_of_another_arm_or_twice_is_refused() -> None:
    with pytest.raises(InputError, match=r"another arm.*kr15.*--update-baseline"):
        compared(runs(0, robot="kr15"), runs(0))
    with pytest.raises(InputError, match="no pair"):
        compared(Results(runs(0, scene="other").runs.head(10)), runs(0))
    with pytest.raises(InputError, match="twice"):
        compared(runs(0), runs(0, speed_m_s=1.0, scene="line"))


def test_a_bound_says_how_many_seeds_it_needs() -> None:
    results = runs(0)
    label = results.runs["scene"] == "corner"
    values = results.runs.loc[label, "control_error_mm.mean"]
    near, far = values.mean() * 1.005, values.mean() * 2.0
    close, kept = (bounds_of(results, [{"control_error_mm.mean": limit}] * len(results.runs))[-1]
                   for limit in (near, far))
    assert close.kept
    assert kept.kept
    assert "flaky" in close.remark
    assert kept.remark == ""
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
