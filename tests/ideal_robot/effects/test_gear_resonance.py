"""A gear so soft that the arm behind it swings within the band, against a motor and an arm between which it lies."""

import numpy as np
import pytest

from ideal_robot.diagnosis import diagnose
from ideal_robot.effects import library
from ideal_robot.effects.elasticity import swinging
from ideal_robot.signals.preprocess import lowpass
from tests.ideal_robot.effects.pendulum import INERTIA, signals_of, through_gear
from trials.report import arm_of
from trials.strangers.score import score
from trials.strangers.trial import draw_trial

STIFFNESS, DAMPING = INERTIA * (2.0 * np.pi * 8.0) ** 2, 0.07


def driven() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, motor angles and torque through the gear of a pendulum behind it, its motor on a given path."""
    dt, count = 1e-4, 150_000
    t = dt * np.arange(count)
    q = 0.25 * np.sin(2.1 * t) + 0.004 * np.sin(2.0 * np.pi * 4.7 * t) + 0.0005 * np.sin(2.0 * np.pi * 10.3 * t + 1.0)
    d = 2.0 * DAMPING * np.sqrt(STIFFNESS * INERTIA)
    return t, q, through_gear(q, dt, lambda twist, rate: STIFFNESS * twist + d * rate)


def test_the_torque_of_a_swinging_arm_is_that_of_an_oscillator_and_tells_its_stiffness():
    t, q, torque = driven()
    signals = signals_of(t[::40], q[::40, None])
    missing = lowpass(torque[::40] - signals.load[:, 0], signals.dt, 12.5)
    away = slice(500, -500)

    def left(key: str, theta: tuple[float, ...]) -> tuple[float, float]:
        """Share of the squares that the best coefficient leaves, and that coefficient."""
        effect = next(e for e in library() if e.key == key)
        column = lowpass(effect.columns(signals, 1, theta)[:, 0, 0], signals.dt, 12.5)[away]
        size = missing[away] @ column / (column @ column)
        return float(np.sum((missing[away] - size * column) ** 2) / np.sum(missing[away] ** 2)), float(size)

    stiffness = STIFFNESS * np.linspace(0.6, 1.6, 41)
    found = [left("joint_elasticity/tau_resonance", (k,)) for k in stiffness]
    best = int(np.argmin([share for share, _ in found]))
    assert stiffness[best] == pytest.approx(STIFFNESS, rel=0.1)
    assert found[best][0] < 0.05
    assert found[best][1] == pytest.approx(1.0, abs=0.25)
    # Above the resonance the arm moves against its load: what a slow gear gives has the wrong sign there.
    assert left("joint_elasticity/tau", ())[0] > 0.5


def test_under_a_slow_load_the_gear_bends_as_the_load_asks():
    dt = 1e-3
    t = dt * np.arange(8000)
    load = 2.0 * np.sin(2.0 * np.pi * 0.2 * t)
    twist = swinging(load / INERTIA, np.full(len(t), INERTIA), dt, STIFFNESS)
    np.testing.assert_allclose(twist[2000:], load[2000:] / STIFFNESS, atol=0.03 * np.max(load) / STIFFNESS)


def test_starts_lie_within_one_search_of_any_stiffness_in_the_band():
    signals = signals_of(*(one[::40] if one.ndim == 1 else one for one in (driven()[0], driven()[1][::40, None])))
    effect = next(e for e in library() if e.key == "joint_elasticity/tau_resonance")
    reached = [effect.bounds_near(signals, 1, theta)[0] for theta in effect.starts(signals, 1)]
    low, high = effect.bounds(signals, 1)[0]
    for stiffness in np.geomspace(1.2 * low, high, 30):
        assert any(a <= stiffness <= b * (1.0 + 1e-9) for a, b in reached)


@pytest.mark.slow
def test_a_stranger_s_soft_gear_is_found_beside_a_delay():
    """It swings at 8 Hz; what a slow gear gives took 6 per cent of what is left, and it was missed."""
    trial = draw_trial(737265, size=(3.0, 10.0))
    with arm_of(trial.urdf) as robot:
        found = diagnose(trial.recording, robot)
    assert score(trial, found).right
    stiffness = next(e.fitted.parameters[0] for e in found.effects if e.fitted.name == "joint_elasticity")
    assert stiffness.value == pytest.approx(trial.values["joint_elasticity", 5, "stiffness"], rel=0.1)
