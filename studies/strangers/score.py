"""The strict score: named at its joint, and nothing else named anywhere.

An empty recording is right only where nothing is named and the verdict is not ``effects`` or ``unknown``. What is
outside the library is right only as ``unknown`` at its joint. What the healthy arm truly has may be named beside it.
Two effects are right only both.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.optimize import minimize
from scipy.special import expit, logit

from studies.strangers.trial import LATE, Trial


@dataclass(frozen=True)
class Score:
    """One trial, as plain values.

    Attributes:
        seed, kind, engine, arm, motion, logger, controller, friction, gears: of the trial.
        causes: name, joint, size of each.
        verdict: as said.
        named: effects said, names with joints.
        unknown: joints of learned terms.
        false: what was said and is not there, ``unknown`` included.
        found: for each cause, whether it was said.
        right: everything, and nothing else.
        covered: for each parameter that can be compared, its error over its standard deviation.
        seconds: processor time of the diagnosis.
        small: of ``named`` those that are said to be too small to matter.
        told: for each cause, whether it was said, and not as too small to matter.
        probabilities: for each of ``named`` how probable it is said to be, and whether it, or what it is said not to
            be told from, is there.
    """

    seed: int
    kind: str
    engine: str
    arm: str
    motion: str
    logger: str
    controller: str
    friction: str
    gears: str
    causes: tuple[tuple[str, int, float], ...]
    verdict: str
    named: tuple[tuple[str, int], ...]
    unknown: tuple[int, ...]
    false: tuple[tuple[str, int], ...]
    found: tuple[bool, ...]
    right: bool
    covered: tuple[tuple[str, float], ...]
    seconds: float
    probabilities: tuple[tuple[float, bool], ...] = ()
    small: tuple[tuple[str, int], ...] = ()
    told: tuple[bool, ...] = ()

    @property
    def said(self) -> tuple[tuple[str, int], ...]:
        """All names with their joints, ``unknown`` among them."""
        return (*self.named, *(("unknown", j) for j in self.unknown))

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return asdict(self)

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Score:
        """Reads what ``to_dict`` wrote."""
        def deep(value: Any) -> Any:
            return tuple(deep(v) for v in value) if isinstance(value, list) else value

        return cls(**{name: deep(value) for name, value in values.items()})


def score(trial: Trial, diagnosis: Any, seconds: float = 0.0) -> Score:
    """Compares what was said with what is there.

    Args:
        trial: as drawn.
        diagnosis: the result of ``ideal_robot.diagnosis.diagnose``, or anything with verdict, effects and unknown.
        seconds: processor time it took.
    """
    loud, model = [e.fitted for e in diagnosis.effects], getattr(diagnosis, "model", None)
    # What is too small to matter is said in a sentence, and stands in the model.
    quiet = [] if model is None else [e for e in model.effects if e not in loud and not e.effect.learned]
    named, small = (tuple((said_name(str(e.name), str(e.channel)), int(e.joint)) for e in group)
                    for group in ([*loud, *quiet], quiet))
    unknown = tuple(int(u.fitted.joint) for u in diagnosis.unknown)
    said = [*named, *(("unknown", j) for j in unknown)]
    true = frozenset().union(*(c.right for c in trial.causes)) if trial.causes else frozenset()
    found = tuple(any(s in c.right for s in said) for c in trial.causes)
    told = tuple(any(s in c.right and s not in small for s in said) for c in trial.causes)
    false = tuple(s for s in said if s not in true and s not in trial.healthy)
    right = all(found) and not false
    if not trial.causes and not said and diagnosis.verdict not in ("none", "undecided"):
        right = False
    covered, compared = [], set()
    # What all torques are late by alike is a part of a joint's delay where it has no name of its own.
    common = 0.0 if {(name, 0) for name in LATE} & set(named) else trial.late
    for effect in diagnosis.effects:
        # Of several orders of one ripple the first, largest one is the one drawn; the others are its multiples.
        place = effect.fitted.name, effect.fitted.joint, effect.fitted.channel
        if place in compared:
            continue
        compared.add(place)
        for p in effect.fitted.parameters:
            truth = trial.values.get((effect.fitted.name, effect.fitted.joint, p.name))
            if truth is not None and p.std > 0.0:
                truth += common if effect.fitted.name == "dead_time" else 0.0
                covered.append((f"{effect.fitted.name}: {p.name}", float((p.value - truth) / p.std)))
    return Score(trial.seed, trial.kind, trial.engine, trial.arm, trial.motion, trial.logger, trial.controller,
                 trial.friction, trial.gears, tuple((c.name, c.joint, c.size) for c in trial.causes),
                 str(diagnosis.verdict), named, unknown, false, found, bool(right), tuple(covered), seconds,
                 _probabilities(diagnosis, true | trial.healthy), small, told)


def _probabilities(diagnosis: Any, true: frozenset[tuple[str, int]]) -> tuple[tuple[float, bool], ...]:
    """Of each cause that was named: its probability, and whether it or one it is not told from is there."""
    result = []
    for effect in diagnosis.effects:
        if not hasattr(effect, "probability"):
            continue
        alike, fitted = {effect.fitted.name, *getattr(effect, "indistinguishable_from", ())}, effect.fitted
        right = any((said_name(name, fitted.channel), joint) in true for name in alike for joint in (fitted.joint, 0))
        result.append((float(effect.probability), right))
    return tuple(result)


def said_name(name: str, channel: str) -> str:
    """Name of an effect with where it was seen: ``arm:`` in the arm's angles, ``tool:`` in the tool's place."""
    if channel.startswith("qa"):
        return f"arm:{name}"
    return f"tool:{name}" if channel and channel[0] in "xyz" else name


SIZES = (0.2, 0.5, 1.0, 2.0, 3.0, 5.0, 10.0)
"""Edges of the power curve, in multiples of visible."""
VISIBLE = 3.0
"""Size from which on the rates that were asked for hold."""
_QUIET = 0.98
"""Share of empty recordings that are to be left alone."""
SINGLE = ("inside", "new", "model", "arm")


def rates(scores: Sequence[Score]) -> str:
    """Markdown table of the rates, all engines together and each by itself."""
    columns = {engine: [s for s in scores if s.engine == engine] for engine in sorted({s.engine for s in scores})}
    columns = columns if len(columns) == 1 else {"all": list(scores), **columns}
    lines = [f"| what | {' | '.join(columns)} |", "| --- |" + " --- |" * len(columns)]

    def row(name: str, value: Callable[[list[Score]], str]) -> None:
        lines.append(f"| {name} | " + " | ".join(map(value, columns.values())) + " |")

    def single(group: list[Score]) -> list[bool]:
        return [s.right for s in group if s.kind in SINGLE]

    row("recordings", lambda g: str(len(g)))
    row("empty ones left alone", lambda g: _share(s.right for s in g if s.kind == "none"))
    row("false names per recording", lambda g: _mean(len(s.false) for s in g))
    row("false names per empty recording", lambda g: _mean(len(s.false) for s in g if s.kind == "none"))
    row("one effect of any size, right and nothing else", lambda g: _share(single(g)))
    row(f"one effect ≥ {VISIBLE:g} × visible, right and nothing else", lambda g: _share(single(_large(g))))
    row("the same, and not as too small to matter", lambda g: _share(
        s.right and all(s.told) for s in _large(g) if s.kind in SINGLE))
    row(f"one effect ≥ {VISIBLE:g} ×, named at its joint whatever else", lambda g: _share(
        all(s.found) for s in _large(g) if s.kind in SINGLE))
    row(f"outside the library ≥ {VISIBLE:g} ×, unknown, and no name of what is not there", lambda g: _share(
        s.right for s in _large(g) if s.kind == "outside"))
    row("the same, and no name at all", lambda g: _share(
        s.right and not s.named for s in _large(g) if s.kind == "outside"))
    row(f"two effects ≥ {VISIBLE:g} ×, both and nothing else", lambda g: _share(
        s.right for s in _large(g) if s.kind == "two"))
    row("95 % intervals that hold the truth", lambda g: _share(abs(error) <= 1.96 for s in g for _, error in s.covered))
    row("processor time of a diagnosis [s]", lambda g: _mean(s.seconds for s in g))
    return "\n".join(lines)


def power(scores: Sequence[Score]) -> str:
    """Markdown table of finding one effect of the library, right and nothing else, over its size, by engine."""
    single = [s for s in scores if s.kind in SINGLE]
    engines = sorted({s.engine for s in single})
    lines = [f"| size, × visible | effects | named at its joint | and nothing else | {' | '.join(engines)} |",
             "| --- | --- | --- | --- |" + " --- |" * len(engines)]
    for low, high in zip((0.0, *SIZES), (*SIZES, np.inf), strict=True):
        here = [s for s in single if low <= s.causes[0][2] < high]
        if here:
            cells = [_share(s.right for s in here if s.engine == engine) for engine in engines]
            lines.append(f"| {low:g} … {high:g} | {len(here)} | {_share(all(s.found) for s in here)} | "
                         f"{_share(s.right for s in here)} | {' | '.join(cells)} |")
    return "\n".join(lines)


def detection(scores: Sequence[Score], family_of: Callable[[str], str], title: str = "family") -> str:
    """Markdown table with a title: sizes at which half and nine tenths of a family's effects are named at their joint.

    The log odds of being named are a family's own plus a slope, common to all, times the logarithm of the size: one
    logistic regression of all trials by Firth's penalised likelihood (1993), finite where a family was always named.
    In brackets one standard error to either side. False names are those of recordings with an effect between half and
    twice of that size; their standard error is a Poisson number's under Jeffreys' prior.

    Args:
        scores, title: of trials; of the first column.
        family_of: a cause by its name.
    """
    trials = [s for s in scores if s.kind in SINGLE]
    size, named, false = np.array([(np.log(s.causes[0][2]), all(s.found), len(s.false))
                                   for s in trials]).reshape(-1, 3).T
    family = np.array([family_of(s.causes[0][0]) for s in trials])
    lines = [f"| {title} | recordings | named | half of them from | false names there | nine tenths from | "
             "false names there |", "| --- " * 7 + "|"]
    for group in (["all"], sorted(set(family))):
        member = np.array([(family == label) | (label == "all") for label in group])
        x = np.vstack([member, size]).T
        if np.linalg.matrix_rank(x) < x.shape[1]:
            continue  # Trials of one size, or none, say nothing of a slope.
        beta, covariance = _logistic(x, named > 0.0)
        for k, (label, own) in enumerate(zip(group, member, strict=True)):
            cells = []
            for share in (0.5, 0.9):
                log_size = (logit(share) - beta[k]) / beta[-1]
                slope = np.zeros(len(beta))
                slope[[k, -1]] = -1.0, -log_size
                error = np.sqrt(slope @ covariance @ slope) / beta[-1]
                here = false[own & (np.abs(size - log_size) < np.log(2.0))]
                sizes = (f"{float(f'{np.exp(x):.2g}'):g}" for x in (log_size, log_size - error, log_size + error))
                cells.append("{} ({} … {})".format(*sizes))
                cells.append(f"{here.mean():.2f} ± {np.sqrt(here.sum() + 0.5) / len(here):.2f}" if len(here) else "")
            lines.append(f"| {label} | {own.sum()} | {named[own].sum():.0f} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _logistic(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients of a logistic regression ``(p,)`` by Firth's penalised likelihood, and their covariance."""
    def information(beta: np.ndarray) -> np.ndarray:
        p = expit(x @ beta)
        return np.asarray(x.T * (p * (1.0 - p)) @ x)

    def loss(beta: np.ndarray) -> float:
        margin = np.where(y, 1.0, -1.0) * (x @ beta)
        return float(np.logaddexp(0.0, -margin).sum() - 0.5 * np.linalg.slogdet(information(beta))[1])

    beta = minimize(loss, np.append(np.zeros(x.shape[1] - 1), 1.0)).x
    return beta, np.linalg.inv(information(beta))


PROBABILITIES = (0.0, 0.5, 0.8, 0.9, 0.95, 0.99, 1.0)
"""Edges of the reliability table."""


def reliability(scores: Sequence[Score], title: str = "probability said") -> str:
    """Markdown table with a title: of the causes that were said with a probability, how many are there.

    There is one where it, or what it is said not to be told from, is there. The Brier score is the mean square of what
    was said less what came out; beside it that of saying of every cause the share of all that are there. The standard
    error is that of the share under Jeffreys' prior.
    """
    p, right = np.array([pair for s in scores for pair in s.probabilities], dtype=float).reshape(-1, 2).T
    lines = [f"| {title} | causes | its mean | there | share | Brier score | of one share for all |",
             "| --- " * 7 + "|"]
    for low, high in (*pairwise(PROBABILITIES), (0.0, 1.0)):
        here = (p >= low) & ((p < high) | (high == 1.0))
        if n := int(here.sum()):
            k = float(right[here].sum())
            share = (k + 0.5) / (n + 1.0)
            scored = [np.mean((guess - right[here]) ** 2) for guess in (p[here], right.mean())]
            lines.append(f"| {low:g} … {high:g} | {n} | {p[here].mean():.3f} | {k:.0f} | {k / n:.2f} ± "
                         f"{np.sqrt(share * (1.0 - share) / (n + 2.0)):.2f} | "
                         f"{' | '.join(f'{value:.3f}' for value in scored)} |")
    return "\n".join(lines)


def breakdown(scores: Sequence[Score], by: str) -> str:
    """Markdown table by an attribute of the trial: empty ones left alone, false names, right."""
    lines = [f"| {by} | recordings | empty left alone | false names per recording | right and nothing else |",
             "| --- | --- | --- | --- | --- |"]
    for value in sorted({getattr(s, by) for s in scores}):
        here = [s for s in scores if getattr(s, by) == value]
        lines.append(f"| {value} | {len(here)} | {_share(s.right for s in here if s.kind == 'none')} | "
                     f"{_mean(len(s.false) for s in here)} | {_share(s.right for s in here)} |")
    return "\n".join(lines)


def falsehoods(scores: Sequence[Score]) -> str:
    """Markdown table: what is said and is not there, of how many, by engine; in brackets those of empty recordings."""
    engines = sorted({s.engine for s in scores})
    counts = Counter(name for s in scores for name, _ in s.said)
    every = Counter((name, s.engine) for s in scores for name, _ in s.false)
    empty = Counter((name, s.engine) for s in scores for name, _ in s.false if s.kind == "none")
    lines = ["| named, not there | of | " + " | ".join(engines) + " |", "| --- | --- |" + " --- |" * len(engines)]
    for name, _ in Counter(name for s in scores for name, _ in s.false).most_common():
        cells = [f"{every[name, e]} ({empty[name, e]})" if every[name, e] else "" for e in engines]
        lines.append(f"| {name} | {counts[name]} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def confusion(scores: Sequence[Score]) -> str:
    """Markdown table: for each cause, how often it was found in which engine, what was said of its joint instead."""
    engines = sorted({s.engine for s in scores})
    lines = [f"| cause | found | {' | '.join(engines)} | said of its joint where it was not |",
             "| --- | --- |" + " --- |" * len(engines) + " --- |"]
    rows: dict[str, list[tuple[bool, list[str], str]]] = defaultdict(list)
    for s in scores:
        for (name, joint, _), found in zip(s.causes, s.found, strict=True):
            here = [n for n, j in s.said if joint in (0, j)] or (["other joints"] if s.said else ["nothing"])
            rows[name].append((found, here, s.engine))
    for name in sorted(rows):
        instead = Counter(n for found, here, _ in rows[name] if not found for n in set(here))
        cells = [_of([found for found, _, engine in rows[name] if engine == e]) for e in engines]
        lines.append(f"| {name} | {_of([found for found, _, _ in rows[name]])} | {' | '.join(cells)} | "
                     + ", ".join(f"{n} {count}" for n, count in instead.most_common()) + " |")
    return "\n".join(lines)


def intervals(scores: Sequence[Score]) -> str:
    """Markdown table: how many 95 % intervals hold the truth, by parameter, and its median error in σ."""
    rows: dict[str, list[float]] = defaultdict(list)
    for s in scores:
        for name, error in s.covered:
            rows[name].append(abs(error))
    lines = ["| parameter | 95 % intervals that hold the truth | median error, in σ |", "| --- | --- | --- |"]
    lines += [f"| {name} | {_of([e <= 1.96 for e in errors])} | {np.median(errors):.1f} |"
              for name, errors in sorted(rows.items())]
    return "\n".join(lines)


def report(scores: Sequence[Score]) -> str:
    """The tables that a page publishes: rates and false names."""
    return "\n\n".join((rates(scores), falsehoods(scores)))


def details(scores: Sequence[Score]) -> str:
    """Further tables: rates by size, by cause, and by engine, motion, logger …, and intervals by parameter."""
    by = ("engine", "motion", "logger", "friction", "gears", "controller")
    return "\n\n".join((power(scores), confusion(scores), intervals(scores), *(breakdown(scores, key) for key in by)))


def _large(scores: Iterable[Score]) -> list[Score]:
    return [s for s in scores if s.causes and min(size for _, _, size in s.causes) >= VISIBLE]


def _share(values: Iterable[bool]) -> str:
    """A share with its standard error under Jeffreys' prior, as in ``reliability``."""
    every = list(values)
    n, p = len(every), (sum(every) + 0.5) / (len(every) + 1.0)
    return f"{100.0 * sum(every) / n:.0f} ± {100.0 * np.sqrt(p * (1.0 - p) / (n + 2.0)):.0f} % of {n}" if n else ""


def _mean(values: Iterable[float]) -> str:
    every = list(values)
    return f"{np.mean(every):.2f} ± {np.std(every) / np.sqrt(len(every)):.2f}" if every else ""


def _of(values: list[bool]) -> str:
    return f"{sum(values)} of {len(values)}" if values else ""
