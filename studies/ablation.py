"""Which rules of the diagnosis earn their place: the same recordings, diagnosed with one rule at a time switched off.

A rule that did not act in a recording cannot change its diagnosis, which is deterministic; such pairs are not played.
Whether it acted is seen in the diagnosis with all rules: a flag that no one read where it differs from the default, a
step that changed nothing, a threshold without which the same candidates would have been large enough.
"""

from __future__ import annotations

import ast
import functools
import re
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, fields, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

import ideal_robot
from ideal_robot.diagnosis import Options, stages
from ideal_robot.diagnosis.case import Case, Findings
from ideal_robot.diagnosis.search import forward_selection
from ideal_robot.diagnosis.search.forward_selection import Search
from ideal_robot.diagnosis.search.scoring import Scoring
from ideal_robot.diagnosis.statistics.problem import Problem
from ideal_robot.diagnosis.validation.domain_diagnosis import DomainDiagnosis
from ideal_robot.effects import Effect, library
from ideal_robot.effects.fitted import Unknown
from ideal_robot.effects.friction import LawTerm, PreslidingHysteresis
from ideal_robot.effects.loads import GravitySpring
from ideal_robot.errors import IdealRobotError
from ideal_robot.identification.checks import checked
from ideal_robot.progress import silent
from ideal_robot.signals.sampling import shortened
from scenes.commands.common import numbers, whole_numbers
from studies.diagnoses import GAVE_UP, known_before
from studies.report import head, kept, row
from studies.strangers.arm import robot_of
from studies.strangers.score import Score, score
from studies.strangers.trial import Trial, draw_trial

FLAGS: dict[str, Any] = {"caution": 1.0}
"""Flags on ``Effect`` that change the behaviour of the search, with the value that switches them off. Those that one
step alone asks are switched off with it: ``sooner_than`` with ``likelier``, ``at_all_frequencies`` with
``holds_slowly``, ``of_slow_motion`` with ``share_slowly``."""
OPTIONS: dict[str, Callable[[Options], float]] = {
    "smallest_learned": lambda o: o.smallest, "smallest_torque": lambda o: 0.0, "smallest_beside": lambda o: 0.0,
    "smallest_own": lambda o: 0.0, "learned_discovery": lambda o: o.false_discovery,
    "unknown_margin": lambda o: 1.0}
"""Thresholds, with the value at which they say no more than the general one."""
_OF_SIZE = ("smallest_torque", "smallest_beside", "smallest_own")
"""Thresholds that only ``Scoring._is_large_here`` asks."""


@dataclass(frozen=True)
class Step:
    """A special case of the search.

    Attributes:
        owner, name: class or module, and its function.
        without: what takes its place, called with the function itself and its arguments.
        acted: whether a result differs from what would stand there without it, from the result and the arguments.
    """

    owner: Any
    name: str
    without: Callable[..., Any]
    acted: Callable[..., bool]


def _says(owner: Any, name: str, neutral: Any) -> Step:
    """A step that mostly says the same."""
    return Step(owner, name, lambda original, *a: neutral,
                lambda result, *a: result is not None if neutral is None else bool(result != neutral))


def _passes(owner: Any, name: str, which: int) -> Step:
    """A step that mostly hands on one of its arguments."""
    return Step(owner, name, lambda original, *a: a[which], lambda result, *a: result is not a[which])


STEPS = (
    *(Step(Search, name, lambda original, *a: None, lambda result, *a: bool(result))
      for name in ("_prune", "_retune")),
    _says(Search, "_with_needed_form", False), _passes(Search, "_sharpened", 2),
    _passes(forward_selection, "likelier", 0), _says(forward_selection, "indistinguishable", False),
    _says(Scoring, "holds_slowly", True),
    _says(Scoring, "holds_everywhere", True), _says(Scoring, "share_slowly", 0.0),
    Step(PreslidingHysteresis, "certain", lambda original, *a: Effect.certain(*a),
         lambda result, *a: bool(result != Effect.certain(*a))), _says(GravitySpring, "like_the_model", None),
    _says(stages, "_columns_changed", False), _passes(stages, "with_braking_friction", 1),
    Step(stages, "transferring", lambda original, problem, choices, *a: (list(choices), ()),
         lambda result, *a: bool(result[1])),
    _says(DomainDiagnosis, "_unsound", None), _says(DomainDiagnosis, "_worthless", None),
    _says(LawTerm, "at_standstill", False),
)
RULES = (*FLAGS, *OPTIONS, *(step.name for step in STEPS))


def _described(kind: type) -> dict[str, str]:
    """Meaning of each attribute, from a class's docstring."""
    text = (kind.__doc__ or "").partition("Attributes:")[2]
    attributes = re.findall(r"^        (\w+): (.*(?:\n            .*)*)", text, re.M)
    return {name: re.split(r"[;:.](?: |$)", re.sub(r"\s+", " ", words))[0] for name, words in attributes}


def meaning(rule: str) -> str:
    """What a rule is for, in its own documentation's words."""
    words = _described(Effect) | _described(Options)
    for step in STEPS:
        text = getattr(step.owner, step.name).__doc__ or ""
        words[step.name] = text.strip().partition("\n")[0].rstrip(".") or step.name
    return words[rule].replace("``", "`")


@contextmanager
def altered(owner: Any, name: str, value: Any) -> Iterator[None]:
    """An attribute with another value for a time."""
    own = vars(owner).get(name, altered)
    setattr(owner, name, value)
    try:
        yield
    finally:
        if own is altered:
            delattr(owner, name)
        else:
            setattr(owner, name, own)


def _setters(flag: str) -> list[type]:
    """Classes of effects that set a flag."""
    kinds = {kind for effect in (*library(), Unknown) for kind in
             (effect.mro() if isinstance(effect, type) else type(effect).mro())}
    return sorted((k for k in kinds if k is not Effect and flag in vars(k)), key=lambda k: k.__name__)


@contextmanager
def without(rule: str) -> Iterator[None]:
    """The diagnosis without a rule; of an option see ``_options``."""
    with ExitStack() as stack:
        if rule in FLAGS:
            for kind in _setters(rule):
                stack.enter_context(altered(kind, rule, FLAGS[rule]))
        for step in STEPS:
            if step.name == rule:
                stack.enter_context(altered(step.owner, step.name, _instead(step)))
        yield


def _instead(step: Step) -> Any:
    original = getattr(step.owner, step.name)

    def instead(*args: Any) -> Any:
        return step.without(original, *args)

    return instead


def _at(options: Options, rule: str) -> Options:
    changes: dict[str, Any] = {rule: OPTIONS[rule](options)}
    return replace(options, **changes)


def _options(rule: str) -> Options:
    """The thresholds without one of them."""
    options = Options()
    return _at(options, rule) if rule in OPTIONS else options


class _Read:
    """A flag that notes who reads it."""

    def __init__(self, value: Any, note: Callable[[], None]) -> None:
        self.value, self.note = value, note

    def __get__(self, instance: Any, owner: Any) -> Any:
        self.note()
        return self.value


@contextmanager
def watched() -> Iterator[set[str]]:
    """All rules, and which of them act."""
    active = set(OPTIONS) - set(_OF_SIZE)
    with ExitStack() as stack:
        for flag, neutral in FLAGS.items():
            for kind in _setters(flag):
                if vars(kind)[flag] != neutral:
                    note = functools.partial(active.add, flag)
                    stack.enter_context(altered(kind, flag, _Read(vars(kind)[flag], note)))
        for step in STEPS:
            stack.enter_context(altered(step.owner, step.name, _noting(step, getattr(step.owner, step.name), active)))
        stack.enter_context(altered(Scoring, "_is_large_here", _noting_sizes(Scoring._is_large_here, active)))
        yield active


def _noting(step: Step, original: Any, active: set[str]) -> Any:
    def noting(*args: Any) -> Any:
        search = args[0] if isinstance(args[0], Search) else None
        before = None if search is None else search.model.choices
        result = original(*args)
        if step.acted(result, *args) or (search is not None and search.model.choices is not before):
            active.add(step.name)
        return result

    return noting


def _noting_sizes(original: Any, active: set[str]) -> Any:
    def noting(scoring: Scoring, s: Any, replaced: Any) -> bool:
        large, options = bool(original(scoring, s, replaced)), scoring.options
        for rule in () if large else _OF_SIZE:
            scoring.options = _at(options, rule)
            if original(scoring, s, replaced):
                active.add(rule)
        scoring.options = options
        return large

    return noting


@contextmanager
def _kept_columns(signals: Any) -> Iterator[None]:
    """Columns of candidates about the prepared regression, computed once for all rules."""
    original, cached = Problem.columns, {}

    def columns(problem: Problem, candidate: Any) -> Any:
        alike = candidate.effect.learned or isinstance(candidate.effect, GravitySpring)
        if problem.regression.signals is not signals or alike:
            return original(problem, candidate)
        key = problem.band, candidate.key
        if key not in cached:
            cached[key] = original(problem, candidate)
        return cached[key]

    with altered(Problem, "columns", columns):
        yield


_STAGES = (stages.effects_of_motor_torque, stages.found_but_not_added, stages.joint_fit,
           stages.effects_of_other_channels)
"""What a diagnosis goes through after its regression stands."""


def said(case: Case, found: Findings) -> SimpleNamespace:
    """What is named after a search about a prepared regression; what is left above the noise is not looked at."""
    for stage in _STAGES:
        found = stage(case, found)
    fits = [SimpleNamespace(fitted=one)
            for domain in found.domains for one in domain.final.all_fitted(domain.reported.prismatic)]
    named, unknown = ([fit for fit in fits if fit.fitted.effect.learned is learned] for learned in (False, True))
    return SimpleNamespace(verdict="unknown" if unknown else "effects" if named else "none", effects=named,
                           unknown=unknown)


def _played(trial: Trial) -> Iterator[tuple[str, Score]]:
    """The score of a trial with all rules (empty name), then without each rule that acted."""
    with robot_of(trial.urdf) as robot:
        model = known_before(trial, robot)
        (recording,), _ = checked([shortened(trial.recording)[0]], robot)

        def case(rule: str) -> Case:
            return Case(recording, robot, model, None, _options(rule), silent, True, None)

        state = stages.baseline(case(""), stages.prepared(case(""), ()))
        with _kept_columns(state.problem.regression.signals):
            with watched() as active:
                yield "", score(trial, said(case(""), state))
            for rule in RULES:
                if rule in active:
                    try:
                        with without(rule):
                            yield rule, score(trial, said(case(rule), state))
                    except (IdealRobotError, ArithmeticError, ValueError):
                        yield rule, score(trial, GAVE_UP)


def ablation(seeds: str = "993100-993123", sizes: str = "3,10", lines: Path = Path("ablation.jsonl")) -> None:
    """Each flag, threshold and special case of the diagnosis switched off alone, on the same recordings.

    Trials as in `strangers`, of 15 to 25 s; each score is a line of --lines, and seeds that stand there are not played
    again. Differences are those of the pairs, with their standard error.
    """
    least, most = numbers(sizes, "--sizes")

    def play(seed: int) -> dict[str, dict[str, Any]]:
        trial = draw_trial(seed, None, None, (least, most), (15.0, 25.0))
        return {rule: result.to_dict() for rule, result in _played(trial)}

    _table([{rule: Score.from_dict(entry) for rule, entry in scores.items()}
            for scores in kept(lines, whole_numbers(seeds, "--seeds"), play)])


def _table(played: list[dict[str, Score]]) -> None:
    """What the trials say of each rule."""
    head("rule", "means", "acted in", "changed", "right", "false names", "empty left alone",
         "intervals that hold")
    whole = [trial[""] for trial in played]
    empty = [k for k, s in enumerate(whole) if s.kind == "none"]
    row("with all", f"{len(whole)} recordings, {len(empty)} of them empty", "", "", sum(s.right for s in whole),
        sum(len(s.false) for s in whole), sum(whole[k].right for k in empty),
        f"{sum(map(_held, whole))} of {sum(len(s.covered) for s in whole)}")
    for rule in RULES:
        other = [trial.get(rule, trial[""]) for trial in played]
        changed = sum((a.named, a.unknown) != (b.named, b.unknown) for a, b in zip(whole, other, strict=True))
        right, false, held = (np.array([f(b) - f(a) for a, b in zip(whole, other, strict=True)], dtype=float)
                              for f in (lambda s: s.right, lambda s: len(s.false), _held))
        row(f"`{rule}`", meaning(rule), sum(rule in trial for trial in played), changed, _summed(right), _summed(false),
            _summed(right[empty]), _summed(held))


def _held(s: Score) -> int:
    """How many 95 % intervals hold the truth."""
    return sum(abs(error) <= 1.96 for _, error in s.covered)


def _summed(differences: np.ndarray) -> str:
    """The sum of differences with its standard error."""
    if not np.any(differences):
        return "0"
    return f"{differences.sum():+.0f} ± {np.std(differences, ddof=1) * np.sqrt(len(differences)):.1f}"


def rules() -> None:
    """Flags of effects, thresholds and module-level numbers of the diagnosis: how many, who sets them.

    Counted from the source: what a rule is for says its documentation, what it is worth the study `ablation`.
    """
    head("flag of `Effect`", "set by", "means")
    flags = [name for name in _described(Effect) if isinstance(vars(Effect).get(name), (bool, int, float, tuple))
             and not name.endswith(("_names", "_units")) and name not in ("within", "discriminating_motion")]
    for name in flags:
        row(f"`{name}`", ", ".join(kind.__name__ for kind in _setters(name)), _described(Effect)[name])
    head("option", "value", "means")
    for option in fields(Options):
        row(f"`{option.name}`", option.default, _described(Options)[option.name])
    root = Path(ideal_robot.__file__).parent
    by_file = {file: _numbers(file) for file in sorted((root / "diagnosis").rglob("*.py"))}
    head("file", "lines", "module-level numbers")
    for file, names in by_file.items():
        row(f"`{file.relative_to(root)}`", len(file.read_text(encoding="utf-8").splitlines()), ", ".join(names))
    row(f"{len(flags)} flags, {len(fields(Options))} options",
        sum(len(file.read_text(encoding="utf-8").splitlines()) for file in by_file), sum(map(len, by_file.values())))


def _numbers(file: Path) -> list[str]:
    """Names of a module's constants that hold a number."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    return [target.id for node in tree.body if isinstance(node, (ast.Assign, ast.AnnAssign)) and node.value is not None
            for target in (node.targets if isinstance(node, ast.Assign) else [node.target])
            if isinstance(target, ast.Name) and target.id.lstrip("_").isupper()
            and any(isinstance(n, ast.Constant) and isinstance(n.value, (int, float)) for n in ast.walk(node.value))]
