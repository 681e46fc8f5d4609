"""Which effects carry over: each that lowers the error of the other recording, and no other."""

from __future__ import annotations

import numpy as np
import pytest

from ideal_robot.diagnosis.validation.carry_over import accepted, eliminated, log_reduction

TRUE = {"a": 3.0, "b": 1.0, "habit": 0.0}
"""What is in the other recording of each effect; each claims twice, once and once of its own."""
CLAIMED = {"a": 2.0, "b": 1.0, "habit": 1.0}


def error(kept):
    left = sum((TRUE[name] - CLAIMED[name] * (name in kept)) ** 2 for name in TRUE)
    return np.array([np.sqrt(left + 0.1), 1.0])


def test_a_habit_is_dropped_and_said_with_its_errors():
    kept, dropped = eliminated(["habit", "a", "b"], error, lambda name: 0)
    assert kept == ["a", "b"]
    (name, without, present), = dropped
    assert name == "habit"
    assert without[0] == pytest.approx(error(["a", "b"])[0])
    assert present[0] == pytest.approx(error(["habit", "a", "b"])[0])


def test_what_lowers_the_error_enough_is_taken():
    assert accepted(["habit", "a", "b"], error, lambda name: 0, 0.0) == ["a", "b"]
    assert accepted(["habit", "a", "b"], error, lambda name: 0, 0.3) == ["a", "b"]
    assert accepted(["b"], error, lambda name: 0, 0.1) == []


def test_an_effect_without_a_channel_is_judged_by_all():
    assert log_reduction(np.array([4.0, 1.0]), np.array([1.0, 1.0]), None) == pytest.approx(np.log(2.0))
    assert log_reduction(np.array([4.0, 1.0]), np.array([1.0, 1.0]), 1) == 0.0
