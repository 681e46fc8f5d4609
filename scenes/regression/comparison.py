"""Compares results with earlier ones and with bounds: rows, verdicts, and the verdict of a suite."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import stats

from ideal_robot.errors import InputError
from ideal_robot.results import Summarised
from scenes.regression.paired import (
    BETTER,
    FAILED,
    NOT_COMPARABLE,
    SAME,
    WORSE,
    Row,
    Rules,
    judged,
    one_run,
    over_all,
    paired,
    seeds_needed,
)
from scenes.regression.results import CASE, MAIN, Results, unit_of
from scenes.verdict import Verdict

if TYPE_CHECKING:
    import pandas as pd

SUITE = "all cases"
FAILURES = "runs that failed"
_CERTAIN = 0.01
"""A bound is flaky where as many seeds again could find the other answer with a larger chance than this."""


@dataclass(frozen=True)
class Bound:
    """A bound on a figure's mean over the seeds of a case.

    Attributes:
        case, figure: the case and the figure of it.
        limit, mean, deviation: bound, mean and standard deviation over the seeds, in the figure's unit.
        seeds: runs that gave a number; failed: runs that gave none; why: of the first of these.
        flaky: chance that as many other seeds give the other answer; needed: number of seeds that decides it with
            certainty.
    """

    case: str
    figure: str
    limit: float
    mean: float
    deviation: float
    seeds: int
    failed: int
    flaky: float
    needed: int | None
    why: str = ""

    @property
    def kept(self) -> bool:
        """Whether the mean is within the bound and no run failed."""
        return not self.failed and self.mean <= self.limit

    @property
    def remark(self) -> str:
        """Why the answer is uncertain: failed runs, a single seed, or too few seeds for the scatter; else empty."""
        if self.failed:
            return f"{self.failed} of {self.seeds + self.failed} runs gave no figure: {self.why}"
        if self.seeds == 1:
            return "one seed does not tell how it scatters; give it three or more"
        if self.flaky > _CERTAIN:
            seeds = "more seeds than anybody runs" if self.needed is None else f"{self.needed} seeds"
            return (f"flaky: {self.seeds} other seeds give the other answer with a chance of "
                    f"{100.0 * self.flaky:.0f} %; {seeds} tell, or another bound")
        return ""

    def json(self) -> dict[str, Any]:
        """Plain values."""
        return {**self.__dict__, "kept": self.kept, "remark": self.remark}


@dataclass(frozen=True, repr=False)
class Comparison(Summarised):
    """Results, and their comparison with earlier results and bounds.

    Attributes:
        title: of the suite, or the two sources.
        before: results compared with; None where only bounds were checked.
        after: the results.
        rows: figures of all cases, those of the suite first; bounds: bounds of the means.
        pairs: a row a pair, with ``label``, ``seed`` and each figure ``NAME before``, ``NAME after``.
        not_played: runs that were lost.
        places: name of a scene → as the command line takes it, where that is another.
    """

    title: str
    before: Results | None
    after: Results
    rows: tuple[Row, ...]
    bounds: tuple[Bound, ...] = ()
    pairs: pd.DataFrame | None = field(default=None)
    not_played: int = 0
    places: dict[str, str] = field(default_factory=dict)

    @property
    def verdict(self) -> str:
        """Verdict on the suite: the worst of all figures, bounds and runs."""
        verdicts = {row.verdict for row in self.rows}
        if FAILED in verdicts:
            return FAILED
        if WORSE in verdicts or self.not_played or not self.bounds_kept:
            return WORSE
        if any(row.verdict == NOT_COMPARABLE and not row.figure for row in self.rows):
            return NOT_COMPARABLE
        if BETTER in verdicts:
            return BETTER
        return SAME if SAME in verdicts or (self.before is None and self.bounds) else NOT_COMPARABLE

    @property
    def uncompared(self) -> tuple[str, ...]:
        """Cases without any figure or bound that could be compared, so that it is unknown whether they are worse."""
        compared = {row.case for row in self.rows if row.verdict != NOT_COMPARABLE}
        compared |= {bound.case for bound in self.bounds}
        refused = [row.case for row in self.rows if not row.figure]
        if self.pairs is None:
            labels = list(labelled(self.after)["label"])
        else:
            labels = list(self.pairs.loc[self.pairs["_merge"] != "left_only", "label"])
        return tuple(dict.fromkeys([*(label for label in labels if label not in compared), *refused]))

    @property
    def bounds_kept(self) -> bool:
        """Whether all bounds are kept, if there are any."""
        return all(bound.kept for bound in self.bounds)

    @property
    def headline(self) -> str:
        """The verdict in words, with the kind of comparison where there was no baseline."""
        rose = any(row.verdict == WORSE for row in self.rows) or self.not_played
        if self.before is not None and self.verdict == WORSE and not self.bounds_kept and not rose:
            return "bounds missed"
        if self.before is not None or self.not_played or self.verdict == FAILED:
            return self.verdict
        if not self.bounds:
            return "first results, nothing to compare with"
        if not self.bounds_kept:
            return "bounds missed, no baseline"
        return "bounds kept, other cases have no baseline" if self.uncompared else "bounds kept, no baseline"

    @property
    def worst(self) -> Row | None:
        """The figure of a case with the largest relative rise; None where nothing became worse."""
        worse = [row for row in self.rows if row.verdict == WORSE and row.case != SUITE and row.figure != FAILURES]
        return max(worse, key=lambda row: row.difference / max(abs(row.before), 1e-300), default=None)

    def pair_of(self, row: Row) -> dict[str, Any] | None:
        """The pair of runs of a row's case in which its figure rose most, as a row of ``pairs``; None without any."""
        names = f"{row.figure} before", f"{row.figure} after"
        if self.pairs is None or not {*names} <= {*self.pairs}:
            return None
        of_case = self.pairs[(self.pairs["label"] == row.case) & (self.pairs["_merge"] == "both")]
        rise = (of_case[names[1]].astype(float).abs() - of_case[names[0]].astype(float).abs()).dropna()
        if rise.empty:
            return None
        return {str(key): value for key, value in of_case.iloc[of_case.index.get_loc(rise.idxmax())].to_dict().items()}

    def summary(self) -> list[tuple[str, str]]:
        """The verdict, and the figures of the suite."""
        return [("comparison", self.title), ("verdict", self.headline),
                *((row.figure, f"{row.before:.4g} → {row.after:.4g}, {row.verdict}") for row in self.rows
                  if row.case == SUITE)]

    def json(self) -> dict[str, Any]:
        """Verdicts with their figures as plain values, without times and places."""
        return {"schema": 1, "title": self.title, "verdict": self.verdict, "not_played": self.not_played,
                "program": {"before": None if self.before is None else self.before.program,
                            "after": self.after.program},
                "figures": [row.json() for row in self.rows], "bounds": [bound.json() for bound in self.bounds]}

    def table(self) -> tuple[list[str], list[list[Any]]]:
        """Column titles and rows of what changed or has a remark; where nothing did, of the suite."""
        shown = ([row for row in self.rows if row.verdict != SAME or row.why]
                 or [row for row in self.rows if row.case == SUITE])
        return (["case", "figure", "pairs", "before", "after", "difference", "standard error", "p", "verdict"],
                [[row.case, row.figure, row.pairs, row.before, row.after, row.difference, row.error, row.corrected,
                  Verdict(f"{row.verdict}: {row.why}" if row.why else row.verdict)] for row in shown])


def compared(before: Results, after: Results, *, figures: Sequence[str] = MAIN, rules: Rules | None = None,
             title: str = "") -> Comparison:
    """Compares results pair by pair; InputError for different arms, no common pair, or a duplicate run.

    Args:
        before, after: earlier results and new ones.
        figures: names of the compared figures; those that not both have are skipped.
        rules: rules by which a difference is a change.
        title: of the comparison.
    """
    pairs = _pairs(before, after)
    rows: list[Row] = []
    names = [name for name in figures if f"{name} before" in pairs]
    numbers = {*before.figures} & {*after.figures}
    for label, group in pairs.groupby("label", sort=False):
        rows += _of_case(str(label), group, names, figures, numbers)
    whole = [row for name in names if (row := over_all(SUITE, [case for case in rows if case.figure == name]))]
    return Comparison(title or f"{before.source} → {after.source}", before, after,
                      tuple(judged([*whole, *rows], rules or Rules())), pairs=pairs)


def _of_case(label: str, group: pd.DataFrame, names: Sequence[str], figures: Sequence[str],
             numbers: set[str]) -> list[Row]:
    """Rows of one case: runs that failed, and those of ``names`` that it has, of the ``figures`` that are asked for.

    ``numbers`` are all figures that both sides have; where none differs between seeds, the runs are one.
    """
    sides = set(group["_merge"])
    if sides != {"both"} and "both" not in sides:
        side = "the new results" if sides == {"left_only"} else "the earlier ones"
        return [Row(label, "", why=f"{side} have no such run; --update-baseline takes the cases of today"),
                *_failures(label, group.loc[group["_merge"] == "right_only", "failure after"])]
    both = group[group["_merge"] == "both"]
    for name, what in (("task_hash", "scene"), ("world_hash", "simulated world")):
        old, new = both[f"{name} before"], both[f"{name} after"]
        if ((old != new) & old.notna() & new.notna()).any():
            return [Row(label, "", why=f"its {what} has changed; make a new baseline (--update-baseline)"),
                    *_failures(label, both["failure after"])]
    ran = both[both["failure before"].isna() & both["failure after"].isna()]
    alike = len(ran) > 1 and bool((ran[[name for name in ran if str(name).rpartition(" ")[0] in numbers]]
                                   .nunique(dropna=False) == 1).all())
    rows = []
    for name in names:
        # For a signed figure, a delay for instance, a smaller absolute value is better.
        had = ran[[f"{name} before", f"{name} after"]].astype(float).abs().dropna(subset=[f"{name} before"])
        values = had.dropna()
        if len(values) < len(had):
            rows.append(Row(label, name, len(had), verdict=WORSE,
                            why=f"{len(had) - len(values)} of {len(had)} runs do not have this figure any more"))
        elif len(values):
            rows.append(one_run(label, name, len(values), *values.to_numpy()[0]) if alike
                        else paired(label, name, *values.to_numpy().T))
    if len(ran) and not rows:
        rows.append(Row(label, "", why=f"has none of the figures compared: {', '.join(figures)}; name one that it has"))
    return [*_failures(label, both["failure after"], both["failure before"]), *rows]


def _failures(label: str, after: pd.Series, before: pd.Series | None = None) -> list[Row]:
    """A row of the runs of a case that failed, by their reasons and those of the baseline's; none where none did."""
    new = after.notna()
    old = new if before is None else before.notna()
    if not (new | old).any():
        return []
    verdict = (FAILED if new.all() else WORSE if (new & ~old).any() else BETTER if (old & ~new).any()
               else NOT_COMPARABLE)
    reasons = after[new & ~old if verdict == WORSE else new]
    # Without a difference, or without earlier results, there is no verdict.
    difference = float(new.sum() - old.sum()) or np.nan
    return [Row(label, FAILURES, len(new), np.nan if before is None else float(old.sum()), float(new.sum()), difference,
                verdict=verdict, why="" if verdict == BETTER else str(reasons.iloc[0]))]


def check_arms(before: Results, robots: set[str]) -> None:
    """Raises InputError where earlier results are of other arms than these alone, wherever the arms' files lie."""
    of, robots = ({Path(robot).name for robot in every} for every in (before.runs["robot"].dropna(), robots))
    if of and robots and not of & robots:
        raise InputError(f"is of another arm ({', '.join(sorted(of))}); these runs are of {', '.join(sorted(robots))}: "
                         "give the baseline of that arm, or make one (--update-baseline)", file=before.source)


def _pairs(before: Results, after: Results) -> pd.DataFrame:
    """One row a run of either side, merged over case and seed; methods are paired by name, or one with one."""
    import pandas as pd

    check_arms(before, set(after.runs["robot"].dropna()))
    keys = [name for name in (*CASE, "seed") if all(result.runs[name].notna().any() for result in (before, after))]
    sides = [result.runs.assign(**{name: result.runs[name].map(_word) for name in keys}) for result in (before, after)]
    sides[0] = _same_method(sides[0], sides[1], keys)
    for result, side in zip((before, after), sides, strict=True):
        twice = side.duplicated(keys)
        if twice.any():
            run = ", ".join(side.loc[twice, keys].iloc[0])
            raise InputError(f"holds a run twice ({run}); give one file for each version", file=result.source)
    merged = pd.merge(sides[0], sides[1], on=keys, how="outer", suffixes=(" before", " after"), indicator=True,
                      sort=False)
    if not (merged["_merge"] == "both").any():
        scenes = [", ".join(sorted(set(side["scene"]))[:4]) for side in sides]
        raise InputError(f"shares no pair with {after.source}: scenes {scenes[0]} there, {scenes[1]} here, or other "
                         "speeds, seeds or methods; compare runs of the same", file=before.source)
    merged["label"] = [_label({str(key): value for key, value in row.items()})
                       for row in merged[[key for key in keys if key != "seed"]].to_dict("records")]
    return merged


def _same_method(before: pd.DataFrame, after: pd.DataFrame, keys: list[str]) -> pd.DataFrame:
    """The earlier runs under the later method's name where each side has but one and they differ."""
    if "method" not in keys:
        return before
    methods = set(before["method"]), set(after["method"])
    if len(methods[0]) == len(methods[1]) == 1 and methods[0] != methods[1]:
        return before.assign(method=next(iter(methods[1])))
    return before


def _word(value: Any) -> str:
    return "" if value is None or value != value else f"{value:g}" if isinstance(value, int | float) else str(value)


def _label(row: dict[str, Any]) -> str:
    """What a case is called: its scene, and what it does not have by default."""
    parts = [row["scene"], f"{row['speed_m_s']} m/s" if row.get("speed_m_s") else "", row.get("method") or "",
             row.get("world") or "", f"arm {row['individual']}" if row.get("individual", "1") != "1" else ""]
    return ", ".join(part for part in parts if part)


def bounds_of(results: Results, asked: Sequence[dict[str, float]]) -> tuple[Bound, ...]:
    """The bounds of each case with the means of its results; ``asked`` has each run's bounds by figure.

    Raises InputError for a figure that no run of the case has.
    """
    frame = labelled(results)
    bounds = []
    for label, group in frame.groupby("label", sort=False):
        # Cases of the same label with other seeds may have other bounds.
        limits = dict.fromkeys(pair for i in group.index for pair in asked[int(i)].items())
        for figure, limit in limits:
            runs = group.loc[[asked[int(i)].get(figure) == limit for i in group.index]]
            if figure not in frame and not runs["failure"].notna().all():
                known = [name for name in results.figures if unit_of(name)]
                raise InputError(f"no run has this figure; there are {', '.join(known)}", field="bounds", value=figure)
            ended = runs.loc[runs["failure"].isna()]
            values = ended[figure].astype(float).abs().dropna().to_numpy() if figure in ended else np.empty(0)
            reasons = [*runs["failure"].dropna(), "the scene has no such figure"]
            bounds.append(_bound(str(label), figure, limit, values, len(runs) - len(values), reasons[0]))
    return tuple(bounds)


def labelled(results: Results) -> pd.DataFrame:
    """The runs, each with the ``label`` of its case."""
    return results.runs.assign(label=[_label({str(key): _word(value) for key, value in row.items()})
                                      for row in results.runs[list(CASE)].to_dict("records")])


def _bound(case: str, figure: str, limit: float, values: np.ndarray, failed: int, why: str) -> Bound:
    n = len(values)
    mean = float(np.mean(values)) if n else np.nan
    deviation = float(np.std(values, ddof=1)) if n > 1 else np.nan
    flaky, needed = 0.0, None
    if deviation > 0.0:
        effect = abs(limit - mean) / deviation
        # Compares the means of two sets of n seeds: the one that was run, and another one.
        flaky = float(stats.t.sf(effect / np.sqrt(2.0 / n), n - 1))
        needed = seeds_needed(effect, _CERTAIN)
    return Bound(case, figure, limit, mean, deviation, n, failed, flaky, needed, why if failed else "")


def comparison_of(after: Results, before: Results | None, bounds: tuple[Bound, ...], **rules: Any) -> Comparison:
    """A suite's comparison with its baseline, where it has one, and with its bounds.

    Args:
        after, before: the results, and the baseline; None where there is none yet.
        bounds: from ``bounds_of``.
        rules: as ``compared`` takes them, and ``title``; errors as there.
    """
    lost = int(after.runs["not_played"].notna().sum()) if "not_played" in after.runs else 0
    if before is None:
        rows = [row for label, group in labelled(after).groupby("label", sort=False)
                for row in _failures(str(label), group["failure"])]
        return Comparison(rules.get("title", ""), None, after, tuple(rows), bounds, None, lost)
    comparison = compared(before, after, **rules)
    return Comparison(comparison.title, before, after, comparison.rows, bounds, comparison.pairs, lost)
