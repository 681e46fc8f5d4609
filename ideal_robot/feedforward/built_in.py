"""The methods of this project: requirements and factory of each."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ideal_robot.arrays import Array
from ideal_robot.feedforward.arm_of_its_type import arm_of_its_type
from ideal_robot.feedforward.base import CommandLimits, Feedforward, PassThrough
from ideal_robot.feedforward.command_adaptation import AdaptedCommand
from ideal_robot.feedforward.command_inverse import CommandInverse
from ideal_robot.feedforward.corrected_arm import CorrectedArm, for_arm
from ideal_robot.feedforward.friction_adaptation import AdaptedIdeal, FrictionAdaptation
from ideal_robot.feedforward.friction_curve import FrictionCurve
from ideal_robot.feedforward.inverse import AHEAD, COMPLETE, PRINTED, Inverse, Options
from ideal_robot.feedforward.learning import Playback, learn_on_model
from ideal_robot.feedforward.linear_inverse import LinearInverse
from ideal_robot.feedforward.method import ITERATIONS, Method, Needs, Setting
from ideal_robot.feedforward.training import train
from ideal_robot.loop.impulse_response import LinearLoop

HORIZON = 0.36
"""Horizon of a method that may choose [s]: in the order of the robot's main time constant ([L] 2.2); from four cycles
on more make no difference (``python -m studies horizon``, seeds 1 to 3)."""


def _corrected(setting: Setting, feedforward: Feedforward) -> Feedforward:
    """A feedforward whose commands correct the arm's geometry by the model's effects."""
    return for_arm(feedforward, setting.robot, setting.identified().effects)


def _linear(setting: Setting) -> Feedforward:
    robot, q_d = setting.robot, setting.path()
    loop = LinearLoop.of(setting.loop(), np.median(q_d, axis=0))
    return _corrected(setting, LinearInverse(loop, setting.horizon(HORIZON), limits=CommandLimits.of(robot)))


def _linear_printed(setting: Setting) -> Feedforward:
    robot = setting.robot
    motion = setting.plays().sinusoids(setting.path())
    answer = motion - setting.plays().play(PassThrough(robot.t_ipo), motion).errors()
    loop = LinearLoop.identify(motion, answer, robot.t_ipo)
    return LinearInverse(loop, setting.horizon(HORIZON), limits=CommandLimits.of(robot))


def _trained(setting: Setting, weighs_torques: bool = True) -> Feedforward:
    robot, loop = setting.robot, setting.loop()
    motion, q_c = setting.plays().training(setting.path(), loop, setting.progress)
    return train([(motion, q_c)], robot.t_ipo, chain=loop.chain if weighs_torques else None,
                 limits=CommandLimits.of(robot))


def _inverse(setting: Setting, options: Options = COMPLETE) -> Inverse:
    # As printed in the paper, the horizon is only as long as the command's delay, or zero.
    return Inverse(setting.loop(), setting.horizon(HORIZON) if options.path else None, options)


BY_LAW = ("none", "ideal", "precorrected", "adapted")
"""Methods whose errors the command's law tells; the others are of [G]'s loop, whatever predicts better."""


def by_law(setting: Setting) -> CommandInverse | None:
    """The inverse by the command's law, where the model has one that predicts commands better than [G]'s loop."""
    model = setting.identified()
    return CommandInverse(model, setting.robot, delay=setting.delay) if model.by_law else None


def _ideal_robot(setting: Setting) -> Feedforward:
    return _corrected(setting, by_law(setting) or _inverse(setting))


def _precorrected(setting: Setting) -> Feedforward:
    if (inverse := by_law(setting)) is not None:
        return _corrected(setting, inverse)
    return _corrected(setting, _inverse(setting, AHEAD))


def _adapted(setting: Setting) -> Feedforward:
    if (inverse := by_law(setting)) is not None:
        return _corrected(setting, AdaptedCommand(inverse))
    if setting.practice is None:
        # This method needs no runs beforehand: it learns during the run.
        return _corrected(setting, _adapting(setting, None if setting.q_d is None else FrictionCurve(setting.loop())))
    practice = setting.plays()
    motion = practice.motion(setting.path())
    start = _adapting(setting, FrictionCurve(setting.loop()))
    before = practice.play(start, motion)
    if before.recording is not None:
        own = arm_of_its_type(before.recording, setting.identified(), setting.robot)
        if own is not setting.model:
            setting = replace(setting, model=own)
            start = _adapting(setting, FrictionCurve(setting.loop()))
            before = practice.play(start, motion)
    # Following errors show friction's shape only if the path is not replanned meanwhile. What another motion has shown
    # of it does not apply to this path, so it starts from the prior.
    curve = FrictionCurve(start.ideal.loop)
    known = before.state.factors, curve, curve.inertia_alone(before.state.curve)

    def strayed(joints: NDArray[np.bool_]) -> Array:
        """How far the motors stray from their plan on the path ``(n,)`` where these joints are adapted."""
        tried = AdaptedIdeal(start.ideal, start.adaptation, *known, joints)
        return np.asarray(practice.play(tried, setting.path()).state.curve.strayed)

    # Results of another motion are kept in the joints that follow the path better with them.
    every = np.ones(setting.robot.n, dtype=bool)
    return _corrected(setting, AdaptedIdeal(start.ideal, start.adaptation, *known, strayed(every) < strayed(~every)))


def _adapting(setting: Setting, curve: FrictionCurve | None = None) -> AdaptedIdeal:
    """The ideal robot that knows nothing beyond the model yet."""
    ideal = _inverse(setting)
    adaptation = FrictionAdaptation(ideal.loop, tool=setting.robot.tool_place,
                                    noise_std=setting.identified().noise_std)
    return AdaptedIdeal(ideal, adaptation, curve=curve)


def _learned_on_model(setting: Setting) -> Feedforward:
    arm = CorrectedArm(setting.robot, setting.identified().effects)
    path = arm.from_rest(setting.path(), setting.robot.t_ipo)
    return Playback(learn_on_model(setting.loop(), path, setting.q_c).q_c, setting.robot.t_ipo)


def _learned(setting: Setting, steps: int) -> Feedforward:
    commands = setting.plays().learned(setting.path(), setting.loop(), setting.progress).kept
    return Playback(commands[min(steps, len(commands) - 1)], setting.robot.t_ipo)


NONE = Method(lambda setting: PassThrough(setting.robot.t_ipo), "the desired path is commanded as it is", Needs.NOTHING)
LINEAR = Method(_linear, "inverse of the linear closed loop about the path's middle ([G] (12))", Needs.PATH, {
    "printed": Method(_linear_printed, "of responses from measured sinusoids, as printed ([G] (7), (12))",
                      Needs.PLAYS)})
TRAINED = Method(_trained, "weights trained on another motion on the arm, of the rigid-body torques too ([G] (13))",
                 Needs.PLAYS, {
    "printed": Method(lambda setting: _trained(setting, weighs_torques=False),
                      "without rigid-body torques, as printed ([G] (13))", Needs.PLAYS)})
PRECORRECTED = Method(_precorrected,
                      "nonlinear precorrection with look ahead and gear elasticity ([G] (16) to (20), [L] 2.2)",
                      settings={
    "printed": Method(lambda setting: _corrected(setting, _inverse(setting, PRINTED)),
                      "as printed: no look ahead, no gear elasticity ([G] (16) to (20))")})
LEARNED = Method(lambda setting: _learned(setting, ITERATIONS),
                 f"learning this path on the arm in {ITERATIONS} steps ([G] (10), (11))", Needs.PLAYS, {
    **{str(steps): Method(partial(_learned, steps=steps), f"after {steps} of {ITERATIONS} steps", Needs.PLAYS)
       for steps in range(1, ITERATIONS)},
    "model": Method(_learned_on_model, "on the identified loop, before the arm moves", Needs.PATH)})
IDEAL = Method(_ideal_robot,
               "inverse of the whole identified loop over the horizon ([L] 2.2)")
ADAPTED = Method(_adapted, "the ideal robot, friction and tool mass adapted before and while the path is run",
                 Needs.PLAYS)
