"""A list that is worked off by processes of this machine, or on a running Dask cluster.

A lost process is replaced, none outlives its parent, an interrupt ends all at once. A cluster may lose workers, its
scheduler, or all of them.
"""

from __future__ import annotations

import logging
import multiprocessing
import os
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection, wait
from typing import TYPE_CHECKING, Any

from ideal_robot.deadline import Deadline
from ideal_robot.errors import InputError

if TYPE_CHECKING:
    from dask.distributed import Client

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


PATIENCE = 60.0
"""How long a cluster may be without a worker, or its scheduler without an answer, while tasks are left [s]."""
_ANSWERS = 5.0
"""How long the scheduler has to say which workers there are [s]; it is asked as often."""
_FETCHED = 1.0
"""How long a result may take to come, which is a few kilobytes [s]; later it is asked for again."""
_RESULTS_LOOK = 0.02
"""How often it is looked for results [s]."""


def work_off_on(address: str, tasks: Sequence[Any], function: Callable[[Any], Any]) -> Iterator[tuple[int, Any]]:
    """Yields index and result of each task as they are done.

    Args:
        address: of a running Dask scheduler.
        tasks: what ``function`` is called with.
        function: of a module that the workers can import.

    Returns:
        Iterator of index and result; the result is a ``LostError`` where the cluster could not bring one.

    Raises:
        InputError: no scheduler answers, or Dask is not installed.
    """
    try:
        from dask.distributed import Client
    except ImportError as error:
        raise InputError("needs the package dask[distributed] (pip install 'ideal-robot[cluster]')",
                         field="--dask") from error
    with _quiet():
        try:
            client = Client(address, timeout="10s")
        except (OSError, ValueError, TimeoutError) as error:
            raise InputError(f"no Dask scheduler answers ({error})", field="--dask", value=address) from error
        pending: dict[Any, int] = {}
        try:
            # A task whose worker is lost goes to another one; Dask gives up after its own count of losses.
            pending.update({client.submit(function, task, pure=False, retries=2): index
                            for index, task in enumerate(tasks)})
            yield from _finished(client, pending)
        finally:
            with suppress(Exception):  # a scheduler that has gone has nothing to cancel
                client.cancel(list(pending))
            client.close(timeout=_ANSWERS)


@contextmanager
def _quiet() -> Iterator[None]:
    """Dask tells of a lost connection in tracebacks; here it is said in a line."""
    logging.disable(logging.CRITICAL)
    try:
        yield
    finally:
        logging.disable(logging.NOTSET)


def _finished(client: Client, pending: dict[Any, int]) -> Iterator[tuple[int, Any]]:
    """Results as they come; of all that is left ``LostError`` where nobody is left to do it."""
    from dask.distributed import as_completed

    coming = as_completed(list(pending))
    left = set(pending)
    patience, asked = Deadline.within(PATIENCE), Deadline.within(_ANSWERS)
    while left:
        for future in coming.next_batch(block=False) if coming.has_ready() else ():
            try:
                result = future.result(timeout=_FETCHED)
                patience = Deadline.within(PATIENCE)
            except TimeoutError:  # its worker has gone with it: another one does it again
                coming.add(future)
                continue
            except Exception as error:  # whatever a cluster makes of lost workers, or of a scheduler that has gone
                result = LostError(f"the cluster lost it ({type(error).__name__})")
            left.discard(future)
            yield pending[future], result
        if asked.passed:
            patience = Deadline.within(PATIENCE) if _workers(client) else patience
            asked = Deadline.within(_ANSWERS)
        if patience.passed:
            for future in left:
                yield pending[future], LostError(f"the cluster was without a worker for {PATIENCE:.0f} s")
            return
        time.sleep(_RESULTS_LOOK)


def _workers(client: Client) -> int:
    """Workers that the scheduler knows; 0 if it does not answer."""
    try:
        return len(client.sync(client.scheduler.ncores, callback_timeout=_ANSWERS))  # type: ignore[union-attr]
    except Exception:  # a scheduler that has gone, hangs, or is another one by now
        return 0
