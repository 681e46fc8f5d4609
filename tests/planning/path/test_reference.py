"""The reference path, travel over time along it, and smoothing."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ideal_robot.arrays import interpolated
from ideal_robot.errors import InputError
from planning.path.desired_path import Smoother
from planning.path.joint_path import JointPath
from planning.path.path_kernels import displaced_frames, sensor_errors, unit
from planning.path.reference import ReferencePath
from planning.path.speed_profile import Limits, SpeedProfile
from tests.planning.cell import T, joint_path, kr6, profile, reference, sine_points


def circle(radius: float = 0.2, turns: float = 0.75) -> ReferencePath:
    u = np.linspace(0.0, 2 * np.pi * turns, 4001)
    return ReferencePath(np.column_stack([radius * np.cos(u), radius * np.sin(u), 0 * u]), smoothing=0.0)


def test_circle_has_its_length_curvature_and_centre() -> None:
    path = circle()
    s = np.linspace(0.02, path.length - 0.02, 200)
    assert path.length == pytest.approx(1.5 * np.pi * 0.2, rel=1e-6)
    np.testing.assert_allclose(path.frames(s).curvature, 5.0, rtol=1e-4)
    # Counter-clockwise seen from above: the left normal points to the centre.
    np.testing.assert_allclose(path.position(s) + 0.2 * path.frames(s).normal, 0.0, atol=1e-7)


def test_parameter_is_arc_length_and_frames_are_right_handed() -> None:
    path = reference()
    s = np.linspace(-0.1, path.length + 0.1, 5001)
    step = np.linalg.norm(np.diff(path.position(s), axis=0), axis=1)
    np.testing.assert_allclose(step, np.diff(s), rtol=2e-4)
    f = path.frames(s)
    axes = np.stack([f.tangent, f.normal, f.up], axis=2)
    np.testing.assert_allclose(axes.transpose(0, 2, 1) @ axes, np.broadcast_to(np.eye(3), axes.shape), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(axes), 1.0, atol=1e-12)


def test_curvature_and_tangent_are_derivatives() -> None:
    path, h = reference(), 1e-5
    s = np.linspace(0.05, path.length - 0.05, 101)
    numeric = (path.position(s + h) - path.position(s - h)) / (2 * h)
    np.testing.assert_allclose(path.frames(s).tangent, numeric, atol=1e-4)
    bend = np.sum((path.frames(s + h).tangent - path.frames(s - h).tangent) / (2 * h) * path.frames(s).normal, axis=1)
    np.testing.assert_allclose(path.frames(s).curvature, bend, atol=2e-3)


def test_goes_on_straight_beyond_its_ends() -> None:
    path = reference()
    for end, sign in ((0.0, -1.0), (path.length, 1.0)):
        beyond = path.position(end + sign * 0.08)
        np.testing.assert_allclose(beyond, path.position(end) + sign * 0.08 * path.frames(end).tangent, atol=1e-9)
        assert path.frames(np.array([end + sign * 0.08])).curvature[0] == 0.0


@settings(max_examples=40, deadline=None)
@given(st.floats(0.05, 0.95), st.floats(-0.02, 0.02), st.floats(-0.01, 0.01))
def test_projection_is_the_inverse_of_the_path_coordinates(share: float, d: float, h: float) -> None:
    path = reference()
    s = share * path.length
    f = path.frames(np.array([s]))
    point = f.position + d * f.normal + h * f.up
    coordinates = path.project(point, s + 0.04, 0.15)
    np.testing.assert_allclose(np.concatenate(coordinates), [s, d, h], atol=1e-7)


def test_projection_keeps_the_branches_of_a_crossing_apart() -> None:
    u = np.linspace(-np.pi / 2, 1.5 * np.pi, 4001)
    eight = ReferencePath(np.column_stack([0.3 * np.sin(u), 0.15 * np.sin(2 * u), 0 * u]))
    # The figure runs through the origin a quarter and three quarters of the way.
    for share in (0.25, 0.75):
        s, lateral, _ = eight.project(np.zeros((1, 3)), share * eight.length + 0.03, 0.1)
        assert s[0] == pytest.approx(share * eight.length, abs=1e-4)
        assert abs(lateral[0]) < 1e-5


@settings(max_examples=15, deadline=None)
@given(st.lists(st.floats(-2.0, 2.0), min_size=6, max_size=6))
def test_moving_the_points_moves_everything_with_them(twist: list[float]) -> None:
    move = pin.exp6(np.array(twist))
    points = sine_points()[::5]
    up = np.array([0.0, 0.0, 1.0])
    path, moved = (
        ReferencePath(points, up=up, turning=0.7),
        ReferencePath(points @ move.rotation.T + move.translation, up=move.rotation @ up, turning=0.7),
    )
    s = np.linspace(0.0, path.length - 1e-6, 30)
    assert moved.length == pytest.approx(path.length, rel=1e-9)
    np.testing.assert_allclose(moved.position(s), path.position(s) @ move.rotation.T + move.translation, atol=1e-8)
    np.testing.assert_allclose(moved.frames(s).normal, path.frames(s).normal @ move.rotation.T, atol=1e-7)
    np.testing.assert_allclose(moved.rotation(s), move.rotation @ path.rotation(s), atol=1e-6)
    np.testing.assert_allclose(moved.frames(s).curvature, path.frames(s).curvature, atol=1e-6)


def test_tool_turns_as_much_as_asked() -> None:
    points = sine_points()
    s = np.linspace(0.1, 0.9, 60)
    with_line = ReferencePath(points, turning=1.0, turn_smoothing=0.0)
    np.testing.assert_allclose(with_line.rotation(s)[:, :, 0], with_line.frames(s).tangent, atol=1e-3)
    np.testing.assert_allclose(with_line.rotation(s)[:, :, 2], np.tile([0, 0, -1.0], (60, 1)), atol=1e-9)
    fixed = ReferencePath(points, turning=0.0)
    np.testing.assert_allclose(fixed.rotation(s), np.broadcast_to(fixed.rotation(0.5), (60, 3, 3)), atol=1e-9)
    half = ReferencePath(points, turning=0.5, turn_smoothing=0.0)
    angle = [np.linalg.norm(pin.log3(fixed.rotation(x).T @ half.rotation(x))) for x in s]
    full = [np.linalg.norm(pin.log3(fixed.rotation(x).T @ with_line.rotation(x))) for x in s]
    np.testing.assert_allclose(angle, 0.5 * np.array(full), atol=1e-3)


def test_tool_turns_on_over_more_than_a_full_turn() -> None:
    u = np.linspace(0.0, 5 * np.pi, 4001)
    spiral = ReferencePath(np.column_stack([0.1 * np.cos(u), 0.1 * np.sin(u), 0.01 * u]), turning=1.0)
    s = np.linspace(0.0, spiral.length, 400)
    R = spiral.rotation(s)
    steps = [np.linalg.norm(pin.log3(a.T @ b)) for a, b in pairwise(R)]
    assert max(steps) < 2.0 * (5 * np.pi / 400)


def test_given_orientation_holds_in_the_mean_direction() -> None:
    rotation = pin.rpy.rpyToMatrix(np.pi, 0.2, 0.3)
    path = ReferencePath(sine_points(), turning=0.0, rotation=rotation)
    np.testing.assert_allclose(path.rotation(0.4), rotation, atol=1e-9)


def test_curved_surface_gives_the_tool_its_normal() -> None:
    u = np.linspace(-0.6, 0.6, 800)
    points = 0.5 * np.column_stack([0 * u, np.sin(u), np.cos(u)])
    path = ReferencePath(points, up=points / 0.5, turning=1.0)
    s = np.linspace(0.05, path.length - 0.05, 50)
    outward = path.position(s) / np.linalg.norm(path.position(s), axis=1, keepdims=True)
    np.testing.assert_allclose(path.frames(s).up, outward, atol=1e-4)
    np.testing.assert_allclose(path.rotation(s)[:, :, 2], -outward, atol=1e-3)


def test_corner_is_rounded_and_curvature_stays_finite() -> None:
    corner = ReferencePath(np.array([[0.0, 0, 0], [0.3, 0, 0], [0.3, 0.3, 0]]), smoothing=0.04)
    s = np.linspace(0.0, corner.length, 2000)
    # Averaging twice over half the length weights with a triangle; at its top both tangents count the same.
    assert np.max(np.abs(corner.frames(s).curvature)) < 1.02 * 4.0 * np.sqrt(2.0) / 0.04
    assert corner.length < 0.6
    cut = np.min(np.linalg.norm(corner.position(s) - [0.3, 0, 0], axis=1))
    assert 0.0 < cut < 0.02


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (np.zeros((5, 3)), "10 mm"),
        (np.array([[0.0, 0, 0], [0.001, 0, 0]]), "10 mm"),
        (np.zeros((5, 2)), "shape"),
        (np.array([[0.0, 0, 0], [np.nan, 0, 0]]), "finite"),
    ],
)
def test_unusable_points_are_refused(points: np.ndarray, message: str) -> None:
    with pytest.raises(InputError, match=message):
        ReferencePath(points)


# Compiled arithmetic of path coordinates against the vectors it stands for.

SEEDS = st.integers(0, 2**32 - 1)


@settings(max_examples=50, deadline=None)
@given(SEEDS)
def test_errors_of_a_camera_displace_points_as_vectors_say(seed: int) -> None:
    rng = np.random.default_rng(seed)
    normal, up, ray, lever = rng.standard_normal((4, 5, 3))
    velocity, rate = rng.standard_normal((2, 3))
    turned, moved, slant = sensor_errors(normal, up, ray, lever, velocity, rate)
    np.testing.assert_allclose(turned, np.sum(normal * np.cross(up, ray), axis=1), atol=1e-12)
    np.testing.assert_allclose(moved, np.sum(normal * (velocity + np.cross(rate, lever)), axis=1), atol=1e-12)
    np.testing.assert_allclose(slant, np.sum(ray * normal, axis=1) / np.sum(ray * up, axis=1), rtol=1e-9)


@pytest.mark.parametrize("directions", [1, 2])
def test_tangents_of_a_displaced_path_are_the_way_its_points_go(directions: int) -> None:
    def waves(s: np.ndarray) -> np.ndarray:
        return np.column_stack([0.01 * np.sin(9.0 * s), 0.004 * np.cos(7.0 * s)])[:, :directions]

    def displaced(s: np.ndarray) -> np.ndarray:
        frames, d = reference().frames(s), waves(s)
        return frames.position + d[:, :1] * frames.normal + (d[:, 1:] * frames.up if directions == 2 else 0.0)

    s, step = np.linspace(0.1, 0.9, 30), 1e-5
    f, slope = reference().frames(s), (waves(s + step) - waves(s - step)) / (2.0 * step)
    points, ahead, up = displaced_frames(f.position, f.tangent, f.normal, f.up, f.curvature, waves(s), slope)
    np.testing.assert_allclose(points, displaced(s), atol=1e-12)
    np.testing.assert_allclose(ahead, unit(displaced(s + step) - displaced(s - step)), atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(up, axis=1), 1.0, atol=1e-12)
    if directions == 2:
        np.testing.assert_allclose(np.sum(up * ahead, axis=1), 0.0, atol=1e-12)


# Travel over time: limits of path and joints, and clear refusals.

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
    q = interpolated(travel.s(t), path.s, path.q)
    velocity = np.gradient(q, 0.004, axis=0)
    assert np.all(np.abs(velocity) <= robot.v_max)
    dq = interpolated(travel.s(t), path.s, path.dq)
    ddq = interpolated(travel.s(t), path.s, path.ddq)
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
