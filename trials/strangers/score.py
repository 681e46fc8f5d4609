"""The strict score: named at its joint, and nothing else named anywhere.

An empty recording is right only where nothing is named and the verdict is not ``effects`` or ``unknown``. What is
outside the library is right only as ``unknown`` at its joint with no name beside it. Two effects are right only both.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from trials.strangers.trial import Trial


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
    common = trial.late if ("torque_filter", 0) not in named else 0.0
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
