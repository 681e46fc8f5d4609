"""What a computer can do so that no answer waits: garbage collection out of the cycle, priority, a core of its own."""

from __future__ import annotations

import gc
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

_PRIORITY = 50
"""Real-time priority that is asked for, of 1 to 99."""
_SWITCH = 1e-4
"""Time another thread (the progress bar) may hold up an answer [s]."""


@contextmanager
def undisturbed(core: int | None = None) -> Iterator[list[str]]:
    """Yields what was granted, as a person reads it; at the end all is as before.

    A full collection looks at every object of numpy, numba and pinocchio, which takes a hundred milliseconds. What is
    there now is put aside, and nothing is collected within the block: a cycle makes no circles among objects.

    Args:
        core: processor core to keep to; None for any.
    """
    granted = ["garbage collection out of the cycle"]
    interval, enabled = sys.getswitchinterval(), gc.isenabled()
    cores, scheduler = _cores(), None
    gc.collect()
    gc.freeze()
    gc.disable()
    sys.setswitchinterval(_SWITCH)
    try:
        if core is not None:
            granted.append(_kept_to(core))
        if hasattr(os, "sched_setscheduler"):
            before = os.sched_getscheduler(0), os.sched_getparam(0)
            try:
                os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PRIORITY))
                scheduler = before
                granted.append(f"real-time priority {_PRIORITY}")
            except OSError:
                granted.append("no real-time priority (not permitted)")
        yield granted
    finally:
        if scheduler is not None:
            os.sched_setscheduler(0, *scheduler)
        if core is not None and cores:
            os.sched_setaffinity(0, cores)
        sys.setswitchinterval(interval)
        gc.unfreeze()
        if enabled:
            gc.enable()


def _cores() -> set[int]:
    return os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set()


def _kept_to(core: int) -> str:
    try:
        os.sched_setaffinity(0, {core})
    except (AttributeError, OSError, ValueError):
        return f"core {core} not available"
    return f"core {core}"
