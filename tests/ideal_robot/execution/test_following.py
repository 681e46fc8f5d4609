"""An arm that does not go where its commands lead is noticed soon, and one that does is let go on."""

from __future__ import annotations

import dataclasses
import subprocess
import sys

import numpy as np
import pytest

from ideal_robot.arrays import Array, eased
from ideal_robot.execution.following import Following
from ideal_robot.robots.robot import Robot
from tests.sources import ROOT

ROBOT = Robot.load("kr6")
N = ROBOT.n


class Loop:
    """Joints with dead time and two lags, whose measured angles have noise; ``stands``: from and to which cycle."""

    def __init__(self, T: float, rng: np.random.Generator, lag: float, dead: int) -> None:
        self.T, self._rng, self._lag, self._dead = T, rng, lag, dead
        self.commanded = np.zeros(N)
        self._queue = [np.zeros(N)] * (dead + 1)
        self._a = self.q = np.zeros(N)

    def response(self, length: int) -> Array:
        """Impulse response ``(length, N)``, its first row of the instant of the command."""
        loop = Loop(self.T, self._rng, self._lag, self._dead)
        steps = [np.zeros(N)]
        for _ in range(length - 1):
            steps.append(loop.step(np.ones(N)).copy())
        return np.diff(np.array([np.zeros(N), *steps]), axis=0)

    def step(self, q_c: Array, rate: float = 1.0) -> Array:
        """One cycle with a command ``(N,)``, of whose change only a share is made."""
        self.commanded = q_c
        self._queue = [*self._queue[1:], q_c]
        share = rate * self.T / (self._lag + self.T)
        self._a = self._a + share * (self._queue[0] - self._a)
        self.q = self.q + (share if rate else 0.0) * (self._a - self.q)
        return self.q


def commands(T: float, rng: np.random.Generator, speed: float) -> Array:
    """From rest to rest and back, as slow moves and fast paths are ``(N, n)`` [rad]."""
    way = speed * rng.uniform(-1.0, 1.0, N)
    way[0] = speed
    count = round(1.875 / T)
    forth = eased(np.arange(1, count + 1)[:, None] / count) * way
    return np.concatenate([np.zeros((20, N)), forth, np.tile(forth[-1], (20, 1)), forth[::-1], np.zeros((40, N))])


@pytest.mark.parametrize("seed", range(12))
def test_a_sound_arm_is_let_go_on_and_one_that_stands_is_noticed(seed: int) -> None:
    """Also where the model's loop is slower by a tenth and off by a cycle."""
    rng = np.random.default_rng(seed)
    T, lag, speed = float(rng.choice([0.004, 0.012])), rng.uniform(0.01, 0.03), rng.uniform(0.2, 1.0)
    known = Loop(T, rng, lag * rng.uniform(0.9, 1.1), 1).response(round(0.3 / T))
    path = commands(T, rng, speed)
    moving = 20 + round(rng.uniform(0.5, 1.3) / T)
    for fault in ("none", "stands", "override"):
        loop = Loop(T, rng, lag, int(rng.integers(0, 3)))
        robot = dataclasses.replace(ROBOT, t_ipo=T)
        watch, noticed = Following(lambda loop=loop: loop.commanded, robot, known), None  # type: ignore[misc]
        held = None
        for k, q_c in enumerate(path):
            loop.step(q_c)
            q = loop.q + 1e-5 * rng.standard_normal(N)
            if fault == "stands" and k >= moving:
                held = q if held is None else held
                q = held
            elif fault == "override" and k >= moving:
                held = q if held is None else held
                q = held + 0.3 * (q - held)
            if (reason := watch.look(k * T, q_c, q)) is not None:
                noticed = k
                break
        if fault == "none":
            assert noticed is None, reason
        else:
            assert noticed is not None
            assert (noticed - moving) * T <= 0.2
            assert ("stands still" in str(reason)) or fault == "override"
            # How far the command is ahead by then is what has to be made good.
            assert np.abs(path[noticed] - path[moving]).max() <= np.radians(0.5) + 0.12 * speed


@pytest.mark.parametrize("fault", ["stands", "override", "the other way"])
@pytest.mark.parametrize("seed", range(8))
def test_a_slow_arm_that_is_paused_may_go_on_and_one_that_goes_on_otherwise_may_not(seed: int, fault: str) -> None:
    """Its gears spring back a little, and a joint may just turn round: "does not follow" was said of a contour."""
    rng = np.random.default_rng(seed)
    T, lag, speed = float(rng.choice([0.004, 0.012])), rng.uniform(0.01, 0.03), rng.uniform(0.1, 0.4)
    loop = Loop(T, rng, lag, 1)
    watch = Following(lambda: loop.commanded, dataclasses.replace(ROBOT, t_ipo=T), loop.response(round(0.3 / T)))
    path = commands(T, rng, speed)
    moving, held, noticed, said = 20 + round(rng.uniform(0.5, 1.1) / T), np.zeros(N), None, None
    for k, q_c in enumerate(path[: moving + round(0.8 / T)]):
        # What is noticed of one that stands is answered by commands to where it is.
        loop.step(q_c if noticed is None or fault != "stands" else held)
        q, since = loop.q, (k - moving) * T
        held = q if k <= moving else held
        if since > 0.0 and fault == "stands":
            back = np.radians(0.06) * np.sign(path[moving] - path[moving - 1])
            q = held - back * (1.0 - np.exp(-since / 0.03))
        elif since > 0.0:
            q = held + (0.3 if fault == "override" else -1.0) * (q - held)
        said = watch.look(k * T, loop.commanded, q + 1e-5 * rng.standard_normal(N)) or said
        noticed = k if noticed is None and said is not None else noticed
        if said is not None and not watch.passes:
            break
    assert noticed is not None
    assert (noticed - moving) * T < 0.3
    assert watch.passes == (fault == "stands"), said
    assert ("stands still" in str(said)) == (fault == "stands")


LOADED = """
import numpy as np
from tests.scenes.follow.loaded_late import watched
from ideal_robot.execution.following import Following
from ideal_robot.robots.robot import Robot

robot, rest = Robot.load("kr6"), np.zeros(6)
known = np.concatenate([np.zeros((1, 6)), np.full((10, 6), 0.1)])
watches = [Following(lambda: rest, robot, response, sure=sure)
           for response, sure in ((None, True), (known, True), (known, False))]
watched(compiled := [], [True])
for watch in watches:
    for k in range(3):
        assert watch.look(0.012 * k, rest, rest) is None
print(*compiled)
"""


def test_nothing_is_compiled_or_loaded_once_an_arm_waits() -> None:
    """In a process of its own, as in others the code may be there already: an arm's first cycle had taken 0.7 s."""
    answer = subprocess.run([sys.executable, "-c", LOADED], cwd=ROOT, capture_output=True, text=True, check=True)
    assert answer.stdout.split() == []
