"""Laws of the strict score."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from ideal_robot.signals.recording import Recording
from studies.strangers.score import Score, leaving_out, power, rates, score
from studies.strangers.trial import Cause, Trial, right_names


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


def test_named_at_its_joint_and_nothing_else_is_right() -> None:
    trial = a_trial(("stribeck", 2))
    assert score(trial, said("effects", ("stribeck", 2))).right
    assert not score(trial, said("effects", ("stribeck", 3))).right
    assert not score(trial, said("none")).right


def test_whatever_is_named_beside_it_makes_it_wrong() -> None:
    trial = a_trial(("stribeck", 2))
    beside = score(trial, said("effects", ("stribeck", 2), ("dead_time", 5)))
    assert beside.found == (True,)
    assert beside.false == (("dead_time", 5),)
    assert not beside.right
    assert not score(trial, said("effects", ("stribeck", 2), unknown=(4,))).right


def test_empty_recording_is_right_only_where_nothing_is_named() -> None:
    assert score(a_trial(), said("none")).right
    assert not score(a_trial(), said("effects", ("degressive", 1))).right
    assert not score(a_trial(), said("unknown", unknown=(1,))).right
    assert not score(a_trial(), said("unknown")).right


def test_what_the_healthy_plant_has_is_neither_asked_for_nor_false() -> None:
    trial = a_trial(healthy=(("presliding_hysteresis", 1),))
    assert score(trial, said("effects", ("presliding_hysteresis", 1))).right
    assert score(trial, said("none")).right
    assert not score(trial, said("effects", ("presliding_hysteresis", 2))).right


def test_outside_the_library_only_unknown_at_the_joint_is_right() -> None:
    trial = a_trial(("bump", 3), outside=True)
    assert score(trial, said("unknown", unknown=(3,))).right
    assert not score(trial, said("effects", ("gravity_spring", 3))).right
    assert not score(trial, said("unknown", unknown=(2,))).right
    assert not score(trial, said("unknown", ("cable_spring", 3), unknown=(3,))).right


def test_two_effects_are_right_only_both() -> None:
    trial = a_trial(("stribeck", 2), ("cable_spring", 4))
    assert not score(trial, said("effects", ("stribeck", 2))).right
    assert score(trial, said("effects", ("cable_spring", 4), ("stribeck", 2))).right


def test_one_filter_of_all_torques_is_one_cause_not_six() -> None:
    trial = a_trial(("torque_filter", 0))
    assert score(trial, said("effects", ("dead_time", 0))).right
    assert score(trial, said("effects", ("common_delay", 0))).right
    assert not score(trial, said("effects", *(("dead_time", j) for j in range(1, 7)))).right


def test_late_arm_encoders_are_named_in_their_channel() -> None:
    trial = a_trial()
    cause = Cause("arm_delay", 0, 4.0, right_names("arm_delay", 0, 6, (0, 1, 2)), False)
    trial = dataclasses.replace(trial, kind="arm", causes=(cause,))
    assert score(trial, said("effects", ("dead_time", 2), channel="qa_2")).right
    assert not score(trial, said("effects", ("dead_time", 2))).right
    assert not score(trial, said("effects", ("dead_time", 5), channel="qa_5")).right


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
    assert "| empty ones left alone | 0 % of 1 |" in rates(every)
    assert "| false names per recording | 0.50 |" in rates(every)
    assert "| 3 … 5 | 1 | 100 % of 1 | 100 % of 1 | 100 % of 1 |" in power(every)


@pytest.mark.parametrize(("joint", "allowed"), [(5, True), (2, False)])
def test_a_load_is_a_payload_only_next_to_the_flange(joint: int, allowed: bool) -> None:
    assert (("payload", 0) in right_names("link_load", joint, 6)) is allowed


def test_an_engine_left_out_is_judged_by_the_factor_of_the_others() -> None:
    def empty(engine: str, *margins: float) -> Score:
        names = tuple(("degressive", j + 1) for j in range(len(margins)))
        made = dataclasses.replace(score(a_trial(), said("effects", *names)), engine=engine, margins=margins)
        return dataclasses.replace(made, right=not margins)

    # Played with halved shares: a margin of 3 is one and a half times the usual share.
    every = [empty("mujoco", 3.0), empty("mujoco"), empty("pybullet", 1.2), empty("pybullet")]
    text = leaving_out(every, 0.5)
    assert "| mujoco | 0.60 | 1 of 2 | 1 of 2 |" in text
    assert "| pybullet | 1.50 | 2 of 2 | 2 of 2 |" in text


def test_a_joints_delay_holds_what_all_torques_are_late_by_unless_that_has_a_name() -> None:
    trial = dataclasses.replace(a_trial(("dead_time", 2)), late=1e-3)
    number = SimpleNamespace(name="delay", value=4e-3, std=1e-4)
    alone = score(trial, said("effects", ("dead_time", 2), parameters=(number,)))
    beside = score(trial, said("effects", ("dead_time", 2), ("common_delay", 0), parameters=(number,)))
    assert dict(alone.covered)["dead_time: delay"] == pytest.approx(0.0, abs=1e-9)
    assert dict(beside.covered)["dead_time: delay"] == pytest.approx(10.0)
