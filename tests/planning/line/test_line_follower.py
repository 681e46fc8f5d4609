"""Line following with an arm that follows its commands exactly: what is left is planning's own error."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ideal_robot.errors import InputError
from planning import LineLostError, LineNeverSeenError, OutOfReachError, PlanningError
from planning.force.contour import SlidingPlan
from planning.line.deviation_model import Expected, PathDeviation
from planning.line.direct_feedback import DirectFeedback
from planning.line.fusion import DeviationFilter
from planning.line.line_follower import FollowerSettings, LineFollower
from planning.line.measurement import Measurement
from planning.path.desired_path import FROZEN, DesiredPath
from planning.path.reference import ReferencePath
from planning.path.speed_profile import Limits, SpeedProfile
from tests.planning.cell import (
    Camera,
    Run,
    Seen,
    T,
    displaced,
    distance,
    follow,
    joint_path,
    kr6,
    profile,
    reference,
    sine_points,
)

LINE = displaced(sine_points())


def follower(n_d: int = 25, speed: float = 0.7, **settings: object) -> LineFollower:
    return LineFollower(
        kr6(),
        reference(),
        profile(speed),
        n_d,
        settings=FollowerSettings(**settings),  # type: ignore[arg-type]
    )


def errors(run: Run, line: np.ndarray = LINE, after: float = 0.5) -> np.ndarray:
    """Distances from the line where it is, from ``after`` seconds on [m]."""
    inside = (run.t > after) & (run.tcp[:, 1] < line[-1, 1] - 0.005)
    return distance(run.tcp[inside], line)


@pytest.mark.parametrize("speed", [0.3, 0.7, 1.0])
def test_displaced_and_turned_line_is_followed(speed: float) -> None:
    run = follow(follower(speed=speed), Camera(LINE, np.random.default_rng(1)))
    # From noise of 0.03 mm a point, at 50 fields a second with 5 points each.
    assert errors(run).mean() < 0.03e-3
    assert errors(run).max() < 0.12e-3


@pytest.mark.parametrize("latency", [0.0, 0.08])
def test_latency_hardly_matters(latency: float) -> None:
    run = follow(follower(latency=latency), Camera(LINE, np.random.default_rng(2)), latency=latency)
    assert errors(run).mean() < 0.03e-3


def test_one_camera_snapshot_is_enough_to_run_on() -> None:
    # A line that is only shifted: a single field of it places all of the path ([L] 4.3).
    line = sine_points() + np.array([0.006, 0.0, 0.0])
    f = follower(max_gap=2.0)
    run = follow(f, Camera(line, np.random.default_rng(3)), blind=(0.004, 2.0))
    assert sum(field.seen for field in run.fields) < 6
    assert errors(run, line).mean() < 2e-3
    assert np.abs(distance(run.tcp[:1], line)).max() > 5e-3


def test_fields_in_the_wrong_order_lead_to_the_same_map() -> None:
    run = follow(follower(), Camera(LINE, np.random.default_rng(4)))
    shuffled = follow(follower(), Camera(LINE, np.random.default_rng(4)), shuffle=True)
    stamps = [field.t for field in shuffled.fields]
    assert stamps != sorted(stamps)
    assert errors(shuffled).mean() < errors(run).mean() + 0.01e-3


def test_turned_camera_and_wrong_time_stamps_are_found_out() -> None:
    f = follower(stamp=0.001)
    run = follow(f, Camera(LINE, np.random.default_rng(5), yaw=0.002), stamp=0.0005)
    yaw, stamp = f.fusion.bias("camera")[0]
    # The follower's bias is what it has to take off: the seen line was turned forwards, the stamps are late.
    assert abs(yaw) == pytest.approx(0.002, abs=2e-4)
    assert abs(stamp) == pytest.approx(0.0005, abs=2e-4)
    assert errors(run).mean() < 0.04e-3


def test_desired_path_is_smooth_although_the_map_changes() -> None:
    run = follow(follower(), Camera(LINE, np.random.default_rng(6), noise=1e-4))
    q = np.array([horizon[0] for horizon in run.horizons])
    jerk = np.abs(np.diff(q, 3, axis=0)) / T**3
    plain = follower().q_reference[: len(q)]
    own = np.abs(np.diff(plain, 3, axis=0)) / T**3
    acceleration = np.abs(np.diff(q - plain, 2, axis=0)) / T**2
    # 4 m/s² of correction at about 0.9 m from the base, more in the wrist, which turns against it.
    assert np.max(acceleration[:, :3]) < 12.0
    assert np.max(jerk) < np.max(own) + 1500.0


def test_new_fields_do_not_touch_what_is_being_executed() -> None:
    run = follow(follower(), Camera(LINE, np.random.default_rng(7)))
    for before, after in zip(run.horizons[:-1], run.horizons[1:], strict=True):
        # Row 0 now was row 1 a cycle ago.
        np.testing.assert_allclose(after[:FROZEN], before[1 : 1 + FROZEN], atol=1e-9)


def test_horizon_is_one_path_and_keeps_still_without_fields() -> None:
    f = follower()
    first = f.horizon(0.0)
    assert first.shape == (25, 6)
    np.testing.assert_allclose(f.horizon(T)[:-1], first[1:], atol=1e-12)
    np.testing.assert_allclose(first, f.q_reference[:25], atol=1e-9)


def test_speed_along_the_path_is_the_references() -> None:
    run = follow(follower(), Camera(LINE, np.random.default_rng(8)))
    s, _, _ = zip(
        *[reference().project(p[None], float(profile().s(t)), 0.1) for t, p in zip(run.t, run.tcp, strict=True)],
        strict=True,
    )
    np.testing.assert_allclose(np.concatenate(s), profile().s(run.t), atol=1e-6)


def test_line_of_another_length_and_shape_is_followed() -> None:
    # Amplitude and wavelength differ, so that equal arc lengths are different places.
    line = sine_points(amplitude=0.036, wavelength=0.77) + np.array([0.004, 0.0, 0.0])
    run = follow(follower(), Camera(line, np.random.default_rng(9)))
    assert errors(run, line).mean() < 0.04e-3


def test_rest_of_the_arm_at_the_end() -> None:
    f = follower()
    run = follow(f, Camera(LINE, np.random.default_rng(10)))
    assert f.finished(run.t[-1])
    end = f.horizon(f.duration + 3.0)
    assert np.max(np.abs(end - end[0])) < 1e-3


def test_gap_is_bridged() -> None:
    f = follower()
    run = follow(f, Camera(LINE, np.random.default_rng(11)), blind=(0.4, 0.48))
    assert errors(run).mean() < 0.05e-3
    assert errors(run).max() < 0.5e-3


def test_variance_grows_while_nothing_is_seen() -> None:
    f = follower(max_gap=2.0)
    follow(f, Camera(LINE, np.random.default_rng(12)), blind=(0.4, 2.0))
    f2 = follower()
    follow(f2, Camera(LINE, np.random.default_rng(12)))
    s = np.array([0.95])
    assert f.deviation(s)[1][0] > 5 * f2.deviation(s)[1][0]


def test_line_lost_midway_says_where_and_when() -> None:
    f = follower(max_gap=0.12)
    with pytest.raises(LineLostError, match=r"line lost at t = .* last seen at .* 120 mm") as lost:
        follow(f, Camera(LINE, np.random.default_rng(13)), blind=(0.4, 2.0))
    assert lost.value.last_s == pytest.approx(0.4, abs=0.02)
    assert 0.52 < lost.value.s < 0.60
    assert lost.value.last_t < lost.value.t
    assert not isinstance(lost.value, LineNeverSeenError)


def test_as_long_as_the_map_knows_the_line_distance_alone_does_not_end_a_run() -> None:
    # Seen up to 0.17 m ahead of s = 0.4, then not for twice the distance allowed.
    f = follower(max_gap=0.06)
    run = follow(f, Camera(LINE, np.random.default_rng(13)), blind=(0.4, 0.52))
    assert f.finished(run.t[-1])
    assert errors(run).max() < 1e-3


@pytest.mark.parametrize("speed", [0.7, 2.0])
def test_a_line_that_breaks_off_ends_the_run_where_the_map_ends(speed: float) -> None:
    f = follower(speed=speed, max_gap=0.12)
    with pytest.raises(LineLostError, match=r"known to \d\.\d mm") as lost:
        follow(f, Camera(LINE, np.random.default_rng(13)), blind=(0.4, 2.0))
    assert lost.value.sigma > f.settings.unsure
    # A cycle's way or two beyond what is known, whatever the speed.
    assert lost.value.s < 0.60 + 2 * T * speed


def test_points_of_a_field_are_spread_at_every_speed() -> None:
    for speed in (0.3, 0.7, 2.0):
        for count in (3, 25):
            s = follower(speed=speed, points=count).predict(0.5).s
            np.testing.assert_allclose(s - s[0], np.linspace(0.0, 0.1, count), atol=1e-9)


def test_silent_camera_loses_the_line_too() -> None:
    f = follower(max_gap=0.12)
    with pytest.raises(LineLostError):
        follow(f, Camera(LINE, np.random.default_rng(14)), rate=1.5)


def test_line_never_seen_says_so() -> None:
    with pytest.raises(LineNeverSeenError, match="never seen") as lost:
        follow(follower(max_search=0.2), Camera(LINE, np.random.default_rng(15)), blind=(-1.0, 2.0))
    assert lost.value.s == pytest.approx(0.2, abs=0.05)


@pytest.mark.parametrize("t_start", [0.0, 0.6])
def test_a_travel_that_begins_later_is_given_up_at_the_same_place(t_start: float) -> None:
    f = LineFollower(kr6(), reference(), profile(), 25, t_start=t_start,
                     settings=FollowerSettings(max_search=0.2))
    with pytest.raises(LineNeverSeenError) as lost:
        follow(f, Camera(LINE, np.random.default_rng(15)), blind=(-1.0, 2.0))
    assert lost.value.s == pytest.approx(0.234, abs=0.01)
    assert lost.value.t - t_start == pytest.approx(np.interp(lost.value.s, profile().s(T * np.arange(200)),
                                                             T * np.arange(200)), abs=2 * T)


@pytest.mark.parametrize("t_ipo", [0.004, 0.012])
def test_plans_reach_as_far_in_time_whatever_the_cycle(t_ipo: float) -> None:
    robot, n_d = replace(kr6(), t_ipo=t_ipo), round(0.3 / t_ipo)
    sliding = SlidingPlan(n_d, t_ipo, robot.home, np.zeros(2))
    assert DesiredPath(robot, reference(), profile(), n_d).samples * t_ipo == pytest.approx(0.444)
    assert sliding.samples * t_ipo == pytest.approx(0.372)
    sliding.follow(np.tile([1e-3, 0.0], (sliding.samples, 1)), 0)
    assert sliding.position[round(0.024 / t_ipo), 0] == pytest.approx(0.5e-3, rel=0.1)


def test_a_plan_that_has_run_out_is_held_at_its_end() -> None:
    sliding = SlidingPlan(20, T, kr6().home, np.zeros(2))
    sliding.follow(np.tile([1e-3, 0.0], (sliding.samples, 1)), 0)
    end = sliding.position[-1].copy()
    sliding.advance(1000)
    np.testing.assert_array_equal(sliding.position, np.tile(end, (sliding.samples + 2, 1)))
    sliding.follow(np.tile(end, (sliding.samples, 1)), 0)
    np.testing.assert_allclose(sliding.position, np.tile(end, (sliding.samples + 2, 1)), atol=1e-12)


def test_blind_end_of_the_path_is_no_loss() -> None:
    # Nothing of the line is left to see while the arm travels the last stretch.
    f = follower(max_gap=0.05)
    run = follow(f, Camera(LINE, np.random.default_rng(16)))
    assert f.finished(run.t[-1])


def test_line_that_leads_out_of_reach_is_reported() -> None:
    out = sine_points() + np.array([0.04, 0.0, 0.0])
    robot = replace(kr6(), q_max=np.max(joint_path().q, axis=0) + 1e-3, q_min=np.min(joint_path().q, axis=0) - 1e-3)
    f = LineFollower(robot, reference(), profile(), 25)
    with pytest.raises(OutOfReachError, match="its limit is"):
        follow(f, Camera(out, np.random.default_rng(17)))


def test_height_from_another_sensor_moves_the_path_up() -> None:
    model = PathDeviation(reference(), up=Expected(), ahead=0.4)
    f = LineFollower(
        kr6(),
        reference(),
        profile(),
        25,
        fusion=DeviationFilter(model, biases={"camera": (0.003, 0.0005)}),
    )
    camera = Camera(LINE, np.random.default_rng(19))
    height = 0.003
    for s in np.linspace(0.0, 0.4, 20):
        f.fuse(Measurement(0.0, np.array([s]), np.array([height]), np.array([[1e-8]]), np.array([[0.0, 1.0]]), "force"))
    run = follow(f, camera)
    middle = (run.t > 0.6) & (run.t < 0.9)
    np.testing.assert_allclose(run.tcp[middle, 2], 0.35 + height, atol=2e-4)
    flat = run.tcp[middle] * [1, 1, 0] + [0, 0, 0.35]
    assert distance(flat, LINE).mean() < 0.03e-3


def test_curved_path_at_any_place_works_alike() -> None:
    # The same scene turned about the base's axis gives the same wrist and arm angles, joint 1 apart.
    c, s = np.cos(0.3), np.sin(0.3)
    R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
    points = sine_points() @ R.T
    path = ReferencePath(points, turning=1.0)
    travel = SpeedProfile.plan(kr6(), path, Limits(0.7))
    there = follow(LineFollower(kr6(), path, travel, 25), Camera(LINE @ R.T, np.random.default_rng(20)))
    here = follow(follower(), Camera(LINE, np.random.default_rng(20)))
    q_here, q_there = (np.array([h[0] for h in run.horizons]) for run in (here, there))
    np.testing.assert_allclose(q_there[:, 1:], q_here[:, 1:], atol=2e-5)


@pytest.mark.parametrize(
    "bad",
    [{"max_gap": 0.0}, {"noise": -1e-5}, {"view": (0.1, 0.05)}, {"latency": -0.1}],
)
def test_settings_that_make_no_sense_are_refused(bad: dict[str, object]) -> None:
    with pytest.raises(InputError):
        FollowerSettings(**bad)  # type: ignore[arg-type]


def test_field_stamped_before_the_history_is_refused() -> None:
    f = follower()
    camera = Camera(LINE, np.random.default_rng(21))
    for k in range(10):
        f.observe(k * T, f.horizon(k * T)[0])
    field = camera.look(f, 0.05, f.history.pose(0.05))
    with pytest.raises(PlanningError, match="no pose at"):
        f.update(replace(field, t=-1.0))
    assert f.update(field) is not None


# Direct sensor feedback, the baseline: it works at low gain, and latency makes it swing ([L] 4.4).

DISPLACED = displaced(sine_points(), turn=0.0, along=0.0)


def ride(k_p: float, k_d: float = 0.0, latency: float = 0.04) -> tuple[np.ndarray, np.ndarray]:
    """TCP distances from the line [m] and lateral corrections [m] of an arm that follows its commands exactly."""
    follower = LineFollower(kr6(), reference(), profile())
    feedback = DirectFeedback(follower, k_p, k_d)
    camera, fk = Camera(DISPLACED, np.random.default_rng(1)), kr6().fk()
    under_way, tcp, corrections = [], [], []
    exposure = 3 * T
    for k in range(int(follower.duration / T)):
        t = k * T
        while under_way and under_way[0].t + latency <= t:
            feedback.update(under_way.pop(0))
        q = feedback.command(t)
        follower.observe(t, q)
        tcp.append(fk(q).translation)
        corrections.append(feedback.correction)
        while exposure <= t - 2 * T:
            under_way.append(camera.look(follower, exposure, follower.history.pose(exposure)))
            exposure += 0.02
    inside = slice(int(0.6 / T), int(1.2 / T))
    return distance(np.array(tcp)[inside], DISPLACED), np.array(corrections)


def test_without_gain_the_reference_is_driven() -> None:
    error, corrections = ride(0.0)
    assert not corrections.any()
    assert error.mean() > 5e-3


def test_moderate_gain_brings_the_arm_towards_the_line() -> None:
    error, _ = ride(0.08)
    assert error.mean() < 0.3 * ride(0.0)[0].mean()


def test_latency_limits_the_gain() -> None:
    # A gain that a prompt sensor takes swings with a late one.
    prompt, late = ride(0.3, latency=0.0)[1], ride(0.3, latency=0.12)[1]
    turns = [np.sum(np.diff(np.sign(np.diff(c[20:]))) != 0) for c in (prompt, late)]
    assert np.ptp(late[40:]) > 3 * np.ptp(prompt[40:])
    assert turns[1] > 2


def test_the_command_follows_the_law() -> None:
    """[L] (1): the correction grows by K_p Δs in every cycle, and by K_d times what Δs has changed by."""
    signals = np.array([0.0, 0.004, 0.004, 0.007, -0.002, -0.002])

    def corrections(*gains: float) -> np.ndarray:
        follower = LineFollower(kr6(), reference(), profile())
        feedback, pose, applied = DirectFeedback(follower, *gains), kr6().fk()(follower.q_start), []
        frames = follower.reference.frames(follower.reference.project(pose.translation[None], 0.0)[0])
        for signal in signals:
            points = pose.actInv((frames.position + signal * frames.normal)[0])[None].repeat(3, axis=0)
            feedback.update(Seen(0.0, points, np.full(3, 3e-5), np.ones(3, dtype=bool), True), pose)
            feedback.command(0.0)
            applied.append(feedback.correction)
        return np.array(applied)

    for k_p, k_d in ((0.1, 0.0), (0.0, 0.5), (0.2, 0.7)):
        expected = np.cumsum(k_p * signals + k_d * np.diff(signals, prepend=0.0))
        np.testing.assert_allclose(corrections(k_p, k_d), expected, atol=1e-8)
    np.testing.assert_array_equal(corrections(0.1), corrections(0.1, 0.0))


def test_negative_gain_is_refused() -> None:
    with pytest.raises(InputError):
        ride(-0.1)


@pytest.mark.parametrize(("n_d", "speed"), [(1, 0.7), (60, 0.3), (60, 1.0), (60, 2.0)])
def test_the_map_reaches_beyond_all_that_is_planned(n_d: int, speed: float) -> None:
    f, here = follower(n_d, speed), 0.2
    f.fusion.travel(here)
    H = f.fusion.model.basis(here + (n_d + 12) * T * f.profile.top_speed + np.array([0.0, 0.01]))
    assert np.abs(H[1] - H[0])[0, f.fusion.model.rigid :].max() > 1e-3
