"""The law of all commands: whatever is asked for, every limit is kept, and what keeps them passes unchanged."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.execution.command_governor import ACCELERATION, CommandGovernor
from ideal_robot.feedforward.method import Needs
from ideal_robot.feedforward.registry import feedforward, methods
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import SHIPPED, Robot
from scenes.models import shipped_model

ROBOT = Robot.load("kr6")


def _largest(robot: Robot, p: Array, jerk: Array) -> dict[str, float]:
    """How far a path of commands goes, as a share of each limit."""
    T = robot.t_ipo
    v = np.diff(p, axis=0) / T
    a = np.diff(v, axis=0) / T
    j = np.diff(a, axis=0) / T
    middle, half = 0.5 * (robot.q_max + robot.q_min), 0.5 * (robot.q_max - robot.q_min)
    return {"position": float(np.max(np.abs(p - middle) / half)), "speed": float(np.max(np.abs(v) / robot.v_max)),
            "acceleration": float(np.max(np.abs(a) / (ACCELERATION * robot.a_max))),
            "jerk": float(np.max(np.abs(j) / jerk))}


def _asked(kind: str, rng: np.random.Generator, robot: Robot, last: Array) -> Array:
    if kind == "jumps":
        return rng.uniform(3.0 * robot.q_min, 3.0 * robot.q_max)
    if kind == "walk":
        return np.asarray(last + rng.normal(size=robot.n) * robot.v_max * robot.t_ipo)
    if kind == "nan":
        return np.where(rng.random(robot.n) < 0.3, np.nan, rng.uniform(robot.q_min, robot.q_max))
    return np.full(robot.n, rng.choice([np.inf, -np.inf, 1e300, -1e300, 0.0]))


@pytest.mark.parametrize("name", SHIPPED)
@pytest.mark.parametrize("kind", ["jumps", "walk", "nan", "huge"])
@pytest.mark.parametrize("smooth", [False, True])
def test_every_limit_is_kept_under_any_input(name: str, kind: str, smooth: bool) -> None:
    robot, rng = Robot.load(name), np.random.default_rng(1)
    acceleration = np.where(np.isfinite(robot.a_max), robot.a_max, 1e3)
    jerk = (60.0 if smooth else 2.0 * ACCELERATION / robot.t_ipo) * acceleration
    start = 0.5 * (robot.q_min + robot.q_max)
    governor = CommandGovernor(robot, start, j_max=jerk)
    path = [start] * 3
    for _ in range(1500):
        path.append(governor.allowed(_asked(kind, rng, robot, path[-1])))
    found = _largest(robot, np.array(path), jerk)
    if not np.isfinite(robot.a_max).all():
        del found["acceleration"]
    assert max(found.values()) <= 1.0 + 1e-6, found
    # What cannot be reached does not stop the arm from moving.
    assert kind == "nan" or np.ptp(np.array(path), axis=0).max() > 0.1


@settings(max_examples=60)
@given(st.lists(st.floats(-0.6, 0.6), min_size=6, max_size=6), st.floats(0.3, 3.0))
def test_what_keeps_the_limits_passes_bit_by_bit(amplitude: list[float], pace: float) -> None:
    start = ROBOT.home
    governor = CommandGovernor(ROBOT, start)
    s = np.clip(np.arange(300) / 250.0, 0.0, 1.0)
    path = start + 0.5 * np.outer(s**3 * (10 - 15 * s + 6 * s**2), amplitude) * min(pace, 1.0)
    for q in path:
        np.testing.assert_array_equal(governor.allowed(q), q)


def test_the_arm_rests_at_its_position_limit_when_driven_beyond() -> None:
    governor = CommandGovernor(ROBOT, ROBOT.home)
    for _ in range(2000):
        last = governor.allowed(2.0 * ROBOT.q_max)
    np.testing.assert_allclose(last, ROBOT.q_max, atol=1e-3)


def test_a_start_outside_the_limits_is_refused() -> None:
    with pytest.raises(InputError, match="within the joint limits"):
        CommandGovernor(ROBOT, 2.0 * ROBOT.q_max)


@pytest.mark.parametrize("key", methods(Needs.MODEL))
def test_every_feedforward_behind_it_keeps_the_limits(key: str) -> None:
    """Horizons that jump, end, and hold NaN; the feedforward may answer anything."""
    law, rng = feedforward(key, Model.load(shipped_model("kr6")), ROBOT, n_d=10), np.random.default_rng(3)
    governor = CommandGovernor(ROBOT, ROBOT.home)
    state, path = law.init(ROBOT.home), [ROBOT.home] * 3
    horizon = np.tile(ROBOT.home, (10, 1))
    for k in range(400):
        if k % 20 == 0:
            horizon = np.tile(rng.uniform(ROBOT.q_min, ROBOT.q_max), (10, 1))
        if k % 97 == 50:
            horizon = np.full((10, 6), np.nan)
        try:
            with np.errstate(all="ignore"):
                q_c, after = law.step(state, horizon)
        except InputError:
            # Refused by the feedforward itself: the arm brakes.
            q_c, after = np.full(6, np.nan), state
        if np.isfinite(q_c).all():
            state = after
        path.append(governor.allowed(q_c))
    found = _largest(ROBOT, np.array(path), 2.0 * ACCELERATION * ROBOT.a_max / ROBOT.t_ipo)
    assert max(found.values()) <= 1.0 + 1e-6, found


def test_no_command_is_outside_a_position_limit_by_so_much_as_rounding() -> None:
    """An arm refuses such a command and stops at once; seen where braking ends at the limit."""
    rng, governor = np.random.default_rng(5), CommandGovernor(ROBOT, ROBOT.home)
    goal = np.where(rng.random(ROBOT.n) < 0.5, ROBOT.q_min, ROBOT.q_max)
    for k in range(3000):
        if k % 150 == 0:
            goal = np.where(rng.random(ROBOT.n) < 0.5, ROBOT.q_min - 0.1, ROBOT.q_max + 0.1)
        command = governor.allowed(goal + 1e-3 * rng.normal(size=ROBOT.n))
        assert np.all((command >= ROBOT.q_min) & (command <= ROBOT.q_max))
