"""The log of a task, and the distance of the desired path from the line that was seen."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ideal_robot.arrays import Array
from ideal_robot.row_log import RowLog
from planning.follower import Phase
from planning.line.fusion import DeviationFilter
from scenes.online.cycle import CycleLog
from sensing.camera.camera_device import Field, Gray
from sensing.camera.line_detection import LineField


@dataclass(frozen=True)
class FieldShown:
    """One camera field kept for the report: its windows, the points found, and the whole image once it is drawn."""

    t: float
    field: Field
    image: Gray
    pixels: Array
    used: NDArray[np.bool_]
    polynomial_pixels: Array


class FieldUse(NamedTuple):
    """Result of a camera field's fusion: its time stamp [s], how many values were fused, and why not all."""

    t: float
    values: int
    reason: str


@dataclass
class TaskLog(CycleLog):
    """The log of a task, for any sensors.

    Attributes:
        phase: of the motion in each cycle.
        s: arc length of the reference at each cycle [m].
        planned: desired deviation from the reference there, in the sensed directions ``(directions,)`` [m].
        with_field: whether a camera field was worked on in each cycle.
        fields: result of each camera field.
        points: of each of them its time stamp [s] and the line points used in the tool frame, three values each, NaN
            where one was left out [m]; empty where they are not kept.
        shown: fields for the report.
        first_used: when a field was used first [s]; NaN if never.
        samples: of each fusion of forces the time of the newest [s], normal force [N], innovation squared for each, how
            many they were.
        wrenches: of all samples of the force sensor the time [s] and the wrench [N, N m].
        readings: of each sensor of the user's the values that it gave, and how many of them were fused.
    """

    phase: list[str] = field(default_factory=list)
    s: RowLog = field(default_factory=RowLog)
    planned: RowLog = field(default_factory=RowLog)
    with_field: RowLog = field(default_factory=RowLog)
    fields: list[FieldUse] = field(default_factory=list)
    points: RowLog = field(default_factory=RowLog)
    shown: list[FieldShown] = field(default_factory=list)
    first_used: float = np.nan
    samples: RowLog = field(default_factory=RowLog)
    wrenches: RowLog = field(default_factory=RowLog)
    readings: dict[str, tuple[int, int]] = field(default_factory=dict)

    @property
    def lateral(self) -> Array:
        """Desired deviation across the path at each cycle ``(K,)`` [m]."""
        return self.planned.column(0) if len(self.planned) else np.empty(0)

    @property
    def desired(self) -> Array:
        """Time [s] and desired deviation in the first sensed direction [m] of each cycle ``(K, 2)``."""
        count = min(len(self.t), len(self.planned))
        return np.column_stack([np.asarray(self.t)[:count], self.lateral[:count]])

    def counts(self) -> dict[str, Any]:
        """How many camera fields arrived, how many of them gave a measurement, and why the others did not."""
        return {"seen": len(self.fields), "used": self.used, "left_out": dict(self.left_out().most_common())}

    @property
    def used(self) -> int:
        """Camera fields that gave a measurement."""
        return sum(field.values > 0 for field in self.fields)

    def left_out(self) -> Counter[str]:
        """Numbers of fields that were not used, by reason."""
        return Counter(field.reason.split(",")[0] or "no value" for field in self.fields if not field.values)

    def why_left_out(self, most: int = 5) -> str:
        """The commonest reasons why fields were not used, in words, each with its number; empty where all were used."""
        return "; ".join(f"{count} × {reason}" for reason, count in self.left_out().most_common(most))

    @property
    def travel(self) -> list[float]:
        """When the cycles of the travel began [s]."""
        return [t for t, phase in zip(self.t, self.phase, strict=False) if phase == Phase.TRAVEL.value]

    def add_points(self, seen: LineField, count: int) -> None:
        """Adds one camera field, of which ``count`` line points are kept."""
        row, some = np.full(1 + 3 * count, np.nan), min(len(seen.points_tcp), count)
        row[0], used = seen.t, seen.used[:some]
        row[1:].reshape(count, 3)[:some][used] = seen.points_tcp[:some][used]
        self.points.append(row)

    def point_columns(self, t: Array, count: int) -> Iterator[tuple[str, Array]]:
        """Columns of a recording one by one: values in the rows ``t (N,)`` [s] at the fields' time stamps, else NaN.

        ``count``: number of line points of a field.
        """
        fields = np.asarray(self.points).reshape(-1, 1 + 3 * count)
        rows = np.minimum(np.searchsorted(t, fields[:, 0]), len(t) - 1)
        for name, values in zip(point_columns(count), fields.T, strict=True):
            column, known = np.full(len(t), np.nan), np.isfinite(values)
            column[rows[known]] = values[known]
            yield name, column


SETTLING = 0.3
"""Time from when the line is first followed until the error counts [s]."""


def plan_error(log: TaskLog, fusion: DeviationFilter) -> dict[str, float | None]:
    """Mean and largest distance [mm] of the planned path from the line as the map shows it after the run.

    From the time at which the line was first followed; None where it never was. In a real cell the true error is
    unknown.
    """
    count = len(log.planned)
    s, t = (np.asarray(values)[:count] for values in (log.s, log.t))
    off = np.abs(log.lateral - fusion.looked_back(s)[0][:, 0])
    off = off[np.isfinite(off) & (t >= log.first_used + SETTLING)]
    return {"mean": 1e3 * float(off.mean()), "max": 1e3 * float(off.max())} if len(off) else {"mean": None, "max": None}


def point_columns(count: int) -> list[str]:
    """``cam_t`` [s] and ``line_x_i line_y_i line_z_i`` [m] of ``count`` line points."""
    return ["cam_t", *(f"line_{axis}_{i + 1}" for i in range(count) for axis in "xyz")]
