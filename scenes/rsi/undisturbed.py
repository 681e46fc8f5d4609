"""What a computer can do so that no answer waits: garbage collection out of the cycle, priority, a core of its own."""

from __future__ import annotations

import gc
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress

PRIORITY = 50
"""Real-time priority of a process that leads an arm, of 1 to 99."""
_SWITCH = 1e-4
"""Time another thread (the progress bar) may hold up an answer [s]."""


@contextmanager
def undisturbed(core: int | None = None, priority: int = PRIORITY) -> Iterator[list[str]]:
    """Yields what was granted, as a person reads it; at the end all is as before.

    A full collection looks at every object of numpy, numba and pinocchio, which takes a hundred milliseconds. What is
    there now is put aside, and nothing is collected within the block: a cycle makes no circles among objects.

    Args:
        core: processor core to keep to; None for any.
        priority: real-time priority that is asked for, of 1 to 99.
    """
    granted = ["garbage collection out of the cycle"]
    interval, enabled = sys.getswitchinterval(), gc.isenabled()
    cores, before = _cores(), {}
    gc.collect()
    gc.freeze()
    gc.disable()
    sys.setswitchinterval(_SWITCH)
    try:
        if core is not None:
            granted.append(_kept_to(core))
        if hasattr(os, "sched_setscheduler"):
            before = _schedulers(priority)
            granted.append(f"real-time priority {priority}" if before else "no real-time priority (not permitted)")
        yield granted
    finally:
        for thread, (policy, had) in before.items():
            with suppress(ProcessLookupError):
                os.sched_setscheduler(thread, policy, had)
        if core is not None and cores:
            os.sched_setaffinity(0, cores)
        sys.setswitchinterval(interval)
        gc.unfreeze()
        if enabled:
            gc.enable()


def _schedulers(priority: int) -> dict[int, tuple[int, os.sched_param]]:
    """Gives every thread of this process real-time priority; returns what they had, nothing if it is not permitted.

    Every one: a thread that draws the progress bar holds Python's lock for a moment, and without priority it could be
    kept from running in that moment by any other program, and us with it.
    """
    threads = [int(name) for name in os.listdir("/proc/self/task")] if os.path.isdir("/proc/self/task") else [0]
    had = {}
    for thread in threads:
        try:
            before = os.sched_getscheduler(thread), os.sched_getparam(thread)
            os.sched_setscheduler(thread, os.SCHED_FIFO, os.sched_param(priority))
            had[thread] = before
        except ProcessLookupError:
            continue
        except OSError:
            break
    return had


def _cores() -> set[int]:
    return os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set()


def _kept_to(core: int) -> str:
    try:
        os.sched_setaffinity(0, {core})
    except (AttributeError, OSError, ValueError):
        return f"core {core} not available"
    return f"core {core}"
