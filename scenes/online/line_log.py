"""What is written down while a line is followed, and how far the desired path was from what was seen."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ideal_robot.arrays import Array
from ideal_robot.row_log import RowLog
from planning.line.fusion import DeviationFilter
from scenes.online.cycle import CycleLog
from sensing.camera.camera_device import Field, Gray
from sensing.camera.line_detection import LineField


@dataclass(frozen=True)
class FieldShown:
    """One camera field kept for the report: what was read out and found in it, the whole image once it is drawn."""

    t: float
    field: Field
    image: Gray
    pixels: Array
    used: NDArray[np.bool_]
    polynomial_pixels: Array


@dataclass
class LineLog(CycleLog):
    """What is written down while a line is followed.

    Attributes:
        fields: of each camera field that arrived its time stamp [s] and the line points used in the tool frame, three
            values each, NaN where one was left out [m]; used: how many of the fields gave a measurement.
        shown: fields for the report.
        with_field: whether a field was worked on in each cycle.
        s: arc length of the reference at each cycle [m].
        believed: desired deviation there [m].
        first_used: when a field was used first [s]; NaN if never.
        sensor_values, sensor_used: how many values each further sensor gave, and how many went into the fusion.
    """

    fields: RowLog = field(default_factory=RowLog)
    used: int = 0
    shown: list[FieldShown] = field(default_factory=list)
    with_field: RowLog = field(default_factory=RowLog)
    s: RowLog = field(default_factory=RowLog)
    believed: RowLog = field(default_factory=RowLog)
    first_used: float = np.nan
    sensor_values: dict[str, int] = field(default_factory=dict)
    sensor_used: dict[str, int] = field(default_factory=dict)

    def add_field(self, seen: LineField, count: int) -> None:
        """What was seen in one camera field, of which ``count`` line points are kept."""
        row, some = np.full(1 + 3 * count, np.nan), min(len(seen.points_tcp), count)
        row[0], used = seen.t, seen.used[:some]
        row[1:].reshape(count, 3)[:some][used] = seen.points_tcp[:some][used]
        self.fields.append(row)
        self.used += int(seen.seen)

    def field_columns(self, t: Array, count: int) -> Iterator[tuple[str, Array]]:
        """Columns of a recording one by one: values in the rows ``t (N,)`` [s] at the fields' time stamps, else NaN.

        ``count``: line points of a field.
        """
        fields = np.asarray(self.fields).reshape(-1, 1 + 3 * count)
        rows = np.minimum(np.searchsorted(t, fields[:, 0]), len(t) - 1)
        for name, values in zip(field_columns(count), fields.T, strict=True):
            column, known = np.full(len(t), np.nan), np.isfinite(values)
            column[rows[known]] = values[known]
            yield name, column


SETTLING = 0.3
"""Time from when the line is first followed until the error counts [s]."""


def plan_error(log: LineLog, fusion: DeviationFilter) -> dict[str, float | None]:
    """The desired path against the line as all fields of the run show it; what a cell can say of itself [mm].

    Mean and largest distance from where the line was first followed on, by the map after the run; None where nothing is
    kept.
    """
    s, believed, t = (np.asarray(values)[: len(log.believed)] for values in (log.s, log.believed, log.t))
    off = np.abs(believed - fusion.looked_back(s)[0][:, 0])
    off = off[np.isfinite(off) & (t >= log.first_used + SETTLING)]
    return {"mean": 1e3 * float(off.mean()), "max": 1e3 * float(off.max())} if len(off) else {"mean": None, "max": None}


def field_columns(count: int) -> list[str]:
    """``cam_t`` [s] and ``line_x_i line_y_i line_z_i`` [m] of ``count`` line points."""
    return ["cam_t", *(f"line_{axis}_{i + 1}" for i in range(count) for axis in "xyz")]
