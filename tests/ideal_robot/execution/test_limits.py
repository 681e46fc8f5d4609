"""Limits lie where they are said to lie: a thousandth less passes, a thousandth more is refused; braking is quick."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import ideal_robot as ir
from ideal_robot.arrays import Array, eased
from ideal_robot.errors import InputError, LimitError
from ideal_robot.execution.command_governor import ACCELERATION, CommandGovernor, stops_at_once
from ideal_robot.execution.command_limits import check_limits, require_within_limits
from ideal_robot.execution.path_stop import moved_away, stopping_rows
from ideal_robot.execution.precorrect import path_at_cycles, precorrect
from ideal_robot.feedforward.base import PassThrough
from ideal_robot.robots.interface import checked_command
from ideal_robot.robots.robot import Robot
from tests.arms import urdf, written
from tests.ideal_robot.execution.test_play import MODEL, ROBOT, Follower, path

T = ROBOT.t_ipo
Moved = Callable[[int, float], Array]


def _positions(joint: int, share: float) -> Array:
    q = np.tile(0.5 * (ROBOT.q_min + ROBOT.q_max), (6, 1))
    q[3, joint] += share * 0.5 * (ROBOT.q_max - ROBOT.q_min)[joint]
    return q


def _speeds(joint: int, share: float) -> Array:
    q = np.tile(ROBOT.home, (6, 1))
    q[:, joint] += share * ROBOT.v_max[joint] * T * np.arange(6)
    return q


def _accelerations(joint: int, share: float) -> Array:
    """Rest, then one step of speed, which lasts."""
    q = np.tile(ROBOT.home, (6, 1))
    q[:, joint] += share * ACCELERATION * ROBOT.a_max[joint] * T**2 * np.maximum(np.arange(6) - 3, 0)
    return q


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("joint", range(6))
@pytest.mark.parametrize(("quantity", "moved", "row", "largest"), [
    ("velocity", _speeds, 0, lambda j: ROBOT.v_max[j]),
    ("acceleration", _accelerations, 2, lambda j: ACCELERATION * ROBOT.a_max[j])])
def test_a_thousandth_beyond_a_limit_is_refused(quantity: str, moved: Moved, row: int, largest: Callable[[int], float],
                                                joint: int, sign: float) -> None:
    check_limits(moved(joint, 0.999 * sign), ROBOT, T)
    with pytest.raises(LimitError, match=f"{quantity} .* at {2.0 + row * T:.3f} s") as caught:
        check_limits(moved(joint, 1.001 * sign), ROBOT, T, start=2.0)
    assert caught.value.joint == joint + 1
    np.testing.assert_allclose([caught.value.value, caught.value.limit], sign * largest(joint) * np.array([1.001, 1.0]))


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("joint", range(6))
def test_a_position_beyond_its_limit_is_refused_and_named(joint: int, sign: float) -> None:
    # So slowly that no speed is in the way.
    check_limits(_positions(joint, 0.999 * sign), ROBOT, 1e3)
    limit = (ROBOT.q_max if sign > 0 else ROBOT.q_min)[joint]
    with pytest.raises(LimitError, match=r"position .* at 0\.036 s") as caught:
        check_limits(_positions(joint, 1.001 * sign), ROBOT, T)
    assert (caught.value.joint, caught.value.limit) == (joint + 1, limit)
    with pytest.raises(InputError, match=r"at -0\.964 s") as refused:
        require_within_limits(_positions(joint, 1.001 * sign), ROBOT, start=-1.0, file="my.csv", column="q_c")
    assert refused.value.field == f"q_c_{joint + 1}"


def test_the_shortest_paths_are_looked_at_as_well() -> None:
    for rows in (1, 2):
        check_limits(np.tile(ROBOT.home, (rows, 1)), ROBOT, T)
    with pytest.raises(LimitError, match="position"):
        check_limits(2.0 * ROBOT.q_max[None], ROBOT, T)
    with pytest.raises(LimitError, match="velocity"):
        check_limits(_speeds(2, 1.001)[:2], ROBOT, T)
    with pytest.raises(LimitError, match="acceleration"):
        check_limits(_accelerations(2, 1.001)[2:5], ROBOT, T)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("joint", range(6))
def test_a_command_can_be_held_where_holding_keeps_the_acceleration(joint: int, sign: float) -> None:
    for share in (0.999, 1.001):
        moving = _accelerations(joint, share * sign)[:5]
        step = moving[-1] - moving[-2]
        held = np.vstack([moving[-2:], moving[-1:]])
        try:
            check_limits(held, ROBOT, T)
            allowed = True
        except LimitError:
            allowed = False
        assert stops_at_once(step, ROBOT, T) == allowed == (share < 1.0)
    # One joint that cannot is enough.
    assert not stops_at_once(2.0 * ACCELERATION * ROBOT.a_max * T**2 * np.eye(6)[joint], ROBOT, T)


def test_a_command_without_room_to_brake_is_refused_and_the_one_before_was_not() -> None:
    """At full speed towards a limit, joint 2: braking takes v²/2a, and the message says when, what and how far."""
    joint, governor = 1, CommandGovernor(ROBOT, ROBOT.home)
    v, a = ROBOT.v_max[joint], ACCELERATION * ROBOT.a_max[joint]
    speeds = np.minimum(a * T * np.arange(1.0, 5000.0), v)
    ahead = iter(ROBOT.home + np.outer(np.cumsum(speeds * T), np.eye(6)[joint]))

    def go_on() -> None:
        for q in ahead:
            governor.require_room(q, start=7.0)
            governor.passed(q)

    with pytest.raises(LimitError, match=r"position at 7\.000 s after which") as caught:
        go_on()
    assert caught.value.joint == joint + 1
    room = ROBOT.q_max[joint] - caught.value.value
    # Of the way v²/2a a cycle or two are left out by rounding to cycles.
    assert room < v**2 / (2.0 * a) < room + 2.5 * v * T
    assert caught.value.limit < caught.value.value


def test_limits_of_a_joint_that_slides_are_said_in_metres(tmp_path: Path) -> None:
    limit = 'lower="-2.9" upper="2.9" effort="0" velocity="1"'
    arm = Robot.load(written(tmp_path, urdf(limit=limit, kind="prismatic")))
    rest = np.zeros(6)

    def said(joint: int, size: float, check: Callable[[Array], object]) -> str:
        with pytest.raises(LimitError) as caught:
            check(size * np.eye(6)[joint])
        return caught.value.quantity

    for joint, unit in ((0, "m"), (1, "rad")):
        for size, end in ((3.0, "]"), (2.5, "/s]")):
            assert f"[{unit}{end}" in said(joint, size, lambda q: check_limits(np.vstack([rest, q]), arm, T))
            assert f"[{unit}{end}" in said(joint, size, lambda q: checked_command(arm, q, rest, T))
        assert f"[{unit}]" in said(joint, 2.5, CommandGovernor(arm, rest).require_room)


def test_without_a_time_the_first_command_is_that_of_the_begin() -> None:
    beyond = ROBOT.home + 0.5 * np.eye(6)[2]
    with pytest.raises(LimitError, match=r"at 0\.000 s"):
        CommandGovernor(ROBOT, ROBOT.home).require_room(beyond)
    with pytest.raises(LimitError, match=r"at 0\.000 s"):
        check_limits(np.vstack([ROBOT.home, beyond]), ROBOT, T)
    with pytest.raises(InputError, match=r"at 0\.000 s"):
        require_within_limits(np.vstack([ROBOT.home, beyond]), ROBOT)


def test_the_governor_is_as_quick_as_the_limits_let_it() -> None:
    """A far goal asked for at once: full acceleration, full speed, and as late a braking as can be."""
    for joint in range(6):
        for goal in (ROBOT.q_min[joint] + 0.01, ROBOT.q_max[joint] - 0.01):
            q, governor = ROBOT.home.copy(), CommandGovernor(ROBOT, ROBOT.home)
            q[joint] = goal
            moved = [ROBOT.home]
            while abs(moved[-1][joint] - goal) > 1e-4:
                moved.append(governor.allowed(q))
                assert len(moved) < 4000
            v, a = ROBOT.v_max[joint], ACCELERATION * ROBOT.a_max[joint]
            distance = abs(goal - ROBOT.home[joint])
            least = distance / v + v / a if distance > v * v / a else 2.0 * np.sqrt(distance / a)
            assert least - T < T * len(moved) < least + 6 * T
            # The other joints were asked for nothing.
            np.testing.assert_array_equal(np.delete(moved[-1] - ROBOT.home, joint), 0.0)


@pytest.mark.parametrize("share", [0.3, 1.0])
def test_nothing_to_follow_means_braking_at_once(share: float) -> None:
    """From full speed a command that is no number brings each joint to rest within v/a and a few cycles."""
    governor, q = CommandGovernor(ROBOT, ROBOT.home), ROBOT.home
    for k in range(200):
        speed = np.minimum(ACCELERATION * ROBOT.a_max * T * k, share * ROBOT.v_max)
        q = q + speed * T
        if np.any(q > ROBOT.q_max - 0.8):
            break
        np.testing.assert_array_equal(governor.allowed(q), q)
    steps = int(np.ceil(np.max(speed / (ACCELERATION * ROBOT.a_max)) / T)) + 4
    last = [governor.allowed(np.full(6, np.nan)) for _ in range(steps)]
    np.testing.assert_allclose(last[-1], last[-2], atol=1e-9)
    # Least way: v²/2a.
    least = speed**2 / (2.0 * ACCELERATION * ROBOT.a_max)
    assert np.all(last[-1] - q < least + 2.5 * speed * T)
    assert np.all(last[-1] - q > least - 2.5 * speed * T)


# Stopping on the path.

@pytest.mark.parametrize(("speed", "deceleration"), [(0.5, 2.0), (1.0, 2.5)])
def test_braking_on_a_path_takes_the_deceleration_that_is_allowed(speed: float, deceleration: float) -> None:
    """On a straight path: time 1.5 v/a, way half of it times v, largest deceleration a, and the path is not left."""
    planned = speed * T * np.arange(400.0)[:, None] * np.array([1.0, -2.0])
    rows = stopping_rows(planned, T, speed, deceleration)
    walked = np.array([next(rows)[0] for _ in range(300)])
    np.testing.assert_allclose(walked[:, 1], -2.0 * walked[:, 0], atol=1e-12)
    v = np.diff(walked[:, 0]) / T
    np.testing.assert_allclose(-np.diff(v).min() / T, deceleration, rtol=0.02)
    length = 1.5 * speed / deceleration
    np.testing.assert_allclose(walked[-1, 0], 0.5 * speed * length, rtol=1e-9)
    assert np.all(v >= -1e-12)
    stands = int(np.ceil(length / T))
    np.testing.assert_array_equal(walked[stands:, 0], walked[-1, 0])
    assert v[stands - 2] > 0.0


def test_horizons_of_a_stop_go_on_one_into_the_next() -> None:
    planned = 0.3 * np.sin(0.02 * np.arange(200.0))[:, None]
    rows = stopping_rows(planned, T, 1.0, 3.0)
    first, second, third = (next(rows) for _ in range(3))
    np.testing.assert_allclose(first[1:], second[:-1], atol=1e-12)
    np.testing.assert_allclose(second[1:], third[:-1], atol=1e-12)
    np.testing.assert_allclose(first[0], planned[0], atol=1e-12)


def test_a_plan_that_ends_before_is_not_left() -> None:
    rows = stopping_rows(np.linspace(0.0, 0.1, 11)[:, None], T, 10.0, 0.1)
    walked = np.array([next(rows)[0, 0] for _ in range(60)])
    np.testing.assert_allclose(walked.max(), 0.1, atol=1e-9)
    np.testing.assert_allclose(walked[-1], 0.1, atol=1e-9)


def test_an_arm_that_lets_go_moves_away_while_it_brakes_and_ends_at_rest_there() -> None:
    planned = 0.5 * T * np.arange(400.0)[:, None] * np.array([1.0, -2.0])
    shift, a_max = np.array([0.1, -0.02]), np.array([10.0, 8.0])
    plain = stopping_rows(planned, T, 0.5, 2.0)
    rows = moved_away(stopping_rows(planned, T, 0.5, 2.0), shift, a_max, T)
    off = np.array([next(rows)[:2] - next(plain)[:2] for _ in range(400)])
    np.testing.assert_allclose(off[1:, 0], off[:-1, 1], atol=1e-12)
    off = np.vstack([np.zeros((1, 2)), off[:, 0]])
    np.testing.assert_allclose(off[-1], shift, rtol=1e-12)
    np.testing.assert_allclose(off[:, 0] / shift[0], off[:, 1] / shift[1], atol=1e-12)
    a = np.abs(np.diff(off, 2, axis=0)) / T**2
    np.testing.assert_allclose(a.max(axis=0)[0], 0.25 * a_max[0], rtol=0.02)
    assert a.max(axis=0)[1] <= 0.25 * a_max[1]
    assert np.all(a[0] < 0.25 * a.max(axis=0))


# What a play does at its ends.

def test_a_path_that_ends_in_motion_is_braked_within_the_limits_and_comes_back_to_its_end() -> None:
    speed = 0.8 * ROBOT.v_max
    k = np.arange(70.0)[:, None]
    inwards = np.sign(0.5 * (ROBOT.q_min + ROBOT.q_max) - ROBOT.home)
    q_d = ROBOT.home + 0.3 * speed * T * inwards * np.where(k < 40, k * eased(k / 40.0), k)
    played = ir.play(Follower(), PassThrough(T), q_d, robot=ROBOT)
    assert played.failure is None
    check_limits(played.q_c, ROBOT, T)
    assert len(played.q_c) > len(q_d)
    np.testing.assert_allclose(played.q_c[-1], q_d[-1], atol=1e-4)
    np.testing.assert_allclose(played.q_c[-1], played.q_c[-2], atol=1e-6)


def test_a_path_that_ends_at_rest_ends_with_its_last_row() -> None:
    assert len(ir.play(Follower(), PassThrough(T), path(), robot=ROBOT).q_c) == len(path())


def test_a_first_step_beyond_the_acceleration_is_not_handed_over() -> None:
    for share, fine in ((0.9, True), (1.1, False)):
        q_d = ROBOT.home + np.minimum(np.arange(40.0), 1.0)[:, None] * share * ACCELERATION * ROBOT.a_max * T**2
        played = ir.play(Follower(), PassThrough(T), q_d, robot=ROBOT)
        assert (played.failure is None) == fine
        np.testing.assert_array_equal(played.q_c[0], q_d[0])
        if not fine:
            assert "acceleration" in str(played.failure)
            check_limits(played.q_c, ROBOT, T)


def test_computing_times_are_those_of_the_computing() -> None:
    begun = time.perf_counter()
    played = ir.play(Follower(), PassThrough(T), path(), robot=ROBOT)
    assert played.compute_times.min() > 0.0
    assert played.compute_times.sum() < time.perf_counter() - begun
    assert played.to_dict()["units"] == ["mrad"] * 6
    times = played.to_dict()["compute_time_ms"]
    assert times["median"] <= times["max"] == pytest.approx(1e3 * played.compute_times.max())


# A path brought to the cycles.

def test_samples_half_a_millisecond_off_the_cycles_are_brought_to_them() -> None:
    def truth(t: Array) -> Array:
        return ROBOT.home + 0.3 * np.sin(6.0 * t)[:, None]

    even = T * np.arange(200.0)
    late = even + np.where(np.arange(200) % 199 == 0, 0.0, 5e-4 * np.sin(np.arange(200.0)))
    times, q, _ = path_at_cycles(late, truth(late), ROBOT, rest=0.0)
    np.testing.assert_allclose(q[:200], truth(times[:200]), atol=1e-6)
    assert np.abs(truth(late) - truth(even)).max() > 3e-4
    # At the cycles they pass as they are.
    np.testing.assert_array_equal(path_at_cycles(even, truth(even), ROBOT, rest=0.0)[1][:200], truth(even))


def test_between_samples_no_way_is_invented() -> None:
    """Across a gap nobody knows it, and between two times that nearly meet it would leave every limit."""
    t = 0.02 * np.arange(300.0)
    q = ROBOT.home + 0.3 * np.sin(t)[:, None]
    with pytest.raises(InputError, match=r"gap of 2\.02 s after t = 1\.98 s.*give samples in between"):
        path_at_cycles(np.delete(t, slice(100, 200)), np.delete(q, slice(100, 200), axis=0), ROBOT, rest=0.0)
    near = t.copy()
    near[100] = near[99] + 1e-5
    with pytest.raises(InputError, match=r"within the joint limits.*1\.98 s and 1\.98001 s.* 1e-05 s apart.*0\.02 s"):
        path_at_cycles(near, q, ROBOT, rest=0.0)
    path_at_cycles(t, q, ROBOT, rest=0.0)


def test_missing_samples_are_told_where_the_others_tell_the_way_and_refused_where_they_do_not() -> None:
    t = 0.02 * np.arange(400.0)
    q = ROBOT.home + 0.02 * np.sin(4.0 * t)[:, None]
    rows = np.delete(np.arange(400), slice(100, 104))
    assert precorrect(t, q, MODEL, ROBOT).warnings == ()
    (warning,) = precorrect(t[rows], q[rows], MODEL, ROBOT).warnings
    assert warning.startswith("bridged: 1 times samples of the path are missing, for 0.1 s at most after t = 1.98 s")
    corner = ROBOT.home + 0.1 * np.abs(np.sin(2.0 * t))[:, None]
    rows = np.delete(np.arange(400), slice(70, 90))
    with pytest.raises(InputError, match=r"missing for 0\.42 s after t = 1\.38 s.* by [\d.]+ mrad there"):
        path_at_cycles(t[rows], corner[rows], ROBOT, rest=0.0)


def test_waypoints_further_apart_than_half_a_second_are_seconds_where_the_arm_could_not_be_quicker() -> None:
    t = 0.6 * np.arange(20.0)
    q = ROBOT.home + 0.1 * np.sin(t)[:, None]
    path_at_cycles(t, q, ROBOT, rest=0.0)
    with pytest.raises(InputError, match="milliseconds"):
        path_at_cycles(1e3 * t, q, ROBOT, rest=0.0)


def test_a_spread_of_controllers_gives_a_range_joint_by_joint() -> None:
    controller = MODEL.controller
    assert controller is not None
    spread = replace(controller, spread={"position_gain": [0.1] * 6, "velocity_gain": [0.1] * 6})
    q_d = path(size=0.1)
    errors = precorrect(T * np.arange(len(q_d)), q_d, replace(MODEL, controller=spread), ROBOT
                        ).to_dict()["expected_rms_error_mrad"]
    low, mean, high = (np.array(errors[key]) for key in ("corrected_from", "corrected", "corrected_to"))
    assert low.shape == high.shape == mean.shape == (6,)
    assert np.all(low < high)
    assert np.all(low <= np.array(errors["uncorrected"]))
