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
        margins: for each of ``false``, how many times the share of the residual it took away that was asked of it.
        found: for each cause, whether it was said.
        right: everything, and nothing else.
        covered: for each parameter that can be compared, its error over its standard deviation.
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
    covered: tuple[tuple[str, float], ...]
    seconds: float
    margins: tuple[float, ...] = ()

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
                 tuple(_margin(e) for e, said_ in zip((*diagnosis.effects, *diagnosis.unknown), said, strict=True)
                       if said_ in false))


def _margin(found: Any) -> float:
    """How many times the share of the residual an effect took away that was asked of it; NaN where it does not say."""
    evidence = getattr(found.fitted, "evidence", {})
    return float(evidence["share"] / evidence["share_asked"]) if evidence.get("share_asked") else float("nan")


def said_name(name: str, channel: str) -> str:
    """Name of an effect with where it was seen: ``arm:`` in the arm's angles, ``tool:`` in the tool's place."""
    if channel.startswith("qa"):
        return f"arm:{name}"
    return f"tool:{name}" if channel and channel[0] in "xyz" else name


SIZES = (0.5, 1.0, 2.0, 3.0, 5.0, 10.0)
"""Edges of the power curve, in multiples of visible."""
VISIBLE = 3.0
"""Size from which on the rates that were asked for hold."""
_QUIET = 0.98
"""Share of empty recordings that are to be left alone."""
_SINGLE = ("inside", "new", "model", "arm")


def rates(scores: Sequence[Score]) -> str:
    """Markdown table of the rates, all engines together and each by itself."""
    engines = sorted({s.engine for s in scores})
    groups = [list(scores), *([s for s in scores if s.engine == e] for e in engines)]
    lines = ["| what | all | " + " | ".join(engines) + " |", "| --- |" + " --- |" * (1 + len(engines))]

    def row(name: str, value: Callable[[list[Score]], str]) -> None:
        lines.append(f"| {name} | " + " | ".join(value(group) for group in groups) + " |")

    def single(group: list[Score]) -> list[bool]:
        return [s.right for s in group if s.kind in _SINGLE]

    row("recordings", lambda g: str(len(g)))
    row("empty ones left alone", lambda g: _share(s.right for s in g if s.kind == "none"))
    row("false names per recording", lambda g: _mean(len(s.false) for s in g))
    row("false names per empty recording", lambda g: _mean(len(s.false) for s in g if s.kind == "none"))
    row("one effect of any size, right and nothing else", lambda g: _share(single(g)))
    row(f"one effect ≥ {VISIBLE:g} × visible, right and nothing else", lambda g: _share(single(_large(g))))
    row("the same, named at its joint whatever else", lambda g: _share(
        all(s.found) for s in _large(g) if s.kind in _SINGLE))
    row(f"outside the library ≥ {VISIBLE:g} ×, unknown and no name", lambda g: _share(
        s.right for s in _large(g) if s.kind == "outside"))
    row(f"two effects ≥ {VISIBLE:g} ×, both and nothing else", lambda g: _share(
        s.right for s in _large(g) if s.kind == "two"))
    row("95 % intervals that hold the truth", lambda g: _share(abs(error) <= 1.96 for s in g for _, error in s.covered))
    row("processor time of a diagnosis [s]", lambda g: _mean(s.seconds for s in g))
    return "\n".join(lines)


def power(scores: Sequence[Score], by: str = "engine") -> str:
    """Markdown table of finding one effect of the library, right and nothing else, over its size.

    Args:
        scores: of trials.
        by: an attribute of the trials; a column for each of its values.
    """
    single = [s for s in scores if s.kind in _SINGLE]
    values = sorted({getattr(s, by) for s in single})
    lines = [f"| size, × visible | effects | named at its joint | and nothing else | {' | '.join(values)} |",
             "| --- | --- | --- | --- |" + " --- |" * len(values)]
    for low, high in zip((0.0, *SIZES), (*SIZES, np.inf), strict=True):
        here = [s for s in single if low <= s.causes[0][2] < high]
        if here:
            cells = [_share(s.right for s in here if getattr(s, by) == value) for value in values]
            lines.append(f"| {low:g} … {high:g} | {len(here)} | {_share(all(s.found) for s in here)} | "
                         f"{_share(s.right for s in here)} | {' | '.join(cells)} |")
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
    """Markdown table: for each cause, how often it was found in which engine, what was said of its joint instead."""
    engines = sorted({s.engine for s in scores})
    lines = [f"| cause | found | {' | '.join(engines)} | said of its joint where it was not |",
             "| --- | --- |" + " --- |" * len(engines) + " --- |"]
    rows: dict[str, list[tuple[bool, list[str], str]]] = defaultdict(list)
    for s in scores:
        said = [*s.named, *(("unknown", j) for j in s.unknown)]
        for (name, joint, _), found in zip(s.causes, s.found, strict=True):
            here = [n for n, j in said if joint in (0, j)] or (["other joints"] if said else ["nothing"])
            rows[name].append((found, here, s.engine))
    for name in sorted(rows):
        instead = Counter(n for found, here, _ in rows[name] if not found for n in set(here))
        cells = [_of([found for found, _, engine in rows[name] if engine == e]) for e in engines]
        lines.append(f"| {name} | {_of([found for found, _, _ in rows[name]])} | {' | '.join(cells)} | "
                     + ", ".join(f"{n} {count}" for n, count in instead.most_common()) + " |")
    return "\n".join(lines)


def intervals(scores: Sequence[Score]) -> str:
    """Markdown table: how many 95 % intervals hold the truth, by parameter, and the factor on σ that would make it so.

    The factor is the 95 % quantile of the errors over 1.96 σ; that of the engines but one is set against the intervals
    of the engine left out.
    """
    rows: dict[str, list[float]] = defaultdict(list)
    for s in scores:
        for name, error in s.covered:
            rows[name].append(abs(error))
    lines = ["| parameter | 95 % intervals that hold the truth | median error, in σ |", "| --- | --- | --- |"]
    lines += [f"| {name} | {_of([e <= 1.96 for e in errors])} | {np.median(errors):.1f} |"
              for name, errors in sorted(rows.items())]
    lines += ["", "| engine left out | factor on σ from the others | its intervals that hold the truth with it |",
              "| --- | --- | --- |"]
    for engine in sorted({s.engine for s in scores}):
        others = [abs(e) for s in scores if s.engine != engine for _, e in s.covered]
        own = [abs(e) for s in scores if s.engine == engine for _, e in s.covered]
        if others and own:
            factor = max(float(np.quantile(others, 0.95)) / 1.96, 1.0)
            lines.append(f"| {engine} | {factor:.1f} | {_of([e <= 1.96 * factor for e in own])} |")
    return "\n".join(lines)


def leaving_out(scores: Sequence[Score], scale: float) -> str:
    """Markdown table: the factor on all shares that the engines but one would ask for, and what it does in that one.

    Made of empty recordings that were diagnosed with all shares lowered: the largest margin of what is named and is
    not there says with which factor the recording is left alone.

    Args:
        scores: of trials; only the empty ones count.
        scale: by which the shares were multiplied when they were played.
    """
    empty = [s for s in scores if s.kind == "none"]

    def needed(s: Score) -> float:
        if not s.false:
            # Below the factor with which it was played nothing is known.
            return scale if s.right else np.inf
        return scale * max((np.inf if np.isnan(m) else m) for m in s.margins)

    lines = ["| engine left out | factor on all shares from the others | its empty ones left alone with it | "
             "with the factor 1 |", "| --- | --- | --- | --- |"]
    for engine in sorted({s.engine for s in empty}):
        others = sorted(needed(s) for s in empty if s.engine != engine)
        own = [needed(s) for s in empty if s.engine == engine]
        if others:
            factor = others[min(int(np.ceil(_QUIET * len(others))), len(others)) - 1]
            alone, as_it_is = (_of([n <= most for n in own]) for most in (factor, 1.0))
            lines.append(f"| {engine} | {factor:.2f} | {alone} | {as_it_is} |")
    return "\n".join(lines)


def report(scores: Sequence[Score]) -> str:
    """All tables."""
    parts = [rates(scores), *(power(scores, by) for by in ("engine", "motion", "logger")), falsehoods(scores),
             confusion(scores), intervals(scores)]
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


def _of(values: list[bool]) -> str:
    return f"{sum(values)} of {len(values)}" if values else ""
