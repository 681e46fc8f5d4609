"""Processes that work off a list: a lost one is replaced, none outlives its parent, an interrupt ends all at once."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from multiprocessing.connection import Connection, wait
from typing import Any

ATTEMPTS = 3
"""How often a task is begun whose process is lost each time."""
TASKS = 200
"""So many tasks a process does: a third of a megabyte of each run stays with the libraries until it ends."""
_NO_MEMORY = 137
"""Exit code of a process without memory, as if the system had ended it."""
_LOOK = 0.5
"""How often a process looks whether its parent is still there [s]."""


class LostError(Exception):
    """The process that worked on a task ended each time, e.g. for want of memory."""


def work_off(tasks: Sequence[Any], function: Callable[[Any], Any], processes: int) -> Iterator[tuple[int, Any]]:
    """Yields index and result of each task as they are done.

    Args:
        tasks: what ``function`` is called with.
        function: of a module, so that every system can hand it to a process; must not raise but for want of memory.
        processes: how many at once.

    Returns:
        Iterator of index and result; the result is a ``LostError`` where the process was lost every time.
    """
    left = deque(range(len(tasks)))
    attempts = [0] * len(tasks)
    workers: list[_Worker] = []
    try:
        while left or workers:
            while left and len(workers) < processes:
                workers.append(_Worker(function))
            for worker in workers:
                if worker.index is None and left:
                    worker.index = left.popleft()
                    attempts[worker.index] += 1
                    worker.begin(tasks[worker.index])
            for worker in [one for one in workers if one.index is None]:
                workers.remove(worker)
                worker.end()
            if not workers:
                continue
            ready = set(wait([one.ours for one in workers if one.index is not None]))
            for worker in [one for one in workers if one.ours in ready]:
                index = worker.index
                assert index is not None
                try:
                    yield index, worker.ours.recv()
                    worker.index = None
                    worker.done += 1
                    if worker.done >= TASKS:
                        workers.remove(worker)
                        worker.end()
                except (EOFError, OSError):
                    workers.remove(worker)
                    code = worker.end()
                    if attempts[index] < ATTEMPTS:
                        left.appendleft(index)
                    else:
                        yield index, LostError(f"its process was lost {ATTEMPTS} times (exit code {code})")
    finally:
        for worker in workers:
            worker.end()


class _Worker:
    """A process and the line to it."""

    def __init__(self, function: Callable[[Any], Any]) -> None:
        self.ours, theirs = multiprocessing.Pipe()
        self.index: int | None = None
        self.done = 0
        self._process = multiprocessing.Process(target=_serve, args=(theirs, function, os.getpid()), daemon=True)
        self._process.start()
        theirs.close()

    def begin(self, task: Any) -> None:
        """Hands a task over."""
        with suppress(OSError):  # already gone: found when its answer is waited for
            self.ours.send(task)

    def end(self) -> int | None:
        """Ends the process at once and returns its exit code."""
        self.ours.close()
        self._process.kill()
        self._process.join(5.0)
        return self._process.exitcode


def _serve(line: Connection, function: Callable[[Any], Any], parent: int) -> None:
    # Ctrl-C goes to all processes of a terminal; the parent answers it for all.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()
    while True:
        try:
            task = line.recv()
        except EOFError:
            return
        try:
            line.send(function(task))
        except MemoryError:
            # Another process may have the memory that this one has not, with all that its tasks have left behind.
            os._exit(_NO_MEMORY)


def _end_with(parent: int) -> None:
    """Ends this process when its parent has ended in whatever way."""
    while os.getppid() == parent:
        time.sleep(_LOOK)
    os._exit(1)
