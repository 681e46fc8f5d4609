"""The page of a history: which case is worse since when, its figure over versions, its replay beside the best."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scenes.regression.history import Course, History
from scenes.regression.replays import replay_place, word_of
from scenes.regression.results import figure_in_words, unit_of
from scenes.report.page import Report
from scenes.report.replay import KeptReplay
from scenes.verdict import BAD, GOOD, OPEN, Verdict

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MOST = 12
"""Courses in the picture."""


def run_command(run: Mapping[Any, Any], scene: str | None = None) -> str:
    """The command line that repeats a run.

    Args:
        run: an answer, or a row of a table of runs, with the keys of ``CASE`` and ``seed``.
        scene: its scene as the command line takes it; the name if None.
    """
    words = ["ideal-robot", "run", scene or str(run["scene"])]
    for option, key in (("--method", "method"), ("--speed", "speed_m_s"), ("--world", "world"), ("--seed", "seed"),
                        ("--individual", "individual")):
        value = word_of(run.get(key))
        if value and (key, value) != ("individual", "1"):
            words += [option, value]
    return shlex.join(words)


def history_page(history: History, folders: Sequence[Path]) -> Report:
    """The page; replays come from the data sets ``folders``."""
    report = Report("Path error over versions", history.headline + ".")
    worse = len(history.worse)
    alone = len(history.versions) == 1
    report.figures([("verdict", Verdict("first version", OPEN) if alone else
                     Verdict("worse" if worse else "as good as the best", BAD if worse else GOOD)),
                    ("versions", str(len(history.versions))),
                    ("figures worse than their best", f"{worse} of {len(history.courses)}")])
    report.next(*next_steps(history))
    report.figure(picture(history), "Mean over the seeds with its standard error, a point a seed, a colour a computer. "
                                    "Green ring: the best version; red ring: the newest, where it is worse.")
    for course in history.worse[:1]:
        replays = replays_of(course, folders)
        if replays:
            report.heading("What became worse, beside the best")
            report.replays(replays, f"Seed {course.worst_seed['seed']:g} of {course.case}, in which {course.figure} "
                                    "rose most, played by both versions.")
    report.heading("Details")
    report.table(*history.table(history.courses), folded="all cases and figures",
                 caption="Versions are compared seed by seed (paired t-test, Holm's correction, and one for the best "
                         "having been picked). Only versions that played the same scene in the same simulated world.")
    report.table(["version", "first run (UTC)", "computers"],
                 [[version.name, version.when, ", ".join(version.computers)] for version in history.versions],
                 folded="versions")
    return report


def next_steps(history: History) -> list[tuple[str, str]]:
    """The next steps, each a sentence and its command."""
    if not history.worse:
        return [("Play the suite with the next version; it is compared with the best of these.",
                 "ideal-robot check SUITE.toml --runs FOLDER --resume")]
    course = history.worse[0]
    assert course.since is not None
    steps = [("Look at the run that became worse.", run_command(course.worst_seed))]
    good, bad = course.versions[course.since - 1].name, course.versions[course.since].name
    if not any(" " in name for name in (good, bad)):
        steps.append(("Find the commit between the last good and the first worse version, with the baseline of the "
                      "good one.", f"git bisect start {bad} {good}\ngit bisect run ideal-robot check SUITE.toml"))
    return steps


def replays_of(course: Course, folders: Sequence[Path]) -> list[tuple[str, KeptReplay]]:
    """Replays of the seed that became worse most: best version's and newest's with titles, as far as stored."""
    run = course.worst_seed
    kept = []
    for index in (course.best, len(course.versions) - 1):
        version = course.versions[index]
        of = course.runs[(course.runs["digest"] == version.digest) & (course.runs["seed"] == run["seed"])]
        for folder in folders:
            replay = KeptReplay.read(replay_place(folder, version.digest, of.iloc[0])) if len(of) else None
            if replay is not None:
                value = f"{abs(float(of.iloc[0][course.figure])):.3g} {unit_of(course.figure) or ''}".rstrip()
                kept.append((f"{'best' if index == course.best else 'newest'}: {version.name}, {value}", replay))
                break
    return kept


def picture(history: History) -> Figure:
    """Figure of path errors over the program's versions, one panel per case, those that became worse first."""
    import matplotlib.pyplot as plt

    courses = [*history.worse, *(course for course in history.courses if course not in history.worse)][:_MOST]
    columns = min(2, len(courses))
    rows = -(-len(courses) // columns)
    figure, panels = plt.subplots(rows, columns, figsize=(5.5 * columns, 2.6 * rows), layout="constrained",
                                  squeeze=False)
    computers = sorted({computer for version in history.versions for computer in version.computers})
    for panel, course in zip(panels.ravel(), courses, strict=False):
        place = {version.digest: i for i, version in enumerate(course.versions)}
        for i, computer in enumerate(computers):
            of = course.runs[course.runs["computer"] == computer]
            panel.plot(of["digest"].map(place), of[course.figure].abs(), ".", color=f"C{i}", alpha=0.4,
                       label=computer if len(computers) > 1 else None)
        panel.errorbar(range(len(course.versions)), course.means, yerr=course.errors, color="0.3", capsize=3.0, lw=1.0)
        ring = {"markersize": 11.0, "markerfacecolor": "none", "markeredgewidth": 2.0}
        panel.plot(course.best, course.means[course.best], "o", markeredgecolor="#2b8a3e", **ring)
        if course.since is not None:
            panel.plot(len(course.versions) - 1, course.means[-1], "o", markeredgecolor="#c0261c", **ring)
        panel.set_title(course.case, fontsize=10.0)
        # One word per line, as the name in one line is longer than the panel is high.
        unit = unit_of(course.figure)
        words = figure_in_words(course.figure).replace(", ", "\n")
        panel.set_ylabel(f"{words} [{unit}]" if unit else words, fontsize=9.0)
        # Space for the ring around the highest point.
        panel.set_ylim(0.0, 1.15 * panel.get_ylim()[1])
        panel.set_xticks(range(len(course.versions)), [version.name[:16] for version in course.versions], rotation=30.0,
                         ha="right", fontsize=8.0)
    for panel in panels.ravel()[len(courses):]:
        panel.set_visible(False)
    if len(computers) > 1:
        panels[0, 0].legend(fontsize=8.0)
    plt.close(figure)
    return figure
