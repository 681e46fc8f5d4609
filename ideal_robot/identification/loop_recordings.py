"""Checks which recordings show a joint's closed loop: commands and positions, in the cycle of the controller."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.signals.recording import Recording

_ERRORLESS = 1e-6
"""No loop follows a motion this closely [rad, m]: such a command is a copy of the measured position."""


def commanded(recording: Recording) -> str:
    """Name of the commands' columns without the joint: that of the desired positions where there are none."""
    return "q_c" if recording.has("q_c") else "q_d"


def require_loop(recordings: Sequence[Recording]) -> None:
    """Raises InputError for recordings with ``q_i`` and ``q_c_i`` (or ``q_d_i``) that do not show a joint's loop.

    The reasons are a command that is missing, never changes in any recording, or is the measured position.
    """
    pairs = [(r.joints(commanded(r)), r.joints("q")) for r in recordings]
    require_changes([q_c for q_c, _ in pairs], commanded(recordings[0]), recordings[0].source)
    for j in np.flatnonzero(np.max([np.ptp(q_c - q, axis=0) for q_c, q in pairs], axis=0) < _ERRORLESS):
        raise InputError(f"is q_{j + 1} itself; log what is commanded, not what is measured",
                         file=recordings[0].source, field=f"{commanded(recordings[0])}_{j + 1}")


def require_changes(values: Sequence[Array], name: str, source: str) -> None:
    """Raises InputError for a joint whose column never changes.

    Args:
        values: of each recording ``(N, n)``.
        name, source: of the columns without the joint, and where they come from.
    """
    for j in np.flatnonzero(np.all([np.ptp(rows, axis=0) == 0.0 for rows in values], axis=0)):
        raise InputError("never changes, which says nothing of the joint's controller", file=source,
                         field=f"{name}_{j + 1}")


def in_cycle(recording: Recording, t_cycle: float) -> tuple[float, int]:
    """Sampling step [s], and its number per cycle of ``t_cycle`` [s]; raises InputError if that is not whole."""
    step = float(np.median(np.diff(recording.t)))
    every = round(t_cycle / step)
    if every < 1 or abs(every * step - t_cycle) > 0.02 * t_cycle:
        raise InputError(f"the sampling step must divide the cycle of {1e3 * t_cycle:g} ms", file=recording.source,
                         field="t", value=f"{1e3 * step:.4g} ms")
    return step, every
