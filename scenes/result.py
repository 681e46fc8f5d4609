"""Interfaces of results of running a scene of any kind, for command line, sweeps and scripts."""

from __future__ import annotations

from abc import ABC, abstractmethod
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ideal_robot.arrays import Array
from ideal_robot.progress import Progress, part_of, silent
from ideal_robot.results import Summarised, as_bars, html_table, in_lines, plain, shown_cell
from ideal_robot.row_log import let_go

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["CompareResult", "Progress", "RunResult", "part_of", "silent"]


class RunResult(Protocol):
    """The result of one scene with one method."""

    @property
    def failure(self) -> str | None:
        """Why the run ended early, or None; results until then are kept."""

    @property
    def report(self) -> Path | None:
        """The HTML page, where one was written."""

    def json(self) -> dict[str, Any]:
        """The content of ``--json``."""

    def summary(self) -> list[tuple[str, str]]:
        """The main figures as rows of label and value with unit."""

    def next_steps(self) -> list[tuple[str, str]]:
        """The next steps, each a sentence and its command line."""


class CompareResult(Protocol):
    """The result of one scene with several methods."""

    @property
    def report(self) -> Path | None:
        """The HTML page, where one was written."""

    def json(self) -> dict[str, Any]:
        """The content of ``--json``; the runs stand under ``methods``."""

    def table(self) -> tuple[list[str], list[list[Any]]]:
        """Column titles and rows, one row per method."""


class Shown(ABC):
    """Base of results of running a scene; the subclass has ``scene`` and ``json``."""

    scene: Any

    @abstractmethod
    def json(self) -> dict[str, Any]:
        """The content of ``--json``."""

    def to_dict(self) -> dict[str, Any]:
        """The content of ``--json`` as plain values."""
        return plain(self.json())


class ShownRun(Shown, Summarised):
    """Base of results of one run of a scene; the subclass also has ``failure``."""

    failure: str | None

    @abstractmethod
    def plot(self) -> Figure:
        """The picture that shows the error of the run."""

    def next_steps(self) -> list[tuple[str, str]]:
        """The next steps, each a sentence and its command line."""
        return []

    def __repr__(self) -> str:
        early = f", ended early: {self.failure}" if self.failure else ""
        return in_lines(type(self).__name__, f"{self.scene.name!r}{early}",
                        [f"{label} {value}" for label, value in self.summary()[:8]])


class ShownTable(Shown):
    """Base of results of several runs of a scene."""

    @abstractmethod
    def table(self) -> tuple[list[str], list[list[Any]]]:
        """Column titles and rows, one per method or model, whose name comes first."""

    def rows(self) -> tuple[tuple[str, ...], list[list[Any]]]:
        """The table for prompt and notebook."""
        columns, rows = self.table()
        return tuple(columns), rows

    def __repr__(self) -> str:
        (_, first, *_), rows = self.rows()
        figures = [f"{row[0]} {shown_cell(row[1])}" for row in rows]
        return in_lines(type(self).__name__, f"{self.scene.name!r}: {len(rows)} runs",
                        [f"{first}: {figures[0]}", *figures[1:]] if figures else [])

    def _repr_html_(self) -> str:
        return html_table(*self.rows())

    def plot(self) -> Figure:
        """Bar chart of the first numeric column, one bar per method or model."""
        columns, rows = self.rows()
        numbers = [i for i in range(1, len(columns)) if any(isinstance(row[i], float) for row in rows)]
        values = [(str(row[0]), float(row[numbers[0]]) if numbers and isinstance(row[numbers[0]], float) else np.nan)
                  for row in rows]
        return as_bars(values, columns[numbers[0]] if numbers else "", self.scene.title)


MOST = 100_000
"""Rows of a series at most, 200 s at 500 Hz; a picture is some thousand pixels wide."""


def step(count: int) -> int:
    """Stride at which ``count`` rows are shown; 1 for all but long series."""
    return max(1, -(-count // MOST))


def extremes(values: Array) -> NDArray[np.int_]:
    """Rows of a series ``(N,)`` to be drawn: all, or of a long one the lowest and the highest of every few."""
    size = 2 * step(len(values))
    if size == 2:
        return np.arange(len(values))
    whole = len(values) // size * size
    pieces = values[:whole].reshape(-1, size)
    first = np.arange(0, whole, size)
    rows = np.concatenate([first + pieces.argmin(axis=1), first + pieces.argmax(axis=1)])
    let_go(values)
    return np.unique(rows)
