"""What a diagnosis leaves open: causes that it could not tell apart, and joints that it could not decide."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.channels.regression import Regression
from ideal_robot.diagnosis.next_motion.separation import Cause, Pair
from ideal_robot.diagnosis.search.choice import Options, PresentModel, overlap
from ideal_robot.diagnosis.search.forward_selection import candidates
from ideal_robot.diagnosis.search.scoring import Scoring
from ideal_robot.diagnosis.statistics.problem import Candidate, Problem
from ideal_robot.diagnosis.validation.result import Diagnosis
from ideal_robot.effects import MOTOR_TORQUE, Effect, library
from ideal_robot.effects.base import prefix_of
from ideal_robot.effects.registry import names
from ideal_robot.errors import InputError
from ideal_robot.identification.program import finite_limits
from ideal_robot.robots.robot import Robot

_ELSEWHERE = re.compile(r"(?P<name>\w+) of joint (?P<joint>\d+)")
"""How a rival at another joint is written in ``indistinguishable_from``."""


@dataclass(frozen=True)
class Named:
    """A cause that a diagnosis names, without its numbers.

    Attributes:
        name: of the effect.
        joint: from 1; 0 for the whole arm.
        prefix: of the channel it was found in.
        rivals: names of what the data could not tell from it; with the joint where that is another one.
    """

    name: str
    joint: int
    prefix: str
    rivals: tuple[tuple[str, int | None], ...] = ()


@dataclass(frozen=True)
class Open:
    """What a diagnosis found and left open.

    Attributes:
        found: the causes it names, in its order.
        undecided: joints (from 1) that moved too little.
    """

    found: tuple[Named, ...] = ()
    undecided: tuple[int, ...] = ()

    @property
    def asks(self) -> bool:
        """Whether anything is open."""
        return bool(self.undecided) or any(one.rivals for one in self.found)


def open_questions(diagnosis: Diagnosis) -> Open:
    """What a diagnosis found and left open."""
    found = tuple(Named(one.fitted.name, one.fitted.joint, prefix_of(one.fitted.channel),
                        tuple(_rival(rival) for rival in one.indistinguishable_from)) for one in diagnosis.effects)
    return Open(found, tuple(sorted(diagnosis.undecided)))


def read_questions(values: Any, n: int, file: Any = None) -> Open:
    """What the JSON of ``diagnose`` says was found and left open.

    Args:
        values: its content.
        n: joints of the arm.
        file: where it was read, for messages.

    Raises:
        InputError: it is no such content, or of another arm or version.
    """
    if not isinstance(values, Mapping) or not isinstance(values.get("effects"), list):
        raise InputError("expected the JSON that ideal-robot diagnose --json wrote", file=file, field="effects")
    known, found = set(names()), []
    for i, entry in enumerate(values["effects"]):
        place = f"effects.{i}"
        if not isinstance(entry, Mapping):
            raise InputError("expected an effect with name and joint", file=file, field=place)
        name, joint, rivals = entry.get("effect"), entry.get("joint"), entry.get("indistinguishable_from", [])
        if not isinstance(name, str) or name not in known:
            raise InputError(f"no such effect; known are {', '.join(sorted(known))}", file=file,
                             field=f"{place}.effect", value=str(name)[:60])
        if not _is_joint(joint, 0, n):
            raise InputError(f"expected a joint from 0 (the whole arm) to {n}", file=file, field=f"{place}.joint",
                             value=str(joint)[:60])
        if not isinstance(rivals, list) or not all(isinstance(rival, str) for rival in rivals):
            raise InputError("expected a list of effects", file=file, field=f"{place}.indistinguishable_from")
        named = tuple(_rival(rival) for rival in rivals)
        for rival, other in named:
            if rival not in known or (other is not None and not 0 <= other <= n):
                raise InputError("no such effect at a joint of this arm", file=file,
                                 field=f"{place}.indistinguishable_from", value=rival[:60])
        found.append(Named(name, int(str(joint)), prefix_of(str(entry.get("channel", ""))), named))
    return Open(tuple(found), _undecided(values.get("undecided", []), n, file))


def _undecided(entries: Any, n: int, file: Any) -> tuple[int, ...]:
    if not isinstance(entries, list):
        raise InputError("expected a list of joints", file=file, field="undecided")
    joints: list[Any] = [entry.get("joint") if isinstance(entry, Mapping) else None for entry in entries]
    for joint in joints:
        if not _is_joint(joint, 1, n):
            raise InputError(f"expected a joint from 1 to {n}", file=file, field="undecided", value=str(joint)[:60])
    return tuple(sorted(set(joints)))


def _is_joint(value: Any, first: int, last: int) -> bool:
    """Whether a value is a joint's number; a truth value is none."""
    return isinstance(value, int) and not isinstance(value, bool) and first <= value <= last


def _rival(text: str) -> tuple[str, int | None]:
    match = _ELSEWHERE.fullmatch(text)
    return (match["name"], int(match["joint"])) if match else (text, None)


class Causes:
    """Fits what a diagnosis names to the recording of one domain.

    Args:
        problem: the regression of the domain.
        options: thresholds of the diagnosis.
    """

    def __init__(self, problem: Problem, options: Options) -> None:
        self.problem = problem
        self.model = PresentModel(problem)
        self.scoring = Scoring(self.model, options)

    def pairs(self, questions: Open) -> tuple[list[Pair], list[str]]:
        """The pairs of this domain that are open, and what could not be asked."""
        made, silent = self.problem.regression, list[str]()
        named = [one for one in questions.found if any(e.domain == made.domain for e in _effects(one.name, one.prefix))]
        taken: list[tuple[Named, Candidate]] = []
        for one in named:
            best = self.best(self.pool(_effects(one.name, one.prefix), one.joint))
            if best is None:
                silent.append(f"{one.name} at joint {one.joint} does not show in this recording")
                continue
            self.model.replace([*self.model.choices, best])
            taken.append((one, best))
        asked: list[Pair] = []
        for one, choice in taken:
            for rival, joint in one.rivals:
                pair = self._pair(choice, rival, joint)
                if pair is None:
                    silent.append(f"{rival} as a rival of {one.name} does not show in this recording")
                else:
                    asked.append(pair)
        return asked, silent

    def _pair(self, choice: Candidate, rival: str, joint: int | None) -> Pair | None:
        """The choice and its best rival of a name, each fitted in the other's place."""
        effects = [e for e in library() if e.name == rival and e.domain == self.problem.regression.domain]
        self.model.add_columns(choice)
        pool = [starts for starts in self.pool(effects, joint) if starts[0].place != choice.place]
        best = self.best(pool, choice)
        if best is None:
            return None
        fit = self.model.fit(choice)
        others = tuple(c for c in self.model.choices if c is not choice)
        return Pair(self._cause(choice, fit.gain(choice.key)[1]), self._cause(best, fit.gain(best.key)[1]), others,
                    self.model.weights, self.model.fit().inflation, self.problem.prior, self.problem.regression.domain)

    def best(self, pool: list[list[Candidate]], instead_of: Candidate | None = None) -> Candidate | None:
        """The candidate that takes most away, refined over theta; one that shares a channel with what it replaces."""
        fit = self.model.fit(*(() if instead_of is None else (instead_of,)))
        scored = [s for s in self.scoring.scored(fit, pool)
                  if instead_of is None or overlap(self.model, instead_of, s)]
        if not scored:
            return None
        return self.scoring.refined(fit, max(scored, key=lambda s: s.test.total))

    def pool(self, effects: Sequence[Effect], joint: int | None) -> list[list[Candidate]]:
        """Every start of the effects, at one joint or (None) at all."""
        made = self.problem.regression
        return [starts for starts in candidates(effects, made.signals, made.undecided, True)
                if joint is None or starts[0].joint == joint]

    def _cause(self, candidate: Candidate, coefficients: Array) -> Cause:
        return Cause(candidate, coefficients, thetas_of(candidate, self.problem.regression))


def undecided_joints(problem: Problem, robot: Robot, joints: Sequence[int]) -> list[Pair]:
    """Joints that moved too little: every cause of the library there, as large as the noise, against none.

    Args:
        problem: the regression of the motor torques.
        robot: the arm, whose speeds say where theta starts.
        joints: that moved too little, from 1.
    """
    made = problem.regression
    level = np.maximum(made.noise_floor, 1e-3 * np.std(made.measured, axis=0) + 1e-9)
    # The joint as it will move, so that what depends on range and speed begins somewhere.
    turn = np.linspace(0.0, 20.0 * np.pi, len(made.signals.t))[:, None]
    half = np.minimum(0.25 * (robot.q_max - robot.q_min), 1.0)
    signals = replace(made.signals, q=half * np.sin(turn), qd=0.5 * finite_limits(robot)[0] * np.cos(turn))
    asked = []
    for joint in joints:
        for effect in library():
            if effect.domain != MOTOR_TORQUE or effect.absorbed_by_base or effect.scanned:
                continue
            if joint not in set(effect.joints(signals)):
                continue
            starts = effect.starts(signals, joint)
            if not starts:
                continue  # of a partner axis where there is no other joint
            theta = starts[len(starts) // 2]
            cause = Cause(Candidate(effect, joint, theta), np.ones(len(effect.coefficient_names)), (theta,))
            asked.append(Pair(cause, None, (), 1.0 / level**2, 1.0, None))
    return asked


def thetas_of(candidate: Candidate, made: Regression) -> tuple[tuple[float, ...], ...]:
    """Values of theta a cause may take as a rival: the fitted one, about it, and where searches start."""
    effect, theta = candidate.effect, candidate.theta
    if not theta:
        return ((),)
    if effect.scanned:
        return (theta,)
    bounds = effect.bounds(made.signals, candidate.joint)
    # Without bounds theta is a choice, such as that of a partner axis, and not a number.
    near = [tuple(f * v for v in theta) for f in (0.5, 0.7, 1.4, 2.0)] if len(bounds) == len(theta) else []
    inside = [one for one in near if all(low <= v <= high for v, (low, high) in zip(one, bounds, strict=True))]
    return tuple(dict.fromkeys([theta, *inside, *effect.starts(made.signals, candidate.joint)]))


def _effects(name: str, prefix: str) -> list[Effect]:
    return [effect for effect in library() if effect.name == name and effect.channel_prefix == prefix]
