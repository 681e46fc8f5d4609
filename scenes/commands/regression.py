"""Verbs that say whether path errors have changed: check, history, compare-results."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ideal_robot.deadline import TIME_LIMIT
from ideal_robot.errors import InputError, did_you_mean
from scenes.commands.common import JsonFigures, TimeLimit, progress_bar, show_table, write_signed
from scenes.outputs import check_outputs

if TYPE_CHECKING:
    from scenes.regression.comparison import Comparison
    from scenes.regression.results import Results
    from scenes.regression.suite import Played, Suite


@dataclass(kw_only=True)
class CheckOptions:
    """Options of ``check``."""

    suite: Annotated[Path, typer.Argument(help="Suite file (.toml): what is run, and its bounds.")]
    update_baseline: Annotated[bool, typer.Option("--update-baseline", help="Write the results as the new "
                                                                             "baseline.")] = False
    baseline: Annotated[Path | None, typer.Option(help="Baseline file; default: the suite's, or NAME.baseline.json "
                                                       "here.")] = None
    processes: Annotated[int, typer.Option(help="Local processes.", min=1)] = 2
    dask: Annotated[str | None, typer.Option(help="Address of a running Dask scheduler instead.")] = None
    runs: Annotated[Path | None, typer.Option(help="Folder of a Parquet data set of the runs, which grows as they "
                                                   "come and can be queried meanwhile.")] = None
    resume: Annotated[bool, typer.Option("--resume", help="Go on with what --runs holds: such runs of this version are "
                                                          "not played again, those of others stay as its "
                                                          "history.")] = False
    allow_new: Annotated[bool, typer.Option("--allow-new", help="Cases that have nothing to be compared with are no "
                                                                "failure: for the first night, and after a new "
                                                                "case.")] = False
    time_limit: TimeLimit = TIME_LIMIT
    out: Annotated[Path | None, typer.Option(help="Folder of the reports; default out/check_SUITE.")] = None


def check(options: CheckOptions) -> None:
    """Plays a suite and says whether it is better, the same or worse than its baseline, and within its bounds.

    Runs are paired by seed. The folder holds a page, Markdown for a pull request, JUnit XML, JSON, JSON Lines and
    Parquet; times stand apart in times.json. Exit code 1 where anything is worse, a bound is missed, a run was lost,
    all runs of a case failed, or a case has neither a bound nor anything to be compared with (--allow-new lets it
    pass). --update-baseline takes what is worse or new as it is; where runs were lost or failed it writes nothing.
    With --runs FOLDER the folder is the history of the suite, which the verb history shows.

    Example, with a checkout: `ideal-robot check examples/nightly.toml --update-baseline`

    Example: `ideal-robot check examples/nightly.toml`
    """
    from scenes.regression.comparison import check_arms
    from scenes.regression.replays import play_and_keep
    from scenes.regression.results import Results, RunSet, times_of
    from scenes.regression.suite import Suite
    from scenes.report.page import write_json
    from scenes.scene_files.scene import Scene
    from scenes.sweep import play

    suite = Suite(options.suite)
    place = options.baseline or suite.baseline
    folder = options.out or Path("out") / f"check_{options.suite.stem}"
    check_outputs({"--out": folder, "--runs": options.runs}, **({"baseline": place} if options.update_baseline else {}))
    earlier = _baseline(options, suite, place)
    work = [job for job, _ in suite.work]
    keep = options.runs
    if earlier is not None and not options.update_baseline:
        check_arms(earlier, {job.scene.robot for job in work if isinstance(job.scene, Scene)})
    file = None if options.runs is None else RunSet(options.runs, resume=options.resume)
    with progress_bar(f"{len(work)} runs") as progress:
        played = suite.play(processes=options.processes, dask=options.dask, file=file, limit=options.time_limit,
                            done=lambda count: progress(count / len(work), f"{count} of {len(work)}"),
                            function=play if keep is None else partial(play_and_keep, folder=keep))
    results = Results.of(played.answers, str(options.suite))
    comparison = _compared(results, earlier, suite, played, anyway=options.update_baseline)
    _report(comparison, folder)
    write_json(folder / "times.json", {"runs": times_of(played.answers)})
    for scene, count in played.spared.items():
        typer.echo(f"{scene}: two seeds give the same run to the last digit; not played: {count} further")
    if keep is not None:
        _tidied(keep)
    failed = dict.fromkeys(row.case for row in comparison.rows if row.verdict == "failed")
    if options.update_baseline and failed:
        typer.echo(f"no baseline was written, as all runs failed of {'; '.join(failed)}", err=True)
    elif options.update_baseline and not comparison.not_played:
        typer.echo(f"baseline: {results.write(place)}")
    elif earlier is None:
        typer.echo(f"no baseline at {place}; --update-baseline makes it", err=bool(comparison.not_played))
    excused = options.update_baseline or options.allow_new
    if comparison.uncompared and not excused:
        typer.echo(f"nothing to compare with: {'; '.join(comparison.uncompared)}; --update-baseline takes these runs "
                   "as the baseline, --allow-new lets them pass", err=True)
    if (comparison.not_played or not comparison.bounds_kept or comparison.verdict == "failed"
            or (comparison.verdict == "worse" and not options.update_baseline)
            or (comparison.uncompared and not excused)):
        raise typer.Exit(1)


def _tidied(folder: Path) -> None:
    """Keeps of a data set's replays those of the newest and of the best version of each case."""
    from scenes.regression.history import history_of
    from scenes.regression.replays import tidy_replays

    with suppress(InputError):  # no run has succeeded yet
        courses = history_of([folder]).courses
        tidy_replays(folder, {course.versions[i].digest for course in courses for i in (course.best, -1)})


def history(
    runs: Annotated[list[Path], typer.Argument(help="Folders that check --runs or sweep --runs have written; several "
                                                    "of several computers.")],
    figures: Annotated[str, typer.Option(help="Figures to look at, by name and separated by commas; default: the "
                                              "errors that a sweep shows.")] = "",
    json: JsonFigures = None,
    out: Annotated[Path, typer.Option(help="Folder of the page.")] = Path("out/history"),
) -> None:
    """Shows path errors over versions and computers: the best version of each case, and since when one is worse.

    The page has the replay of the run that became worse most, beside the best version's. Exit code 1 where the newest
    version is worse than the best in any case.

    Example: `ideal-robot check examples/nightly.toml --runs out/nightly --resume --allow-new` every night, then
    `ideal-robot history out/nightly`
    """
    from scenes.regression.history import history_of
    from scenes.regression.history_page import history_page, next_steps
    from scenes.regression.results import MAIN

    check_outputs({"--out": out}, json=json)
    found = history_of(runs, figures=[name.strip() for name in figures.split(",") if name.strip()] or MAIN)
    if not found.courses:
        raise InputError("no run has such a figure", field="--figures", value=figures or ", ".join(MAIN))
    show_table("over versions", *found.table())
    page = history_page(found, runs).write(out / "report.html")
    write_signed(json, found.json())
    typer.echo(f"{found.headline}")
    typer.echo(f"report: {page}")
    for text, command in next_steps(found):
        typer.echo(f"next: {text}\n  " + command.replace("\n", "\n  "))
    if found.worse:
        raise typer.Exit(1)


def _baseline(options: CheckOptions, suite: Suite, place: Path) -> Results | None:
    """The results that a suite is compared with; None where there are none, and need not be."""
    from scenes.regression.results import read_results

    needed = options.baseline or not (options.allow_new or any(bounds for _, bounds in suite.work))
    if not place.is_file() and not options.update_baseline and needed:
        raise InputError("no such baseline; --update-baseline makes it, --allow-new plays without", file=place)
    if options.resume and options.runs is None:
        raise InputError("needs --runs FOLDER, with the runs to be continued", field="--resume")
    return read_results(place) if place.is_file() else None


def _compared(results: Results, earlier: Results | None, suite: Suite, played: Played, *, anyway: bool) -> Comparison:
    """Results beside the baseline's; ``anyway`` without it where the two cannot be compared."""
    from scenes.regression.comparison import bounds_of, comparison_of

    bounds = bounds_of(results, played.bounds)
    rules = {"figures": suite.file.figures, "rules": suite.rules, "title": suite.file.title}
    try:
        comparison = comparison_of(results, earlier, bounds, **rules)
    except InputError:
        if not anyway:
            raise
        comparison = comparison_of(results, None, bounds, **rules)
    return replace(comparison, places=suite.places)


def compare_results(
    before: Annotated[Path, typer.Argument(help="Earlier results: file or folder that run, compare, sweep or check "
                                                "has written.")],
    after: Annotated[Path, typer.Argument(help="New results.")],
    figures: Annotated[str, typer.Option(help="Figures to compare, by name and separated by commas; default: the "
                                              "errors that a sweep shows.")] = "",
    out: Annotated[Path, typer.Option(help="Folder of the reports.")] = Path("out/compare_results"),
) -> None:
    """Compares two results pair by pair: difference, standard error, p and verdict of each figure, with the picture.

    Exit code 1 where anything is worse, or all runs of a case failed.

    Example: `ideal-robot run edge --json main.json`, with the other version `ideal-robot run edge --json branch.json`,
    and then `ideal-robot compare-results main.json branch.json`
    """
    from scenes.regression.comparison import compared
    from scenes.regression.results import MAIN, read_results

    check_outputs({"--out": out})
    results = read_results(before), read_results(after)
    names = [name.strip() for name in figures.split(",") if name.strip()]
    known = [name for name in results[0].figures if name in results[1].figures]
    for name in names:
        if name not in known:
            raise InputError(f"not in both; {did_you_mean(name, known)}there are {', '.join(known)}", field="--figures",
                             value=name)
    comparison = compared(*results, figures=names or MAIN)
    _report(comparison, out)
    if comparison.verdict in ("worse", "failed"):
        raise typer.Exit(1)


def _report(comparison: Comparison, folder: Path) -> None:
    from scenes.regression.formats import bounds_table, next_steps, write_comparison

    if comparison.before is not None or comparison.rows:
        show_table("what changed, or all cases together", *comparison.table())
    if comparison.bounds:
        show_table("bounds", *bounds_table(comparison))
    report = write_comparison(comparison, folder)
    if comparison.not_played:
        typer.echo(f"{comparison.not_played} runs were not played", err=True)
    typer.echo(f"verdict: {comparison.headline}")
    typer.echo(f"report: {report}")
    for text, command in next_steps(comparison):
        typer.echo(f"next: {text}" + "".join(f"\n  {line}" for line in command.splitlines()))
