"""What a path scene needs before anything moves, and the feedforward of each method for its path."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.feedforward.base import Feedforward
from ideal_robot.feedforward.learning import Learned
from ideal_robot.feedforward.method import Practice, Rehearsed, Setting
from ideal_robot.feedforward.registry import methods
from ideal_robot.feedforward.training import REST_AFTER, REST_BEFORE, training_motion
from ideal_robot.loop.from_model import loop_model
from ideal_robot.loop.loop_model import LoopModel
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from scenes.arms import arm_of
from scenes.methods import SceneMethod
from scenes.models import model_for
from scenes.path.result import Play, measured_errors, play
from scenes.result import Progress, silent
from scenes.scene_files.path_scene import JointPath, PathScene, joint_path
from sim.arm.world import World

HORIZON = 0.36
"""How far ahead the ideal robot is given desired positions [s]."""
DELAY = "_delay"
"""Behind a method's key: the standard path planner's delay is in force."""


def path_methods() -> tuple[str, ...]:
    """Every key that ``--method`` takes."""
    return (*methods(), *(key + DELAY for key in methods()))


@dataclass
class PathCell:
    """One path in one world: makes the feedforward of each method for it, and keeps what is expensive.

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

    def feedforward(self, method: str | SceneMethod, progress: Progress = silent) -> Feedforward:
        """The feedforward of a method.

        Args:
            method: a key with or without suffix, or a method of the user's.
            progress: called with the fraction of the learning done.

        Raises:
            InputError: no such method.
        """
        wanted = method if isinstance(method, SceneMethod) else SceneMethod(method)
        setting = Setting(self.robot, self.model, round(HORIZON / self.robot.t_ipo), self.delay, self.path.q_d,
                          practice=self.practice,
                          progress=progress)
        return wanted.feedforward(setting)

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
        return Rehearsed(played.state, lambda: measured_errors(self.robot, path, played.recording, self.learn_from),
                         played.recording)


def training_path(path: JointPath, t_ipo: float) -> JointPath:
    """The motion about a path that training, adaptation and diagnosis learn from."""
    return about(path, training_motion(path.q_d, t_ipo), t_ipo)


def about(path: JointPath, q_d: Array, t_ipo: float) -> JointPath:
    """A joint motion about a path, without a desired TCP of its own.

    Args:
        path: what the motion is about; gives the tool path.
        q_d: joint motion at the cycles ``(N, n)`` [rad].
        t_ipo: cycle [s].
    """
    counts = np.zeros(len(q_d), dtype=bool)
    counts[round(REST_BEFORE / t_ipo) : len(q_d) - round(REST_AFTER / t_ipo)] = True
    return JointPath(q_d, np.zeros((len(q_d), 3)), np.asarray(t_ipo * np.arange(float(len(q_d)))), counts, path.tool)


def set_up(scene: PathScene, *, delay: bool, model: Model | None = None) -> PathCell:
    """Everything a path scene needs, with or without the standard path planner's delay.

    Args:
        scene: the scene.
        delay: whether the delay is in force.
        model: of the arm; None for the one that the scene asks for.

    Raises:
        InputError: path out of reach, no model, a value of the world that makes no sense.
    """
    world = World.from_table(scene.robot, {**scene.arm_world, "correction_delay": delay}, scene.source)
    robot = world.with_cycles(arm_of(scene.robot))
    return PathCell(robot, world, model or model_for(scene, robot), joint_path(scene, robot, world.t_ipo),
                    scene.learn_from, scene.seed)
