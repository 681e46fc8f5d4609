"""What the verbs share: applying options to a scene, the progress bar, tables, and how a run is closed."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from ideal_robot.errors import InputError
from scenes import result
from scenes.terminal import shown

N = TypeVar("N", int, float)
_MOST_NUMBERS = 100_000


@contextmanager
def progress_bar(title: str) -> Iterator[result.Progress]:
    """A bar on standard error while the block runs; yields the function that moves it."""
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), TextColumn("{task.percentage:>3.0f} %"),
               TimeElapsedColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(shown(title), total=1.0)

        def move(fraction: float, text: str) -> None:
            bar.update(task, completed=min(max(fraction, 0.0), 1.0),
                       description=shown(f"{title}: {text}" if text else title))

        yield move


def show_table(title: str, columns: list[str], rows: list[list[Any]]) -> None:
    """Prints a table; floats with three significant digits."""
    # Text, not str: rich would take a name such as [/red] for its own markup.
    table = Table(title=Text(shown(title)) if title else None, title_justify="left")
    for column in columns:
        table.add_column(Text(shown(column)))
    for row in rows:
        cells = (f"{cell:.3g}" if isinstance(cell, float) else "–" if cell is None else str(cell) for cell in row)
        table.add_row(*(Text(shown(cell)) for cell in cells))
    Console().print(table)


def closed(run: result.RunResult) -> None:
    """Prints the result of a run; exit code 1 where it ended early."""
    show_table("", ["figure", "value"], [list(pair) for pair in run.summary()])
    if run.report is not None:
        typer.echo(f"report: {run.report}")
    if run.failure is not None:
        typer.echo(f"ideal-robot: {run.failure}", err=True)
        raise typer.Exit(1)


def numbers(text: str, option: str) -> list[float]:
    """Finite numbers from ``1,2,5``; empty text gives none."""
    found = [_number(piece.strip(), float, option, text) for piece in text.split(",") if piece.strip()]
    if not all(map(math.isfinite, found)):
        raise InputError("expected finite numbers separated by commas", field=option, value=text[:60])
    return found


def whole_numbers(text: str, option: str) -> list[int]:
    """Numbers of 0 and above from ``1,2,5`` or ``1-10`` (both ends included); empty text gives none."""
    found: list[int] = []
    for piece in (piece.strip() for piece in text.split(",") if piece.strip()):
        first, dash, last = piece.partition("-")
        low = _number(first, int, option, text)
        high = _number(last, int, option, text) if dash else low
        if not 0 <= low <= high < 2**63 or high - low >= _MOST_NUMBERS:
            raise InputError(f"expected whole numbers from 0 up, at most {_MOST_NUMBERS}, or a range such as 1-10",
                             field=option, value=text[:60])
        found.extend(range(low, high + 1))
    return found


def _number(piece: str, kind: type[N], option: str, text: str) -> N:
    try:
        return kind(piece)
    except ValueError as error:
        whole = kind is int
        raise InputError(f"expected {'whole ' if whole else ''}numbers separated by commas"
                         + (" or a range such as 1-10" if whole else ""), field=option, value=text[:60]) from error
