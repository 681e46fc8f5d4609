"""A computer that does not hold the cycle is refused before anything moves; one that does is not."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from ideal_robot.arrays import Array
from ideal_robot.robots.interface import RobotState
from scenes.online.devices import Devices
from scenes.online.journal import Journal
from scenes.online.live_arm import LiveArm
from scenes.online.run import _job, load_cell
from scenes.online.self_test import LASTS, LATE, SelfTest, self_test
from scenes.scene_files.scene import SceneError
from tests.scenes.follow.pair import Tame


class Timed(Tame):
    """A controller that misses what comes later than its cycle after its packet, and notes where it was held."""

    def send(self, q_c: Array) -> None:
        self.answer_times.append(time.perf_counter() - self._told)
        self._late = self.answer_times[-1] > self.t_ipo
        super().send(q_c)

    def receive(self) -> RobotState:
        # What is computed behind the command is in the way of the next answer.
        self._told, state = self._sent, super().receive()
        self.missed = self._late
        return state

    _told = _sent = 0.0


class Prompt(Timed):
    """A controller whose packet comes the moment it is waited for."""

    def receive(self) -> RobotState:
        self._sent = time.perf_counter()
        return super().receive()


def computed(seconds: float) -> Iterator[float]:
    while True:
        time.sleep(seconds)
        yield seconds


def test_only_what_chance_does_not_make_of_a_computer_that_holds_the_cycle_is_refused() -> None:
    rng = np.random.default_rng(2)
    cycles = round(LASTS / 0.012)

    def refused(share: float) -> float:
        draws = [SelfTest(cycles, int(rng.binomial(cycles, share)), 0.012, (0.001, 0.002), 1e-4) for _ in range(3000)]
        return float(np.mean([draw.too_slow for draw in draws]))

    assert refused(0.0) == refused(0.5 * LATE) == refused(LATE) == 0.0
    assert refused(0.25) == 1.0


def test_a_computer_that_is_too_slow_is_refused_where_the_arm_was_held(tmp_path: Path,
                                                                        monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("scenes.online.self_test.LASTS", 0.36)
    monkeypatch.setattr("scenes.online.live_arm._LATE", 2.0)
    link = Prompt()
    arm = LiveArm(link, Journal(tmp_path, link.robot, {}))
    link._sent = time.perf_counter()
    with pytest.raises(SceneError, match=r"is too slow for the cycle: \d+ of 30 answers late.*--cycle"):
        self_test(arm, computed(0.02), ahead=False)
    np.testing.assert_array_equal(link.taken, np.tile(link.robot.home, (len(link.taken), 1)))


def test_a_quick_one_is_told_by_its_figures(tmp_path: Path) -> None:
    link = Prompt()
    arm = LiveArm(link, Journal(tmp_path, link.robot, {}))
    link._sent = time.perf_counter()
    job = _job(load_cell("line"), Devices("rsi:"), None, None)
    cycles = job.imagined_cycles()
    next(cycles)
    link._told = time.perf_counter()
    result = self_test(arm, cycles, ahead=True)
    assert result.cycles == round(LASTS / arm.t_ipo)
    assert 0.0 < result.computing[0] <= result.computing[1]
    assert "answers late" in result.text
    assert arm.between == []
