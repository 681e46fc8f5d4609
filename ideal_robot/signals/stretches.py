"""Recordings of bounded length: of very long ones, stretches that are spread evenly over them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ideal_robot.file_array import let_go
from ideal_robot.signals.recording import Recording

MOST = 500_000
"""Samples that are used at most, 17 minutes at 500 Hz: a fit takes about three kilobytes for each."""
STRETCH = 50_000
"""Samples of a stretch, so many that what filters lose at its ends does not count."""
_PAUSE, _STEPS = 0.9, 20.0
"""Between two stretches that are joined at least: a time [s], and steps of sampling; a pause, but none to be named."""
_TIMES = ("t", "cam_t")
"""Columns that hold times."""
FEWEST = 5_000
"""Samples that are used of each recording at least, where it has so many."""


def stretches(recordings: Sequence[Recording]) -> tuple[tuple[Recording, ...], list[str]]:
    """The recordings, or of more than ``MOST`` samples stretches of each, and a warning that says so.

    Args:
        recordings: of any length; their columns may lie in files.
    """
    total = sum(len(one.t) for one in recordings)
    if total <= MOST:
        return tuple(recordings), []
    found, used = [], 0
    for one in recordings:
        share = max(MOST * len(one.t) // total, min(FEWEST, len(one.t)))
        rows = min(STRETCH, share)
        starts = np.linspace(0, len(one.t) - rows, share // max(rows, 1)).astype(int)
        found += [_part(one, int(start), rows) for start in starts]
        used += rows * len(starts)
    return tuple(found), [f"long-recording: of {total} samples {used} are used, in {len(found)} stretches spread "
                          "evenly; give shorter recordings to choose which"]


def shortened(recording: Recording) -> tuple[Recording, list[str]]:
    """The recording, or of more than ``MOST`` samples its stretches as one recording, and a warning that says so.

    The time between stretches is taken out: they follow each other after a pause, near which nothing is used.

    Args:
        recording: of any length; its columns may lie in files.
    """
    parts, warnings = stretches([recording])
    if not warnings:
        return recording, []
    shifts: list[float] = []
    end = 0.0
    for part in parts:
        step = float(part.t[-1] - part.t[0]) / max(len(part.t) - 1, 1)
        begin = end + max(_PAUSE, _STEPS * step) if shifts else float(part.t[0])
        shifts.append(begin - float(part.t[0]))
        end = float(part.t[-1]) + shifts[-1]
    columns = {name: np.concatenate([part.columns[name] + (shift if name in _TIMES else 0.0)
                                     for part, shift in zip(parts, shifts, strict=True)])
               for name in recording.columns}
    for values in columns.values():
        values.setflags(write=False)
    return replace(recording, columns=columns), [f"{warnings[0]}; the time between them is taken out"]


def _part(recording: Recording, start: int, rows: int) -> Recording:
    columns = {name: np.array(values[start : start + rows]) for name, values in recording.columns.items()}
    let_go(*recording.columns.values())
    for values in columns.values():
        values.setflags(write=False)
    t = columns["t"]
    return replace(recording, columns=columns, source=f"{recording.source} ({t[0]:.0f} to {t[-1]:.0f} s)")
