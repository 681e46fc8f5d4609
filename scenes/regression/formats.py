"""Writes a comparison as a page, Markdown for a pull request, JUnit XML, JSON, JSON Lines and Parquet."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import stats

from ideal_robot.results import plain
from ideal_robot.whole_file import whole_file, write_text
from scenes.outputs import whole_folder
from scenes.regression.comparison import FAILURES, SUITE, Comparison, labelled
from scenes.regression.history_page import run_command
from scenes.regression.paired import FAILED, NOT_COMPARABLE, SAME, WORSE, Row
from scenes.regression.results import CASE, figure_in_words, unit_of
from scenes.report.page import Report, write_json
from scenes.verdict import BAD, GOOD, OPEN, Verdict

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MOST_ROWS = 60
"""Rows of a Markdown comment; forges cut off long ones."""
_MOST_CASES = 24
"""Cases in the picture."""


def write_comparison(comparison: Comparison, out: Path) -> Path:
    """Writes page, Markdown, JUnit XML, JSON, JSON Lines and Parquet into a folder; returns the page.

    The same runs give the same bytes.
    """
    with whole_folder(out) as new:
        comparison.after.write(new / "results.json")
        write_json(new / "comparison.json", comparison.json())
        write_text(new / "comparison.md", markdown(comparison))
        write_text(new / "junit.xml", junit(comparison))
        lines = [json.dumps(plain(row), allow_nan=False) for row in comparison.json()["figures"]]
        write_text(new / "comparison.jsonl", "".join(f"{line}\n" for line in lines))
        with whole_file(new / "results.parquet") as file:
            comparison.after.runs.to_parquet(file, index=False)
        page(comparison).write(new / "report.html")
    return out / "report.html"


def markdown(comparison: Comparison) -> str:
    """The comparison as a comment of a pull request: the verdict, then what changed, then the bounds."""
    parts = [f"### Path error: {comparison.headline}", "", _escaped(comparison.title), ""]
    if comparison.before is not None:
        parts += [f"{_version(comparison.before.program)} → {_version(comparison.after.program)}; "
                  f"{sum(row.verdict == SAME for row in comparison.rows)} of {len(comparison.rows)} figures "
                  "the same.", ""]
    for columns, rows in (comparison.table(), bounds_table(comparison)):
        if rows:
            parts += ["| " + " | ".join(columns) + " |", "|" + " --- |" * len(columns)]
            parts += ["| " + " | ".join(_escaped(_cell(cell)) for cell in row) + " |" for row in rows[:_MOST_ROWS]]
            parts += [f"… and {len(rows) - _MOST_ROWS} more."] if len(rows) > _MOST_ROWS else []
            parts.append("")
    return "\n".join(parts)


def bounds_table(comparison: Comparison) -> tuple[list[str], list[list[Any]]]:
    """Column titles and rows: each bound on a figure's mean, the mean, and whether the bound is kept."""
    return (["case", "bound on the mean", "limit", "mean", "deviation", "seeds", "result", "remark"],
            [[b.case, b.figure, b.limit, b.mean, b.deviation, b.seeds, Verdict("kept" if b.kept else "missed"),
              b.remark] for b in comparison.bounds])


def _version(program: dict[str, Any]) -> str:
    return " ".join(str(program[key]) for key in ("version", "commit") if program.get(key)) or "unknown version"


def _cell(cell: Any) -> str:
    if isinstance(cell, float):
        return f"{cell:.3g}" if np.isfinite(cell) else "–"
    return str(cell)


def _escaped(text: str) -> str:
    return _one_line(text).replace("|", "\\|").replace("<", "&lt;").replace("@", "@\u200b")


def junit(comparison: Comparison) -> str:
    """JUnit XML with a suite per case and a test per figure or bound; without pairs a test is skipped."""
    cases: dict[str, list[tuple[str, str, str]]] = {}
    for row in comparison.rows:
        cases.setdefault(row.case, []).append((row.figure or "comparison", row.verdict, sentence(row)))
    for bound in comparison.bounds:
        text = f"mean {bound.mean:.4g}, bound {bound.limit:.4g} {unit_of(bound.figure) or ''} {bound.remark}".rstrip()
        cases.setdefault(bound.case, []).append((f"{bound.figure} bound", SAME if bound.kept else WORSE, text))
    if comparison.not_played:
        cases["runs"] = [("not played", WORSE, f"{comparison.not_played} runs were lost")]
    root = ET.Element("testsuites", name="ideal-robot check")
    for case, tests in cases.items():
        failures, skipped = (str(sum(verdict in what for _, verdict, _ in tests))
                             for what in ((WORSE, FAILED), (NOT_COMPARABLE,)))
        suite = ET.SubElement(root, "testsuite", name=_one_line(case), tests=str(len(tests)), errors="0",
                              failures=failures, skipped=skipped)
        for name, verdict, text in tests:
            test = ET.SubElement(suite, "testcase", classname=_one_line(case), name=_one_line(name))
            if verdict in (WORSE, FAILED, NOT_COMPARABLE):
                ET.SubElement(test, "skipped" if verdict == NOT_COMPARABLE else "failure", message=_one_line(text))
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def _one_line(text: str) -> str:
    """A scene file's words without what XML refuses and a terminal would obey."""
    return "".join(c if c.isprintable() else " " for c in text)


def sentence(row: Row) -> str:
    """A row in words."""
    if row.figure == FAILURES:
        return f"{row.after:g} of {row.pairs} runs failed: {row.why}"
    if row.verdict == NOT_COMPARABLE or not np.isfinite(row.error):
        return row.why or row.verdict
    # For all cases together the value is relative to before.
    unit = "" if row.case == SUITE else f" {unit_of(row.figure) or ''}".rstrip()
    sure = f"p {row.corrected:.2g}, {row.pairs} pairs" if np.isfinite(row.p) else row.why
    return (f"{row.before:.4g} → {row.after:.4g}{unit}, difference {row.difference:+.3g} ± {row.error:.2g}, "
            f"{sure}")


def answer(comparison: Comparison) -> str:
    """The verdict in a sentence with its number."""
    worst = comparison.worst
    missed = next((bound for bound in comparison.bounds if not bound.kept), None)
    if worst is not None:
        unit, ratio = unit_of(worst.figure) or "", worst.after / max(worst.before, 1e-300)
        by = f"{100.0 * (ratio - 1.0):+.0f} %" if ratio < 3.0 else f"{ratio:.3g} times as much"
        return (f"{worst.case}: {figure_in_words(worst.figure)} rose from {worst.before:.3g} to {worst.after:.3g} "
                f"{unit}".rstrip() + f" ({by}).")
    if missed is not None:
        unit = f" {unit_of(missed.figure) or ''}".rstrip()
        return (f"{missed.case}: {figure_in_words(missed.figure)} is {missed.mean:.3g}{unit}, its bound "
                f"{missed.limit:.3g}{unit}.")
    if comparison.uncompared:
        return f"Nothing to compare with: {'; '.join(comparison.uncompared)}."
    compared = sum(row.verdict != NOT_COMPARABLE for row in comparison.rows)
    return f"{compared} figures were compared and {len(comparison.bounds)} bounds looked at; none is worse or missed."


def next_steps(comparison: Comparison) -> list[tuple[str, str]]:
    """The next steps, each a sentence and its command."""
    worst = comparison.worst
    pair = None if worst is None else comparison.pair_of(worst)
    suite = comparison.after.source if comparison.after.source.endswith(".toml") else None
    if worst is not None and pair is not None:
        seed = {**pair, **{name: pair[f"{name} after"] for name in (*CASE, "seed") if f"{name} after" in pair}}
        rise = f"{pair[f'{worst.figure} before']:.3g} → {pair[f'{worst.figure} after']:.3g}"
        steps = [(f"Look at the run that rose most ({rise}).",
                  run_command(seed, comparison.places.get(str(pair["scene"]))))]
        if suite is not None and (good := (comparison.before and comparison.before.program.get("commit"))):
            begin = f"git bisect start HEAD {good.removesuffix('-dirty')}"
            steps.append(("Find the commit that did it.", f"{begin}\ngit bisect run ideal-robot check {suite}"))
        return steps
    missed = next((bound for bound in comparison.bounds if not bound.kept), None)
    if missed is not None:
        run = next((row for row in labelled(comparison.after).to_dict("records") if row["label"] == missed.case), None)
        return [] if run is None else [("Look at a run of the case that misses its bound.",
                                        run_command(run, comparison.places.get(str(run["scene"]))))]
    if comparison.uncompared and suite is not None:
        return [("Take these runs as the baseline.", f"ideal-robot check {suite} --update-baseline")]
    if suite is not None:
        return [("Keep the runs of every night: their history shows what rises slowly.",
                 f"ideal-robot check {suite} --runs FOLDER --resume")]
    return [("Find smaller differences: play both with more seeds.",
             "ideal-robot sweep SCENE --seeds 1-10 --json after.json")]


def page(comparison: Comparison) -> Report:
    """The page: verdict, picture, next steps, changes, bounds, and all figures."""
    report = Report(f"Path error: {comparison.headline}", f"{comparison.title}. {answer(comparison)}")
    kept = sum(bound.kept for bound in comparison.bounds)
    report.figures([("verdict", Verdict(comparison.headline, _kind(comparison))),
                    ("runs", str(len(comparison.after.runs))), ("figures compared", str(len(comparison.rows))),
                    *([("bounds kept", Verdict(f"{kept} of {len(comparison.bounds)}",
                                               GOOD if kept == len(comparison.bounds) else BAD))]
                      if comparison.bounds else [])])
    if steps := next_steps(comparison):
        report.next(*steps)
    if comparison.pairs is not None and (drawn := picture(comparison)) is not None:
        report.figure(drawn, "Left: each pair's error before and after; on the line nothing changed. Right: each "
                             "pair's relative difference, with the mean of the case and its 95 % interval; right of "
                             "zero is worse.")
    columns, changed = comparison.table()
    if changed:
        report.heading("What changed")
        report.table(columns, _read(changed), "p is corrected for all figures looked at (Holm). Differences of the row "
                                              "of all cases are relative.")
    if comparison.bounds:
        report.heading("Bounds")
        columns, bounds = bounds_table(comparison)
        report.table(columns, _read(bounds))
    if not comparison.rows:
        return report
    report.heading("All figures")
    report.table(["case", "figure", "pairs", "before", "after", "difference", "standard error", "p",
                  "would be found", "verdict"],
                 [[row.case, row.figure, row.pairs, row.before, row.after, row.difference, row.error, row.corrected,
                   row.finds, Verdict(row.verdict)] for row in comparison.rows], folded="every figure of every case",
                 caption="A difference as large as the column says would be found in nine of ten comparisons.")
    return report


def _read(rows: list[list[Any]]) -> list[list[Any]]:
    """Rows of case and figure with the figure's name and unit as a person reads them."""
    return [[case, figure_in_words(figure) + (f" [{unit}]" if (unit := unit_of(figure)) else ""), *others]
            for case, figure, *others in rows]


def _kind(comparison: Comparison) -> str:
    if comparison.verdict in (WORSE, FAILED) or not comparison.bounds_kept:
        return BAD
    return OPEN if comparison.uncompared else GOOD


def picture(comparison: Comparison) -> Figure | None:
    """Errors before over after, and relative differences of each pair; None where no figure has pairs."""
    import matplotlib.pyplot as plt

    pairs = comparison.pairs
    counts: dict[str, int] = {}
    for row in comparison.rows:
        if row.pairs and f"{row.figure} before" in (() if pairs is None else pairs):
            counts[row.figure] = counts.get(row.figure, 0) + row.pairs
    if pairs is None or not counts:
        return None
    name = max(counts, key=lambda key: counts[key])
    groups = [(str(label), *group[[f"{name} before", f"{name} after"]].astype(float).dropna().to_numpy().T)
              for label, group in pairs[pairs["_merge"] == "both"].groupby("label", sort=False)]
    groups = [group for group in groups if len(group[1])]
    # Only the cases that changed most are drawn where there are too many.
    groups = sorted(groups, key=lambda g: -abs(float(np.mean(g[2] - g[1]))) / max(float(np.mean(g[1])), 1e-12))
    groups = groups[:_MOST_CASES]
    figure, (left, right) = plt.subplots(1, 2, figsize=(11.0, 1.6 + 0.3 * max(len(groups), 8)), layout="constrained",
                                         width_ratios=(1.0, 1.3))
    everything = np.concatenate([np.concatenate(group[1:]) for group in groups])
    ends = [0.9 * everything.min(), 1.1 * everything.max()]
    left.plot(ends, ends, color="0.6", lw=1.0)
    for i, (_, before, after) in enumerate(groups):
        left.plot(before, after, ".", color=f"C{i % 10}")
        share = 100.0 * (after - before) / before
        right.plot(share, np.full(len(share), float(i)), ".", color=f"C{i % 10}", alpha=0.5)
        spread = float(stats.sem(share) * stats.t.ppf(0.975, len(share) - 1)) if len(share) > 1 else 0.0
        right.errorbar(float(share.mean()), i, xerr=spread, fmt="k|", capsize=3.0)
    unit = unit_of(name) or "1"
    left.locator_params(nbins=5)
    left.set(title=figure_in_words(name), xlabel=f"before [{unit}]", ylabel=f"after [{unit}]")
    right.axvline(0.0, color="0.6", lw=1.0)
    right.set_yticks(range(len(groups)), [group[0] for group in groups])
    right.invert_yaxis()
    right.set_xlabel("difference [%]")
    plt.close(figure)
    return figure
