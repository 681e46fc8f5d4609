"""Travel over time: limits of path and joints, and clear refusals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ideal_robot.errors import InputError
from planning.path.desired_path import Smoother
from planning.path.reference import ReferencePath
from planning.path.speed_profile import JointPath, Limits, SpeedProfile
from tests.planning.cell import T, joint_path, kr6, profile, reference, sine_points


@pytest.mark.parametrize("speed", [0.1, 0.7, 1.2])
def test_from_rest_to_rest_within_the_limits_of_the_path(speed: float) -> None:
    limits = Limits(speed, acceleration=4.0, jerk=80.0)
    travel = SpeedProfile.plan(kr6(), reference(), limits, joint_path())
    t = np.arange(0.0, travel.duration, 5e-4)
    assert travel.s(0.0) == pytest.approx(0.0, abs=1e-12)
    assert travel.s(travel.duration) == pytest.approx(reference().length, rel=1e-9)
    for end in (0.0, travel.duration):
        assert travel.speed(end) == pytest.approx(0.0, abs=1e-6)
    assert np.all(np.diff(travel.s(t)) >= -1e-9)
    assert travel.top_speed == pytest.approx(speed, rel=1e-3)
    assert np.max(np.abs(travel.acceleration(t))) <= 4.0 * 1.01
    assert np.max(np.abs(np.diff(travel.acceleration(t)))) / 5e-4 <= 80.0 * 1.3


def test_joints_keep_their_limits() -> None:
    robot = kr6()
    travel = SpeedProfile.plan(robot, reference(), Limits(1.2), joint_path())
    t = np.arange(0.0, travel.duration, 0.004)
    path = joint_path()
    q = np.column_stack([np.interp(travel.s(t), path.s, column) for column in path.q.T])
    velocity = np.gradient(q, 0.004, axis=0)
    assert np.all(np.abs(velocity) <= robot.v_max)
    dq = np.column_stack([np.interp(travel.s(t), path.s, column) for column in path.dq.T])
    ddq = np.column_stack([np.interp(travel.s(t), path.s, column) for column in path.ddq.T])
    acceleration = dq * travel.acceleration(t)[:, None] + ddq * travel.speed(t)[:, None] ** 2
    assert np.all(np.abs(acceleration) <= 0.86 * robot.a_max)


def test_slows_down_in_a_sharp_corner_only() -> None:
    points = np.array([[0.95, -0.4, 0.35], [0.95, 0.1, 0.35], [0.6, 0.1, 0.35]])
    path = ReferencePath(points, smoothing=0.06, turning=1.0, turn_smoothing=0.05)
    weak = replace(kr6(), a_max=0.25 * kr6().a_max)
    travel = SpeedProfile.plan(weak, path, 0.6)
    instants = np.arange(0.0, travel.duration, 0.001)
    at_corner = instants[np.searchsorted(travel.s(instants), 0.5 * path.length + 0.05)]
    assert travel.top_speed == pytest.approx(0.6, rel=0.02)
    assert travel.slowed
    assert not SpeedProfile.plan(kr6(), reference(), 0.7, joint_path()).slowed
    begin, end, lowest, joint = min(travel.slowed, key=lambda piece: piece[2])
    assert begin < 0.5 < end + 0.1
    assert lowest < 0.5
    assert 1 <= joint <= 6
    assert travel.speed(at_corner) < 0.6


def test_unreachable_speed_names_joint_limit_and_remedy() -> None:
    slow = replace(kr6(), v_max=0.1 * kr6().v_max)
    with pytest.raises(InputError, match=r"joint \d would need .* rad/s.*limit.*lower the speed") as refused:
        SpeedProfile.plan(slow, reference(), 2.0, joint_path())
    assert refused.value.field == "speed"
    assert refused.value.value == 2.0
    # What the message offers is possible.
    offered = float(str(refused.value).split("at most ")[1].split()[0])
    assert SpeedProfile.plan(slow, reference(), offered - 0.01, joint_path()).top_speed > 0.97 * (offered - 0.01)


def test_path_too_short_for_the_speed_says_so() -> None:
    short = ReferencePath(sine_points(length=0.3))
    with pytest.raises(InputError, match="lengthen the path"):
        SpeedProfile.plan(kr6(), short, Limits(1.5, acceleration=2.0))


def test_path_out_of_reach_says_where() -> None:
    far = ReferencePath(sine_points() + np.array([1.5, 0.0, 0.0]))
    with pytest.raises(InputError, match="out of reach") as refused:
        JointPath.of(kr6(), far)
    assert refused.value.field == "path"


@pytest.mark.parametrize("bad", [0.0, -1.0, float("nan"), float("inf")])
def test_speeds_that_are_none_are_refused(bad: float) -> None:
    with pytest.raises(InputError, match="positive"):
        Limits(bad)


def test_single_instant_agrees_with_many() -> None:
    travel = profile()
    for t in (-1.0, 0.0, 0.1234, 0.9, travel.duration, travel.duration + 1.0):
        s, speed = travel.at(t)
        assert s == pytest.approx(float(travel.s(t)), abs=1e-12)
        assert speed == pytest.approx(float(travel.speed(t)), abs=1e-9)


def test_a_path_that_would_last_for_hours_is_refused_before_it_is_sampled() -> None:
    with pytest.raises(InputError, match="would last"):
        SpeedProfile.plan(kr6(), reference(), Limits(1e-8), joint_path())


def test_a_long_travel_has_a_bounded_number_of_samples(monkeypatch: pytest.MonkeyPatch) -> None:
    fine = profile(0.05)
    monkeypatch.setattr("planning.path.speed_profile.MOST_TICKS", round(fine.duration / 0.004))
    coarse = SpeedProfile.plan(kr6(), reference(), Limits(0.05), joint_path())
    assert fine.tick == 0.001
    assert coarse.tick in (0.004, 0.005)
    t = np.linspace(0.0, fine.duration, 500)
    np.testing.assert_allclose(coarse.s(t), fine.s(t), atol=1e-3)
    np.testing.assert_allclose(coarse.at(1.234)[0], coarse.s(1.234), rtol=1e-12)
    jerk = np.abs(np.diff(coarse.speed(coarse.tick * np.arange(round(coarse.duration / coarse.tick) + 1)), 2))
    assert jerk.max() / coarse.tick**2 < 1.1 * Limits(0.05).jerk


# Smoothing: continuous, without delay, gentle where it has to be.

N = 40


def chain(smoother: Smoother, estimate: np.ndarray, every: int = 2, start: float = 0.0) -> np.ndarray:
    """Plans again and again from the state reached; positions, velocities, accelerations executed ``(K, 3)``."""
    state = np.array([[start], [0.0], [0.0]])
    out = []
    for k in range(0, len(estimate) - N - 1, every):
        plan = smoother.plan(state, estimate[k + 1 : k + 1 + N, None])
        out += [plan[:, i, 0] for i in range(every)]
        state = plan[:, every - 1]
    return np.array(out)


def test_constant_velocity_passes_unchanged() -> None:
    ramp = 0.003 + 0.02 * T * np.arange(200)
    smoother = Smoother(N, T)
    state = np.array([[ramp[0]], [0.02], [0.0]])
    plan = smoother.plan(state, ramp[1 : N + 1, None])
    np.testing.assert_allclose(plan[0, :, 0], ramp[1 : N + 1], atol=1e-12)
    np.testing.assert_allclose(plan[1, :, 0], 0.02, atol=1e-9)


@pytest.mark.parametrize("frequency", [1.0, 3.0, 5.0])
def test_waves_below_the_cutoff_pass_without_delay(frequency: float) -> None:
    t = T * np.arange(400)
    wave = 1e-3 * np.sin(2 * np.pi * frequency * t)
    executed = chain(Smoother(N, T, cutoff=12.0, acceleration=100.0), wave)[:, 0]
    settled = slice(80, 300)
    reference = wave[1 : len(executed) + 1]
    gain = float(executed[settled] @ reference[settled] / (reference[settled] @ reference[settled]))
    assert gain == pytest.approx(1.0 / (1.0 + (frequency / 12.0) ** 6), abs=0.01)
    assert np.max(np.abs(executed - reference)[settled]) < 0.02e-3


def test_position_velocity_and_acceleration_are_continuous_although_the_estimate_jumps() -> None:
    rng = np.random.default_rng(1)
    smoother = Smoother(N, T)
    state = np.zeros((3, 1))
    executed = []
    for k in range(100):
        # Each field moves the whole estimate a little.
        estimate = 2e-3 * np.sin(0.05 * (k + 1 + np.arange(N))) + 1e-4 * rng.normal()
        plan = smoother.plan(state, estimate[:, None])
        state = plan[:, 0]
        executed.append(state[:, 0])
    x, v, a = np.array(executed).T
    # The motion over a cycle follows from the state before it and a constant jerk.
    jerk = np.diff(a) / T
    np.testing.assert_allclose(x[1:], x[:-1] + T * v[:-1] + 0.5 * T**2 * a[:-1] + T**3 / 6 * jerk, atol=1e-12)
    np.testing.assert_allclose(v[1:], v[:-1] + T * a[:-1] + 0.5 * T**2 * jerk, atol=1e-10)


@pytest.mark.parametrize("step", [1e-3, 1e-2, 3e-2])
def test_jump_of_the_estimate_is_worked_off_within_the_acceleration(step: float) -> None:
    executed = chain(Smoother(N, T, acceleration=4.0), np.full(200, step))
    assert np.max(np.abs(executed[:, 2])) <= 4.0 + 1e-9
    # As fast as that acceleration allows, give and take a factor: rest to rest takes 2.4 √(step/a).
    arrived = np.flatnonzero(np.abs(executed[:, 0] - step) > 0.05 * step)[-1] * T
    assert arrived < 4.0 * 2.4 * np.sqrt(step / 4.0) + 0.1
    assert executed[-1, 0] == pytest.approx(step, rel=1e-3)


def test_directions_do_not_mix() -> None:
    smoother = Smoother(N, T)
    rng = np.random.default_rng(2)
    state, estimate = 1e-4 * rng.normal(size=(3, 2)), 1e-4 * rng.normal(size=(N, 2)).cumsum(axis=0)
    both = smoother.plan(state, estimate)
    alone = Smoother(N, T, acceleration=np.inf)
    np.testing.assert_allclose(alone.plan(state, estimate)[:, :, 1], alone.plan(state[:, 1:], estimate[:, 1:])[:, :, 0])
    assert both.shape == (3, N, 2)
