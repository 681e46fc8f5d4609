"""Verbs that say whether path errors have changed: check, compare-results."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ideal_robot.deadline import TIME_LIMIT
from ideal_robot.errors import InputError, did_you_mean
from scenes.commands.common import TimeLimit, progress_bar, show_table
from scenes.outputs import check_outputs

if TYPE_CHECKING:
    from scenes.regression.comparison import Comparison
    from scenes.regression.results import Results
    from scenes.regression.suite import Suite


@dataclass(kw_only=True)
class CheckOptions:
    """Options of ``check``."""

    suite: Annotated[Path, typer.Argument(help="Suite file (.toml): what is played, and its bounds.")]
    update_baseline: Annotated[bool, typer.Option("--update-baseline", help="Write the results as the new "
                                                                             "baseline.")] = False
    baseline: Annotated[Path | None, typer.Option(help="Baseline file; default: the suite's, or NAME.baseline.json "
                                                       "here.")] = None
    processes: Annotated[int, typer.Option(help="Local processes.", min=1)] = 2
    dask: Annotated[str | None, typer.Option(help="Address of a running Dask scheduler instead.")] = None
    runs: Annotated[Path | None, typer.Option(help="Folder of a Parquet data set of the runs, which grows as they "
                                                   "come and can be queried meanwhile.")] = None
    resume: Annotated[bool, typer.Option("--resume", help="Go on with what --runs holds: such runs of this version are "
                                                          "not played again.")] = False
    time_limit: TimeLimit = TIME_LIMIT
    out: Annotated[Path | None, typer.Option(help="Folder of the reports; default out/check_SUITE.")] = None


def check(options: CheckOptions) -> None:
    """Plays a suite and says whether it is better, the same or worse than its baseline, and within its bounds.

    Runs are paired by seed. The folder holds a page, Markdown for a pull request, JUnit XML, JSON, JSON Lines and
    Parquet; times stand apart in times.json. Exit code 1 where anything is worse, a bound is missed, a run was lost or
    all runs of a case failed. --update-baseline takes what is worse than before as it is, and writes nothing in the
    last two cases.

    Example, with a checkout: `ideal-robot check examples/nightly.toml --update-baseline`

    Example: `ideal-robot check examples/nightly.toml`
    """
    from scenes.regression.comparison import check_arms
    from scenes.regression.results import Results, RunSet, times_of
    from scenes.regression.suite import Suite
    from scenes.report.page import write_json
    from scenes.scene_files.scene import Scene

    suite = Suite(options.suite)
    place = options.baseline or suite.baseline
    folder = options.out or Path("out") / f"check_{options.suite.stem}"
    check_outputs({"--out": folder, "--runs": options.runs}, **({"baseline": place} if options.update_baseline else {}))
    earlier = _baseline(options, suite, place)
    work = [job for job, _ in suite.work]
    if earlier is not None and not options.update_baseline:
        check_arms(earlier, {job.scene.robot for job in work if isinstance(job.scene, Scene)})
    file = None if options.runs is None else RunSet(options.runs, resume=options.resume)
    with progress_bar(f"{len(work)} runs") as progress:
        answers = suite.play(processes=options.processes, dask=options.dask, file=file, limit=options.time_limit,
                             done=lambda count: progress(count / len(work), f"{count} of {len(work)}"))
    results = Results.of(answers, str(options.suite))
    comparison = _compared(results, earlier, suite, anyway=options.update_baseline)
    _report(comparison, folder)
    write_json(folder / "times.json", {"runs": times_of(answers)})
    failed = dict.fromkeys(row.case for row in comparison.rows if row.verdict == "failed")
    if options.update_baseline and failed:
        typer.echo(f"no baseline was written: all runs failed of {'; '.join(failed)}", err=True)
    elif options.update_baseline and not comparison.not_played:
        typer.echo(f"baseline: {results.write(place)}")
    elif earlier is None:
        typer.echo(f"no baseline at {place}; --update-baseline makes it", err=bool(comparison.not_played))
    if (comparison.not_played or not comparison.bounds_kept or comparison.verdict == "failed"
            or (comparison.verdict == "worse" and not options.update_baseline)):
        raise typer.Exit(1)


def _baseline(options: CheckOptions, suite: Suite, place: Path) -> Results | None:
    """The results that a suite is compared with; None where there are none, and need not be."""
    from scenes.regression.results import read_results

    needed = options.baseline or not any(bounds for _, bounds in suite.work)
    if not place.is_file() and not options.update_baseline and needed:
        raise InputError("no such baseline; --update-baseline makes it", file=place)
    if options.resume and options.runs is None:
        raise InputError("needs --runs FOLDER, what to go on with", field="--resume")
    return read_results(place) if place.is_file() else None


def _compared(results: Results, earlier: Results | None, suite: Suite, *, anyway: bool) -> Comparison:
    """Results beside the baseline's; ``anyway`` without it where the two cannot be compared."""
    from scenes.regression.comparison import bounds_of, comparison_of

    bounds = bounds_of(results, [bounds for _, bounds in suite.work])
    rules = {"figures": suite.file.figures, "rules": suite.rules, "title": suite.file.title}
    try:
        return comparison_of(results, earlier, bounds, **rules)
    except InputError:
        if not anyway:
            raise
        return comparison_of(results, None, bounds, **rules)


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
    from scenes.regression.formats import bounds_table, write_comparison

    if comparison.before is not None or comparison.rows:
        show_table("what changed, or all cases together", *comparison.table())
    if comparison.bounds:
        show_table("bounds", *bounds_table(comparison))
    report = write_comparison(comparison, folder)
    if comparison.not_played:
        typer.echo(f"{comparison.not_played} runs were not played", err=True)
    typer.echo(f"verdict: {comparison.headline}")
    typer.echo(f"report: {report}")
