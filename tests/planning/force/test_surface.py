"""What a camera field and a force say of the deviation, without simulation: geometry, doubts, phases."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
import pytest

from ideal_robot.arrays import Array
from ideal_robot.robots.robot import Robot
from planning.force import surface_forecast
from planning.force.contact import ContactSettings, Phase, surface_model
from planning.force.force_follower import DirectForceFeedback, SurfaceFollower
from planning.force.line_on_surface import LineOnSurface, SightSettings
from planning.force.surface_forecast import (
    BETTER,
    LENGTH,
    MOST_WAVES,
    ROTATION,
    ROUGHEST,
    SurfaceForecast,
    likelier_variances,
)
from planning.line.deviation_model import matern
from planning.line.fusion import DeviationFilter
from planning.path.reference import ReferencePath
from planning.path.speed_profile import SpeedProfile
from sensing.camera.camera_model import default_mount


@dataclass
class Seen:
    t: float
    points_tcp: np.ndarray
    sigma: np.ndarray
    used: np.ndarray
    seen: bool = True


def above_the_surface(**camera: Any) -> SurfaceFollower:
    """Above a straight reference of 0.5 m along the base's y, resting at its start."""
    robot = Robot.load("kr6")
    x = np.linspace(0.0, 0.5, 300)
    reference = ReferencePath(np.column_stack([np.full(300, 0.98), x - 0.25, np.full(300, 0.35)]), turning=1.0)
    profile = SpeedProfile.plan(robot, reference, 0.2)
    biases = {"camera": (0.003, 0.0005, 1e-6), "force": (0.3, 0.002)}
    fusion = DeviationFilter(surface_model(reference, 0.3), biases=biases)
    made = SurfaceFollower(robot, reference, profile, 20, ContactSettings(), fusion=fusion, **camera)
    for k in range(6):
        made.observe(0.012 * k, made.q_start)
    return made


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
        follower.update_force(np.array([late[0]]), late[1][None])
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


def test_approach_ends_with_touch_and_travel_begins_when_the_force_has_settled(follower: SurfaceFollower) -> None:
    up = follower.history.pose(0.03).rotation.T @ np.array([0.0, 0.0, 1.0])
    assert follower.phase is Phase.APPROACH
    assert follower.update_force(np.array([0.03]), 1.0 * up[None]) is None
    assert follower.phase is Phase.APPROACH
    for k in range(6, 40):
        t = 0.012 * k
        follower.observe(t, follower.q_start)
        follower.update_force(np.array([t - 0.02]), 20.0 * up[None])
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


def test_the_expected_torques_do_the_work_of_the_wanted_force(follower: SurfaceFollower) -> None:
    """τ_d of [L] 2.2: τ_dᵀ δq = Fᵀ δx for any small motion, as long as there is contact, and none before."""
    q_d, fk = np.tile(follower.q_start, (20, 1)), follower.robot.fk()
    assert not follower.contact_torque(q_d).any()
    up = follower.history.pose(0.03).rotation.T @ np.array([0.0, 0.0, 1.0])
    follower.update_force(np.array([0.03]), 20.0 * up[None])
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
    follower.update_force(np.array([0.03]), 20.0 * up[None])
    error, heights = np.array([0.0, 4.0, 4.0, -3.0, -3.0, 8.0]), []
    for one in error:
        feedback.update(follower.settings.force + one)
        heights.append(fk(feedback.command(0.06, np.tile(follower.q_start, (20, 1)))).translation[2])
    np.testing.assert_allclose(np.diff(heights), (k_p * error + k_d * np.diff(error, prepend=0.0))[1:], atol=1e-7)


# The surface ahead of the tip: waves once felt go on, and one that has none is not continued worse.

STEP = 0.0024
AHEAD = 0.014
NOISE = 1.2e-5


def waves(s: Array) -> Array:
    return 4e-3 * np.sin(2 * np.pi * s / 0.26) + 1.5e-3 * np.sin(2 * np.pi * s / 0.14 + 1.2) + 0.01 * s + 0.004


def bump(s: Array) -> Array:
    return 0.3 * (s - 0.4) ** 2 + 1e-3 * np.exp(-(((s - 0.45) / 0.08) ** 2))


def errors(surface: Callable[[Array], Array], count: int = 240) -> tuple[Array, Array]:
    """Errors 14 mm ahead of the forecast, and of a prior that knows smoothness alone."""
    s = STEP * np.arange(count)
    felt = surface(s) + NOISE * np.random.default_rng(3).standard_normal(count)
    forecast = SurfaceForecast((0.3, 0.002))
    ours, smooth = np.zeros(count), np.zeros(count)
    for n in range(count):
        forecast.add(float(s[n]), float(felt[n]), NOISE**2, np.zeros(2))
        x, here = s[n : n + 1] + AHEAD, s[max(0, n - 120) : n + 1]
        ours[n] = forecast.height(x)[0] - surface(x)[0]
        away = here - here[-1]
        K = 0.02**2 + ROTATION**2 * np.outer(away, away) + NOISE**2 * np.eye(len(here))
        K += ROUGHEST**2 * matern(np.abs(here[:, None] - here), LENGTH)
        cross = 0.02**2 + ROTATION**2 * AHEAD * away + ROUGHEST**2 * matern(np.abs(x - here), LENGTH)
        smooth[n] = cross @ np.linalg.solve(K, felt[max(0, n - 120) : n + 1]) - surface(x)[0]
    return ours, smooth


@pytest.mark.parametrize(("surface", "share"), [(waves, 0.4), (bump, 0.6)])
def test_what_was_felt_is_continued_better_than_by_smoothness_alone(
    surface: Callable[[Array], Array], share: float
) -> None:
    ours, smooth = errors(surface)
    later = slice(120, None)
    assert np.sqrt(np.mean(ours[later] ** 2)) < share * np.sqrt(np.mean(smooth[later] ** 2))


def test_a_tip_at_rest_says_where_it_is_and_nothing_else() -> None:
    forecast = SurfaceForecast((0.3, 0.002))
    for _ in range(40):
        forecast.add(0.0, 0.003, NOISE**2, np.zeros(2))
    np.testing.assert_allclose(forecast.height(np.array([0.0, 0.005])), 0.003, atol=2e-4)


def test_what_friction_hides_as_the_tip_begins_to_slide_is_no_slope() -> None:
    """Level ground; from the first tenth of a millimetre on friction makes it look 90 µm lower."""
    forecasts = SurfaceForecast((0.3, 0.002)), SurfaceForecast((0.3, 0.002, 0.3))
    for k in range(60):
        s = max(0.0, 1e-4 * (k - 30))
        slides = 3e-4 * -np.expm1(-s / 1e-4)
        for forecast, wrong in zip(forecasts, ([0.0, 0.0], [0.0, 0.0, slides]), strict=True):
            forecast.add(s, -0.3 * slides, NOISE**2, np.array(wrong))
    without, told = (abs(float(one.height(np.array([0.008]))[0])) for one in forecasts)
    assert told < 0.5 * without


# Variances of waves: the same as with a likelihood that is computed anew for each change.

WAVELENGTHS = 1.0 / np.linspace(1.0 / 0.8, 1.0 / 0.08, 40)
LARGEST = 1e-4


def wave_columns(s: Array) -> Array:
    phase = 2 * np.pi / WAVELENGTHS * s[:, None]
    return np.concatenate([np.cos(phase), np.sin(phase)], axis=1)


@dataclass(frozen=True)
class Felt:
    """Two waves with noise, and what a regression makes of them."""

    s: Array
    value: Array
    noise: float

    def covariance(self, gamma: Array) -> Array:
        return (wave_columns(self.s) * np.tile(gamma, 2)) @ wave_columns(self.s).T + self.noise**2 * np.eye(len(self.s))

    def likelihood(self, gamma: Array) -> float:
        K = self.covariance(gamma)
        return -0.5 * float(self.value @ np.linalg.solve(K, self.value) + np.linalg.slogdet(K)[1])

    def likelier(self, gamma: Array) -> Array:
        inverse = np.linalg.inv(self.covariance(gamma))
        return likelier_variances(gamma, wave_columns(self.s), inverse, inverse @ self.value, LARGEST)


@pytest.fixture(params=[1e-5, 1e-7], ids=["noise 10 µm", "noise 0.1 µm"])
def felt(request: pytest.FixtureRequest) -> Felt:
    s = np.linspace(0.0, 0.5, 60)
    value = 3e-3 * np.sin(2 * np.pi * s / WAVELENGTHS[11]) + 5e-4 * np.cos(2 * np.pi * s / WAVELENGTHS[22])
    return Felt(s, value + request.param * np.random.default_rng(1).standard_normal(len(s)), request.param)


def test_changes_without_a_new_inverse_are_those_with_one(
    felt: Felt, monkeypatch: pytest.MonkeyPatch
) -> None:
    start = np.full(len(WAVELENGTHS), 1e-8)
    together = felt.likelier(start)
    monkeypatch.setattr(surface_forecast, "MOST_WAVES", 1)
    alone = start
    for _ in range(MOST_WAVES):
        alone = felt.likelier(alone)
    assert np.count_nonzero(together != start) > 2
    np.testing.assert_allclose(together, alone, rtol=1e-3, atol=1e-14)


def test_each_change_gains_likelihood(felt: Felt, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(surface_forecast, "MOST_WAVES", 1)
    gamma = np.full(len(WAVELENGTHS), 1e-8)
    for _ in range(MOST_WAVES):
        changed = felt.likelier(gamma)
        if np.array_equal(changed, gamma):
            break
        assert felt.likelihood(changed) > felt.likelihood(gamma) + BETTER
        gamma = changed
