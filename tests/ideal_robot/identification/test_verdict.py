"""Verdicts on identified joints: usable, weak with the motion that would tell, unusable."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ideal_robot.identification.idim import identify
from ideal_robot.identification.verdict import JointVerdict, joint_verdicts, told
from ideal_robot.model.parametrisation import Parameter
from ideal_robot.signals.recording import Recording
from tests.ideal_robot.identification.arm import record, robot, truth


def verdicts(recording: Recording, *unseen: Recording) -> tuple[JointVerdict, ...]:
    result = identify([recording], robot(), validation=unseen, friction="viscous_coulomb")
    return joint_verdicts(result.model, result, robot())


def with_tau(recording: Recording, joint: int, tau: np.ndarray) -> Recording:
    return replace(recording, columns={**recording.columns, f"tau_{joint}": tau})


@pytest.fixture(scope="module")
def good() -> Recording:
    return record(truth(), np.random.default_rng(0), rate=100.0)


def test_a_motion_that_excites_gives_usable_joints(good: Recording) -> None:
    found = verdicts(good)
    assert [one.verdict for one in found] == 6 * ["usable"]
    assert not any(one.reason or one.would_tell for one in found)


def test_torque_of_other_causes_makes_a_joint_weak_then_unusable(good: Recording) -> None:
    spread, wave = np.std(good.columns["tau_6"]), np.sin(5.0 * good.t) + np.sin(7.3 * good.t)
    weak, unusable = (verdicts(with_tau(good, 6, good.columns["tau_6"] + share * spread * wave)) for share in (0.5, 3))
    assert [one.verdict for one in weak[:3]] == 3 * ["usable"]
    assert (weak[5].verdict, unusable[5].verdict) == ("weak", "unusable")
    assert "diagnose" in weak[5].reason


def test_what_only_the_validation_leaves_asks_for_its_motion(good: Recording) -> None:
    other = record(truth(), np.random.default_rng(1), rate=100.0, seed=2)
    shifted = with_tau(other, 6, other.columns["tau_6"] * 2.0)
    found = verdicts(good, shifted)[5]
    assert found.verdict != "usable"
    assert "the validation's motion" in found.would_tell


def test_a_joint_that_stands_still_or_is_not_measured_is_unusable(good: Recording) -> None:
    still = replace(good, columns={**good.columns, "q_6": np.full(len(good.t), 0.3)})
    found = verdicts(still)[5]
    assert (found.verdict, found.reason) == ("unusable", "it does not move")
    assert "joint 6" in found.would_tell
    dead = np.where(np.random.default_rng(4).random(len(good.t)) < 0.8, 0.0, good.columns["tau_6"])
    found = verdicts(with_tau(good, 6, dead))[5]
    assert (found.verdict, found.would_tell) == ("unusable", "")


def test_three_seconds_of_motion_say_which_motion_would_tell_more() -> None:
    noisy = record(truth(), np.random.default_rng(1), noise=0.02)
    here = (noisy.t >= 6.0) & (noisy.t < 9.25)
    found = verdicts(replace(noisy, columns={name: values[here] for name, values in noisy.columns.items()}))
    asking = [one for one in found if "beyond the recorded postures" in one.reason]
    assert asking
    assert all(one.verdict == "weak" and f"joint {one.joint}" in one.would_tell for one in asking)


def test_parameters_within_two_deviations_of_zero_are_not_told() -> None:
    named = Parameter("Fc_1", 1, 2.0, 0.5, "N m", "friction")
    assert told(named)
    assert not told(replace(named, std=1.5))
    assert not told(replace(named, value=0.0, std=0.0))
