"""A clock that runs slower than this computer's, for whole chains of processes: no busy computer decides what they do.

What measures time or sleeps in Python does so by that clock; what only waits for a message is answered by it as soon as
it comes. A process gets it by ``environment``, and so do those that it starts.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tests.sources import ROOT

VARIABLE = "IDEAL_ROBOT_STUDY_SLOWED"
"""How many times as long every second takes."""


def environment(folder: Path, slowed: float) -> dict[str, str]:
    """Environment of processes whose clock is slower.

    Args:
        folder: where a file is written that Python reads when it starts.
        slowed: how many times as long every second takes.
    """
    (folder / "sitecustomize.py").write_text("from studies.slow_clock import begin\nbegin()\n", encoding="utf-8")
    return {**os.environ, VARIABLE: str(slowed), "PYTHONPATH": os.pathsep.join(
        [str(folder), str(ROOT), os.environ.get("PYTHONPATH", "")])}


def begin() -> None:
    """Slows the clock of this process, where its environment says so."""
    slowed = float(os.environ.get(VARIABLE, "1"))
    if slowed != 1.0:
        _slow(slowed)


@contextmanager
def slower(slowed: float) -> Iterator[None]:
    """Within the block the clock of this process is slower, of all its threads.

    Args:
        slowed: how many times as long every second takes.
    """
    clocks: Any = time
    before = clocks.perf_counter, clocks.monotonic, clocks.sleep
    _slow(slowed)
    try:
        yield
    finally:
        clocks.perf_counter, clocks.monotonic, clocks.sleep = before


def _slow(slowed: float) -> None:
    def slow(clock: Callable[[], float]) -> Callable[[], float]:
        return lambda: clock() / slowed

    sleep = time.sleep
    patched: Any = time
    patched.perf_counter, patched.monotonic = slow(time.perf_counter), slow(time.monotonic)
    patched.sleep = lambda seconds: sleep(seconds * slowed)
