"""Interface of methods: a description, their requirements, and the factory that makes the feedforward."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.feedforward.base import CommandLimits, Feedforward
from ideal_robot.feedforward.friction_at_work import FrictionAtWork
from ideal_robot.feedforward.learning import Learned, LearningLaw, Playback, learn
from ideal_robot.feedforward.training_motion import training_motion
from ideal_robot.loop.from_model import loop_model
from ideal_robot.loop.impulse_response import LinearLoop
from ideal_robot.loop.loop import Loop
from ideal_robot.model.model import Model
from ideal_robot.progress import Progress, silent
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording

# Runs on the arm before the path, which learning, training and adaptation need.

ITERATIONS = 4
"""Learning steps on the arm, as in [G] 4.3."""

DURATION, AMPLITUDE, FREQUENCIES = 8.0, 0.1, (0.4, 1.2)
"""Of the sinusoids that impulse responses are identified from: [s], [rad], of the first and the last joint [Hz]."""


@dataclass(frozen=True)
class Rehearsed:
    """The result of one run on the arm before the task.

    Attributes:
        state: the feedforward's last state.
        errors: gives the measured errors ``q_d - q (N, n)`` [rad] at the cycles; computed when it is called.
        recording: what the controller logged; None where nothing is logged.
    """

    state: Any
    errors: Callable[[], Array]
    recording: Recording | None = None


Play = Callable[[Feedforward, Array], Rehearsed]
"""Plays ``q_d (N, n)`` [rad], rest before and behind included, once, from rest at its start."""


class Practice:
    """Learns on the arm and caches the results, so that several methods share the runs.

    Args:
        play: runs a path once.
        robot: cycle times and limits.
    """

    def __init__(self, play: Play, robot: Robot) -> None:
        self.play, self.robot = play, robot
        self._learned: tuple[Array, Learned] | None = None
        self._trained: tuple[Array, Array, Array] | None = None

    def learned(self, q_d: Array, loop: Loop, progress: Progress = silent) -> Learned:
        """Learning of a path on the arm, [G] (10), (11), from the uncorrected path.

        Args:
            q_d, progress: the path ``(N, n)`` [rad]; called with the share done.
            loop: identified loop, whose linearisation about the middle of the path is inverted.
        """
        if self._learned is None or not np.array_equal(self._learned[0], q_d):
            self._learned = q_d, self._learn(q_d, loop, progress)
        return self._learned[1]

    def motion(self, q_d: Array) -> Array:
        """A motion ``(M, n)`` [rad] about a path ``q_d (N, n)`` [rad] for training and adaptation."""
        return training_motion(q_d, self.robot.t_ipo)

    def sinusoids(self, q_d: Array) -> Array:
        """"Simple sinusoidal joint trajectories" ([G] 3.2) ``(M, n)`` [rad] about the middle of a path ``(N, n)``.

        From rest to rest, each joint with a frequency of its own, by some degrees.
        """
        robot, middle = self.robot, np.median(q_d, axis=0)
        t = robot.t_ipo * np.arange(round(DURATION / robot.t_ipo))
        frequency = np.linspace(*FREQUENCIES, robot.n)
        room = np.minimum(middle - robot.q_min, robot.q_max - middle)
        size = np.minimum.reduce([np.full(robot.n, AMPLITUDE), 0.5 * np.maximum(room, 0.0),
                                  0.3 * robot.v_max / (2.0 * np.pi * frequency)])
        swell = np.sin(np.pi * np.clip(t / DURATION, 0.0, 1.0)) ** 2
        return np.asarray(middle + size * swell[:, None] * np.sin(2.0 * np.pi * t[:, None] * frequency))

    def training(self, q_d: Array, loop: Loop, progress: Progress = silent) -> tuple[Array, Array]:
        """A motion ``(M, n)`` about a path that differs from it, and the commands learned for it ``(M, n)`` [rad].

        Args:
            q_d, loop, progress: as in ``learned``.
        """
        if self._trained is None or not np.array_equal(self._trained[0], q_d):
            motion = self.motion(q_d)
            self._trained = q_d, motion, self._learn(motion, loop, progress).q_c
        return self._trained[1:]

    def _learn(self, q_d: Array, loop: Loop, progress: Progress) -> Learned:
        robot, done = self.robot, 0

        def attempt(commands: Array) -> Array:
            nonlocal done
            progress(done / (ITERATIONS + 1), f"learning, play {done + 1}")
            done += 1
            return self.play(Playback(commands, robot.t_ipo), q_d).errors()

        law = LearningLaw(LinearLoop.of(loop, np.median(q_d, axis=0)), len(q_d))
        return learn(attempt, q_d, law, iterations=ITERATIONS, limits=CommandLimits.of(robot))


class Needs(IntEnum):
    """Requirements of a method; each includes those before it."""

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
    """The inputs of a method's factory.

    Attributes:
        robot: cycle times and limits.
        model: identified model; None where only ``NOTHING`` is needed.
        n_d: length of the horizon that will be given; None where the method may choose.
        delay: cycles between hand-over of a command and the start of its interpolation ([G] 5.2.3), beyond those of the
            recordings that the model is from.
        q_d: the path at the cycles ``(N, n)`` [rad], where it is known beforehand.
        q_c: commands ``(N, n)`` [rad] that learning starts from; the path itself if None.
        practice: runs on the arm, where there is an arm.
        progress: called with the fraction of the method's preparation that is done.
        friction: identified from a motion like the job's; None for the friction of the model.
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

    def horizon(self, preferred: float) -> int:
        """Rows of the horizon: the given number, else the method's preferred time [s] in cycles."""
        return round(preferred / self.robot.t_ipo) if self.n_d is None else self.n_d

    def identified(self) -> Model:
        """The model; raises InputError where none was given."""
        if self.model is None:
            raise InputError("this method needs an identified model; identify one, or use method none", field="model")
        return self.model

    def loop(self) -> Loop:
        """The identified closed loop; raises InputError for no model, another arm's, or one without a controller."""
        loop = loop_model(self.identified(), self.robot, delay=self.delay)
        return loop if self.friction is None else self.friction.in_loop(loop)

    def path(self) -> Array:
        """The path ``(N, n)`` [rad]; raises InputError where it is not known beforehand."""
        if self.q_d is None:
            raise InputError("this method is made for one path; give the path as q_d (N, n) [rad]", field="q_d")
        return self.q_d

    def plays(self) -> Practice:
        """Access to runs on the arm; raises InputError where there is no arm."""
        if self.practice is None:
            raise InputError("this method learns in runs on the arm; give practice=Practice(play)", field="practice")
        return self.practice


Factory = Callable[[Setting], Feedforward]
"""Makes the feedforward of a method, or raises InputError, which says what it needs and is not in the setting; a
subclass of ``Feedforward`` that takes a ``Setting`` is one."""


@dataclass(frozen=True)
class Method:
    """One way of correcting a path.

    Attributes:
        make: factory.
        description: one line for help texts and tables.
        needs: its requirements, which decide where it can be used.
        settings: the same method set otherwise, for comparisons: by a paper's equations as printed, or stopped earlier.
    """

    make: Factory
    description: str
    needs: Needs = Needs.MODEL
    settings: Mapping[str, Method] = field(default_factory=dict)
