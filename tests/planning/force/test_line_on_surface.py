"""What a camera field and a force say of the deviation, without simulation: geometry, doubts, phases."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
import pytest

from ideal_robot.robots.robot import Robot
from planning.force.contact import ContactSettings, Phase, surface_model
from planning.force.force_follower import SurfaceFollower
from planning.force.line_on_surface import LineOnSurface, SightSettings
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


@pytest.fixture
def follower() -> SurfaceFollower:
    """Above a straight reference of 0.5 m along the base's y, resting at its start."""
    robot = Robot.load("kr6")
    x = np.linspace(0.0, 0.5, 300)
    reference = ReferencePath(np.column_stack([np.full(300, 0.98), x - 0.25, np.full(300, 0.35)]), turning=1.0)
    profile = SpeedProfile.plan(robot, reference, 0.2)
    biases = {"camera": (0.003, 0.0005, 1e-6), "force": (0.3, 0.002)}
    fusion = DeviationFilter(surface_model(reference, 0.3), biases=biases)
    made = SurfaceFollower(robot, reference, profile, 20, ContactSettings(), fusion=fusion, lateral=True)
    for k in range(6):
        made.observe(0.012 * k, made.q_start)
    return made


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
