"""What a method key stands for: a description, what it needs, and the factory that makes its feedforward."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Protocol

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.feedforward.base import Feedforward
from ideal_robot.feedforward.friction_at_work import FrictionAtWork
from ideal_robot.feedforward.practice import Practice
from ideal_robot.loop.from_model import loop_model
from ideal_robot.loop.loop_model import LoopModel
from ideal_robot.model.model import Model
from ideal_robot.progress import Progress, silent
from ideal_robot.robots.robot import Robot


class Needs(IntEnum):
    """What has to be there before a method can be made; each includes those before it."""

    NOTHING = 0
    """Only the arm's cycle time and limits."""
    MODEL = 1
    """An identified model; works on paths that are only known over the horizon."""
    PATH = 2
    """The whole path beforehand."""
    PLAYS = 3
    """The path, and plays on the arm before it counts."""


@dataclass(frozen=True)
class Setting:
    """Everything a factory may use.

    Attributes:
        robot: cycle times and limits.
        model: identified model; None where only ``NOTHING`` is needed.
        n_d: length of the horizon that will be given; None where the method may choose.
        delay: cycles between hand-over of a command and the start of its interpolation ([G] 5.2.3).
        q_d: the path at the cycles ``(N, n)`` [rad], where it is known beforehand.
        q_c: commands ``(N, n)`` [rad] that learning starts from; the path itself if None.
        practice: plays on the arm, where there is one to play on.
        progress: called with the share of the making that is done.
        friction: as a motion like the job's has shown it, in place of the model's; the model's if None.
    """

    robot: Robot
    model: Model | None = None
    n_d: int | None = None
    delay: int = 0
    q_d: Array | None = None
    q_c: Array | None = None
    practice: Practice | None = None
    progress: Progress = silent
    friction: FrictionAtWork | None = None

    def horizon(self, preferred: int) -> int:
        """Length of the horizon: the one that will be given, else the method's preferred one."""
        return preferred if self.n_d is None else self.n_d

    def identified(self) -> Model:
        """The model.

        Raises:
            InputError: none was given.
        """
        if self.model is None:
            raise InputError("this method needs an identified model; identify one, or use method none", field="model")
        return self.model

    def loop(self) -> LoopModel:
        """The identified closed loop.

        Raises:
            InputError: no model, one of another arm, or one without a controller.
        """
        loop = loop_model(self.identified(), self.robot, delay=self.delay)
        return loop if self.friction is None else self.friction.in_loop(loop)

    def path(self) -> Array:
        """The path ``(N, n)`` [rad].

        Raises:
            InputError: it is not known beforehand.
        """
        if self.q_d is None:
            raise InputError("this method is made for one path; give the path as q_d (N, n) [rad]", field="q_d")
        return self.q_d

    def plays(self) -> Practice:
        """Plays on the arm.

        Raises:
            InputError: there is no arm to play on.
        """
        if self.practice is None:
            raise InputError("this method learns in plays on the arm; give practice=Practice(play)", field="practice")
        return self.practice


class Factory(Protocol):
    """Makes the feedforward of a method; a subclass of ``Feedforward`` that takes a ``Setting`` is one."""

    def __call__(self, setting: Setting) -> Feedforward:
        """Makes it.

        Raises:
            InputError: something it needs is not in the setting; the message says what.
        """
        ...


@dataclass(frozen=True)
class Method:
    """One way of correcting a path.

    Attributes:
        make: factory.
        description: one line for help texts and tables.
        needs: what has to be there, which says where it applies.
    """

    make: Factory
    description: str
    needs: Needs = Needs.MODEL
