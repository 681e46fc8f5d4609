"""Paired comparison: differences of runs that differ in the program alone, seed by seed.

Two-sided paired t-test; Holm's step-down correction over all figures and cases, so that an unchanged program is called
worse or better with the chance ``false_alarms`` at most, however many figures there are.
"""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import stats

from ideal_robot.arrays import Array

BETTER, SAME, WORSE, NOT_COMPARABLE, FAILED = "better", "same", "worse", "not comparable", "failed"
POWER = 0.9
"""Chance with which a difference is to be found where it is said which one would be."""
MOST_SEEDS = 100_000
"""Beyond so many seeds none are asked for."""


@dataclass(frozen=True)
class Rules:
    """Rules by which a difference is a change.

    Attributes:
        false_alarms: chance that anything of an unchanged program is called worse or better.
        relevant: smallest change of a mean that counts, relative to its value before.
    """

    false_alarms: float = 0.01
    relevant: float = 0.01


@dataclass(frozen=True)
class Row:
    """One figure of one case, before and after.

    Attributes:
        case: the case; figure: name with its unit.
        pairs: seeds that both have.
        before, after: means over the pairs.
        difference, error: mean difference and its standard error; of the suite relative to ``before``.
        p: chance of a difference as large from an unchanged program; corrected: after Holm's correction.
        finds: smallest difference that so many pairs find with the chance ``POWER``.
        verdict: better, same, worse, not comparable, or failed where no run of the case succeeded; why: its reason.
    """

    case: str
    figure: str
    pairs: int = 0
    before: float = np.nan
    after: float = np.nan
    difference: float = np.nan
    error: float = np.nan
    p: float = np.nan
    corrected: float = np.nan
    finds: float = np.nan
    verdict: str = NOT_COMPARABLE
    why: str = ""

    def json(self) -> dict[str, Any]:
        """Plain values."""
        return dict(self.__dict__)


def paired(case: str, figure: str, before: Array, after: Array) -> Row:
    """The difference of one figure over pairs; ``judged`` adds the verdict for all rows together.

    Args:
        case: the case.
        figure: its name.
        before: values of each pair ``(n,)``, in the figure's unit.
        after: values of each pair ``(n,)``, in the figure's unit.
    """
    d = after - before
    n, mean = len(d), float(np.mean(d))
    error = float(np.std(d, ddof=1) / np.sqrt(n)) if n > 1 else np.nan
    return Row(case, figure, n, float(np.mean(before)), float(np.mean(after)), mean, error, _p(mean, error, n - 1))


def one_run(case: str, figure: str, seeds: int, before: float, after: float) -> Row:
    """The difference of one figure where all seeds give the same run: one pair, without scatter.

    Args:
        case: the case.
        figure: its name.
        seeds: the seeds that were run.
        before: value of each of them, in the figure's unit.
        after: value of each of them, in the figure's unit.
    """
    return Row(case, figure, 1, before, after, after - before, 0.0,
               why=f"the seed does not enter: the runs of {seeds} seeds are one and the same")


def _p(mean: float, error: float, dof: float) -> float:
    if not np.isfinite(error):
        return np.nan
    if error == 0.0:
        return 1.0 if mean == 0.0 else 0.0
    return float(2.0 * stats.t.sf(abs(mean) / error, dof))


def over_all(name: str, rows: list[Row]) -> Row | None:
    """The mean of the cases' relative differences of one figure, which detects small changes common to all cases.

    Standard error and degrees of freedom (Welch and Satterthwaite) come from the scatter within the cases. None where
    no case has two pairs and a mean to relate to.
    """
    known = [row for row in rows if row.pairs > 1 and row.before > 0.0]
    if not known:
        return None
    share = np.array([row.difference / row.before for row in known])
    variance = np.array([(row.error / row.before) ** 2 for row in known])
    dof = float(variance.sum() ** 2 / max(float(np.sum(variance**2 / [row.pairs - 1 for row in known])), 1e-300))
    mean, error = float(share.mean()), float(np.sqrt(variance.sum()) / len(known))
    return Row(name, known[0].figure, sum(row.pairs for row in known), 1.0, 1.0 + mean, mean, error,
               _p(mean, error, max(dof, 1.0)))


def judged(rows: list[Row], rules: Rules) -> list[Row]:
    """The rows with their corrected p and verdicts; one that has a verdict, or no difference, is kept as it is."""
    tested = [i for i, row in enumerate(rows) if np.isfinite(row.p)]
    order = sorted(tested, key=lambda i: rows[i].p)
    corrected, largest = dict.fromkeys(range(len(rows)), np.nan), 0.0
    for rank, i in enumerate(order):
        largest = max(largest, min(1.0, (len(order) - rank) * rows[i].p))
        corrected[i] = largest
    level = rules.false_alarms / max(len(order), 1)
    return [_judged(row, corrected[i], level, rules) for i, row in enumerate(rows)]


def _judged(row: Row, corrected: float, level: float, rules: Rules) -> Row:
    if not np.isfinite(row.difference) or row.verdict != NOT_COMPARABLE:
        return row
    moved = abs(row.difference) > rules.relevant * abs(row.before)
    finds = np.nan
    if row.pairs > 1:
        finds = float(stats.t.ppf(1.0 - level / 2.0, row.pairs - 1) + stats.t.ppf(POWER, row.pairs - 1)) * row.error
    if not moved:
        return replace(row, corrected=corrected, finds=finds, verdict=SAME)
    if row.pairs < 2 and row.error != 0.0:
        return replace(row, verdict=NOT_COMPARABLE, why="one pair has no standard error; give it three seeds or more")
    sign = WORSE if row.difference > 0.0 else BETTER
    return replace(row, corrected=corrected, finds=finds,
                   verdict=sign if row.pairs < 2 or corrected < rules.false_alarms else SAME)


def seeds_needed(effect: float, chance: float) -> int | None:
    """Seeds that distinguish a mean from its bound by a one-sided t-test of power ``POWER``; None if too many.

    The power is that of the noncentral t distribution.

    Args:
        effect: distance of mean and bound, relative to the standard deviation of one run.
        chance: of a false answer.

    >>> seeds_needed(1.0, 0.05)
    11
    """
    def power(n: int) -> float:
        return float(stats.nct.sf(stats.t.ppf(1.0 - chance, n - 1), n - 1, effect * np.sqrt(n)))

    if effect <= 0.0 or power(MOST_SEEDS) < POWER:
        return None
    return bisect_left(range(MOST_SEEDS), POWER, lo=2, key=power)
