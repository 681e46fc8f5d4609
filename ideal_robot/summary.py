"""Results that say what they are: three lines at the prompt, a small table in a notebook."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from html import escape
from typing import Any

from ideal_robot.arrays import Array

_WIDTH = 240
"""Characters of a line of figures; what does not fit is left out."""


class Summarised(ABC):
    """Base of results whose few figures are shown by ``repr`` and in notebooks."""

    @abstractmethod
    def summary(self) -> list[tuple[str, str]]:
        """The few figures a person wants first: label and value with unit."""

    def __repr__(self) -> str:
        (_, first), *rest = self.summary()
        return in_lines(type(self).__name__, first, [f"{label} {value}" for label, value in rest])

    def _repr_html_(self) -> str:
        return html_table((type(self).__name__, ""), self.summary())


def in_lines(name: str, head: str, figures: Sequence[str]) -> str:
    """A result at the prompt: what it is, and a line of figures below; what does not fit is left out.

    Args:
        name: of the result's class.
        head: what it is, behind the name.
        figures: each with its label and unit, the important first.
    """
    told = f"{name}({_cut(head)})"
    line = "; ".join(" ".join(figure.split()) for figure in figures)
    if len(line) > _WIDTH:
        line = (line[:_WIDTH].rpartition("; ")[0] or _cut(line)) + "; …"
    return told + (f"\n  {line}" if line else "")


def _cut(text: str) -> str:
    """One line."""
    text = " ".join(text.split())
    return text if len(text) <= _WIDTH else text[:_WIDTH].rpartition(" ")[0] + " …"


def html_table(columns: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    """An HTML table for notebooks; numbers with four significant digits.

    Args:
        columns: titles.
        rows: texts and numbers, one a column.
    """
    def line(cells: Sequence[Any], tag: str) -> str:
        return "<tr>" + "".join(f"<{tag}>{escape(shown_cell(cell))}</{tag}>" for cell in cells) + "</tr>"

    return ("<table><thead>" + line(columns, "th") + "</thead><tbody>" + "".join(line(row, "td") for row in rows)
            + "</tbody></table>")


def listed(values: Array, unit: str = "") -> str:
    """Values of all joints ``(n,)`` with three significant digits, and their unit."""
    return ", ".join(f"{value:.3g}" for value in values) + (f" {unit}" if unit else "")


def shown_cell(cell: Any) -> str:
    """A cell of a table: numbers with four significant digits, nothing for None."""
    return f"{cell:.4g}" if isinstance(cell, float) else "" if cell is None else str(cell)
