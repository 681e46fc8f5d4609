"""The ways of correcting a known path, by their keys (design §6)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.feedforward.base import Feedforward
from ideal_robot.feedforward.friction_adaptation import AdaptedIdeal
from ideal_robot.feedforward.ideal import IdealRobot
from ideal_robot.feedforward.learning import Learned, LearningLaw, Playback, learn, learn_on_model
from ideal_robot.feedforward.linear_inverse import LinearInverse
from ideal_robot.feedforward.passthrough import PassThrough
from ideal_robot.feedforward.precorrection import Precorrection
from ideal_robot.feedforward.training import Trained, train
from ideal_robot.loop.from_model import loop_model
from ideal_robot.loop.impulse_response import LinearLoop
from ideal_robot.loop.loop_model import LoopModel
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from scenes.path.player import Play, measured_errors, play
from scenes.path.scene import REST_AFTER, REST_BEFORE, JointPath
from scenes.result import Progress, silent
from sim.arm.world import World

ITERATIONS = 4
"""Learning steps on the arm, as in [G] 4.3."""
N_D = 30
METHODS = ("none", "linear", "trained", "precorrected_1", "precorrected", "model_learned",
           *(f"learned_{p}" for p in range(1, ITERATIONS + 1)), "ideal", "adapted")
"""Keys without suffix; ``_delay`` behind one keeps the standard path planner's delay in force. ``precorrected_1`` is
[G] as printed: no look ahead, no gear elasticity."""


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
    _learned: Learned | None = field(default=None, repr=False)
    _training: tuple[JointPath, Array] | None = field(default=None, repr=False)

    @property
    def delay(self) -> int:
        """Cycles between hand-over of a command and the start of its interpolation."""
        return int(self.world.correction_delay)

    def loop(self) -> LoopModel:
        """The identified closed loop in this world's mode of the path planner."""
        return loop_model(self.model, self.robot, delay=self.delay)

    def linear(self, path: JointPath | None = None) -> LinearLoop:
        """Linear closed loops about the middle of the path, from the identified loop."""
        return LinearLoop.of(self.loop(), np.median((path or self.path).q_d, axis=0))

    def play(self, feedforward: Feedforward, path: JointPath | None = None, state: object = None) -> Play:
        """Plays a path; every play has noise of its own."""
        self.plays += 1
        rng = np.random.default_rng([self.seed, self.delay, self.plays])
        return play(self.robot, self.world, path or self.path, feedforward, rng, state=state)

    def feedforward(self, method: str, progress: Progress = silent) -> tuple[Feedforward, object]:
        """The feedforward of a method key without suffix, and the state it starts with (None for a fresh one).

        Raises:
            InputError: no such method.
        """
        robot, limits = self.robot, (self.robot.q_min, self.robot.q_max)
        if method == "none":
            return PassThrough(self.world.t_ipo), None
        if method == "linear":
            return LinearInverse(self.linear(), N_D, limits=limits), None
        if method == "precorrected":
            return Precorrection.complete(self.model, robot, delay=self.delay), None
        if method == "precorrected_1":
            return Precorrection(self.model, robot), None
        if method == "ideal":
            return IdealRobot(self.loop(), N_D), None
        if method == "model_learned":
            return Playback(learn_on_model(self.loop(), self.path.q_d).q_c, self.world.t_ipo), None
        if method == "trained":
            return self.trained(progress), None
        if method == "adapted":
            return self.adapted()
        if method.startswith("learned_") and method[8:] in {str(p) for p in range(1, ITERATIONS + 1)}:
            kept = self.learned(progress).kept
            return Playback(kept[min(int(method[8:]), len(kept) - 1)], self.world.t_ipo), None
        raise InputError(f"expected one of {', '.join(METHODS)}, with or without _delay", field="method", value=method)

    def learned(self, progress: Progress = silent) -> Learned:
        """Learning of the path on the arm, [G] (10), (11), from the uncorrected path."""
        if self._learned is None:
            self._learned = self._learn(self.path, progress)
        return self._learned

    def trained(self, progress: Progress = silent, base: Feedforward | None = None) -> Trained:
        """[G] (13), trained on a motion of all joints about the path's postures that is not the path."""
        if self._training is None:
            motion = training_motion(self.path, self.world.t_ipo)
            self._training = motion, self._learn(motion, progress).q_c
        motion, q_c = self._training
        return train([(motion.q_d, q_c)], self.world.t_ipo, chain=self.loop().chain, base=base,
                     limits=(self.robot.q_min, self.robot.q_max))

    def adapted(self) -> tuple[Feedforward, object]:
        """The ideal robot, its friction adapted on the training motion before the path, and going on while it plays."""
        feedforward = AdaptedIdeal(IdealRobot(self.loop(), N_D))
        before = self.play(feedforward, training_motion(self.path, self.world.t_ipo))
        factors = before.state.factors  # type: ignore[attr-defined]
        return feedforward, feedforward.init(self.path.q_d[0], factors)

    def _learn(self, path: JointPath, progress: Progress) -> Learned:
        done = 0

        def attempt(commands: Array) -> Array:
            nonlocal done
            progress(done / (ITERATIONS + 1), f"learning, play {done + 1}")
            done += 1
            played = self.play(Playback(commands, self.world.t_ipo), path)
            return measured_errors(self.robot, path, played.recording, self.learn_from)

        law = LearningLaw(self.linear(path), len(path.q_d))
        return learn(attempt, path.q_d, law, iterations=ITERATIONS, limits=(self.robot.q_min, self.robot.q_max),
                     step_max=1.5 * self.robot.v_max * self.world.t_ipo)


def training_motion(path: JointPath, t_ipo: float) -> JointPath:
    """Smooth joint motion through the neighbourhood of a path, as fast as the path is: what [G] trains on.

    Sinusoids of different frequencies and phases per joint about the path's middle, with amplitudes of the path's own
    range (at least 3°), faded in and out.
    """
    low, high = path.q_d.min(axis=0), path.q_d.max(axis=0)
    amplitude = np.maximum(0.5 * (high - low), np.radians(3.0))
    speed = np.maximum(np.max(np.abs(np.diff(path.q_d, axis=0)), axis=0) / t_ipo, 0.1)
    n = path.q_d.shape[1]
    length = 8.0
    t = np.arange(0.0, length, t_ipo)
    fade = np.clip(np.minimum(t, length - t) / 1.0, 0.0, 1.0)
    fade = fade**3 * (10 - 15 * fade + 6 * fade**2)
    rate = np.clip(speed / amplitude, 1.0, 2 * np.pi * 0.8)
    phase = 2.4 * np.arange(n)
    waves = 0.7 * np.sin(np.outer(t, rate * 0.55) + phase) + 0.45 * np.sin(np.outer(t, rate * 1.25) + 1.7 * phase)
    q = 0.5 * (low + high) + 0.8 * amplitude * fade[:, None] * waves
    before, after = round(REST_BEFORE / t_ipo), round(REST_AFTER / t_ipo)
    q_d = np.concatenate([np.tile(q[0], (before, 1)), q, np.tile(q[-1], (after, 1))])
    counts = np.zeros(len(q_d), dtype=bool)
    counts[before : before + len(q)] = True
    x_d = np.zeros((len(q_d), 3))
    return JointPath(q_d, x_d, np.asarray(t_ipo * np.arange(float(len(q_d)))), counts, path.tool)
