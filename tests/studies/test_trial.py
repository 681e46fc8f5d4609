"""Trials follow from their seeds, and are of the size that they say."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from studies.strangers.effects import INSIDE, Setup
from studies.strangers.engines import ENGINES
from studies.strangers.logger import draw_logger, left, read, record, sizes
from studies.strangers.other_effects import NEW
from studies.strangers.trial import KINDS, SHARES, draw_trial
from tests.studies.plants import a_motion, a_plant, an_arm


@pytest.mark.parametrize("engine", sorted(ENGINES))
def test_a_seed_gives_the_same_recording_bit_for_bit(engine: str) -> None:
    one, two = (draw_trial(7, "none", engine, seconds=(4.0, 5.0)) for _ in range(2))
    assert one.recording.hash == two.recording.hash
    assert one.urdf == two.urdf
    assert draw_trial(10, "none", engine, seconds=(4.0, 5.0)).recording.hash != one.recording.hash


def test_size_that_came_out_is_near_the_one_drawn() -> None:
    trial = draw_trial(12, "inside", "integrator", (4.0, 5.0), (8.0, 10.0))
    assert 4.0 / 1.7 <= trial.causes[0].size <= 5.0 * 1.7
    assert trial.recording.n >= 2


def test_a_third_of_the_trials_and_more_hold_nothing() -> None:
    assert SHARES[KINDS.index("none")] > 1.0 / 3.0
    assert sum(SHARES) == pytest.approx(1.0)


def test_size_of_an_effect_grows_with_it_and_is_zero_without() -> None:
    arm = an_arm()
    rng = np.random.default_rng(2)
    setup = Setup(a_plant(arm), draw_logger(rng, arm.n, ()))
    motion = a_motion(arm, 8.0)
    effect = INSIDE["cable_spring"](rng, setup, 1)
    assert effect is not None

    def seen(amount: float) -> float:
        changed = effect.apply(setup, amount)
        return float(sizes(healthy, read(record(changed.logger, changed.plant, ENGINES["integrator"](
            changed.plant, motion)), arm.model), absorbed=True)[1])

    healthy = read(record(setup.logger, setup.plant, ENGINES["integrator"](setup.plant, motion)), arm.model)
    assert seen(0.0) == 0.0
    assert seen(4.0) > 1.5 * seen(2.0) > 0.0


@pytest.mark.parametrize("engine", sorted(ENGINES))
def test_nothing_but_dry_friction_keeps_a_clean_rigid_plant_out_of_the_model_class(engine: str) -> None:
    """No clock or engine leaves a trace of its own: without dry friction the model class explains the torque."""
    arm = an_arm()
    rng = np.random.default_rng(2)
    logger = dataclasses.replace(draw_logger(rng, arm.n, ()), every=4, torque="sampled", encoder=1e-9, jitter=0.0,
                                 noise=np.zeros(arm.n), dropped=0.0, spikes=0.0)
    motion = a_motion(arm, 12.0)
    shares = []
    for friction in (False, True):
        plant = a_plant(arm, friction=friction)
        reading = read(record(logger, plant, ENGINES[engine](plant, motion)), arm.model)
        shares.append(np.std(left(reading), axis=0) / np.std(reading.tau, axis=0))
    assert np.all(shares[0] < 2e-3)
    assert np.max(shares[1]) > 10.0 * np.max(shares[0])


def test_jitter_makes_an_effect_less_visible() -> None:
    arm = an_arm()
    rng = np.random.default_rng(2)
    setup = Setup(a_plant(arm), draw_logger(rng, arm.n, ()))
    motion = a_motion(arm, 8.0)
    changed = INSIDE["cable_spring"](rng, setup, 1).apply(setup, 4.0)
    runs = [ENGINES["integrator"](s.plant, motion) for s in (setup, changed)]

    def seen(jitter: float) -> float:
        logger = dataclasses.replace(setup.logger, every=16, jitter=jitter, stamps="nominal", encoder=1e-6)
        healthy, other = (read(record(logger, setup.plant, run), arm.model) for run in runs)
        return float(sizes(healthy, other, absorbed=True)[1])

    assert seen(0.15) < 0.9 * seen(0.0)


def test_filter_of_all_torques_is_late_by_its_time_constant() -> None:
    arm = an_arm()
    rng = np.random.default_rng(2)
    setup = Setup(a_plant(arm), draw_logger(rng, arm.n, ()))
    run = ENGINES["integrator"](setup.plant, a_motion(arm, 8.0))
    effect = NEW["torque_filter"](rng, setup, 0)
    assert effect is not None
    late = effect.apply(setup, 2.0)
    one, two = (record(s.logger, s.plant, run) for s in (setup, late))
    slope = np.gradient(one.joints("tau"), one.t, axis=0)
    change = two.joints("tau") - one.joints("tau")
    lag = -np.sum(change * slope, axis=0) / np.sum(slope**2, axis=0)
    assert np.all(lag > 0.0)
    assert effect.values(2.0)["torque_filter", 0, "time constant"] == pytest.approx(6e-3)
