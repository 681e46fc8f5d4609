"""What a camera field and a force say of the deviation, without simulation: geometry, doubts, phases."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import gamma, kv

from ideal_robot.robots.robot import Robot
from planning.follower import Phase
from planning.force.contact import ContactSettings
from planning.force.force_follower import DirectForceFeedback, Errors, SurfaceFollower, surface_filter
from planning.force.line_on_surface import LineOnSurface, SightSettings
from planning.force.surface_forecast import ORDER, SmoothSurface, surfaces
from planning.line.deviation_model import PathDeviation, Stand
from planning.line.filter_bank import FilterBank
from planning.line.fusion import DeviationFilter
from planning.line.measurement import Fused, Measurement
from planning.path.reference import ReferencePath
from planning.path.speed_profile import SpeedProfile
from sensing.camera.camera_model import default_mount
from tests.planning.cell import Seen


def fused(follower: SurfaceFollower, t: Any, contact: Any) -> Fused | None:
    """Fuses contact forces; None while there is no contact yet."""
    measurement = follower.measured(t, contact)
    return None if measurement is None else follower.fuse(t, measurement)


def above_the_surface(**camera: Any) -> SurfaceFollower:
    """Above a straight reference of 0.5 m along the base's y, resting at its start."""
    robot = Robot.load("kr6")
    x = np.linspace(0.0, 0.5, 300)
    reference = ReferencePath(np.column_stack([np.full(300, 0.98), x - 0.25, np.full(300, 0.35)]), turning=1.0)
    profile = SpeedProfile.plan(robot, reference, 0.2)
    biases = {"camera": (0.003, 0.0005, 1e-6)}

    def across() -> PathDeviation:
        return PathDeviation(reference, ahead=0.3)

    def fusion(errors: Errors) -> FilterBank:
        return FilterBank([DeviationFilter(model, biases=biases | {"force": errors}, confirm=0)
                           for model in surfaces(across)])

    surface_follower = SurfaceFollower(robot, reference, profile, 20, ContactSettings(), fusion=fusion, **camera)
    for k in range(6):
        surface_follower.observe(0.012 * k, surface_follower.q_start)
    return surface_follower


def test_a_cycle_without_time_goes_on_as_planned(follower: SurfaceFollower) -> None:
    planned = follower.horizon(0.012)
    np.testing.assert_allclose(follower.horizon(0.024, anew=False)[:-1], planned[1:], atol=1e-6)


@pytest.fixture
def follower() -> SurfaceFollower:
    return above_the_surface(lateral=True)


class Pressed(NamedTuple):
    """What a job with an arm that goes where it is told has left, for the cycles in which the tip travels."""

    s: np.ndarray
    force: np.ndarray
    map: np.ndarray
    sigma: np.ndarray


def pressed(surface: Callable[[np.ndarray], np.ndarray]) -> Pressed:
    """A tip like a spring on a surface of this height over arc length, felt by a sensor that is a cycle late."""
    follower = above_the_surface()
    fk, up, late, rows = follower.robot.fk(), np.array([0.0, 0.0, 1.0]), (0.06, np.zeros(3)), []
    while follower.phase is not Phase.DONE:
        t = late[0] + follower.robot.t_ipo
        fused(follower, np.array([late[0]]), late[1][None])
        q = follower.horizon(t)[0]
        follower.observe(t, q)
        tip = fk(q)
        s, _, height = follower.reference.project(tip.translation[None], follower.s_at(t))
        force = follower.settings.elasticity * max(float((surface(s) - height)[0]), 0.0)
        late = (t, tip.rotation.T @ (force * up))
        if follower.phase is Phase.TRAVEL:
            mean, covariance = follower.fusion.deviation(s)
            rows.append((s[0], force, mean[0, 1], np.sqrt(covariance[-1, -1])))
        assert t < 8.0
    return Pressed(*np.array(rows).T)


def field(follower: SurfaceFollower, t: float, lateral: float, *, height: float = 0.004, scatter: float = 0.0,
          rng: np.random.Generator | None = None) -> Seen:
    """The line, displaced by ``lateral`` and lying ``height`` above the reference, as seen from the tool."""
    s = np.linspace(0.03, 0.11, 5)
    frames = follower.reference.frames(s)
    points = frames.position + lateral * frames.normal + height * frames.up
    if rng is not None:
        points = points + scatter * rng.standard_normal(5)[:, None] * frames.normal
    pose = follower.history.pose(t)
    return Seen(t, (points - pose.translation) @ pose.rotation, np.full(5, 5e-5), np.ones(5, dtype=bool))


def test_two_fields_that_agree_are_believed(follower: SurfaceFollower) -> None:
    sight = LineOnSurface(follower, default_mount(), SightSettings(), (0.0, 0.5))
    first = sight.update(field(follower, 0.02, 0.003))
    assert first is not None
    assert first.dof == 0
    assert "waiting for another one" in first.reason
    second = sight.update(field(follower, 0.04, 0.003))
    assert second is not None
    assert second.dof == 5
    deviation, _ = follower.fusion.deviation(np.array([0.07]))
    assert deviation[0, 0] == pytest.approx(0.003, abs=2e-4)


@pytest.mark.parametrize(("stands", "used"), [(0.0, 5), (0.08, 2), (0.2, 0)])
def test_what_the_tool_has_passed_meanwhile_is_left_out(follower: SurfaceFollower, stands: float, used: int) -> None:
    """The filter went back for it, measurement by measurement: 35 ms a field behind a stall."""
    sight = LineOnSurface(follower, default_mount(), SightSettings(), (0.0, 0.5))
    assert [sight.update(field(follower, t, 0.003)) is None for t in (0.02, 0.04)] == [False, False]
    for member in follower.fusion.members:
        member._stand = Stand(member.model.begin, stands)
    fused = sight.update(field(follower, 0.05, 0.003))
    assert fused is not None
    assert (fused.dof, fused.reason == "behind the tool by now") == (used, used == 0)


def test_points_that_are_on_no_line_are_left_out(follower: SurfaceFollower) -> None:
    sight = LineOnSurface(follower, default_mount(), SightSettings(), (0.0, 0.5))
    rng = np.random.default_rng(0)
    for t in (0.01, 0.03, 0.05):
        fused = sight.update(field(follower, t, 0.003, scatter=0.002, rng=rng))
        assert fused is not None
        assert fused.dof == 0
        assert fused.reason == "points are not on one line"


def test_fields_that_contradict_each_other_are_left_out(follower: SurfaceFollower) -> None:
    sight = LineOnSurface(follower, default_mount(), SightSettings(), (0.0, 0.5))
    for t, lateral in ((0.01, 0.004), (0.02, -0.006), (0.03, 0.001), (0.05, 0.007)):
        fused = sight.update(field(follower, t, lateral))
        assert fused is not None
        assert fused.dof == 0


def test_an_oblique_camera_measures_across_its_rays(follower: SurfaceFollower) -> None:
    """Seen from the side, a point at a wrong height is displaced along the ray; across it nothing changes."""
    aside = pin.SE3(default_mount().rotation, np.array([0.065, 0.15, -0.25]))
    sight = LineOnSurface(follower, aside, SightSettings(), (0.0, 0.5))
    pose = follower.history.pose(0.03)
    eye = pose.act(aside.translation)
    frames = follower.reference.frames(np.array([0.05, 0.09]))
    true = frames.position + 0.002 * frames.normal + 0.006 * frames.up
    values, directions = [], []
    for error in (0.0, 0.01):
        # The same rays, cut at a wrong height.
        ray = true - eye
        cut = true + ray * (error / np.sum(ray * frames.up, axis=1))[:, None]
        measurement = sight._measurement(0.03, (cut - pose.translation) @ pose.rotation, np.full(2, 5e-5))
        assert measurement.direction is not None
        values.append(measurement.value)
        directions.append(measurement.direction)
    assert np.min(np.abs(directions[0][:, 1])) > 0.3
    sunk = follower.settings.force / follower.settings.elasticity
    expected = 0.002 + directions[0][:, 1] * (0.006 - sunk)
    np.testing.assert_allclose(values[0], expected, atol=2e-5)
    np.testing.assert_allclose(values[1], values[0], atol=2e-5)


def test_a_camera_turned_about_itself_moves_what_it_sees_about_itself(follower: SurfaceFollower) -> None:
    """Taken for turned about the TCP, it leaves the line off by the angle times the camera's distance ahead."""
    mount, right = default_mount(), field(follower, 0.03, 0.002).points_tcp
    sight = LineOnSurface(follower, mount, SightSettings(), (0.0, 0.5))
    turned = mount.translation + (right - mount.translation) @ pin.exp3(np.array([0.0, 0.0, -1e-3])).T
    unturned, other = (sight._measurement(0.03, points, np.full(5, 5e-5)) for points in (right, turned))
    np.testing.assert_allclose(other.value - unturned.value, 1e-3 * np.asarray(unturned.bias)[:, 0], atol=2e-6)


def test_approach_ends_with_touch_and_travel_begins_when_the_force_has_settled(follower: SurfaceFollower) -> None:
    up = follower.history.pose(0.03).rotation.T @ np.array([0.0, 0.0, 1.0])
    assert follower.phase is Phase.APPROACH
    assert fused(follower, np.array([0.03]), 1.0 * up[None]) is None
    assert follower.phase is Phase.APPROACH
    for k in range(6, 40):
        t = 0.012 * k
        follower.observe(t, follower.q_start)
        fused(follower, np.array([t - 0.02]), 20.0 * up[None])
        q_d = follower.horizon(t)
        assert q_d.shape == (20, 6)
    assert follower.phase is Phase.TRAVEL
    assert np.isfinite(follower.t_travel)
    # The touch says where the surface is: the right force, so no deviation from where the tip is.
    deviation, _ = follower.fusion.deviation(np.zeros(1))
    assert deviation[0, 1] == pytest.approx(0.01, abs=5e-4)


def test_the_map_shows_the_surface_that_was_felt() -> None:
    """A bump of 3 mm and a step of 1 mm, as no sum of waves: the force enters the filter all along the way."""
    def surface(s: np.ndarray) -> np.ndarray:
        return 3e-3 * np.exp(-(((s - 0.2) / 0.04) ** 2)) + 1e-3 / (1.0 + np.exp(-(s - 0.35) / 0.01))

    job = pressed(surface)
    assert job.force.min() > 10.0
    off = (job.map - (surface(job.s) - 20.0 / 5000.0))[job.s > 0.05]
    assert np.abs(off).max() < 1.5e-4
    assert np.all(np.abs(off) < 3.0 * job.sigma[job.s > 0.05])


def test_the_filter_is_what_keeps_the_force(monkeypatch: pytest.MonkeyPatch) -> None:
    """With forces kept out of it from 50 mm on, the tip goes straight on."""
    def surface(s: np.ndarray) -> np.ndarray:
        return 3e-3 * np.exp(-(((s - 0.2) / 0.04) ** 2))

    filtered = pressed(surface)
    inner = FilterBank.update

    def update(self: FilterBank, measurement: Measurement) -> Fused:
        if measurement.s[0] < 0.05:
            return inner(self, measurement)
        return Fused(np.zeros(1, dtype=bool), np.zeros(1), 0.0, 0)

    monkeypatch.setattr(FilterBank, "update", update)
    without = pressed(surface)
    rms, left_out = (np.sqrt(np.mean((run.force - 20.0) ** 2)) for run in (filtered, without))
    assert rms < 1.0
    assert left_out > 4.0


def test_the_expected_torques_do_the_work_of_the_wanted_force(follower: SurfaceFollower) -> None:
    """τ_d of [L] 2.2: τ_dᵀ δq = Fᵀ δx for any small motion, as long as there is contact, and none before."""
    q_d, fk = np.tile(follower.q_start, (20, 1)), follower.robot.fk()
    assert not follower.contact_torque(q_d).any()
    up = follower.history.pose(0.03).rotation.T @ np.array([0.0, 0.0, 1.0])
    fused(follower, np.array([0.03]), 20.0 * up[None])
    torque = follower.contact_torque(q_d)
    assert torque.shape == q_d.shape
    for joint in range(6):
        step = 1e-6 * np.eye(6)[joint]
        raised = (fk(q_d[0] + step).translation - fk(q_d[0] - step).translation)[2]
        np.testing.assert_allclose(torque[:, joint] * 2e-6, 20.0 * raised, atol=1e-10)


@pytest.mark.parametrize(("k_p", "k_d"), [(2e-5, 0.0), (0.0, 5e-5), (1e-5, 4e-5)])
def test_direct_force_feedback_follows_its_law(follower: SurfaceFollower, k_p: float, k_d: float) -> None:
    """[L] (1): the command rises by K_p Δs in every cycle, and by K_d times what Δs has changed by."""
    feedback, fk = DirectForceFeedback(follower, k_p, k_d), follower.robot.fk()
    up = follower.history.pose(0.03).rotation.T @ np.array([0.0, 0.0, 1.0])
    fused(follower, np.array([0.03]), 20.0 * up[None])
    error, heights = np.array([0.0, 4.0, 4.0, -3.0, -3.0, 8.0]), []
    for excess in error:
        feedback.update(follower.settings.force + excess)
        heights.append(fk(feedback.command(0.06, np.tile(follower.q_start, (20, 1)))).translation[2])
    np.testing.assert_allclose(np.diff(heights), (k_p * error + k_d * np.diff(error, prepend=0.0))[1:], atol=1e-7)


# The surface as a Gaussian process.

NOISE = 3e-5
STEP = 0.0024


@pytest.mark.parametrize("length", [0.03, 0.1])
def test_the_states_are_those_of_materns_kernel(length: float) -> None:
    """Covariance of two heights, against the kernel's formula with Bessel's function; Rasmussen and Williams (4.14)."""
    model = SmoothSurface(length)
    P, nu = model.prior()[1][2:, 2:], ORDER + 0.5
    for distance in (0.001, 0.01, 0.05):
        r = np.sqrt(2 * nu) * distance / length
        expected = P[0, 0] * 2 ** (1 - nu) / gamma(nu) * r**nu * kv(nu, r)
        F, Q = model.carry(distance)
        assert (F[2:, 2:] @ P)[0, 0] == pytest.approx(expected, rel=1e-6)
        np.testing.assert_allclose(F[2:, 2:] @ P @ F[2:, 2:].T + Q[2:, 2:], P, rtol=1e-9, atol=1e-9 * P.max())
        assert model.spread(np.array([distance]), Stand())[0, 1] == pytest.approx(Q[2, 2], abs=1e-12 * P[0, 0])


def test_a_way_is_the_sum_of_its_parts() -> None:
    model = SmoothSurface(0.05)
    (F, Q), (F_1, Q_1), (F_2, Q_2) = (model.carry(distance) for distance in (0.03, 0.01, 0.02))
    np.testing.assert_allclose(F, F_2 @ F_1, atol=1e-9)
    np.testing.assert_allclose(Q, F_2 @ Q_1 @ F_2.T + Q_2, atol=1e-12)


def felt_at(k: int, height: float, **more: object) -> Measurement:
    s = STEP * k
    return Measurement(0.012 * k, np.array([s]), np.array([height]), np.array([[NOISE**2]]), np.array([[0.0, 1.0]]),
                       "force", at=s, **more)  # type: ignore[arg-type]


def bump(s: float) -> float:
    return 2e-3 * float(np.exp(-0.5 * ((s - 0.3) / 0.04) ** 2))


@given(st.permutations(range(8)))
@settings(max_examples=20, deadline=None)
def test_forces_that_come_late_and_in_any_order_say_the_same(order: list[int]) -> None:
    """Also where the map across the path has travelled on meanwhile."""
    x = np.linspace(0.0, 0.5, 100)
    reference = ReferencePath(np.column_stack([x, 0 * x, 0 * x]))

    def filled(which: list[int], travelled: float) -> DeviationFilter:
        fusion = DeviationFilter(SmoothSurface(0.065, PathDeviation(reference, ahead=0.2)), confirm=0)
        for k in range(100, 104):
            fusion.travel(STEP * k)
            fusion.update(felt_at(k, bump(STEP * k)))
        fusion.travel(travelled)
        for k in which:
            fusion.update(felt_at(104 + k, bump(STEP * (104 + k))))
        return fusion

    ahead = np.array([0.28, 0.3])
    late, straight = filled(order, STEP * 112 + 0.03), filled(sorted(order), STEP * 112 + 0.03)
    for shuffled, ordered in zip(late.deviation(ahead), straight.deviation(ahead), strict=True):
        np.testing.assert_allclose(shuffled, ordered, rtol=1e-6, atol=1e-12)


def test_what_lies_ahead_may_be_seen_late() -> None:
    """Markov: places ahead depend on those behind by the state alone, so nothing is lost by not going back."""
    def map_with(t: float) -> DeviationFilter:
        surface = DeviationFilter(SmoothSurface(0.065), biases={"force": ()})
        for k in range(40):
            surface.update(felt_at(k, bump(STEP * k)))
        ahead = np.array([STEP * 39 + 0.02])
        surface.update(Measurement(t, ahead, bump(ahead[0]) * np.ones(1), np.array([[NOISE**2]]),
                                   np.array([[0.0, 1.0]]), "camera", at=STEP * 30))
        return surface

    s = STEP * 39 + np.linspace(0.0, 0.04, 5)
    for late, in_time in zip(map_with(0.012 * 30).deviation(s), map_with(0.012 * 39).deviation(s), strict=True):
        np.testing.assert_array_equal(late, in_time)


def test_a_bank_finds_the_length_scale_and_says_how_sure_the_height_ahead_is() -> None:
    rng = np.random.default_rng(5)
    model, picked, off, stated = SmoothSurface(0.045), [], [], []
    root = np.linalg.cholesky(model.prior()[1][2:, 2:] + 1e-16 * np.eye(ORDER + 1))
    F, Q = model.carry(STEP)
    value, vector = np.linalg.eigh(Q[2:, 2:])
    driven, x = vector * np.sqrt(np.maximum(value, 0.0)), root @ rng.standard_normal(ORDER + 1)
    heights = []
    for _ in range(400):
        heights.append(x[0])
        x = F[2:, 2:] @ x + driven @ rng.standard_normal(ORDER + 1)
    bank = FilterBank([DeviationFilter(surface, confirm=0) for surface in surfaces(lengths=(0.02, 0.045, 0.15))])
    for k in range(395):
        bank.update(felt_at(k, heights[k] + NOISE * rng.standard_normal()))
        mean, variance = bank.deviation(np.array([STEP * (k + 5)]))
        picked.append(bank.members.index(bank.likeliest))
        off.append(mean[0, 1] - heights[k + 5])
        stated.append(variance[0, 1])
    assert np.bincount(picked[100:]).argmax() == 1
    assert np.sqrt(np.mean(np.square(off[100:]) / stated[100:])) == pytest.approx(1.0, abs=0.3)


def test_a_wrong_stiffness_is_found_and_noise_is_not_taken_for_one() -> None:
    """The distance that the ratio counts for is the state's: the value felt has the noise in it."""
    errors = []
    for ratio, seed in itertools.product((0.0, -0.3, 0.4), range(10)):
        rng = np.random.default_rng(seed)
        fusion = DeviationFilter(SmoothSurface(0.065), biases={"force": (0.3,)}, confirm=0)
        for k in range(220):
            height = bump(STEP * k)
            origin = height + 1.5e-4 * np.sin(0.4 * k)
            value = origin + np.exp(ratio) * (height - origin) + 2 * NOISE * rng.standard_normal()
            fusion.update(felt_at(k, value, bias=np.zeros((1, 1)), origin=np.array([origin])))
        estimate, sigma = fusion.bias("force")
        errors.append(abs(estimate[0] - ratio))
        assert sigma[0] < 0.06
    # About its estimate the equation is linear only nearly, and some noise leads an extended filter astray: linearised
    # alone, without what the second order leaves, it does in one of three.
    assert np.median(errors) < 0.08
    assert np.mean(np.array(errors) > 0.3) < 0.2


def test_a_tip_at_rest_says_where_it_is_and_nothing_else() -> None:
    bank = surface_filter((0.3, 0.002, 0.3))
    for k in range(40):
        bank.update(Measurement(0.012 * k, np.zeros(1), np.array([0.003]), np.array([[NOISE**2]]),
                                np.array([[0.0, 1.0]]), "force", np.zeros((1, 3)), at=0.0))
    np.testing.assert_allclose(bank.mean(np.array([0.0, 0.005]))[:, 1], 0.003, atol=2e-4)


def test_what_friction_hides_as_the_tip_begins_to_slide_is_no_slope() -> None:
    """Level ground; from the first tenth of a millimetre on friction makes it look 90 µm lower."""
    banks = surface_filter((0.3, 0.002, 1e-6)), surface_filter((0.3, 0.002, 0.3))
    for k in range(60):
        s = max(0.0, 1e-4 * (k - 30))
        slides = 3e-4 * -np.expm1(-s / 1e-4)
        for bank in banks:
            bank.update(Measurement(0.012 * k, np.array([s]), np.array([-0.3 * slides]), np.array([[1.2e-5**2]]),
                                    np.array([[0.0, 1.0]]), "force", np.array([[0.0, 0.0, slides]]), at=s))
    without, with_friction = (abs(float(bank.mean(np.array([0.008]))[0, 1])) for bank in banks)
    assert with_friction < 0.5 * without


def test_lifting_is_planned_ahead_at_its_speed(follower: SurfaceFollower) -> None:
    follower.phase, follower._t_lift, follower._lift_from, follower._contact_since = Phase.LIFT, 1.0, np.zeros(2), 0.5
    rows = np.zeros(follower._plan.samples, dtype=int)
    T = follower.robot.t_ipo
    rise = follower._estimate(1.0, 1, rows)[:, 1]
    np.testing.assert_allclose(rise, np.minimum(0.05 * T * (2 + np.arange(len(rise))), follower.settings.lift))


def test_a_force_that_rises_never_says_that_the_surface_recedes() -> None:
    """For half a second the force follows the tip's way the wrong way round, as gears that wind up make it; then the
    surface comes up under the tip, which goes down. With a stiffness that could be below zero half of the maps went
    down, too."""
    beside = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        bank, rest, turned = surface_filter((0.3, 5e-4, 0.3)), int(rng.integers(40, 80)), rng.uniform(1.5, 3.0)
        pace = rng.uniform(0.2, 0.8)
        for k in range(rest + 60):
            s = max(0.0, 2.4e-4 * (k - rest))
            height = 0.15 * s
            origin = height + (2e-5 * np.sin(pace * k) if k < rest else -1.5e-6 * (k - rest))
            ratio = 1.0 - turned if k < rest else 1.5
            value = origin + ratio * (height - origin) + 2e-6 * rng.standard_normal()
            bank.update(Measurement(0.012 * k, np.array([s]), np.array([value]), np.array([[6e-6**2]]),
                                    np.array([[0.0, 1.0]]), "force", np.zeros((1, 3)), origin=np.array([origin]), at=s))
        beside.append(float(bank.mean(np.array([s]))[0, 1]) < origin)
    assert np.mean(beside) <= 0.1
