"""The strict score: named at its joint, and nothing else named anywhere.

An empty recording is right only where nothing is named and the verdict is not ``effects`` or ``unknown``. What is
outside the library is right only as ``unknown`` at its joint with no name beside it. Two effects are right only both.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from trials.strangers.trial import Trial

SIZES = (0.5, 1.0, 2.0, 3.0, 5.0, 10.0)
"""Edges of the power curve, in multiples of visible."""
VISIBLE = 3.0
"""Size from which on the rates that were asked for hold."""


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
        covered: for each parameter that can be compared, whether its 95 % interval holds the truth.
        seconds: processor time of the diagnosis.
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
    covered: tuple[tuple[str, bool], ...]
    seconds: float

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
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
    named = tuple((said_name(str(e.fitted.name), str(e.fitted.channel)), int(e.fitted.joint))
                  for e in diagnosis.effects)
    unknown = tuple(int(u.fitted.joint) for u in diagnosis.unknown)
    said = [*named, *(("unknown", j) for j in unknown)]
    true = frozenset().union(*(c.right for c in trial.causes)) if trial.causes else frozenset()
    found = tuple(any(s in c.right for s in said) for c in trial.causes)
    false = tuple(s for s in said if s not in true and s not in trial.healthy)
    outside = any(c.outside for c in trial.causes)
    right = all(found) and not false and (diagnosis.verdict == "unknown" if outside else True)
    if not trial.causes and not said and diagnosis.verdict not in ("none", "undecided"):
        right = False
    covered = []
    for effect in diagnosis.effects:
        for p in effect.fitted.parameters:
            truth = trial.values.get((effect.fitted.name, effect.fitted.joint, p.name))
            if truth is not None and p.std > 0.0:
                covered.append((f"{effect.fitted.name}: {p.name}", bool(abs(p.value - truth) <= 1.96 * p.std)))
    return Score(trial.seed, trial.kind, trial.engine, trial.arm, trial.motion, trial.logger, trial.controller,
                 trial.friction, trial.gears, tuple((c.name, c.joint, c.size) for c in trial.causes),
                 str(diagnosis.verdict), named, unknown, false, found, bool(right), tuple(covered), seconds)


def said_name(name: str, channel: str) -> str:
    """Name of an effect with where it was seen: ``arm:`` in the arm's angles, ``tool:`` in the tool's place."""
    if channel.startswith("qa"):
        return f"arm:{name}"
    return f"tool:{name}" if channel and channel[0] in "xyz" else name


def rates(scores: Sequence[Score]) -> str:
    """Markdown table of the rates, all engines together and each by itself."""
    engines = sorted({s.engine for s in scores})
    groups = [list(scores), *([s for s in scores if s.engine == e] for e in engines)]
    lines = ["| what | all | " + " | ".join(engines) + " |", "| --- |" + " --- |" * (1 + len(engines))]

    def row(name: str, value: Callable[[list[Score]], str]) -> None:
        lines.append(f"| {name} | " + " | ".join(value(group) for group in groups) + " |")

    def single(group: list[Score]) -> list[bool]:
        return [s.right for s in group if s.kind in ("inside", "new", "model", "arm")]

    row("recordings", lambda g: str(len(g)))
    row("empty ones left alone", lambda g: _share(s.right for s in g if s.kind == "none"))
    row("false names per recording", lambda g: _mean(len(s.false) for s in g))
    row("false names per empty recording", lambda g: _mean(len(s.false) for s in g if s.kind == "none"))
    row("one effect of any size, right and nothing else", lambda g: _share(single(g)))
    row(f"one effect ≥ {VISIBLE:g} × visible, right and nothing else", lambda g: _share(single(_large(g))))
    row("the same, named at its joint whatever else", lambda g: _share(
        all(s.found) for s in _large(g) if s.kind in ("inside", "new", "model", "arm")))
    row(f"outside the library ≥ {VISIBLE:g} ×, unknown and no name", lambda g: _share(
        s.right for s in _large(g) if s.kind == "outside"))
    row(f"two effects ≥ {VISIBLE:g} ×, both and nothing else", lambda g: _share(
        s.right for s in _large(g) if s.kind == "two"))
    row("95 % intervals that hold the truth", lambda g: _share(ok for s in g for _, ok in s.covered))
    row("processor time of a diagnosis [s]", lambda g: _mean(s.seconds for s in g))
    return "\n".join(lines)


def power(scores: Sequence[Score]) -> str:
    """Markdown table of finding one effect of the library over its size."""
    lines = ["| size, × visible | effects | named at its joint | and nothing else |", "| --- | --- | --- | --- |"]
    single = [s for s in scores if s.kind in ("inside", "new", "model", "arm")]
    for low, high in zip((0.0, *SIZES), (*SIZES, np.inf), strict=True):
        here = [s for s in single if low <= s.causes[0][2] < high]
        if here:
            lines.append(f"| {low:g} … {high:g} | {len(here)} | {_share(all(s.found) for s in here)} | "
                         f"{_share(s.right for s in here)} |")
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
    """Markdown table: what is named and is not there, by engine; in brackets those of empty recordings."""
    engines = sorted({s.engine for s in scores})
    every: dict[str, Counter[str]] = defaultdict(Counter)
    empty: dict[str, Counter[str]] = defaultdict(Counter)
    for s in scores:
        for name, _ in s.false:
            every[name][s.engine] += 1
            if s.kind == "none":
                empty[name][s.engine] += 1
    lines = ["| named, not there | " + " | ".join(engines) + " |", "| --- |" + " --- |" * len(engines)]
    for name in sorted(every, key=lambda key: -every[key].total()):
        cells = [f"{every[name][e]} ({empty[name][e]})" if every[name][e] else "" for e in engines]
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def confusion(scores: Sequence[Score]) -> str:
    """Markdown table: for each cause, how often it was found, and what was said of its joint instead."""
    lines = ["| cause | drawn | found | said of its joint where it was not |", "| --- | --- | --- | --- |"]
    rows: dict[str, list[tuple[bool, list[str]]]] = defaultdict(list)
    for s in scores:
        said = [*s.named, *(("unknown", j) for j in s.unknown)]
        for (name, joint, _), found in zip(s.causes, s.found, strict=True):
            here = [n for n, j in said if joint in (0, j)] or (["other joints"] if said else ["nothing"])
            rows[name].append((found, here))
    for name in sorted(rows):
        instead = Counter(n for found, here in rows[name] if not found for n in set(here))
        lines.append(f"| {name} | {len(rows[name])} | {sum(f for f, _ in rows[name])} | "
                     + ", ".join(f"{n} {count}" for n, count in instead.most_common()) + " |")
    return "\n".join(lines)


def report(scores: Sequence[Score]) -> str:
    """All tables."""
    parts = [rates(scores), power(scores), falsehoods(scores), confusion(scores)]
    parts += [breakdown(scores, by) for by in ("engine", "motion", "logger", "friction", "gears", "controller")]
    return "\n\n".join(parts)


def _large(scores: Iterable[Score]) -> list[Score]:
    return [s for s in scores if s.causes and min(size for _, _, size in s.causes) >= VISIBLE]


def _share(values: Iterable[bool]) -> str:
    every = list(values)
    return f"{100.0 * sum(every) / len(every):.0f} % of {len(every)}" if every else ""


def _mean(values: Iterable[float]) -> str:
    every = list(values)
    return f"{sum(every) / len(every):.2f}" if every else ""
