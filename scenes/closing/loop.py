"""``close-loop``: find what the model lacks, add it, run again, keep or reject it; and the rule for keeping it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.diagnosis import Diagnosis
from ideal_robot.effects import FittedEffect
from ideal_robot.errors import IdealRobotError
from ideal_robot.model.model import Model
from ideal_robot.progress import Steps
from ideal_robot.registry import in_words
from ideal_robot.signals.recording import Recording
from ideal_robot.whole_file import OutputError
from scenes.result import Progress, part_of, silent
from scenes.scene_files.scene import SceneError

PIECES = 20
"""10 to 30 give a mean's scatter nearly all the degrees of freedom that it can use, and leave pieces long enough to be
independent (Schmeiser 1982, Batch size effects in the analysis of simulation output, Operations Research 30)."""
REPEATS = 0.03
"""Relative change of a path error with gears that are one kelvin warmer or colder, root mean square over arms of the
random closings (every ninth of seeds 1000 to 1099, nothing undeclared: 4.0 % and 1.7 %)."""


@dataclass(frozen=True)
class Comparison:
    """Measured error of the same motion without and with a change, which is kept where it falls by a standard error.

    Both runs follow the same motion, so they are compared segment by segment. What is compared is the logarithm of the
    ratio of the errors of the whole motion,

        θ = log(E_after / E_before) ,

    and its standard error contains two independent parts:

    - along the motion: that of the jackknife over ``PIECES`` pieces of equal length, the ratio with one piece after the
      other left out (Efron & Tibshirani 1993, An Introduction to the Bootstrap, 11). It holds the noise of both plays,
      and how unlike the change acts from place to place;
    - from play to play: ``REPEATS``, by which the error of an arm and a model that nobody touched differs.

    One standard error is what a simpler model is given up for (Breiman, Friedman, Olshen & Stone 1984, Classification
    and Regression Trees, 3.4.3). A change that acts alike everywhere has to do little; one that takes in one piece what
    it gives in another has to do much.

    Attributes:
        before, after: root mean square of the deviation [SI]; infinite where nothing was measured.
        t: logarithm of their ratio over its standard error; negative where the error falls.
    """

    before: float
    after: float
    t: float

    @classmethod
    def of(cls, before: Array, after: Array) -> Comparison:
        """Compares the measured deviations of two runs.

        Args:
            before: deviations ``(N,)`` or ``(N, c)`` in order of time, as they are measured without the change [SI].
            after: likewise with it ``(M,)`` or ``(M, c)``; the same share of the rows is the same piece of the motion.
        """
        count = min(PIECES, len(before), len(after))
        if count < 2:
            return cls(_rms(before), _rms(after), -np.inf if len(after) else np.inf)
        own = np.array([[_rms(piece) ** 2 * len(piece) / len(rows) for piece in np.array_split(rows, count)]
                        for rows in (before, after)]) + 1e-300
        without = 0.5 * np.diff(np.log(own.sum(axis=1, keepdims=True) - own), axis=0)
        theta = 0.5 * float(np.diff(np.log(own.sum(axis=1)))[0])
        return cls(_rms(before), _rms(after), theta / float(np.hypot(np.sqrt((count - 1) * np.var(without)), REPEATS)))

    @property
    def falls(self) -> bool:
        """Whether the error falls by more than one standard error."""
        return self.t < -1.0

    @property
    def rises(self) -> bool:
        """Whether the error rises by more than one standard error."""
        return self.t > 1.0

    def reason(self, scale: float, unit: str) -> str:
        """Why a change with this comparison is rejected; ``scale`` converts the error's ``unit`` to SI."""
        size = f"{scale * self.before:.3g} to {scale * self.after:.3g} {unit}"
        if self.after >= self.before:
            return f"the measured error does not fall: {size}"
        return f"the measured error falls by {-self.t:.1f} standard errors, one is asked for: {size}"


def _rms(deviation: Array) -> float:
    if not len(deviation):
        return float("inf")
    return float(np.sqrt(np.sum(np.square(deviation, dtype=float)) / len(deviation)))


ROUNDS = 4
"""Of finding and trying, at most: a camera that is wrong by some percent is found with some percent of that left."""
MODEL = "extended_model.json"
"""File of the extended model in the output folder."""
SHARES_OF_ROUND = {"finding": 0.7, "trying": 0.15, "asking": 0.15}
"""Measured shares of a round's time."""
_LEFT = 0.4
"""Share of the rounds' time that a round leaves to those after it, which need not come."""

R = TypeVar("R")
"""One play of what is closed."""
Place = tuple[str, int]
"""Name of an effect and its joint, from 1; 0 for none of them."""


@dataclass(frozen=True)
class Form:
    """One form of a change of the model, to be tried.

    Attributes:
        label: name of the change.
        change: makes the changed model from the present one and the run with it.
        places: effects that it adds; none where it only fits parameters anew.
    """

    label: str
    change: Callable[[Model, Any], Model]
    places: tuple[Place, ...] = ()

    @classmethod
    def adding(cls, label: str, effects: Sequence[FittedEffect]) -> Form:
        """The form that adds effects to the model."""
        return cls(label, lambda model, _: model.with_effects(tuple(effects)), places_of(effects))


Forms = tuple[Form, ...]
"""Forms of one change; the first that passes its trial is accepted."""


def places_of(effects: Sequence[FittedEffect]) -> tuple[Place, ...]:
    """Name and joint of each effect."""
    return tuple((effect.name, effect.joint) for effect in effects)


def said(name: str, joint: int) -> str:
    """Name of an effect with its joint, for people."""
    return in_words(name) + (f" in joint {joint}" if joint else "")


@dataclass(frozen=True)
class Group:
    """Changes that are tried together and, where that is rejected, one after the other."""

    together: Forms
    apart: tuple[Forms, ...] = ()

    @classmethod
    def adding(cls, effects: Sequence[FittedEffect]) -> Group:
        """A group that adds effects to the model, together and each alone."""
        label = " and ".join(dict.fromkeys(in_words(effect.name) for effect in effects))
        together = (Form.adding(label, effects),) if len(effects) > 1 else ()
        return cls(together, tuple((Form.adding(said(effect.name, effect.joint), (effect,)),) for effect in effects))


@dataclass(frozen=True)
class Step:
    """One change of the model, with the result of its trial or the reason for none.

    Attributes:
        tried: the change.
        refused: why it does not stay; empty where it does.
        error: measured error with it [SI]; NaN without a run.
        places: effects that it would add.
        round: from 1.
    """

    tried: str
    refused: str
    error: float = float("nan")
    places: tuple[Place, ...] = ()
    round: int = 0

    @property
    def taken(self) -> bool:
        """Whether the change is kept in the model."""
        return not self.refused


@dataclass(frozen=True)
class Found:
    """The result of a motion: the diagnosis (None where what is missing was measured), and the changes to try."""

    diagnosis: Diagnosis | None
    recording: Recording
    groups: tuple[Group, ...] = ()
    refused: tuple[Step, ...] = ()


class Subject(ABC, Generic[R]):
    """Interface of a kind of scene to ``close-loop``: it runs its motion, diagnoses the model and measures errors."""

    unit, scale = "mm", 1e3
    """Of the measured error as it is told, and what it is times the SI unit."""

    @abstractmethod
    def play(self, model: Model) -> R:
        """Runs the motion with a model; raises ``IdealRobotError`` where that is not possible."""

    @abstractmethod
    def find(self, model: Model, run: R, progress: Progress) -> Found:
        """Diagnoses what the model lacks, from the last run or from a motion of its own.

        Args:
            model: the present one.
            run: the run with it.
            progress: called with the fraction done.
        """

    @abstractmethod
    def readings(self, before: R, after: R, known: Model, model: Model) -> list[tuple[Array, Array]]:
        """Measured deviations ``(N,)`` or ``(N, c)`` of two runs [SI]: a pair for every reading that the data permit.

        Such as one for each error that the recorded torques of the gears may have.

        Args:
            before, after: the runs with the present model and with the changed one.
            known, model: these models.
        """

    def foreseen(self, forms: Forms, models: list[Model], model: Model, run: R) -> tuple[list[int], str]:
        """Indices of the forms to run, the most promising first; and why none is run, if there are none.

        Args:
            forms: of one change.
            models: changed by each.
            model: the present one.
            run: the run with it.
        """
        return list(range(len(forms))), ""

    def asked(self, found: Found, model: Model, run: R, progress: Progress) -> Found | None:
        """The result of a further motion after a round without success; None where there is none.

        Args:
            found: in this round.
            model: the present one.
            run: the run with it.
            progress: called with the fraction done.
        """
        return None


@dataclass
class Closed(Generic[R]):
    """Present state of ``close-loop``: the model, its run, every trial, and the last findings.

    ``first`` is the deciding error with the original model [SI].
    """

    subject: Subject[R]
    model: Model
    run: R
    first: float = float("nan")
    steps: list[Step] = field(default_factory=list)
    found: list[Found] = field(default_factory=list)

    def try_all(self, found: Found) -> bool:
        """Tries all proposed changes; whether any of them is kept."""
        present = self.model
        self.found.append(found)
        self.steps += found.refused
        for group in found.groups:
            if not (group.together and self._one_of(group.together)):
                for forms in group.apart:
                    self._one_of(forms)
        return self.model is not present

    def _one_of(self, forms: Forms) -> bool:
        try:
            models = [form.change(self.model, self.run) for form in forms]
        except IdealRobotError as failed:
            return self._note(forms[0], f"cannot be fitted: {failed}")
        order, reason = self.subject.foreseen(forms, models, self.model, self.run)
        return any(self._tried(forms[k], models[k]) for k in order) if order else self._note(forms[0], reason)

    def _tried(self, form: Form, model: Model) -> bool:
        try:
            run = self.subject.play(model)
            readings = [Comparison.of(*pair) for pair in self.subject.readings(self.run, run, self.model, model)]
        except IdealRobotError as failed:
            return self._note(form, f"cannot be played: {failed}")
        # For every interpretation of what is not measured, the error has to fall.
        worst = max(readings, key=lambda reading: reading.t)
        if not worst.falls:
            return self._note(form, worst.reason(self.subject.scale, self.subject.unit), worst.after)
        self.model, self.run = model, run
        return self._note(form, "", readings[0].after)

    def _note(self, form: Form, refused: str, error: float = float("nan")) -> bool:
        self.steps.append(Step(form.label, refused, error, form.places))
        return not refused


def close(subject: Subject[R], model: Model, run: R, *, rounds: int = ROUNDS, out: Path | None = None,
          progress: Progress = silent) -> Closed[R]:
    """Repeats finding and trying until no change is kept; returns the final state.

    Args:
        subject: the scene's runs and measurements.
        model: as it was.
        run: the run with it.
        rounds: at most.
        out: folder that holds the model of each round that is done; nothing is written without.
        progress: called with the fraction done.

    Raises:
        SceneError: interrupted, or no room to write, in a round; says which model the folder holds.
    """
    closed, last = Closed(subject, model, run), 0
    for round_ in range(1, rounds + 1):
        before_it, steps = 1.0 - _LEFT ** (round_ - 1), len(closed.steps)
        within = Steps(part_of(progress, before_it, (1.0 - _LEFT) * (1.0 - before_it)), SHARES_OF_ROUND)
        try:
            finding = subject.find(closed.model, closed.run, within.begin("finding", f"round {round_}: diagnosis"))
            closed.first = closed.first if last else Comparison.of(*subject.readings(run, run, model, model)[0]).before
            within.begin("trying", f"round {round_}: what was found is tried")
            stays = closed.try_all(finding)
            if not stays:
                # Before giving up, another motion may distinguish the causes that this one does not.
                answer = subject.asked(finding, closed.model, closed.run, within.part("asking"))
                stays = answer is not None and closed.try_all(answer)
            if stays and out is not None:
                closed.model.save(out / MODEL)
        except (KeyboardInterrupt, SystemExit, OutputError) as ended:
            outcome = f"{out / MODEL} is the model of round {last}" if out is not None and last else \
                "no round was done, the model is as it was"
            why = f"{ended}; ended" if isinstance(ended, OutputError) else "interrupted"
            raise SceneError(f"{why} in round {round_}; {outcome}") from ended
        closed.steps[steps:] = [replace(step, round=round_) for step in closed.steps[steps:]]
        if not stays:
            break
        last = round_
    return closed
