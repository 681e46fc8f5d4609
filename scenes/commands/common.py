"""What the verbs share: applying options to a scene, tables, and how a run is closed."""

from __future__ import annotations

import math
import os
import re
import sys
from typing import Any, TypeVar

import typer
from rich.box import HEAVY_HEAD
from rich.cells import cell_len
from rich.console import Console
from rich.table import Table
from rich.text import Text

from ideal_robot.errors import InputError
from scenes import result
from scenes.terminal import shown

N = TypeVar("N", int, float)
_MOST_NUMBERS = 100_000
_NO_EDGE = 10_000
"""Columns of an output that is no terminal."""


def show_table(title: str, columns: list[str], rows: list[list[Any]]) -> None:
    """Prints a table; floats with three significant digits.

    In a pipe the table is as wide as it needs to be. In a terminal long texts are folded between words; where the
    longest words do not fit beside each other between borders, there are none; where they do not fit at all, every row
    becomes a block of lines.

    Args:
        title: above the table; empty for none.
        columns: titles.
        rows: cells.
    """
    console = Console(width=None if sys.stdout.isatty() or os.environ.get("COLUMNS") else _NO_EDGE)
    names = [shown(column) for column in columns]
    cells = [[shown(_cell(cell)) for cell in row] for row in rows]
    texts = [[name, *(row[i] for row in cells)] for i, name in enumerate(names)]
    least = [max(cell_len(word) for text in column for word in (*text.split(), "")) for column in texts]
    # Text, not str: rich would take a name such as [/red] for its own markup.
    if sum(least) + len(least) > console.width:
        _show_blocks(console, title, names, cells)
        return
    bordered = sum(least) + 3 * len(least) + 1 <= console.width
    room = console.width - (3 * len(least) + 1 if bordered else len(least))
    table = Table(title=Text(shown(title)) if title else None, title_justify="left",
                  box=HEAVY_HEAD if bordered else None, padding=(0, 1) if bordered else (0, 1, 0, 0))
    for name, width in zip(names, _widths(least, [max(map(cell_len, column)) for column in texts], room), strict=True):
        table.add_column(Text(name), overflow="fold", width=width)
    for row in cells:
        table.add_row(*map(Text, row))
    console.print(table)


def _widths(least: list[int], wanted: list[int], room: int) -> list[int]:
    """Widths of a table's columns: their longest words at least, the rest of the room to those that lack most of it."""
    widths = list(least)
    for _ in range(min(room, sum(wanted)) - sum(least)):
        lacking = [want - width for want, width in zip(wanted, widths, strict=True)]
        widths[lacking.index(max(lacking))] += 1
    return widths


def _cell(cell: Any) -> str:
    if isinstance(cell, float):
        return "–" if math.isnan(cell) else f"{cell:.3g}"
    return "–" if cell is None else str(cell)


def _show_blocks(console: Console, title: str, names: list[str], cells: list[list[str]]) -> None:
    """Rows one below the other, each cell on a line of its own: for terminals too narrow for a table."""
    if title:
        console.print(Text(shown(title), style="italic"), overflow="fold")
    for row in cells:
        console.print(Text(row[0] or "–", style="bold"), overflow="fold")
        for name, cell in zip(names[1:], row[1:], strict=True):
            console.print(Text(f"  {name}: {cell}"), overflow="fold")


def closed(run: result.RunResult) -> None:
    """Prints the result of a run; exit code 1 where it ended early."""
    show_table("", ["figure", "value"], [list(pair) for pair in run.summary()])
    if run.report is not None:
        typer.echo(f"report: {run.report}")
    if run.failure is not None:
        typer.echo(f"ideal-robot: {run.failure}", err=True)
        raise typer.Exit(1)


def length(text: str, option: str) -> float:
    """A length in metres from ``0.2mm``, ``200um`` or ``0.0002``.

    >>> length("2.5mm", "--tolerance")
    0.0025
    """
    found = re.fullmatch(r"\s*([0-9.eE+-]+)\s*(mm|um|µm|m|)\s*", text)
    value = _number(found[1], float, option, text) if found else math.nan
    if found is None or not (math.isfinite(value) and value > 0):
        raise InputError("expected a positive length such as 0.2mm", field=option, value=text[:60])
    return value * {"mm": 1e-3, "um": 1e-6, "µm": 1e-6}.get(found[2], 1.0)


def numbers(text: str, option: str) -> list[float]:
    """Finite numbers from ``1,2,5``; empty text gives none."""
    found = [_number(piece.strip(), float, option, text) for piece in text.split(",") if piece.strip()]
    if not all(map(math.isfinite, found)):
        raise InputError("expected finite numbers separated by commas", field=option, value=text[:60])
    return found


def whole_numbers(text: str, option: str) -> list[int]:
    """Numbers of 0 and above from ``1,2,5`` or ``1-10`` (both ends included); empty text gives none.

    >>> whole_numbers("1-3,7", "--seeds")
    [1, 2, 3, 7]
    """
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
