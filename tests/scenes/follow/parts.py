"""An arm that does what it is told, without a wire, for tests of what leads it."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.robots.interface import RobotState
from ideal_robot.robots.robot import Robot


@dataclass
class Counts:
    cycles: int = 0


@dataclass
class Tame:
    """A ``Link`` whose controller's clock is given by hand; ``lost`` cycles are left out of it."""

    robot: Robot = field(default_factory=lambda: Robot.load("kr6"))
    fault: str | None = None
    lost: tuple[int, ...] = ()
    raises: Exception | None = None
    repeats: bool = False

    def __post_init__(self) -> None:
        self.t_ipo = self.robot.t_ipo
        self.commanded = self.robot.home.copy()
        self.counts, self.answer_times = Counts(), []
        self.arrived, self._k, self._begun = time.perf_counter(), 0, time.perf_counter()
        self.taken: list[Array] = []
        self.skipped: list[Array] = []
        self.gone_on = 0

    def send(self, q_c: Array) -> None:
        self.commanded = q_c
        self.taken.append(q_c)

    def skip(self, q_c: Array) -> None:
        self.skipped.append(q_c)

    def receive(self) -> RobotState:
        if self.raises is not None:
            raise self.raises
        lost = self._k + 1 in self.lost
        self._k += 1 + lost
        self.gone_on = lost if self.repeats else 0
        self.arrived = self._begun + self._k * self.t_ipo
        return RobotState(self._k * self.t_ipo, self.commanded.copy(), np.zeros(self.robot.n))
