"""Tool paths: figures, timing and orientation."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from ideal_robot.errors import InputError
from scenes.path.shapes import shape_of
from scenes.path.tool_path import Arc, Line, Shape, duration, tool_path, travel

CYCLE = 0.012


@pytest.mark.parametrize("name", ["iso9283", "triangle", "circle", "edge"])
def test_speed_and_acceleration_stay_within_what_was_asked(name):
    path = tool_path(shape_of(name, 0.3), pin.SE3.Identity(), 0.4, 3.0, CYCLE)
    x = path.positions
    speed = np.linalg.norm(np.diff(x, axis=0), axis=1) / CYCLE
    assert speed.max() <= 0.4 + 1e-9
    assert path.speed.max() <= 0.4 + 1e-9
    # Along the path 3 m/s²; on arcs the centripetal part comes on top (smallest radius 30 mm of the edge).
    along = np.abs(np.diff(path.speed)) / CYCLE
    assert along.max() <= 3.0 + 1e-6


def test_figures_close_and_have_their_size():
    for name in ("iso9283", "triangle", "circle"):
        x = tool_path(shape_of(name, 0.4), pin.SE3.Identity(), 0.5, 3.0, CYCLE).positions
        assert np.linalg.norm(x[0] - x[-1]) < 1e-5
    circle = tool_path(shape_of("circle", 0.32), pin.SE3.Identity(), 0.63, 3.0, CYCLE).positions
    np.testing.assert_allclose(np.linalg.norm(circle, axis=1), 0.16, atol=1e-9)
    iso = tool_path(shape_of("iso9283", 0.4), pin.SE3.Identity(), 0.5, 3.0, CYCLE).positions
    np.testing.assert_allclose(np.ptp(iso, axis=0)[:2], 0.4, atol=1e-4)


def test_the_tool_stops_at_corners_and_nowhere_else():
    path = tool_path(shape_of("triangle", 0.3), pin.SE3.Identity(), 0.4, 3.0, CYCLE)
    slow = path.speed < 0.02
    starts = np.flatnonzero(np.diff(slow.astype(int)) == -1)
    assert len(starts) == 3
    circle = tool_path(shape_of("circle", 0.3), pin.SE3.Identity(), 0.4, 3.0, CYCLE)
    assert np.all(circle.speed[10:-10] > 0.1)


@pytest.mark.parametrize("degrees", [0.2, 2.0, 15.0, 90.0])
def test_no_corner_is_too_flat_to_stop_at(degrees):
    """Driven through, a corner asks for any acceleration; where pieces meet in a tangent it is that of the curve."""
    turn = np.radians(degrees)
    line, angle = Line((0.3, 0.0)), Line((0.3 + 0.3 * np.cos(turn), 0.3 * np.sin(turn)))
    arc = Arc((0.3, 0.5), turn)
    sharp, smooth = (tool_path(Shape((0.0, 0.0), (line, last)), pin.SE3.Identity(), 0.4, 3.0, CYCLE)
                     for last in (angle, arc))
    at_corner = [path.speed[np.argmin(np.linalg.norm(path.positions[:, :2] - (0.3, 0.0), axis=1))]
                 for path in (sharp, smooth)]
    assert at_corner[0] < 0.05
    if 0.5 * turn > 0.05:
        assert at_corner[1] > 0.3


@pytest.mark.parametrize(("length", "speed"), [(0.4, 0.5), (0.02, 0.5), (0.1, 0.02)])
def test_travel_gets_there_in_its_time(length, speed):
    time = duration(length, speed, 3.0)
    t = np.linspace(0, time, 40001)
    s, v = travel(length, speed, 3.0, t)
    assert s[0] == 0.0
    assert s[-1] == pytest.approx(length, abs=1e-9)
    np.testing.assert_allclose(np.gradient(s, t)[2:-2], v[2:-2], atol=2e-3 * speed)


def test_orientation_turns_by_the_angle():
    path = tool_path(shape_of("edge", 0.02), pin.SE3.Identity(), 0.02, 0.1, CYCLE, turn=((0.0, 0.0, 1.0), np.pi / 2))
    turned = path.poses[-1].rotation @ path.poses[0].rotation.T
    np.testing.assert_allclose(pin.log3(turned), [0, 0, np.pi / 2], atol=1e-4)


def test_pieces_without_length_are_refused():
    with pytest.raises(InputError, match="no length"):
        tool_path(Shape((0.0, 0.0), (Line((0.0, 0.0)),)), pin.SE3.Identity(), 0.1, 1.0, CYCLE)


def test_a_speed_that_is_never_reached_is_refused():
    with pytest.raises(InputError, match="too short for this speed"):
        tool_path(shape_of("circle", 0.3), pin.SE3.Identity(), 5.0, 3.0, CYCLE)


def test_a_path_that_would_last_for_years_is_refused_before_it_is_made():
    with pytest.raises(InputError, match="would last"):
        tool_path(shape_of("circle", 0.06), pin.SE3.Identity(), 3e-10, 3.0, CYCLE)
