"""Results that show themselves: lines at the prompt, a table in a notebook, plain values, plots."""

from __future__ import annotations

import dataclasses
import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from html import escape
from typing import TYPE_CHECKING, Any, overload

import numpy as np

from ideal_robot.arrays import Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure
else:
    Figure = Any  # for annotations; matplotlib is imported only for drawing

_WIDTH = 240
"""Characters of a line of figures; what does not fit is left out."""


class Summarised(ABC):
    """Base of results whose main figures are shown by ``repr`` and in notebooks."""

    @abstractmethod
    def summary(self) -> list[tuple[str, str]]:
        """The main figures as rows of label and value with unit."""

    def __repr__(self) -> str:
        (_, first), *rest = self.summary()
        return in_lines(type(self).__name__, first, [f"{label} {value}" for label, value in rest])

    def _repr_html_(self) -> str:
        return html_table((type(self).__name__, ""), self.summary())


def in_lines(name: str, head: str, figures: Sequence[str]) -> str:
    """A result at the prompt: a headline, and a line of figures below, cut to the width.

    Args:
        name: of the result's class.
        head: description after the name.
        figures: each with its label and unit, the important first.
    """
    title = f"{name}({_cut(head)})"
    line = "; ".join(" ".join(figure.split()) for figure in figures)
    if len(line) > _WIDTH:
        line = (line[:_WIDTH].rpartition("; ")[0] or _cut(line)) + "; …"
    return title + (f"\n  {line}" if line else "")


def _cut(text: str) -> str:
    """One line."""
    text = " ".join(text.split())
    return text if len(text) <= _WIDTH else text[:_WIDTH].rpartition(" ")[0] + " …"


def html_table(columns: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    """An HTML table of titles and rows of texts and numbers for notebooks; numbers with four significant digits."""
    def line(cells: Sequence[Any], tag: str) -> str:
        return "<tr>" + "".join(f"<{tag}>{escape(shown_cell(cell))}</{tag}>" for cell in cells) + "</tr>"

    return ("<table><thead>" + line(columns, "th") + "</thead><tbody>" + "".join(line(row, "td") for row in rows)
            + "</tbody></table>")


def listed(values: Array, unit: str = "") -> str:
    """Values of all joints ``(n,)`` with three significant digits, and their unit."""
    return ", ".join(f"{value:.3g}" for value in values) + (f" {unit}" if unit else "")


def one_unit(units: Sequence[str]) -> str:
    """The common unit of all joints: "mrad", or "mrad or mm" for an arm with both kinds."""
    return " or ".join(dict.fromkeys(units))


def shown_cell(cell: Any) -> str:
    """A cell of a table: numbers with four significant digits, nothing for None."""
    return f"{cell:.4g}" if isinstance(cell, float) else "" if cell is None else str(cell)


# Converts results to plain values that JSON can hold.

@overload
def plain(value: dict[str, Any], digits: int | None = None) -> dict[str, Any]: ...


@overload
def plain(value: Any, digits: int | None = None) -> Any: ...


def plain(value: Any, digits: int | None = None) -> Any:
    """A value as dictionaries, lists, numbers and strings, converted from dataclasses, arrays and paths.

    Non-finite numbers are None, others have so many significant ``digits``; all of them if None.
    """
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {entry.name: plain(getattr(value, entry.name), digits) for entry in dataclasses.fields(value)}
    if isinstance(value, dict):
        return {str(key): plain(item, digits) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item, digits) for item in value]
    if isinstance(value, np.ndarray):
        return plain(value.tolist(), digits)
    if isinstance(value, np.generic):
        return plain(value.item(), digits)
    if isinstance(value, float):
        if not math.isfinite(value):
            return None
        return value if digits is None else float(f"{value:.{digits}g}")
    return value if value is None or isinstance(value, (str, int)) else str(value)


def flat(content: dict[str, Any], before: str = "") -> dict[str, Any]:
    """Values by dotted name, from nested tables or from dotted keys."""
    result: dict[str, Any] = {}
    for key, value in content.items():
        result |= flat(value, f"{before}{key}.") if isinstance(value, dict) else {f"{before}{key}": value}
    return result


# Figures of results; the only file of this package that imports matplotlib, when a figure is drawn.

Panel = tuple[str, Sequence[tuple[str, Array]]]
"""What stands at the vertical axis of a panel, and its series: name and values ``(N,)``."""
_COLOURS = ("#b0413e", "#2f6690", "#3a7d44", "#8d6a9f")
_MOST = 4000
"""Points drawn of a series; more cannot be seen."""


def over_time(t: Array, panels: Sequence[Panel], title: str, along: str = "t [s]") -> Figure:
    """Figure of series over time, or along a path, one panel per channel, one above the other.

    Args:
        t: times ``(N,)`` [s], or another rising quantity.
        panels: series of ``N`` values each.
        title: of the picture.
        along: name of ``t``, with its unit.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 1.0 + 1.4 * len(panels)), layout="constrained")
    axes = np.atleast_1d(np.asarray(figure.subplots(len(panels), sharex=True)))
    step = max(1, len(t) // _MOST)
    for axis, (name, series) in zip(axes, panels, strict=True):
        for (label, values), colour in zip(series, _COLOURS, strict=False):
            axis.plot(t[::step], values[::step], label=label, color=colour, linewidth=0.9)
        axis.set_ylabel(name)
        axis.grid(alpha=0.3)
    axes[0].legend(loc="upper right", fontsize="small")
    axes[-1].set_xlabel(along)
    figure.align_ylabels()
    figure.suptitle(title)
    return figure


def as_bars(values: Sequence[tuple[str, float]], unit: str, title: str) -> Figure:
    """Bar chart of one quantity over several runs; runs without a value have no bar.

    Args:
        values: name and figure of each.
        unit, title: of all of them, and of the picture.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, 1.2 + 0.4 * len(values)), layout="constrained")
    axis = figure.subplots()
    bars = axis.barh(range(len(values)), [value for _, value in values], color=_COLOURS[1])
    axis.bar_label(bars, [f"{value:.3g}" if math.isfinite(value) else "" for _, value in values], padding=3)
    axis.set_yticks(range(len(values)), [name for name, _ in values])
    axis.invert_yaxis()
    axis.set_xlabel(unit)
    axis.set_title(title)
    return figure


def with_intervals(values: Sequence[tuple[str, float, float, float]], unit: str, title: str) -> Figure:
    """Estimates with their intervals.

    Args:
        values: name, estimate, lower and upper end of the interval.
        unit, title: of all of them, and of the picture.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, 1.2 + 0.35 * len(values)), layout="constrained")
    axis = figure.subplots()
    places = np.arange(len(values))
    middle = np.array([value for _, value, _, _ in values])
    ends = np.array([[low, high] for _, _, low, high in values]).reshape(-1, 2)
    axis.hlines(places, ends[:, 0], ends[:, 1], color=_COLOURS[1])
    axis.plot(middle, places, "o", color=_COLOURS[1])
    axis.set_yticks(places, [name for name, *_ in values])
    axis.invert_yaxis()
    axis.set_xlabel(unit)
    axis.grid(alpha=0.3)
    axis.set_title(title)
    return figure
