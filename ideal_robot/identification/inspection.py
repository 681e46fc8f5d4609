"""Inspects a recording before any identification: columns, rates, ranges, and contradictions to the URDF."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.identification.against_urdf import Finding, findings
from ideal_robot.results import Figure, Summarised, over_time, plain
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.channels import ChannelFinding, channel_findings
from ideal_robot.signals.clean import cleaned
from ideal_robot.signals.recording import Recording, expect, is_known_column

_SHOWN = 4000
"""Samples of a signal that are drawn."""


@dataclass(frozen=True)
class Range:
    """Values of one joint's column against the URDF's limits.

    Attributes:
        column: e.g. ``q_3``.
        unit: of its values.
        least, most: of the values.
        low, high: the URDF's limits; infinite where it has none.
    """

    column: str
    unit: str
    least: float
    most: float
    low: float
    high: float

    @property
    def fits(self) -> bool:
        """Whether the values are within the limits."""
        return self.low <= self.least and self.most <= self.high


@dataclass(frozen=True, repr=False)
class Inspection(Summarised):
    """A recording with the findings about it.

    Attributes:
        recording: as it can be used, or as it was read where it cannot.
        acts: interpretations, omissions and repairs, in order, ``name: sentence``.
        channels: findings about single channels.
        contradictions: contradictions of the recording to the URDF.
        ranges: of positions, speeds and torques.
        rate, longest, gaps: samples a second, the longest step [s] and how many steps are longer than five usual ones.
        unused: columns that mean nothing to the program.
        refused: why it cannot be used; empty where it can.
    """

    recording: Recording
    acts: tuple[str, ...]
    channels: tuple[ChannelFinding, ...]
    contradictions: tuple[Finding, ...]
    ranges: tuple[Range, ...]
    rate: float
    longest: float
    gaps: int
    unused: tuple[str, ...]
    refused: str = ""

    @property
    def usable(self) -> bool:
        """Whether the recording can be used for an identification."""
        return not self.refused and not self.contradictions

    def summary(self) -> list[tuple[str, str]]:
        """Content and contradictions as rows of label and value."""
        r = self.recording
        size = f"{r.n} joints, {len(r.t)} samples, {r.duration:.4g} s, {self.rate:.4g} Hz"
        return [("recording", f"{r.source!r}: {size}"),
                ("does not fit", self.refused or "; ".join([*(f.warning for f in self.contradictions), *self._beyond])
                 or "nothing")]

    @property
    def _beyond(self) -> list[str]:
        """Columns whose values are beyond the URDF's limits, in one sentence."""
        beyond = [own.column for own in self.ranges if not own.fits]
        return [f"values beyond the URDF's limits: {', '.join(beyond)}"] if beyond else []

    def to_dict(self) -> dict[str, Any]:
        """Everything but the samples as plain values."""
        return plain({
            "source": self.recording.source, "joints": self.recording.n, "samples": len(self.recording.t),
            "duration_s": self.recording.duration, "rate_Hz": self.rate, "longest_step_s": self.longest,
            "gaps": self.gaps, "acts": self.acts, "channels": [finding.warning for finding in self.channels],
            "contradictions": [finding.to_dict() for finding in self.contradictions],
            "ranges": [{**vars(one), "fits": one.fits} for one in self.ranges], "unused_columns": self.unused,
            "refused": self.refused, "usable": self.usable})

    def plot(self) -> Figure:
        """Positions and torques over time."""
        r = self.recording
        stride = max(1, len(r.t) // _SHOWN)
        units = {one.column: f" [{one.unit}]" for one in self.ranges}
        names = [name for j in range(r.n) for prefix in ("q", "tau", "current")
                 if (name := f"{prefix}_{j + 1}") in r.columns and (prefix != "current" or not r.has("tau"))]
        panels = [(name + units.get(name, ""), [("recorded", r.columns[name][::stride])]) for name in names]
        return over_time(r.t[::stride], panels, r.source)


def inspect(recording: Recording, robot: Robot) -> Inspection:
    """Inspects a recording: its content, its repairs, and contradictions to the robot.

    Args:
        recording: as it was read.
        robot: the arm that it should be of.

    Raises:
        InputError: the recording has no samples or no joints at all.
    """
    expect(recording, Recording, "recording", "make one by Recording.from_frame, from_arrays or read")
    if recording.n and len(recording.t) < 2:
        raise InputError("a recording needs samples over time", file=recording.source, field="t",
                         value=f"{len(recording.t)} samples")
    if recording.n == 0:
        raise InputError("holds no joint positions q_1, q_2, … over time; map the columns with --columns",
                         file=recording.source, field="q_1")
    unused = tuple(name for name in recording.columns if not is_known_column(name))
    try:
        done = cleaned(recording, robot)
    except InputError as error:
        read = tuple(str(text) for text in recording.meta.get("reading", ()))
        return Inspection(recording, read, (), (), (), *_clock(recording.t), unused, str(error))
    clean = done.recording
    try:
        contradictions = findings(clean, robot, amperes=done.amperes)
    except InputError as error:
        return Inspection(clean, done.acts, channel_findings(clean), (), _ranges(clean, robot, done.amperes),
                          *_clock(clean.t), unused, str(error))
    return Inspection(clean, done.acts, channel_findings(clean), contradictions, _ranges(clean, robot, done.amperes),
                      *_clock(clean.t), unused)


def _clock(t: Array) -> tuple[float, float, int]:
    """Samples a second, the longest step [s] and how many steps are longer than five usual ones."""
    steps = np.diff(t[np.isfinite(t)])
    usual = float(np.median(np.abs(steps))) if len(steps) else 0.0
    return (1.0 / usual if usual > 0.0 else 0.0, float(np.max(steps, initial=0.0)),
            int(np.count_nonzero(steps > 5.0 * usual)))


def _ranges(recording: Recording, robot: Robot, amperes: bool) -> tuple[Range, ...]:
    """Ranges of positions, speeds and torques beside the URDF's limits."""
    q, tau, t = recording.joints("q"), recording.joints("tau"), recording.t
    # Speed over ten samples, so that encoder steps do not appear as speed.
    over = min(10, len(t) - 1)
    speed = (q[over:] - q[:-over]) / (t[over:] - t[:-over])[:, None]
    rows = []
    for j in range(recording.n):
        angle, rate, torque = (robot.units(unit)[j] for unit in ("rad", "rad/s", "N m"))
        rows += [
            Range(f"q_{j + 1}", angle, float(q[:, j].min()), float(q[:, j].max()), float(robot.q_min[j]),
                  float(robot.q_max[j])),
            Range(f"speed of {j + 1}", rate, float(speed[:, j].min()), float(speed[:, j].max()),
                  -float(robot.v_max[j]), float(robot.v_max[j])),
            Range(f"tau_{j + 1}", "A" if amperes else torque, float(tau[:, j].min()), float(tau[:, j].max()),
                  *((-np.inf, np.inf) if amperes else (-float(robot.tau_max[j]), float(robot.tau_max[j]))))]
    return tuple(rows)
