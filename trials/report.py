"""What the benchmarks of blind trials share: the arm of a trial, its line, and the tables in the documentation."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from ideal_robot.robots.robot import Robot
from trials.score import Score, confusion, rates

DOCS = Path(__file__).resolve().parents[1] / "docs"


@contextmanager
def arm_of(urdf: str) -> Iterator[Robot]:
    """The arm of a trial from the text of its URDF, whose file is there as long as the context."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "arm.urdf"
        path.write_text(urdf, encoding="utf-8")
        yield Robot.load(path)


def line_of(s: Score) -> str:
    """One trial in a line."""
    mark = "ok " if s.right else "BAD"
    return f"{mark} {s.seed} {s.kind:8s} {s.seconds:5.1f} s  true {s.truth}  found {s.verdict} {s.found}"


def tables(scores: Sequence[Score]) -> str:
    """Markdown of the rates and the confusion matrix."""
    return "\n".join([rates(scores), "", confusion(scores)])


def write_tables(mark: str, text: str) -> None:
    """Puts text between ``<!-- mark -->`` and ``<!-- end of mark -->`` of the page of evidence that has them."""
    first, last = f"<!-- {mark} -->\n", f"<!-- end of {mark} -->"
    page = next(one for one in sorted(DOCS.glob("evidence*.md")) if first in one.read_text(encoding="utf-8"))
    before, _, rest = page.read_text(encoding="utf-8").partition(first)
    page.write_text(f"{before}{first}{text}\n{last}{rest.partition(last)[2]}", encoding="utf-8")
