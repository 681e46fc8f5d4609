"""History of a data set of runs over versions and computers: the best version, and since when it is worse."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ideal_robot.errors import InputError
from ideal_robot.results import Summarised
from scenes.program import ORIGIN
from scenes.regression.comparison import labelled
from scenes.regression.paired import WORSE, Row, Rules, judged, one_run, paired
from scenes.regression.results import MAIN, Results, figure_in_words, table, unit_of
from scenes.verdict import Verdict

if TYPE_CHECKING:
    import pandas as pd

_NO_RUN = "holds no run that says which version played it; check --runs and sweep --runs write such"


@dataclass(frozen=True)
class Version:
    """One state of the program's sources.

    Attributes:
        digest: of its sources; name: its commit, or its version and digest where it was installed.
        when: time of its first run (UTC).
        computers: computers that ran it.
    """

    digest: str
    name: str
    when: str
    computers: tuple[str, ...]


@dataclass(frozen=True)
class Course:
    """One figure of one case over the versions that ran the same scene in the same simulated world.

    Attributes:
        case, figure: the case, and the figure's name with its unit.
        versions: from the first to the newest; means, errors: over the seeds, and its standard error ``(N,)``; of one
            seed the error is NaN.
        best: index of the version with the smallest mean; newest: the last index.
        row: best and newest compared, seed by seed.
        since: index of the first version from which on every one is worse than the best; None where the newest is not.
        runs: a row a run, with ``digest``, ``computer``, ``seed`` and the figure.
    """

    case: str
    figure: str
    versions: tuple[Version, ...]
    means: np.ndarray
    errors: np.ndarray
    best: int
    row: Row
    since: int | None
    runs: pd.DataFrame = field(repr=False)

    @property
    def worst_seed(self) -> dict[str, Any]:
        """The newest version's run whose figure rose most since the best version, as a row of ``runs``."""
        of = self.runs.drop_duplicates(["digest", "seed"]).set_index("seed")
        newest, best = (of[of["digest"] == self.versions[i].digest] for i in (-1, self.best))
        rise = (newest[self.figure].abs() - best[self.figure].abs()).dropna()
        place = newest.index.get_loc(rise.idxmax()) if len(rise) else 0
        return {"seed": newest.index[place], **{str(key): value for key, value in newest.iloc[place].to_dict().items()}}


@dataclass(frozen=True, repr=False)
class History(Summarised):
    """Figures of all cases over versions.

    Attributes:
        title: the data sets.
        versions: all, the newest last.
        courses: a course a case and figure.
    """

    title: str
    versions: tuple[Version, ...]
    courses: tuple[Course, ...]

    @property
    def worse(self) -> list[Course]:
        """Figures whose newest version is worse than the best, the largest relative rise first."""
        return sorted((course for course in self.courses if course.row.verdict == WORSE),
                      key=lambda course: -course.row.difference / max(course.row.before, 1e-300))

    @property
    def headline(self) -> str:
        """One sentence: which version made which figure worse, or that none did."""
        newest = self.versions[-1].name
        if len(self.versions) == 1:
            return f"{newest} is the only version; nothing to compare with"
        if not self.worse:
            return f"{newest} is as good as the best of {len(self.versions)} versions in every case"
        first = self.worse[0]
        assert first.since is not None
        unit = f" {unit_of(first.figure) or ''}".rstrip()
        return (f"{first.case}: {figure_in_words(first.figure)} rose from {first.row.before:.3g}{unit} "
                f"({first.versions[first.best].name}) to {first.row.after:.3g}{unit} with "
                f"{first.versions[first.since].name}; {len(self.worse)} of {len(self.courses)} figures are worse than "
                "their best")

    def summary(self) -> list[tuple[str, str]]:
        """The headline, and the number of runs and versions behind it."""
        return [("history", self.title), ("versions", str(len(self.versions))), ("verdict", self.headline)]

    def json(self) -> dict[str, Any]:
        """Plain values."""
        return {"schema": 1, "title": self.title, "headline": self.headline,
                "versions": [version.__dict__ for version in self.versions],
                "figures": [{"case": course.case, "figure": course.figure, "means": course.means,
                             "versions": [version.digest for version in course.versions],
                             "best": course.versions[course.best].digest,
                             "since": None if course.since is None else course.versions[course.since].digest,
                             **{key: value for key, value in course.row.json().items()
                                if key not in ("case", "figure")}} for course in self.courses]}

    @property
    def main(self) -> list[Course]:
        """The figures that are worse, and of the other cases the first figure."""
        first = {course.case: course for course in reversed(self.courses)}
        worse = self.worse
        return [*worse, *(course for case, course in first.items() if case not in {one.case for one in worse})]

    def table(self, courses: Sequence[Course] | None = None) -> tuple[list[str], list[list[Any]]]:
        """The histories as a table, one row each; those of ``main`` if None."""
        return (["case", "figure", "versions", "best", "of version", "newest", "of version", "worse since", "verdict"],
                [[course.case, course.figure, len(course.versions), float(course.means[course.best]),
                  course.versions[course.best].name, float(course.means[-1]), course.versions[-1].name,
                  "" if course.since is None else course.versions[course.since].name,
                  Verdict("best" if course.best == len(course.versions) - 1 else course.row.verdict)]
                 for course in (self.main if courses is None else courses)])


def history_of(folders: Sequence[Path], *, figures: Sequence[str] = MAIN, rules: Rules | None = None) -> History:
    """The history of the runs in data sets; equal runs of several computers are averaged.

    Args:
        folders: of ``check --runs`` or ``sweep --runs``.
        figures: names of the figures, as far as a case has them; less is better.
        rules: rules by which a difference is a change.

    Raises:
        InputError: no data set, or none with a run that says which version ran it.
    """
    runs = _runs(folders)
    versions = _versions(runs)
    order = [version.digest for version in versions]
    courses = []
    for label, group in runs.groupby("label", sort=False):
        newest = group[group["digest"] == max(group["digest"], key=order.index)]
        alike = group
        for name in ("task_hash", "world_hash"):
            alike = alike[alike[name].isin(set(newest[name])) | alike[name].isna()]
        for figure in figures:
            if figure in alike and alike[figure].notna().any():
                courses.append(_course(str(label), figure, alike, versions))
    compared = iter(judged([course.row for course in courses], rules or Rules()))
    courses = [_dated(course, next(compared)) for course in courses]
    return History(", ".join(map(str, folders)), versions, tuple(courses))


def _runs(folders: Sequence[Path]) -> pd.DataFrame:
    """All runs of the data sets that succeeded, with ``ORIGIN`` and the ``label`` of their case."""
    import pandas as pd

    parts = []
    for folder in folders:
        files = sorted(folder.glob("scene=*/*.parquet"))
        if not files:
            raise InputError("is not a data set of runs; give the folder of check --runs or sweep --runs", file=folder)
        for path in files:
            try:
                part = pd.read_parquet(path.absolute())
            except (OSError, ValueError) as error:
                raise InputError(f"cannot be read as a part of a data set ({str(error)[:200]})", file=path) from error
            if "digest" not in part:
                continue
            part["scene"] = path.parent.name.removeprefix("scene=")
            origins = part[[name for name in ORIGIN if name in part]].reindex(columns=list(ORIGIN))
            figures = table(part.astype(object).where(part.notna(), None).to_dict("records"))
            parts.append(pd.concat([labelled(Results(figures)), origins], axis="columns"))
    if not parts:
        raise InputError(_NO_RUN, file=folders[0])
    runs = pd.concat(parts, ignore_index=True)
    runs = runs[runs["failure"].isna() & runs["digest"].notna()]
    if runs.empty:
        raise InputError(_NO_RUN, file=folders[0])
    return runs


def _versions(runs: pd.DataFrame) -> tuple[Version, ...]:
    """The versions, by the time of their first run."""
    versions = []
    for digest, group in runs.groupby("digest"):
        commit, number = (next(iter(group[name].dropna()), None) for name in ("commit", "version"))
        # Uncommitted sources have the name of the commit below them and their digest.
        name = f"{commit} {str(digest)[:6]}" if str(commit).endswith("-dirty") else commit
        versions.append(Version(str(digest), str(name or f"{number} {str(digest)[:6]}"),
                                str(group["when"].dropna().min()),
                                tuple(sorted(map(str, set(group["computer"].dropna()))))))
    return tuple(sorted(versions, key=lambda version: version.when))


def _course(case: str, figure: str, runs: pd.DataFrame, versions: Sequence[Version]) -> Course:
    """A course, its row not judged and its date not looked for yet."""
    runs = runs[runs[figure].notna()]
    by = runs.assign(**{figure: runs[figure].astype(float).abs()}).groupby(["digest", "seed"], dropna=False)[figure]
    values = by.mean().unstack("seed")
    played = [version for version in versions if version.digest in values.index]
    values = values.loc[[version.digest for version in played]]
    # Only seeds that every version has: otherwise means would compare seeds, not versions.
    common = values.dropna(axis="columns")
    values = common if common.shape[1] else values
    means = values.mean(axis="columns").to_numpy()
    errors = (values.std(axis="columns", ddof=1) / np.sqrt(values.notna().sum(axis="columns"))).to_numpy()
    best = int(np.nanargmin(means))
    row = _compared(case, figure, values, best, -1)
    # The best version was picked among all, so its p is corrected for that number.
    row = replace(row, p=min(1.0, row.p * max(len(played) - 1, 1)))
    return Course(case, figure, tuple(played), means, errors, best, row, None, runs)


def _compared(case: str, figure: str, values: pd.DataFrame, before: int, after: int) -> Row:
    """Two versions seed by seed; of seeds that are all one run, or a single one, without chance."""
    pair = values.iloc[[before, after]].dropna(axis="columns").to_numpy()
    if not pair.shape[1]:
        return Row(case, figure, why="the two versions have no seed in common")
    if pair.shape[1] > 1 and np.all(pair == pair[:, :1]):
        return one_run(case, figure, pair.shape[1], *map(float, pair[:, 0]))
    return paired(case, figure, *pair)


def _dated(course: Course, row: Row) -> Course:
    """The course with its row judged, and since which version it is worse."""
    since = None
    if row.verdict == WORSE:
        # The step is where the figure last crosses the middle between the best and the newest version.
        middle = 0.5 * (course.means[course.best] + course.means[-1])
        since = int(np.flatnonzero(course.means <= middle)[-1]) + 1
    return replace(course, row=row, since=since)
