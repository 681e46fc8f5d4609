"""Processes a list of tasks in processes of this machine, or on a running Dask cluster.

A lost process is replaced, none outlives its parent, an interrupt ends all at once. A cluster may lose workers, its
scheduler, or all of them. A task that hangs, takes all memory or ends its process costs only itself: it is begun twice,
then given up.
"""

from __future__ import annotations

import itertools
import logging
import multiprocessing
import os
import resource
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any

from ideal_robot.deadline import TIME_LIMIT, Deadline
from ideal_robot.errors import InputError

if TYPE_CHECKING:
    from dask.distributed import Client

ATTEMPTS = 2
"""How often a task is begun whose process is lost each time."""
TASKS = 200
"""So many tasks a process does: a third of a megabyte of each run stays with the libraries until it ends."""
_LOOK = 0.5
"""How often a process looks whether its parent is still there [s]."""


class LostError(Exception):
    """The process of a task died each time, e.g. for lack of memory, or was ended for taking too long."""


def work_off(tasks: Sequence[Any], function: Callable[[Any], Any], processes: int,
             limit: float = TIME_LIMIT) -> Iterator[tuple[int, Any]]:
    """Yields index and result of each task as they are done; a ``LostError`` where the process was lost every time.

    Args:
        tasks: arguments of ``function``.
        function: of a module, so that every system can hand it to a process; must not raise but for want of memory.
        processes: number of simultaneous processes.
        limit: how long a task may take [s]; its process is ended then.
    """
    waiting = deque((index, 1) for index in range(len(tasks)))
    crew: list[_Process] = []
    working: dict[Future[Any], tuple[_Process, int, int]] = {}
    try:
        while waiting or working:
            while waiting and len(working) < processes:
                index, attempt = waiting.popleft()
                process = next((one for one in crew if one.idle), None) or _Process()
                crew = [*(one for one in crew if one is not process), process]
                working[process.begun(function, tasks[index], limit)] = process, index, attempt
            for future in wait(working, return_when=FIRST_COMPLETED).done:
                process, index, attempt = working.pop(future)
                process.idle = True
                error = future.exception()
                if error is None and process.tasks < TASKS:
                    yield index, future.result()
                    continue
                # A new process may have more memory, as this one keeps that of its earlier tasks.
                crew.remove(process)
                code = process.end()
                if error is None:
                    yield index, future.result()
                elif not isinstance(error, BrokenProcessPool | MemoryError):
                    raise error
                elif attempt < ATTEMPTS:
                    waiting.appendleft((index, attempt + 1))
                else:
                    why = ("no memory" if isinstance(error, MemoryError) else
                           f"did not end within {limit:g} s" if code == -signal.SIGALRM else f"exit code {code}")
                    yield index, LostError(f"its process was lost {ATTEMPTS} times ({why})")
    finally:
        for process in crew:
            process.end()


class _Process(ProcessPoolExecutor):
    """A pool of one process, so that what ends it is known to be the one task that it works on.

    Attributes:
        idle: whether it has nothing to do.
        tasks: how many it was given.
    """

    def __init__(self) -> None:
        super().__init__(1, initializer=_prepared, initargs=(os.getpid(),))
        self.idle, self.tasks = True, 0
        number = self.submit(os.getpid).result()
        self._own = next(child for child in multiprocessing.active_children() if child.pid == number)

    def begun(self, function: Callable[[Any], Any], task: Any, limit: float) -> Future[Any]:
        """What will be the task's result."""
        self.idle, self.tasks = False, self.tasks + 1
        return self.submit(_limited, function, task, limit)

    def end(self) -> int | None:
        """Ends the process at once and returns its exit code."""
        self._own.kill()
        self.shutdown(cancel_futures=True)
        return self._own.exitcode


def _prepared(parent: int) -> None:
    # A terminal sends Ctrl-C to all processes; the parent handles it for all.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    # A process that needs more than half of the memory fails, before the system ends another one.
    half = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") // 2
    resource.setrlimit(resource.RLIMIT_DATA, (half, resource.getrlimit(resource.RLIMIT_DATA)[1]))
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _limited(function: Callable[[Any], Any], task: Any, limit: float) -> Any:
    with _ended_after(limit):
        return function(task)


def _end_with(parent: int) -> None:
    """Ends this process when its parent has ended in whatever way."""
    while os.getppid() == parent:
        time.sleep(_LOOK)
    os._exit(1)


PATIENCE = 60.0
"""How long a cluster may be without a worker, or its scheduler without an answer, while tasks are left [s]."""
BATCH = 1.0
"""How long the tasks that are handed over together take [s], at least: a hundred times what Dask spends on them."""
SPENT = 0.05
"""What a batch costs the client, which takes one after the other [s]; by `python -m studies sweep-plan`."""
_MOST_OF_A_BATCH = 100
"""So many tasks at most are begun again when their worker is lost."""
_AHEAD = 4
"""Batches handed over for each worker: the next ones are there when one is done, and the scheduler's memory is flat."""
_LOSSES = 2
"""How often a task is begun alone whose worker is lost each time."""
_ANSWERS = 5.0
"""How long the scheduler has to say which workers there are [s]; it is asked as often."""
_FETCHED = 1.0
"""How long a result may take to come, which is a few kilobytes [s]; later it is asked for again."""
_RESULTS_LOOK = 0.02
"""How often it is looked for results, and for a scheduler that has gone [s]."""


def batch_lasts(workers: int) -> float:
    """Duration of a batch's tasks [s] with which the client keeps ``workers`` busy, with a margin of half."""
    return max(BATCH, 1.5 * SPENT * workers)


def work_off_on(address: str, tasks: Sequence[Any], function: Callable[[Any], Any],
                limit: float = TIME_LIMIT) -> Iterator[tuple[int, Any]]:
    """Yields index and result of each task as they are done, each once; a ``LostError`` where none was possible.

    Short tasks are handed over in batches. Where a batch's worker is lost each time, its tasks are run alone after all
    others, so that only one task is lost with its worker. After a loss of the scheduler it waits for a new one at the
    same address, which gets the remaining tasks. Raises InputError where none answers, or Dask is not installed.

    Args:
        address: of a running Dask scheduler.
        tasks: arguments of ``function``.
        function: of a module that the workers can import.
        limit: longest duration of a task [s]; then its worker is ended, and Dask's nanny restarts it.
    """
    try:
        from dask.distributed import Client
    except ImportError as error:
        raise InputError("needs the package dask[distributed] (pip install 'ideal-robot[cluster]')",
                         field="--dask") from error
    work, begun, patience = _Handed(tasks, function, limit), False, Deadline.within(PATIENCE)
    with _quiet():
        while work.left and not (begun and patience.passed):
            try:
                client = Client(address, timeout="10s" if not begun else f"{_ANSWERS}s")
            except (OSError, ValueError, TimeoutError) as error:
                if not begun:
                    raise InputError(f"no Dask scheduler answers ({error})", field="--dask", value=address) from error
                time.sleep(_RESULTS_LOOK)
                continue
            begun = True
            try:
                yield from work.done_by(client)
            except _GoneError:
                patience = Deadline.within(PATIENCE)
                work.again()
                continue
            finally:
                with suppress(Exception):  # a scheduler that has gone has nothing to cancel
                    client.cancel(list(work.pending))
                with suppress(Exception):
                    client.close(timeout=_ANSWERS)
            break
    for index in sorted(work.left):
        yield index, LostError(f"the cluster was without a worker for {PATIENCE:.0f} s")


class _GoneError(Exception):
    """The scheduler has gone."""


def _batch(function: Callable[[Any], Any], tasks: list[Any], limit: float) -> tuple[float, list[Any]]:
    """Runs a batch on a worker: the time that a task takes [s], and the results."""
    start, results = time.perf_counter(), []
    for task in tasks:
        results.append(_limited(function, task, limit))
    return (time.perf_counter() - start) / len(tasks), results


_DEADLINES: dict[int, Deadline] = {}
"""Of the tasks under way in this process, by thread."""


@contextmanager
def _ended_after(limit: float) -> Iterator[None]:
    """Ends this process where the block takes longer [s], even if it hangs in compiled code: by the system's alarm."""
    thread = threading.get_ident()
    _DEADLINES[thread] = Deadline.within(limit)
    try:
        _set_alarm()
        yield
    finally:
        del _DEADLINES[thread]
        _set_alarm()


def _set_alarm() -> None:
    soonest = min((deadline.left for deadline in list(_DEADLINES.values())), default=None)
    signal.setitimer(signal.ITIMER_REAL, 0.0 if soonest is None else max(soonest, 1e-3))


class _Handed:
    """Tasks that are handed to a cluster, and what has become of them."""

    def __init__(self, tasks: Sequence[Any], function: Callable[[Any], Any], limit: float) -> None:
        self.tasks, self.function, self.limit = tasks, function, limit
        self.left = set(range(len(tasks)))
        self.pending: dict[Any, list[int]] = {}
        self._queue: deque[list[int]] = deque()
        self._suspects: deque[int] = deque()
        self._next = iter(range(len(tasks)))
        self._losses = [0] * len(tasks)
        self._size, self._workers = 1, 0

    def again(self) -> None:
        """What was with a scheduler that has gone is handed over once more."""
        self._queue.extend(self.pending.values())
        self.pending = {}

    def done_by(self, client: Client) -> Iterator[tuple[int, Any]]:
        """Index and result as they come; raises ``_GoneError``. What stays in ``left`` at the end had no worker."""
        from dask.distributed import as_completed

        coming = as_completed()
        self._workers = _workers(client)
        patience, refresh = Deadline.within(PATIENCE), Deadline.within(_ANSWERS)
        while self.left:
            while len(self.pending) < _AHEAD * max(self._workers, 1) and (batch := self._taken()):
                future = client.submit(_batch, self.function, [self.tasks[i] for i in batch], self.limit, pure=False)
                self.pending[future] = batch
                coming.add(future)
            for future in coming.next_batch(block=False) if coming.has_ready() else ():
                results = self._fetched(future)
                if results is None:  # its worker has gone with it, so another one repeats it
                    coming.add(future)
                    continue
                patience = Deadline.within(PATIENCE)
                yield from results
            if client.status != "running":
                raise _GoneError
            if refresh.passed:
                self._workers = _workers(client)
                patience = Deadline.within(PATIENCE) if self._workers else patience
                refresh = Deadline.within(_ANSWERS)
            if patience.passed:
                return
            time.sleep(_RESULTS_LOOK)

    def _taken(self) -> list[int]:
        batch = self._queue.popleft() if self._queue else list(itertools.islice(self._next, self._size))
        if batch or self.pending or not self._suspects:
            return batch
        # Suspects run alone, as a dead worker does not show which of its jobs killed it.
        return [self._suspects.popleft()]

    def _fetched(self, future: Any) -> list[tuple[int, Any]] | None:
        """Indices and results of a batch; empty where it was handed over anew, None where it is not there yet."""
        from dask.distributed import KilledWorker

        if future.status == "cancelled":
            raise _GoneError
        try:
            seconds, results = future.result(timeout=_FETCHED)
        except TimeoutError:
            return None
        except (KilledWorker, MemoryError) as error:
            return self._lost(future, f"its worker was lost each time ({type(error).__name__}), or it did "
                                      f"not end within {self.limit:g} s")
        except Exception as error:  # any other exception of a cluster
            return self._lost(future, f"the cluster lost it ({type(error).__name__})")
        batch = self.pending.pop(future)
        self._size = int(min(max(batch_lasts(self._workers) / max(seconds, 1e-6), 1.0), _MOST_OF_A_BATCH))
        pairs = [(index, result) for index, result in zip(batch, results, strict=True) if index in self.left]
        self.left -= set(batch)
        return pairs

    def _lost(self, future: Any, why: str) -> list[tuple[int, Any]]:
        """Tasks of a lost batch begin alone, after all others; one that was lost alone too often is given up."""
        batch = self.pending.pop(future)
        for index in batch:
            self._losses[index] += not self.pending
        given_up = [index for index in batch if len(batch) == 1 and self._losses[index] >= _LOSSES]
        self._suspects.extend(index for index in batch if index not in given_up)
        self.left -= set(given_up)
        return [(index, LostError(why)) for index in given_up]


@contextmanager
def _quiet() -> Iterator[None]:
    """Keeps Dask's tracebacks of lost connections off the terminal, within the block."""
    logging.disable(logging.CRITICAL)
    try:
        yield
    finally:
        logging.disable(logging.NOTSET)


def _workers(client: Client) -> int:
    """Workers that the scheduler knows; 0 if it does not answer."""
    try:
        return len(client.sync(client.scheduler.ncores, callback_timeout=_ANSWERS))
    except Exception:  # a scheduler that has ended, hangs, or was replaced
        return 0
