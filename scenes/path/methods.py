"""The methods of ``ideal_robot.feedforward`` for one known path on one simulated arm."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.feedforward.base import Feedforward
from ideal_robot.feedforward.learning import Learned
from ideal_robot.feedforward.practice import Practice, Rehearsed
from ideal_robot.feedforward.registry import feedforward
from ideal_robot.feedforward.training_motion import REST_AFTER, REST_BEFORE, training_motion
from ideal_robot.loop.from_model import loop_model
from ideal_robot.loop.loop_model import LoopModel
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from scenes.path.player import Play, measured_errors, play
from scenes.path.scene import JointPath
from scenes.result import Progress, silent
from sim.arm.world import World

N_D = 30


@dataclass
class Workshop:
    """Makes the feedforward of each method for one path in one world, and keeps what is expensive.

    Attributes:
        robot, world, model, path: what it works on; ``world`` says whether the planner's delay is in force.
        learn_from: what learning measures, see ``PathScene``.
        seed: of the arm's noise.
    """

    robot: Robot
    world: World
    model: Model
    path: JointPath
    learn_from: str
    seed: int
    plays: int = 0
    _practice: Practice | None = field(default=None, repr=False, init=False)

    @property
    def delay(self) -> int:
        """Cycles between hand-over of a command and the start of its interpolation."""
        return int(self.world.correction_delay)

    def loop(self) -> LoopModel:
        """The identified closed loop in this world's mode of the path planner."""
        return loop_model(self.model, self.robot, delay=self.delay)

    def play(self, feedforward: Feedforward, path: JointPath | None = None) -> Play:
        """Plays a path; every play has noise of its own."""
        self.plays += 1
        rng = np.random.default_rng([self.seed, self.delay, self.plays])
        return play(self.robot, self.world, path or self.path, feedforward, rng)

    def feedforward(self, method: str, progress: Progress = silent) -> Feedforward:
        """The feedforward of a method key without suffix.

        Raises:
            InputError: no such method.
        """
        return feedforward(method, self.model, self.robot, n_d=N_D, delay=self.delay, q_d=self.path.q_d,
                           practice=self.practice, progress=progress)

    @property
    def practice(self) -> Practice:
        """Plays on this arm before the path counts, and what was learned in them."""
        if self._practice is None:
            self._practice = Practice(self._rehearsed, self.robot)
        return self._practice

    def learned(self, progress: Progress = silent) -> Learned:
        """Learning of the path on the arm, [G] (10), (11), from the uncorrected path."""
        return self.practice.learned(self.path.q_d, self.loop(), progress)

    def _rehearsed(self, feedforward: Feedforward, q_d: Array) -> Rehearsed:
        path = self.path if q_d is self.path.q_d else about(self.path, q_d, self.world.t_ipo)
        played = self.play(feedforward, path)
        return Rehearsed(played.state, lambda: measured_errors(self.robot, path, played.recording, self.learn_from))


def training_path(path: JointPath, t_ipo: float) -> JointPath:
    """The motion about a path that training, adaptation and diagnosis learn from."""
    return about(path, training_motion(path.q_d, t_ipo), t_ipo)


def about(path: JointPath, q_d: Array, t_ipo: float) -> JointPath:
    """A joint motion ``q_d (N, n)`` [rad] at cycles of ``t_ipo`` [s] about a path, without a desired TCP of its own."""
    counts = np.zeros(len(q_d), dtype=bool)
    counts[round(REST_BEFORE / t_ipo) : len(q_d) - round(REST_AFTER / t_ipo)] = True
    return JointPath(q_d, np.zeros((len(q_d), 3)), np.asarray(t_ipo * np.arange(float(len(q_d)))), counts, path.tool)
