"""Motions that a diagnosis plans, against random ones: do they decide between causes that a recording left open?"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline

from ideal_robot.arrays import Array
from ideal_robot.diagnosis import Diagnosis, Open, diagnose, plan_diagnosis
from ideal_robot.diagnosis.next_motion.questions import open_questions
from ideal_robot.errors import IdealRobotError
from ideal_robot.identification.excitation import Workspace
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from scenes.commands.common import whole_numbers
from studies.report import head, row
from studies.strangers.arm import STEP, Arm, Motion, draw_arm, draw_motion, robot_of
from studies.strangers.effects import INSIDE, Setup
from studies.strangers.engines import ENGINES
from studies.strangers.logger import draw_logger, record
from studies.strangers.plant import draw_plant
from studies.strangers.trial import Twin

ENGINE = "integrator"
ANYWHERE = Workspace(z_min=-np.inf, r_min=0.0)
"""Chains drawn at random stand on nothing."""


@dataclass(frozen=True)
class Poor:
    """A stranger with one cause, name and joint from 1, and a recording of a slow and narrow motion."""

    setup: Setup
    cause: tuple[str, int]
    recording: Recording

    def again(self, motion: Motion) -> Recording:
        """What the same arm records on another motion."""
        return record(self.setup.logger, self.setup.plant, ENGINES[ENGINE](self.setup.plant, motion))


def planned(seeds: str = "800000-800099", pairs: int = 10, longest: float = 30.0) -> None:
    """Strangers whose poor recording leaves rivals of the cause; a planned and a random motion of the same length.

    A recording of two slow frequencies a joint, 8 to 14 s, with an effect of the library of 3 to 10 times visible. Open
    is one whose diagnosis names the cause, or a rival that it does not separate from it. Decided: the cause is named
    and no rival with it, after the motion alone.
    """
    head("seed", "cause", "left open with", "length s", "planned", "random")
    right = {"planned": 0, "random": 0}
    count = 0
    for seed in whole_numbers(seeds, "--seeds"):
        for poor, rival, arm, robot in _open(seed):
            try:
                questions = Open(open_questions(diagnose(poor.recording, robot)).found)
                plan = plan_diagnosis(poor.recording, _limited(robot, arm), questions, longest=longest,
                                      workspace=ANYWHERE)
            except IdealRobotError as error:
                row(seed, poor.cause, rival, "", error, "")
                continue
            if len(plan.commands) < 2:
                row(seed, f"`{poor.cause[0]}`", f"`{rival}`", "no motion helps", "", "")
                continue
            motions = {"planned": _along(plan.commands, robot.t_ipo),
                       "random": draw_motion(np.random.default_rng([seed, 31]), arm, plan.seconds, "fourier")}
            said = {key: _decided(diagnose(poor.again(motion), robot), poor.cause) for key, motion in motions.items()}
            right = {key: right[key] + (word == "decided") for key, word in said.items()}
            count += 1
            row(seed, f"`{poor.cause[0]}`", f"`{rival}`", f"{plan.seconds:.0f}", *said.values())
        if count == pairs:
            break
    row("decided", "", "", "", *(f"{right[key]} of {count}" for key in right))


def _open(seed: int) -> Iterator[tuple[Poor, str, Arm, Robot]]:
    """The stranger of a seed with one rival, where its recording leaves one."""
    rng = np.random.default_rng([seed, 7207])
    arm = draw_arm(rng)
    joint, name = int(rng.integers(arm.n)), str(rng.choice(sorted(INSIDE)))
    logger = replace(draw_logger(rng, arm.n, ()), spikes=0.0, dropped=0.0, temp=(), xy=False)
    try:
        twin = Twin(Setup(draw_plant(rng, arm), logger), ENGINE, _poor_motion(rng, arm))
        effect = INSIDE[name](rng, twin.setup, joint)
        if effect is None:
            return
        scaled = twin.scaled(effect, float(np.exp(rng.uniform(*np.log((3.0, 10.0))))), "inside")
    except RuntimeError:
        # A plant that its controller cannot hold is no trial.
        return
    if scaled is None:
        return
    setup = effect.apply(twin.setup, scaled[0])
    poor = Poor(setup, (name, joint + 1), record(setup.logger, setup.plant, scaled[2]))
    with robot_of(arm.urdf) as robot:
        for found in diagnose(poor.recording, robot).effects:
            names = [found.fitted.name, *found.indistinguishable_from]
            if found.fitted.joint == joint + 1 and name in names and len(names) > 1:
                yield poor, next(one for one in names if one != name), arm, robot
                return


def _decided(found: Diagnosis, cause: tuple[str, int]) -> str:
    named = {(e.fitted.name, e.fitted.joint): e.indistinguishable_from for e in found.effects}
    if cause not in named:
        return "the cause is not named"
    return "decided" if not named[cause] else "open"


def _poor_motion(rng: np.random.Generator, arm: Arm) -> Motion:
    """Two frequencies a joint, slow and narrow, for 8 to 14 s, from rest."""
    t = np.arange(round(rng.uniform(8.0, 14.0) / STEP), dtype=float) * STEP
    x = np.zeros((len(t), arm.n))
    for j in range(arm.n):
        for w in 2.0 * np.pi / 8.0 * rng.choice([1.0, 2.0, 3.0, 5.0], 2, replace=False):
            x[:, j] += rng.uniform(0.4, 1.0) / w * np.sin(w * t + rng.uniform(0, 2 * np.pi))
    s = np.clip(t, 0.0, 1.0)[:, None]
    x = (x - x[0]) * (10 * s**3 - 15 * s**4 + 6 * s**5)
    v = np.gradient(x, STEP, axis=0)
    x *= np.minimum.reduce([0.1 * (arm.high - arm.low) / np.max(np.abs(x), axis=0),
                            0.35 * arm.fast / np.max(np.abs(v), axis=0),
                            0.5 * arm.quick / np.max(np.abs(np.gradient(v, STEP, axis=0)), axis=0)])
    return _motion(t, 0.5 * (arm.high + arm.low) + x)


def _along(commands: Array, t_ipo: float) -> Motion:
    """Commands ``(N, n)`` [rad] every ``t_ipo`` [s] as a desired motion."""
    t = np.arange(round(t_ipo * (len(commands) - 1) / STEP), dtype=float) * STEP
    return _motion(t, CubicSpline(t_ipo * np.arange(float(len(commands))), commands, axis=0)(t))


def _motion(t: Array, q: Array) -> Motion:
    qd = np.gradient(q, STEP, axis=0)
    return Motion("asked", t, q, qd, np.gradient(qd, STEP, axis=0))


def _limited(robot: Robot, arm: Arm) -> Robot:
    """The robot with the limits that the arm's recordings stay within."""
    return replace(robot, q_min=arm.low, q_max=arm.high, v_max=arm.fast, a_max=arm.quick,
                   tau_max=np.full(arm.n, np.inf))
