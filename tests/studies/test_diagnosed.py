"""Recordings in strangers' physics: rates of what is said, over seeds that nobody chose."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from ideal_robot.diagnosis import diagnose
from ideal_robot.effects import Signals
from ideal_robot.effects.drive import AxisCoupling, CommonDelay
from ideal_robot.signals.recording import Recording
from studies.diagnoses import known_before
from studies.strangers.arm import robot_of
from studies.strangers.score import Score, score
from studies.strangers.trial import draw_trial


def diagnosed(seed: int, kind: str) -> Score:
    trial = draw_trial(seed, kind, size=(3.0, 10.0), seconds=(15.0, 25.0))
    with robot_of(trial.urdf) as robot:
        return score(trial, diagnose(trial.recording, robot, model=known_before(trial, robot)))


@pytest.mark.slow
def test_a_healthy_arm_is_left_alone_nineteen_times_of_twenty() -> None:
    """Of eight at most two otherwise: one program in a hundred and seventy that does so fails here."""
    assert sum(bool(diagnosed(seed, "none").said) for seed in range(7_500_000, 7_500_008)) <= 2


@pytest.mark.slow
def test_an_effect_of_three_times_what_is_visible_is_found_four_times_of_five() -> None:
    """Of eight at least four: one program in a hundred that does so fails here."""
    scores = [diagnosed(seed, "inside") for seed in range(7_510_000, 7_510_008)]
    assert sum(s.right for s in scores) >= 4
    assert sum(len(s.false) for s in scores) <= 3


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "delays"), [
    (994008, (5e-3,)), (994001, (0.0, 5e-3, 12e-3))])
def test_a_clock_that_is_late_for_all_torques_is_a_common_delay(seed: int, delays: tuple[float, ...]) -> None:
    """A filter as the only name would say that fast motion is weakened."""
    trial = draw_trial(seed, "none", size=(3.0, 10.0), seconds=(15.0, 25.0))
    assert trial.late == 0.0
    with robot_of(trial.urdf) as robot:
        for delay in delays:
            effects = [e for e in diagnose(_late_by(trial.recording, delay), robot).effects
                       if isinstance(e.fitted.effect, CommonDelay)]
            assert [e.fitted.name for e in effects] == (["common_delay"] if delay else [])
            for effect in effects:
                assert effect.indistinguishable_from == ("torque_filter",)
                assert effect.fitted.parameters[0].value == pytest.approx(delay, abs=4e-4)


def _late_by(recording: Recording, delay: float) -> Recording:
    """A recording all of whose torques a logger stamps late."""
    late = {name: CubicSpline(recording.t, values)(recording.t - delay) if name.startswith("tau") else values
            for name, values in recording.columns.items()}
    return dataclasses.replace(recording, columns=late)


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_a_coupled_shaft_has_inertia_and_friction_not_less_than_none(sense: float) -> None:
    t = np.linspace(0.0, 10.0, 1000)
    q = np.column_stack([np.sin(t), np.cos(1.7 * t)])
    qd, qdd = np.gradient(q, t, axis=0), np.gradient(np.gradient(q, t, axis=0), t, axis=0)
    signals = Signals(t, q, qd, qdd, qd, qd, qd)
    effect = AxisCoupling()

    def plausible(inertia: float, viscous: float, dry: float) -> bool:
        return effect.plausible(np.array([sense * inertia, sense * viscous, dry]), (1.0, sense, 2.0), signals, 2)

    assert plausible(0.3, 0.4, 0.5)
    assert plausible(0.3, -0.01, 0.5)
    assert not plausible(0.3, 0.4, -0.5)
    assert not plausible(-0.3, 0.0, 0.5)
