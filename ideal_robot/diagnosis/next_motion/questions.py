"""Open questions of a diagnosis: causes that it did not distinguish, and joints with too little motion."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np

from ideal_robot.diagnosis.best_set import BestSet
from ideal_robot.diagnosis.causes import Candidate, candidates
from ideal_robot.diagnosis.channels.regression import Regression, rms
from ideal_robot.diagnosis.next_motion.separation import Cause, Pair
from ideal_robot.diagnosis.statistics.problem import Problem
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
        prefix: prefix of its channel.
        rivals: names of causes that the data do not distinguish from it, with the joint where it differs.
    """

    name: str
    joint: int
    prefix: str
    rivals: tuple[tuple[str, int | None], ...] = ()

    @property
    def effects(self) -> list[Effect]:
        """Effects of the library with this name."""
        return [e for e in library() if e.name == self.name and e.channel_prefix == self.prefix]


@dataclass(frozen=True)
class Open:
    """The findings and open questions of a diagnosis.

    Attributes:
        found: the causes it names, in its order.
        undecided: joints (from 1) that moved too little.
    """

    found: tuple[Named, ...] = ()
    undecided: tuple[int, ...] = ()

    @property
    def asks(self) -> bool:
        """Whether there is an open question."""
        return bool(self.undecided) or any(named.rivals for named in self.found)


def open_questions(diagnosis: Diagnosis) -> Open:
    """The findings and open questions of a diagnosis."""
    causes = tuple(Named(effect.fitted.name, effect.fitted.joint, prefix_of(effect.fitted.channel),
                         tuple(map(_rival, effect.indistinguishable_from))) for effect in diagnosis.effects)
    return Open(causes, tuple(sorted(diagnosis.undecided)))


def read_questions(values: Any, n: int, file: Any = None) -> Open:
    """The findings and open questions from the JSON of ``diagnose``.

    Args:
        values, n: its content, and joints of the arm.
        file: the file that it was read from, for messages.

    Raises:
        InputError: it is no such content, or of another arm or version.
    """
    def require(holds: bool, words: str, field: str, value: str | None = None) -> None:
        if not holds:
            raise InputError(words, file=file, field=field, value=value and value[:60])

    require(isinstance(values, Mapping) and isinstance(values.get("effects"), list),
            "expected the JSON that ideal-robot diagnose --json wrote", "effects")
    known, causes = set(names()), []
    for i, entry in enumerate(values["effects"]):
        place = f"effects.{i}"
        require(isinstance(entry, Mapping), "expected an effect with name and joint", place)
        name, joint, rivals = entry.get("effect"), entry.get("joint"), entry.get("indistinguishable_from", [])
        require(isinstance(name, str) and name in known, f"no such effect; known are {', '.join(sorted(known))}",
                f"{place}.effect", str(name))
        require(_is_joint(joint, 0, n), f"expected a joint from 0 (the whole arm) to {n}", f"{place}.joint", str(joint))
        require(isinstance(rivals, list) and all(isinstance(rival, str) for rival in rivals),
                "expected a list of effects", f"{place}.indistinguishable_from")
        named = tuple(map(_rival, rivals))
        for rival, other in named:
            require(rival in known and (other is None or 0 <= other <= n), "no such effect at a joint of this arm",
                    f"{place}.indistinguishable_from", rival)
        causes.append(Named(name, joint, prefix_of(str(entry.get("channel", ""))), named))
    undecided = values.get("undecided", [])
    require(isinstance(undecided, list), "expected a list of joints", "undecided")
    joints: list[Any] = [entry.get("joint") if isinstance(entry, Mapping) else None for entry in undecided]
    for joint in joints:
        require(_is_joint(joint, 1, n), f"expected a joint from 1 to {n}", "undecided", str(joint))
    return Open(tuple(causes), tuple(sorted(set(joints))))


def _is_joint(value: Any, first: int, last: int) -> bool:
    """Whether a value is a joint's number; a truth value is none."""
    return isinstance(value, int) and not isinstance(value, bool) and first <= value <= last


def _rival(text: str) -> tuple[str, int | None]:
    match = _ELSEWHERE.fullmatch(text)
    return (match["name"], int(match["joint"])) if match else (text, None)


class Causes:
    """Fits a diagnosis's causes to the recording of one domain.

    Args:
        problem: the regression of the domain.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem, self.best = problem, BestSet(problem, [], absorbed=True)

    def pairs(self, questions: Open) -> tuple[list[Pair], list[str]]:
        """The open pairs of this domain, and questions that could not be posed."""
        domain = self.problem.regression.domain
        pairs, silent, chosen = list[Pair](), list[str](), list[tuple[Named, Candidate]]()
        for named in questions.found:
            effects = named.effects
            if not any(effect.domain == domain for effect in effects):
                continue
            best = self._best(effects, named.joint)
            if best is None:
                silent.append(f"{named.name} at joint {named.joint} does not show in this recording")
                continue
            self.best.take([*self.best.choices, best])
            chosen.append((named, best))
        for named, choice in chosen:
            for rival, joint in named.rivals:
                best = self._best([e for e in library() if e.name == rival and e.domain == domain], joint, choice)
                if best is None:
                    silent.append(f"{rival} as a rival of {named.name} does not show in this recording")
                else:
                    pairs.append(self._pair(choice, best))
        return pairs, silent

    def _pair(self, choice: Candidate, rival: Candidate) -> Pair:
        """The two, each fitted in the other's place."""
        regression, rest = self.problem.regression, [c for c in self.best.choices if c is not choice]
        keys = ["W", *[c.key for c in rest]]
        fitted = self.best.system.posterior(keys)
        cause, other = (Cause(c, self.best.joined(c, fitted, keys).mean, _thetas_of(c, regression))
                        for c in (choice, rival))
        level = rms(self.best.fit_of(self.best.choices).residual(regression), regression.use)
        weights = np.where(level > 0.0, 1.0 / np.maximum(level, 1e-300) ** 2, 0.0)
        colours = [channel.noise.colour for channel in self.best.system.channels if channel.use.any()]
        return Pair(cause, other, tuple(rest), weights, max(float(np.median(colours)), 1.0), self.problem.root,
                    regression.domain)

    def _best(self, effects: Sequence[Effect], joint: int | None, own: Candidate | None = None) -> Candidate | None:
        """The candidate that lowers the residual most, theta refined; None where there is none.

        Args:
            effects: which may be candidates.
            joint: at this joint; None for all.
            own: the choice that it takes the place of, whose place is then left out.
        """
        self.best.pool = [starts for starts in candidates(effects, self.problem.regression.signals, True)
                          if joint in (None, starts[0].joint) and (own is None or starts[0].place != own.place)]
        ranked = self.best.ranked(own, 1, anywhere=True, least=-np.inf)
        return ranked[0].candidate if ranked else None


def undecided_joints(problem: Problem, robot: Robot, joints: Sequence[int]) -> list[Pair]:
    """Questions about joints that moved too little: does the joint have a cause, or none?

    Each pair is one cause of the library, as large as the noise, and nothing in its place.

    Args:
        problem, robot: the motor torques, and the arm, whose speeds say where theta starts.
        joints: numbers of the joints that moved too little, from 1.
    """
    regression = problem.regression
    level = np.maximum(regression.noise_floor, 1e-3 * np.std(regression.measured, axis=0) + 1e-9)
    # The joint as it will move, so that effects that depend on range and speed have start values.
    turn = np.linspace(0.0, 20.0 * np.pi, len(regression.signals.t))[:, None]
    half = np.minimum(0.25 * (robot.q_max - robot.q_min), 1.0)
    signals = replace(regression.signals, q=half * np.sin(turn), qd=0.5 * finite_limits(robot)[0] * np.cos(turn))
    pairs = []
    effects = [e for e in library() if e.domain == MOTOR_TORQUE and not (e.absorbed_by_base or e.scanned)]
    for joint, effect in product(joints, effects):
        starts = effect.starts(signals, joint) if joint in effect.joints(signals) else ()
        if not starts:
            continue  # an effect with a partner axis, but there is no other joint
        theta = starts[len(starts) // 2]
        cause = Cause(Candidate(effect, joint, theta), np.ones(len(effect.coefficient_names)), (theta,))
        pairs.append(Pair(cause, None, (), 1.0 / level**2, 1.0, None))
    return pairs


def _thetas_of(candidate: Candidate, regression: Regression) -> tuple[tuple[float, ...], ...]:
    """Values of theta a cause may take as a rival: the fitted one, about it, and where searches start."""
    effect, theta = candidate.effect, candidate.theta
    if not theta or effect.scanned:
        return (theta,)
    bounds = effect.bounds(regression.signals, candidate.joint)
    # Without bounds theta is a choice, such as that of a partner axis, not a number.
    near = [tuple(f * v for v in theta) for f in (0.5, 0.7, 1.4, 2.0)] if len(bounds) == len(theta) else []
    inside = [trial for trial in near if all(low <= v <= high for v, (low, high) in zip(trial, bounds, strict=True))]
    return tuple(dict.fromkeys([theta, *inside, *effect.starts(regression.signals, candidate.joint)]))
