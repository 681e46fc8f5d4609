"""Pictures of results; the one file of this package that imports matplotlib, when a picture is asked for."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ideal_robot.arrays import Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Panel = tuple[str, Sequence[tuple[str, Array]]]
"""What stands at the vertical axis of a panel, and its series: name and values ``(N,)``."""
_COLOURS = ("#b0413e", "#2f6690", "#3a7d44", "#8d6a9f")
_MOST = 4000
"""Points drawn of a series; more cannot be seen."""


def over_time(t: Array, panels: Sequence[Panel], title: str) -> Figure:
    """Series over time, one panel a channel, one above the other.

    Args:
        t: times ``(N,)`` [s].
        panels: what is drawn, of ``N`` values each.
        title: of the picture.
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
    axes[-1].set_xlabel("t [s]")
    figure.suptitle(title)
    return figure


def with_intervals(values: Sequence[tuple[str, float, float, float]], unit: str, title: str) -> Figure:
    """Estimates with their intervals.

    Args:
        values: name, estimate, lower and upper end of the interval.
        unit: of all of them.
        title: of the picture.
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
