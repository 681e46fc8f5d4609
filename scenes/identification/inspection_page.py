"""The page of an inspection: what a recording holds, and what does not fit."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ideal_robot.identification.inspection import Inspection
from ideal_robot.robots.robot import Robot
from scenes.report.page import Report
from scenes.verdict import BAD, GOOD, Verdict


def inspection_page(found: Inspection, robot: Robot, then: tuple[str, str]) -> Report:
    """The page of an inspection: implausible entries, next steps, and the content of the recording.

    Args:
        found: the inspection.
        robot: the arm it is to be of.
        then: the next steps, each a sentence and its command.
    """
    recording = found.recording
    verdict = found.refused or ("it does not fit the URDF" if found.contradictions else
                                "it fits the URDF and can be used")
    page = Report(f"{Path(recording.source).name}, of {robot.name}",
                  f"{verdict[:1].upper()}{verdict[1:]}: {recording.n} joints, {recording.duration:.4g} s at "
                  f"{found.rate:.4g} Hz, longest step {1e3 * found.longest:.3g} ms, "
                  f"{found.gaps or 'no'} gap{'s' * (found.gaps != 1)}.")
    page.figures([("verdict", Verdict("not usable", BAD) if found.refused else Verdict("does not fit", BAD)
                   if found.contradictions else Verdict("fits", GOOD))])
    for finding in found.contradictions:
        page.warning(finding.warning)
    if found.refused:
        page.warning(found.refused)
    said = [*found.acts, *(finding.warning for finding in found.channels)]
    if said:
        page.heading("What was read, left out and repaired")
        page.table(["act", "what"], [[name, rest.strip()] for name, _, rest in (text.partition(":") for text in said)])
    page.next(then)
    page.heading("Signals")
    page.figure(found.plot(), "Positions and torques as they are used.")
    if found.ranges:
        page.heading("Ranges", folded=all(one.fits for one in found.ranges))
        page.table(*ranges_table(found), "What the recording holds beside the limits of the URDF and the drive data.")
    if found.unused:
        page.table(["column"], [[name] for name in found.unused], folded="Columns that are kept and not used")
    return page


def ranges_table(found: Inspection) -> tuple[list[str], list[list[Any]]]:
    """Column titles and rows: least and most value of each column, beside the permitted range."""
    return (["column", "least", "most", "allowed from", "to", "unit", "fits"],
            [[one.column, one.least, one.most, *(value if np.isfinite(value) else None
                                                 for value in (one.low, one.high)),
              one.unit, Verdict("yes", GOOD) if one.fits else Verdict("no", BAD)] for one in found.ranges])
