"""Travel over time: limits of path and joints, and clear refusals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ideal_robot.errors import InputError
from planning.path.reference import ReferencePath
from planning.path.speed_profile import JointPath, Limits, SpeedProfile
from tests.planning.cell import joint_path, kr6, profile, reference, sine_points


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
