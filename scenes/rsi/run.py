"""What came of a path that was played over RSI."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.signals.recording import Recording
from ideal_robot.summary import Summarised, shown_cell


@dataclass(frozen=True, repr=False)
class RsiRun(Summarised):
    """A path played over RSI.

    Attributes:
        recording: ``t`` [s] since the first packet, which is answered by no correction, ``q_d_i``, ``q_c_i`` (handed
            over at ``t``), ``q_i`` and, where the controller sends currents, ``current_i`` and ``tau_i``.
        failure: why it ended before the end of the path, or None.
        counts: what happened on the link.
        stamps: how the controller's time stamps rise.
        answer_times_ms: median, 99th percentile and maximum from reading a packet to its answer; NaN without any.
        precautions: what the system granted for even timing.
        begun: rows of rest before the path.
        rows: rows of the path, rests included.
    """

    recording: Recording
    failure: str | None
    counts: dict[str, Any]
    stamps: str
    answer_times_ms: dict[str, float]
    precautions: list[str]
    begun: int
    rows: int

    def summary(self) -> list[tuple[str, str]]:
        """What came of the cycles."""
        _, rows = self.table()
        return [("path", f"{rows[0][1]} cycles answered{f', ended early: {self.failure}' if self.failure else ''}"),
                *((str(label), shown_cell(value)) for label, value in rows[1:])]

    def json(self) -> dict[str, Any]:
        """Key figures."""
        return {**self.recording.meta, "failure": self.failure, "cycles": len(self.recording.t),
                "path_cycles": self.rows, "link": self.counts, "time_stamps": self.stamps,
                "answer_time_ms": self.answer_times_ms, "timing": self.precautions,
                "motor_rms_error_mrad": None if len(self.recording.t) <= self.begun else self.errors_mrad()}

    def errors_mrad(self) -> Array:
        """Root mean square of desired position minus motor angle, rest before the path left out ``(n,)`` [mrad]."""
        off = (self.recording.joints("q_d") - self.recording.joints("q"))[self.begun :]
        return np.asarray(1e3 * np.sqrt(np.mean(off**2, axis=0)))

    def table(self) -> tuple[list[str], list[list[Any]]]:
        """What a person wants first."""
        link = self.counts
        rows: list[list[Any]] = [["cycles answered", f"{len(self.recording.t)} of {self.rows}"],
                                 ["time stamps", self.stamps],
                                 ["packets lost", link["lost"]], ["repeated", link["repeated"]],
                                 ["refused", link["refused"]], ["optional elements ignored", link["ignored"]],
                                 ["answers late by the controller's count", link["late"]],
                                 ["answer after, median ms", self.answer_times_ms["median"]],
                                 ["answer after, worst ms", self.answer_times_ms["max"]]]
        if len(self.recording.t) > self.begun:
            rows.append(["motor error, worst joint mrad rms", float(np.max(self.errors_mrad()))])
        return ["figure", "value"], rows
