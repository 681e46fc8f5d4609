"""Scores of blind trials: what was drawn against what a diagnosis said, rates and the confusion matrix."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

TARGETS = {
    "right effect and joint": 0.90, "right joint": 0.97, "outside the library called unknown": 0.80,
    "false alarm without effect": 0.05, "two effects, both found": 0.75,
    "held-out error at most 1.1 times the oracle's": 0.90,
}


@dataclass(frozen=True)
class Score:
    """One trial.

    Attributes:
        seed, kind, truth: as drawn.
        verdict: of the diagnosis.
        found: effects reported: name, joint, and what they are not separated from; learned terms as ``unknown``.
        right: whether the trial counts as solved.
        joint: whether the first joint named is the right one.
        ratio: held-out error of the affected channel over that of a fit with the true form; None where not computed.
        seconds: CPU time.
    """

    seed: int
    kind: str
    truth: tuple[tuple[str, int], ...]
    outside: bool
    verdict: str
    found: tuple[tuple[str, int, tuple[str, ...]], ...]
    right: bool
    joint: bool
    ratio: float | None
    seconds: float


def score(seed: int, kind: str, truth: tuple[tuple[str, int], ...], outside: bool, diagnosis: Any, seconds: float,
          ratio: float | None = None) -> Score:
    """Compares a diagnosis with the truth.

    An effect counts as found where its name and joint are reported, or where it stands in the group of those that the
    data do not separate from one reported of the same joint.

    Args:
        seed: of the trial.
        kind: of the trial.
        truth: hidden effects, name and joint (from 1).
        outside: whether they are outside the library.
        diagnosis: result of ``diagnose``.
        seconds: time that it took [s].
        ratio: error of the diagnosed model over that of a fit that is given the true form, 1; None where not computed.
    """
    found = tuple([(e.fitted.name, e.fitted.joint, tuple(e.indistinguishable_from)) for e in diagnosis.effects]
                  + [("unknown", u.fitted.joint, ()) for u in diagnosis.unknown])

    def said(name: str, joint: int) -> bool:
        return any(joint == j and (name == n or name in group) for n, j, group in found)

    strongest = _strongest(diagnosis)
    joint = bool(truth) and bool(found) and all(any(j == t for _, j, _ in found) for _, t in truth) \
        and strongest in {t for _, t in truth}
    if kind == "none":
        right = diagnosis.verdict == "none"
    elif outside:
        right = diagnosis.verdict == "unknown" and any(n == "unknown" and j == truth[0][1] for n, j, _ in found)
    else:
        right = all(said(*t) for t in truth)
    return Score(seed, kind, truth, outside, diagnosis.verdict, found, right, joint, ratio, seconds)


def _strongest(diagnosis: Any) -> int | None:
    """Joint of what lowers the error of its channel most."""
    every = [*diagnosis.effects, *diagnosis.unknown]
    if not every:
        return None
    return int(max(every, key=lambda e: e.rms_before / max(e.rms_after, 1e-300)).fitted.joint)


def rates(scores: Sequence[Score]) -> str:
    """Markdown table of the rates beside what was asked for."""
    single = [s for s in scores if s.kind in ("inside", "arm", "model")]
    groups: list[tuple[str, list[bool], str]] = [
        ("right effect and joint", [s.right for s in single], "≥"),
        ("right joint", [s.joint for s in single], "≥"),
        ("outside the library called unknown", [s.right for s in scores if s.outside], "≥"),
        ("false alarm without effect", [not s.right for s in scores if s.kind == "none"], "≤"),
        ("two effects, both found", [s.right for s in scores if s.kind == "two"], "≥"),
        ("held-out error at most 1.1 times the oracle's", [s.ratio <= 1.1 for s in scores if s.ratio is not None], "≥"),
    ]
    lines = ["| what | measured | trials | asked for |", "| --- | --- | --- | --- |"]
    for name, values, sense in groups:
        if values:
            lines.append(f"| {name} | {100.0 * sum(values) / len(values):.1f} % | {len(values)} | "
                         f"{sense} {100.0 * TARGETS[name]:.0f} % |")
    return "\n".join(lines)


def confusion(scores: Sequence[Score]) -> str:
    """Markdown confusion matrix: what was drawn against the effects said of the right joint (or none, or another)."""
    table: dict[str, Counter[str]] = defaultdict(Counter)
    for s in scores:
        if not s.truth:
            table["(none)"]["none" if s.verdict == "none" else f"{s.found[0][0]}" if s.found else s.verdict] += 1
        for name, joint in s.truth:
            here = [n if n == name or name not in group else name for n, j, group in s.found if j == joint]
            label = (name if name in here else here[0] if here else ("none" if not s.found else "other joint"))
            table[f"{name} *" if s.outside else name][label] += 1
    columns = sorted({c for row in table.values() for c in row})
    lines = ["Rows: drawn (* outside the library). Columns: said of that joint.", "",
             "| drawn | " + " | ".join(columns) + " |", "| --- |" + " --- |" * len(columns)]
    for name in sorted(table):
        lines.append(f"| {name} | " + " | ".join(str(table[name][c] or "") for c in columns) + " |")
    return "\n".join(lines)
