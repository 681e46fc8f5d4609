"""Trials follow from their seeds, and are of the size that they say."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from ideal_robot.diagnosis.validation.result import WeighedSet, probability
from ideal_robot.errors import InputError
from ideal_robot.signals.recording import Recording
from studies.__main__ import GROUPS, STUDIES, main
from studies.diagnoses import by_name
from studies.strangers.effects import INSIDE, Setup
from studies.strangers.engines import ENGINES, TURNS
from studies.strangers.logger import draw_logger, left, read, record, sizes
from studies.strangers.other_effects import NEW
from studies.strangers.score import Score, detection, power, rates, reliability, score
from studies.strangers.trial import KINDS, SHARES, Cause, Trial, draw_trial, right_names
from tests.arms import a_logger, a_motion, a_plant, an_arm

ARM = an_arm()


@pytest.mark.parametrize("engine", [pytest.param(engine, marks=() if engine == "integrator" else pytest.mark.slow)
                                    for engine in sorted(ENGINES)])
def test_a_seed_gives_the_same_recording_bit_for_bit(engine: str) -> None:
    if engine == "dart":
        pytest.importorskip("dartpy", exc_type=ImportError)
    first, second = (draw_trial(7, "none", engine, seconds=(4.0, 5.0)) for _ in range(2))
    assert first.recording.hash == second.recording.hash
    assert first.urdf == second.urdf
    assert draw_trial(10, "none", engine, seconds=(4.0, 5.0)).recording.hash != first.recording.hash


@pytest.mark.slow
def test_an_engine_that_was_left_out_is_drawn_only_by_its_name() -> None:
    assert "dart" in ENGINES
    assert [draw_trial(seed, "none", seconds=(4.0, 4.1)).engine for seed in (0, 1, 2)] == list(TURNS)
    with pytest.raises(InputError, match="the engines are mujoco"):
        draw_trial(0, engine="moon")


@pytest.mark.slow
def test_size_that_came_out_is_near_the_one_drawn() -> None:
    trial = draw_trial(12, "inside", "integrator", (4.0, 5.0), (8.0, 10.0))
    assert 4.0 / 1.7 <= trial.causes[0].size <= 5.0 * 1.7
    assert trial.recording.n >= 2


@pytest.mark.slow
def test_a_cause_that_was_asked_for_is_in_the_trial_or_there_is_none() -> None:
    trial = draw_trial(12, "inside", "integrator", seconds=(8.0, 10.0), cause="torque_ripple")
    assert [c.name for c in trial.causes] == ["torque_ripple"]
    with pytest.raises(RuntimeError, match="no trial of kind inside in pybullet"):
        draw_trial(12, "inside", "pybullet", seconds=(8.0, 10.0), cause="axis_coupling")


def test_a_third_of_the_trials_and_more_hold_nothing() -> None:
    assert SHARES[KINDS.index("none")] > 1.0 / 3.0
    assert sum(SHARES) == pytest.approx(1.0)


@pytest.mark.slow
def test_size_of_an_effect_grows_with_it_and_is_zero_without() -> None:
    rng = np.random.default_rng(2)
    setup = Setup(a_plant(ARM), draw_logger(rng, ARM.n, ()))
    motion = a_motion(ARM, 8.0)
    effect = INSIDE["cable_spring"](rng, setup, 1)
    assert effect is not None

    def seen(amount: float) -> float:
        changed = effect.apply(setup, amount)
        return float(sizes(healthy, read(record(changed.logger, changed.plant, ENGINES["integrator"](
            changed.plant, motion)), ARM.model), absorbed=True)[1])

    healthy = read(record(setup.logger, setup.plant, ENGINES["integrator"](setup.plant, motion)), ARM.model)
    assert seen(0.0) == 0.0
    assert seen(4.0) > 1.5 * seen(2.0) > 0.0


@pytest.mark.parametrize("engine", ["integrator", *(pytest.param(name, marks=pytest.mark.slow)
                                                   for name in ("mujoco", "pybullet"))])
def test_nothing_but_dry_friction_keeps_a_clean_rigid_plant_out_of_the_model_class(engine: str) -> None:
    """No clock or engine leaves a trace of its own: without dry friction the model class explains the torque."""
    logger = a_logger(np.random.default_rng(2), ARM.n, every=4, encoder=1e-9, noise=np.zeros(ARM.n))
    motion = a_motion(ARM, 12.0)
    shares = []
    for friction in (False, True):
        plant = a_plant(ARM, friction=friction)
        reading = read(record(logger, plant, ENGINES[engine](plant, motion)), ARM.model)
        shares.append(np.std(left(reading), axis=0) / np.std(reading.tau, axis=0))
    assert np.all(shares[0] < 2e-3)
    assert np.max(shares[1]) > 10.0 * np.max(shares[0])


@pytest.mark.slow
def test_jitter_makes_an_effect_less_visible() -> None:
    rng = np.random.default_rng(2)
    setup = Setup(a_plant(ARM), draw_logger(rng, ARM.n, ()))
    motion = a_motion(ARM, 8.0)
    changed = INSIDE["cable_spring"](rng, setup, 1).apply(setup, 4.0)
    runs = [ENGINES["integrator"](s.plant, motion) for s in (setup, changed)]

    def seen(jitter: float) -> float:
        logger = dataclasses.replace(setup.logger, every=16, jitter=jitter, stamps="nominal", encoder=1e-6)
        healthy, other = (read(record(logger, setup.plant, run), ARM.model) for run in runs)
        return float(sizes(healthy, other, absorbed=True)[1])

    assert seen(0.15) < 0.9 * seen(0.0)


def test_filter_of_all_torques_is_late_by_its_time_constant() -> None:
    rng = np.random.default_rng(2)
    setup = Setup(a_plant(ARM), draw_logger(rng, ARM.n, ()))
    run = ENGINES["integrator"](setup.plant, a_motion(ARM, 8.0))
    effect = NEW["torque_filter"](rng, setup, 0)
    assert effect is not None
    plain, filtered = (record(s.logger, s.plant, run) for s in (setup, effect.apply(setup, 2.0)))
    slope = np.gradient(plain.joints("tau"), plain.t, axis=0)
    change = filtered.joints("tau") - plain.joints("tau")
    lag = -np.sum(change * slope, axis=0) / np.sum(slope**2, axis=0)
    assert np.all(lag > 0.0)
    assert effect.values(2.0)["torque_filter", 0, "time constant"] == pytest.approx(6e-3)


# Laws of the strict score.

def a_trial(*causes: tuple[str, int], outside: bool = False, healthy: tuple[tuple[str, int], ...] = ()) -> Trial:
    right = [Cause(name, joint, 4.0,
                   frozenset({("unknown", joint)}) if outside else right_names(name, joint, 6), outside)
             for name, joint in causes]
    return Trial(1, "inside" if causes else "none", "mujoco", Recording({"t": np.zeros(1)}), "", None,
                 tuple(right), frozenset(healthy), {("dead_time", 2, "delay"): 3e-3}, "kr6/6", "fourier",
                 "sampled", "cascade", "tanh", "rigid")


def said(verdict: str, *named: tuple[str, int], unknown: tuple[int, ...] = (), channel: str = "",
         parameters: tuple[SimpleNamespace, ...] = ()) -> SimpleNamespace:
    effects = [SimpleNamespace(fitted=SimpleNamespace(name=name, joint=joint, channel=channel or f"tau_{joint}",
                                                      parameters=parameters)) for name, joint in named]
    return SimpleNamespace(verdict=verdict, effects=effects, unknown=[
        SimpleNamespace(fitted=SimpleNamespace(name="learned", joint=j)) for j in unknown])


STRIBECK = "stribeck", 2
LATE_ENCODERS = Cause("arm_delay", 0, 4.0, right_names("arm_delay", 0, 6, (0, 1, 2)), False)


@pytest.mark.parametrize(("trial", "right", "wrong"), [
    pytest.param(a_trial(STRIBECK), [said("effects", STRIBECK)],
                 [said("effects", ("stribeck", 3)), said("none"), said("effects", STRIBECK, ("dead_time", 5)),
                  said("effects", STRIBECK, unknown=(4,))], id="named at its joint and nothing beside it"),
    pytest.param(a_trial(), [said("none")], [said("effects", ("degressive", 1)), said("unknown", unknown=(1,)),
                                             said("unknown")], id="an empty recording, of which nothing is named"),
    pytest.param(a_trial(healthy=(("presliding_hysteresis", 1),)),
                 [said("effects", ("presliding_hysteresis", 1)), said("none")],
                 [said("effects", ("presliding_hysteresis", 2))],
                 id="what the healthy plant has is neither asked for nor false"),
    pytest.param(a_trial(("bump", 3), outside=True), [said("unknown", unknown=(3,))],
                 [said("effects", ("gravity_spring", 3)), said("unknown", unknown=(2,)),
                  said("unknown", ("cable_spring", 3), unknown=(3,))], id="unknown to the library at its joint"),
    pytest.param(a_trial(STRIBECK, ("cable_spring", 4)), [said("effects", ("cable_spring", 4), STRIBECK)],
                 [said("effects", STRIBECK)], id="both of two"),
    pytest.param(a_trial(("torque_filter", 0)),
                 [said("effects", ("dead_time", 0)), said("effects", ("common_delay", 0))],
                 [said("effects", *(("dead_time", j) for j in range(1, 7)))],
                 id="one filter of all torques is one cause, not six"),
    pytest.param(dataclasses.replace(a_trial(), kind="arm", causes=(LATE_ENCODERS,)),
                 [said("effects", ("dead_time", 2), channel="qa_2")],
                 [said("effects", ("dead_time", 2)), said("effects", ("dead_time", 5), channel="qa_5")],
                 id="late arm encoders in their channel"),
])
def test_which_answers_are_right(trial: Trial, right: list[SimpleNamespace], wrong: list[SimpleNamespace]) -> None:
    assert all(score(trial, answer).right for answer in right)
    assert not any(score(trial, answer).right for answer in wrong)


def test_what_is_named_beside_the_cause_is_counted() -> None:
    beside = score(a_trial(STRIBECK), said("effects", STRIBECK, ("dead_time", 5)))
    assert beside.found == (True,)
    assert beside.false == (("dead_time", 5),)


def test_intervals_are_compared_with_the_truth() -> None:
    trial = a_trial(("dead_time", 2))

    def covered(value: float) -> bool:
        number = SimpleNamespace(name="delay", value=value, std=1e-4)
        errors = dict(score(trial, said("effects", ("dead_time", 2), parameters=(number,))).covered)
        return abs(errors["dead_time: delay"]) < 1.96

    assert covered(3.1e-3)
    assert not covered(3.3e-3)


def test_scores_survive_json_and_make_tables() -> None:
    every = [score(a_trial(("stribeck", 2)), said("effects", ("stribeck", 2))),
             score(a_trial(), said("effects", ("degressive", 1)))]
    assert [Score.from_dict(s.to_dict()) for s in every] == every
    assert "| empty ones left alone | 0 ± 25 % of 1 |" in rates(every)
    assert "| false names per recording | 0.50 ± 0.35 |" in rates(every)
    assert "| 3 … 5 | 1 | 100 ± 25 % of 1 | 100 ± 25 % of 1 | 100 ± 25 % of 1 |" in power(every)


def test_the_size_that_is_found_half_of_the_time_comes_back_from_what_was_found() -> None:
    right = score(a_trial(("stribeck", 2)), said("effects", ("stribeck", 2)))
    rng = np.random.default_rng(3)
    every = []
    for size in np.exp(rng.uniform(np.log(0.1), np.log(5.0), 2000)):
        # Half of them from 0.8 on, nine tenths from 0.8 * 9 ** 0.5 = 2.4.
        detected = rng.uniform() < 1.0 / (1.0 + (size / 0.8) ** -2.0)
        every.append(dataclasses.replace(right, causes=(("stribeck", 2, float(size)),), found=(bool(detected),)))
    cells = detection(every, lambda cause: "friction").splitlines()[2].split("|")
    half, nine = (float(cells[k].split()[0]) for k in (4, 6))
    assert half == pytest.approx(0.8, rel=0.1)
    assert nine == pytest.approx(2.4, rel=0.1)
    assert cells[5].strip().startswith("0.00 ± 0.00")
    assert len(detection(every[:1], lambda cause: "friction").splitlines()) == 2
    # A family that was always found has finite sizes all the same.
    alone = detection([dataclasses.replace(one, found=(True,)) for one in every[:5]],
                      lambda cause: "friction")
    assert "nan" not in alone
    assert "inf" not in alone
    assert "| friction | 5 | 5 |" in alone


def test_the_probability_of_a_cause_is_against_what_else_could_be_named() -> None:
    def of(*sets: WeighedSet) -> float:
        return probability((*sets, WeighedSet("", 0, 310.0, 40.0)), "stribeck")

    # Without a standard error the odds are those of the score.
    assert of(WeighedSet("backlash/tau_flight", 3, np.log(4.0), 0.0)) == pytest.approx(0.8, abs=1e-4)
    # Nothing is certain because of a difference within its standard error.
    assert 0.6 < of(WeighedSet("backlash", 3, 20.0, 40.0)) < 0.75
    assert of(WeighedSet("backlash", 3, -20.0, 40.0)) < 0.4
    # Another form of the same cause speaks for it.
    assert of() > 0.99
    assert of(WeighedSet("stribeck", 3, -5.0, 3.0)) == of()


def test_causes_said_with_a_probability_are_counted_where_it_was_asked_for() -> None:
    trial, answer = a_trial(("stribeck", 2)), said("effects", ("stribeck", 2), ("dead_time", 5), unknown=(3,))
    assert score(trial, answer).probabilities == ()
    for effect, rivals, likely in zip(answer.effects, (("degressive",), ()), (0.96, 0.6), strict=True):
        effect.indistinguishable_from, effect.probability = rivals, likely
    result = score(trial, answer)
    assert result.probabilities == (pytest.approx((0.96, True)), pytest.approx((0.6, False)))
    lines = reliability([result, score(a_trial(), said("none"))]).splitlines()
    assert lines[2].startswith("| 0.5 … 0.8 | 1 | 0.600 | 0 | 0.00 ±")
    assert lines[3].startswith("| 0.95 … 0.99 | 1 | 0.960 | 1 | 1.00 ±")
    # (0.04² + 0.6²) / 2, and half of them are there.
    assert lines[4].startswith("| 0 … 1 | 2 | 0.780 | 1 | 0.50 ±")
    assert lines[4].endswith("| 0.181 | 0.250 |")
    # What it is said not to be told from is a right answer as well.
    assert score(a_trial(("degressive", 2)), answer).probabilities[0][1]


def test_a_name_is_as_probable_as_it_was_right_in_other_recordings() -> None:
    trial = a_trial(("stribeck", 2))
    answers = [*[(("stribeck", 2),)] * 30, *[(("backlash", 2),)] * 10, *[(("stribeck", 2), ("backlash", 2))] * 10]
    right = dataclasses.replace(trial, healthy=frozenset({("backlash", 2)}))
    scores = by_name([score(right if k >= 40 else trial, said("effects", *named)) for k, named in enumerate(answers)])
    (often, was_right), = scores[0].probabilities
    assert was_right
    assert often > 0.97
    # Ten of twenty were right; an answer's own is not among those that it is judged by.
    (_, _), (one_right, _) = scores[-1].probabilities
    (one_wrong, was_right), = scores[30].probabilities
    assert not was_right
    assert one_right < 0.5 < one_wrong < 0.56
    # Of a name that no other recording has, as much is known as of all names.
    alone = by_name([*scores, score(trial, said("effects", ("payload", 0)))])[-1].probabilities[0][0]
    assert 0.5 < alone < 0.97
    assert by_name([score(trial, said("none"))])[0].probabilities == ()


@pytest.mark.parametrize(("joint", "allowed"), [(5, True), (2, False)])
def test_a_load_is_a_payload_only_next_to_the_flange(joint: int, allowed: bool) -> None:
    assert (("payload", 0) in right_names("link_load", joint, 6)) is allowed


def test_a_joints_delay_holds_what_all_torques_are_late_by_unless_that_has_a_name() -> None:
    trial = dataclasses.replace(a_trial(("dead_time", 2)), late=1e-3)
    number = SimpleNamespace(name="delay", value=4e-3, std=1e-4)
    alone = score(trial, said("effects", ("dead_time", 2), parameters=(number,)))
    beside = score(trial, said("effects", ("dead_time", 2), ("common_delay", 0), parameters=(number,)))
    assert dict(alone.covered)["dead_time: delay"] == pytest.approx(0.0, abs=1e-9)
    assert dict(beside.covered)["dead_time: delay"] == pytest.approx(10.0)


# One runner for all studies.

def test_every_study_is_listed_with_a_line(capsys: pytest.CaptureFixture[str]) -> None:
    main([])
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == len(GROUPS) + len(STUDIES)
    assert all(len(line.split()) > 4 for line in lines if line.startswith("  "))


def test_every_study_can_be_called(capsys: pytest.CaptureFixture[str]) -> None:
    for name in STUDIES:
        with pytest.raises(SystemExit) as ended:
            main([name, "--help"])
        assert ended.value.code == 0
        assert f"python -m studies {name}" in capsys.readouterr().out


@pytest.mark.parametrize("words", [["dance"], ["closings", "none.jsonl", "--count", "0"], ["world", "--moon"],
                                   ["strangers", "--engine", "moon"]])
def test_what_cannot_be_played_is_said_in_a_line(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(words)
    # A text is printed by the interpreter, which then ends with 1.
    assert isinstance(ended.value.code, str) or ended.value.code in (1, 2)
    assert "Traceback" not in (message := capsys.readouterr().err)
    assert message.strip() or str(ended.value.code).strip()


# Numbers of modules that are halved and doubled.
