"""A URDF in other units is the same arm: what cannot be is converted, told, and nothing else is touched."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from ideal_robot.robots.robot import Robot
from ideal_robot.robots.size import of_its_size
from ideal_robot.robots.units import in_si
from tests.arms import urdf, written

LIMIT = 'lower="-2.9" upper="2.6" effort="300" velocity="3"'
TEXT = urdf(6, mass=5.0, limit=LIMIT)


def scaled(text: str, keys: str, factor: float, only: Callable[[int], bool] = lambda _: True) -> str:
    """The text with the numbers of some attributes multiplied, in those places for which ``only`` holds."""
    places = iter(range(10**6))

    def times(found: re.Match[str]) -> str:
        numbers = [float(word) * (factor if only(place) else 1.0) for word in found.group(2).split()]
        return f'{found.group(1)}="{" ".join(f"{number:.15g}" for number in numbers)}"'

    def counted(found: re.Match[str]) -> str:
        nonlocal place
        place = next(places)
        return times(found)

    place = 0
    return re.sub(rf'\b({keys})="([^"]*)"', counted, text)


def same(one: Robot, other: Robot) -> None:
    """Two arms have the same kinematics, limits and masses."""
    for key in ("q_min", "q_max", "v_max", "tau_max"):
        np.testing.assert_allclose(getattr(one, key), getattr(other, key), rtol=1e-9)
    for mine, yours in zip(one.pinocchio.inertias, other.pinocchio.inertias, strict=True):
        assert mine.mass == pytest.approx(yours.mass)
        np.testing.assert_allclose(mine.inertia, yours.inertia, rtol=1e-6, atol=1e-9)
    q = np.linspace(-0.7, 0.9, one.n)
    np.testing.assert_allclose(one.fk()(q).homogeneous, other.fk()(q).homogeneous, atol=1e-9)


DEGREES = 180.0 / math.pi


@pytest.mark.parametrize(("keys", "factor", "says"), [
    ("xyz", 1e3, "millimetres"), ("xyz", 1e2, "centimetres"), ("lower|upper", DEGREES, "degrees, times"),
    ("velocity", DEGREES, "degrees a second"), ("value", 1e3, "grams"), ("ixx|iyy|izz|ixy|ixz|iyz", 1e6, "kg mm²")])
def test_another_unit_is_converted_and_told(keys: str, factor: float, says: str, tmp_path: Path) -> None:
    text = TEXT
    if keys == "xyz":  # axes are directions and stay
        text = re.sub(r'<axis xyz="([^"]*)"', r'<axis way="\1"', text)
    if keys.startswith("ixx"):  # links that differ, as an arm's do
        for link in range(6):
            text = scaled(text, "ixx|iyy|izz", 1.0 + 0.1 * link, lambda place, link=link: place // 3 == link)
    altered = scaled(text, keys, factor).replace("axis way", "axis xyz")
    robot = Robot.load(written(tmp_path, altered, "altered"))
    same(robot, Robot.load(written(tmp_path, text.replace("axis way", "axis xyz"), "plain")))
    assert any(says in note for note in robot.assumed)


@pytest.mark.parametrize("joint", range(6))
def test_one_joint_in_degrees_is_found_where_it_is(joint: int, tmp_path: Path) -> None:
    altered = scaled(TEXT, "lower|upper", DEGREES, lambda place: place // 2 == joint)
    robot = Robot.load(written(tmp_path, altered))
    same(robot, Robot.load(written(tmp_path, TEXT, "plain")))
    assert [f"joint_{joint + 1} " in note for note in robot.assumed] == [True]


def test_what_people_have_is_left_alone() -> None:
    for wide, fast, mass in ((6.28, 3.0, 5.0), (7.0, 25.0, 12.0), (2.0, 1.5, 1.5), (12.5, 0.5, 5.0)):
        limit = f'lower="{-wide}" upper="{wide}" effort="300" velocity="{fast}"'
        assert in_si(urdf(6, mass=mass, limit=limit))[1] == ()
        assert in_si(urdf(6, limit=limit))[1] == ()


def test_a_limit_that_stands_for_none_is_one_turn(tmp_path: Path) -> None:
    altered = scaled(TEXT, "lower|upper", 1e7, lambda place: place // 2 == 5)
    robot = Robot.load(written(tmp_path, altered))
    np.testing.assert_allclose([robot.q_min[5], robot.q_max[5]], [-2 * np.pi, 2 * np.pi])


@pytest.mark.parametrize("joints", [(0,), (5,), (0, 3, 5), tuple(range(6))])
def test_placeholder_efforts_are_replaced_also_where_gravity_asks_for_none(joints: tuple[int, ...],
                                                                          tmp_path: Path) -> None:
    numbers = iter(range(6))
    altered = re.sub('effort="300"', lambda _: f'effort="{0.5 if next(numbers) in joints else 300}"', TEXT)
    robot = of_its_size(Robot.load(written(tmp_path, altered)))
    replaced = robot.tau_max != 300.0
    assert set(np.flatnonzero(replaced)) >= set(joints)
    assert (robot.tau_max > 5.0).all()
    assert f"no effort of joint{'s' if replaced.sum() > 1 else ''} {joints[0] + 1}" in " ".join(robot.assumed)
