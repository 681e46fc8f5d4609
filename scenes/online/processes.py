"""Process utilities: memory, interrupts, real-time priority, and functions called in another process."""

from __future__ import annotations

import ctypes
import gc
import importlib
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

# Calls functions by name in processes that need modules which their starter shall not load.

def called(name: str, *given: Any) -> Any:
    """Calls a function by its name in another process; its module is imported there only.

    Args:
        name: ``module:function``.
        given: its arguments.
    """
    module, _, function = name.partition(":")
    return getattr(importlib.import_module(module), function)(*given)


# Memory and processor time of processes, as the system reports them; NaN where it does not.

def peak_memory(pid: int) -> float:
    """Largest resident memory of a process [MB] since it began, or since ``give_back``, shared parts included."""
    return _field(Path(f"/proc/{pid}/status"), "VmHWM")


def memory_together(pids: Sequence[int]) -> float:
    """Memory of processes now [MB]; memory that they share, above all of libraries, is included once."""
    own, shared = 0.0, 0.0
    for pid in pids:
        file = Path(f"/proc/{pid}/smaps_rollup")
        own += _field(file, "Private_Clean") + _field(file, "Private_Dirty")
        shared = max(shared, _field(file, "Shared_Clean") + _field(file, "Shared_Dirty"))
    return own + shared


def processor_seconds(pid: int) -> float:
    """Processor time that all threads of a process have taken [s]."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    except (OSError, ValueError, IndexError):
        return float("nan")


def _field(file: Path, name: str) -> float:
    try:
        line = next(line for line in file.read_text(encoding="ascii").splitlines() if line.startswith(f"{name}:"))
        return int(line.split()[1]) * 1024 / 1e6
    except (OSError, ValueError, StopIteration):
        return float("nan")


# Releases memory that only loading needed, before the arm moves.
#
# Loading compiled functions runs through much of the compiler's code, which no cycle needs again. The simulated run
# that follows loads what is needed, so that nothing is loaded while a controller waits.

_DONTNEED = 4
"""``MADV_DONTNEED`` of Linux: pages of a file are read from it again when they are touched again."""


def give_back() -> float:
    """Drops pages of libraries' code and free memory of the heap; does nothing where the system is no Linux.

    Returns the largest memory of this process so far [MB] and resets it.
    """
    most = peak_memory(os.getpid())
    if not sys.platform.startswith("linux"):
        return most
    gc.collect()
    library = ctypes.CDLL(None)
    with suppress(OSError, ValueError, AttributeError):
        for line in Path("/proc/self/maps").read_text(encoding="utf-8").splitlines():
            fields = line.split(maxsplit=5)
            # Only pages of code, which are never written, so that the file has all of them.
            if len(fields) == 6 and fields[1] == "r-xp" and fields[5].startswith("/"):
                begin, end = (int(place, 16) for place in fields[0].split("-"))
                library.madvise(ctypes.c_void_p(begin), ctypes.c_size_t(end - begin), _DONTNEED)
        library.malloc_trim(0)
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
    return most


# Measures against late answers: no garbage collection in the cycle, real-time priority, a core of its own.

PRIORITY = 50
"""Real-time priority of a process that leads an arm, of 1 to 99."""
_SWITCH = 1e-4
"""Time another thread (the progress bar) may hold up an answer [s]."""


@contextmanager
def kept_from_collector() -> Iterator[None]:
    """Excludes all present objects from garbage collection within the block.

    A full collection looks at every object of numpy, numba and pinocchio, which takes some hundred milliseconds. If
    objects are excluded already, nothing changes.
    """
    if gc.get_freeze_count():
        yield
        return
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


@contextmanager
def undisturbed(core: int | None = None, priority: int = PRIORITY) -> Iterator[list[str]]:
    """Raises this thread's priority within the block; yields the granted privileges in words.

    Garbage collection is off within the block, as cycles create no reference cycles.

    Args:
        core: processor core to keep to; None for any.
        priority: requested real-time priority, from 1 to 99.
    """
    granted = ["garbage collection out of the cycle"]
    interval, enabled = sys.getswitchinterval(), gc.isenabled()
    cores, before = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set[int](), {}
    gc.disable()
    sys.setswitchinterval(_SWITCH)
    try:
        if core is not None:
            granted.append(_kept_to(core))
        if hasattr(os, "sched_setscheduler"):
            before = _schedulers(priority)
            granted.append(f"real-time priority {priority}" if before else "no real-time priority (not permitted)")
        with kept_from_collector():
            yield granted
    finally:
        for thread, (policy, had) in before.items():
            with suppress(ProcessLookupError):
                os.sched_setscheduler(thread, policy, had)
        if core is not None and cores:
            os.sched_setaffinity(0, cores)
        sys.setswitchinterval(interval)
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


def _kept_to(core: int) -> str:
    try:
        os.sched_setaffinity(0, {core})
    except (AttributeError, OSError, ValueError):
        return f"core {core} not available"
    return f"core {core}"


# Ctrl-C and SIGTERM bring the arm to rest on its path; before the motion they end the program.

@contextmanager
def stopping_on_signals(stop: Callable[[str], None], begun: Callable[[], bool] = lambda: True) -> Iterator[None]:
    """Within the block, stops the arm on an interrupt or termination signal; restores the old handlers afterwards.

    Only the main thread receives signals: in another one the block has no handlers, and its starter has to stop the
    arm.

    Args:
        stop: brings the arm to rest; receives the reason.
        begun: whether an arm is moving; without one the program ends.
    """

    def interrupt(number: int, _: object) -> None:
        if not begun():
            raise KeyboardInterrupt
        stop("stopped by the user" if number == signal.SIGINT else "stopped by the system (SIGTERM)")

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, interrupt) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
