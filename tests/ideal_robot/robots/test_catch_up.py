"""What was missed is caught up under the arm's own limits of acceleration and jerk, at the controller."""

from __future__ import annotations

import numpy as np
import pytest

from ideal_robot.arrays import Array
from ideal_robot.robots.interface import CatchUp
from ideal_robot.robots.robot import Robot

ROBOT = Robot.load("kr6")
RISE = 0.03


def received(T: float, missed: tuple[int, ...], goes_on: bool) -> tuple[Array, Array]:
    """Wanted path, and what a controller has in force that holds, or goes on, where an answer is missed."""
    t = T * np.arange(round(6.0 / T))
    wanted = 0.5 * (1 - np.cos(1.3 * t))[:, None] * np.array([1.0, -0.6, 0.8, 1.0, -0.5, 0.3])
    wanted[t > 2 * np.pi / 1.3] = 0.0
    catch_up, at = CatchUp(ROBOT.a_max, ROBOT.v_max, T), [wanted[0], wanted[0]]
    gap = False
    for k in range(1, len(t)):
        step, before = wanted[k] - wanted[k - 1], wanted[k - 1] - wanted[max(k - 2, 0)]
        speed = at[-1] - at[-2]
        if k in missed:
            at.append(at[-1] + (speed if goes_on else 0.0))
            gap = True
            continue
        if gap:
            catch_up.start(at[-1] - wanted[k - 1], speed - step, before - step, before)
            gap = False
        at.append(wanted[k] + catch_up.next(step))
    return wanted, np.array(at[1:])


@pytest.mark.parametrize("T", [0.004, 0.012])
@pytest.mark.parametrize("goes_on", [False, True])
@pytest.mark.parametrize("missed", [(150,), (100, 101, 102, 103), tuple(range(60, 330, 9))])
def test_speed_acceleration_and_jerk_are_kept(T: float, goes_on: bool, missed: tuple[int, ...]) -> None:
    wanted, at = received(T, missed, goes_on)
    speed = np.diff(at, axis=0) / T
    bend = np.diff(speed, axis=0) / T
    jerk = np.diff(bend, axis=0) / T
    # That a controller holds the arm at once is its own doing; it shows in the differences about a missed cycle.
    held = np.zeros(len(at), dtype=bool)
    held[list(missed)] = not goes_on
    own = ~held[2:]
    usual = np.abs(np.diff(wanted, axis=0)).max(axis=0) / T
    assert (np.abs(bend[own]) <= 0.8 * ROBOT.a_max).all()
    assert (np.abs(jerk[own[1:] & own[:-1] & ~held[1:-2]]) <= 1.1 * 0.5 * ROBOT.a_max / RISE + 3.0).all()
    assert (np.abs(speed) <= 1.3 * usual + 0.05 * ROBOT.v_max + 1e-9).all()
    np.testing.assert_allclose(at[-1], wanted[-1], atol=1e-12)


def test_the_joints_keep_step() -> None:
    """Held and led back at constant speed, the arm stays on the straight line in joint space."""
    T, direction = 0.012, np.array([1.0, -0.6, 0.8, 1.0, -0.5, 0.3])
    catch_up, step = CatchUp(ROBOT.a_max, ROBOT.v_max, T), 0.6 * T * direction
    catch_up.start(-step, -step, np.zeros(6), step)
    offsets = np.array([catch_up.next(step) for _ in range(100)])
    along = np.outer(offsets @ direction, direction) / (direction @ direction)
    np.testing.assert_allclose(offsets, along, atol=1e-12)
