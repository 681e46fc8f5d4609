"""Another cycle than the robot's: the identified loop is brought to it, or it is said why not."""

from __future__ import annotations

import gc
import sys

import numpy as np
import pytest

from ideal_robot.errors import InputError
from ideal_robot.feedforward.method import Needs
from ideal_robot.feedforward.passthrough import PassThrough
from ideal_robot.feedforward.registry import register, unregister
from ideal_robot.loop.simulation import simulate
from ideal_robot.robots.robot import Robot
from scenes.rsi.self_test import held_cycles
from scenes.rsi.setup import _require_better, answers_within, prepared
from scenes.rsi.undisturbed import undisturbed


@pytest.mark.parametrize("cycle_ms", [1, 4, 5, 8, 12, 40])
def test_the_ideal_robot_is_one_at_every_cycle(cycle_ms: int) -> None:
    arm, law, loop, _ = prepared(robot="kr6", cycle=1e-3 * cycle_ms)
    assert loop is not None
    assert law.t_ipo == arm.t_ipo == loop.t_ipo == pytest.approx(1e-3 * cycle_ms)
    t = np.arange(0.0, 2.4, arm.t_ipo)
    shape = np.sin(np.pi * np.clip((t - 0.6) / 1.2, 0.0, 1.0))[:, None] ** 4
    q_d = arm.home + shape * np.array([0.3, -0.2, 0.25, 0.4, -0.3, 0.5])
    off = [np.sqrt(np.mean((q_d - simulate(loop, q_c).q_a[:-1])[t > 0.6] ** 2)) for q_c in (law.along(q_d), q_d)]
    assert off[0] < 0.1 * off[1]
    assert 0.02 < answers_within(loop, arm) < 0.6


def test_a_correction_that_makes_it_worse_is_refused_with_what_to_do() -> None:
    arm, law, loop, file = prepared(robot="kr6", cycle=0.004)
    assert loop is not None
    q_d = arm.home + 0.01 * np.sin(np.linspace(0.0, np.pi, 300))[:, None] ** 4

    class Wrong(PassThrough):
        def step(self, state, q_d, tau_ext_d=None):
            return q_d[0] + 0.05, None

    with pytest.raises(InputError, match=r"identify the arm at it.*--method none"):
        _require_better(Wrong(arm.t_ipo), loop, q_d, file)
    _require_better(law, loop, q_d, file)


def test_the_self_test_hears_of_every_packet() -> None:
    held = held_cycles(method="none", seconds=0.4, cycles_ms=(12,))
    (test,) = held.tests
    assert test.failure is None
    assert len(test.delays_ms) == 33
    assert np.isfinite(test.delays_ms).sum() > 0
    assert {"shortest_cycle_ms", "granted", "cycles"} <= held.json().keys()
    assert len(held.reasons()) >= 2
    assert len(held.table()[1]) == 1


def test_what_was_granted_is_given_back() -> None:
    before = gc.isenabled(), gc.get_freeze_count(), sys.getswitchinterval()
    with undisturbed() as granted:
        assert not gc.isenabled()
        assert granted
    assert (gc.isenabled(), gc.get_freeze_count(), sys.getswitchinterval()) == before


def test_a_method_of_another_package_is_served() -> None:
    register("mine", lambda setting: PassThrough(setting.robot.t_ipo), description="mine", needs=Needs.NOTHING)
    try:
        arm, law, loop, _ = prepared(robot="kr6", method="mine")
    finally:
        unregister("mine")
    assert isinstance(law, PassThrough)
    assert law.t_ipo == arm.t_ipo
    assert loop is None


@pytest.mark.parametrize("method", ["trained", "learned_1", "model_learned", "unheard_of"])
def test_methods_that_need_more_than_a_model_are_refused(method: str) -> None:
    with pytest.raises(InputError, match="expected one of none, precorrected_1, precorrected, ideal"):
        prepared(robot="kr6", method=method)


def test_the_kr6_keeps_its_own_cycle_where_none_is_given() -> None:
    assert prepared(robot="kr6", method="none")[0].t_ipo == Robot.load("kr6").t_ipo
