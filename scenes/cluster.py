"""A list worked off on a running Dask cluster, which may lose workers, its scheduler, or all of them."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any

from ideal_robot.deadline import Deadline
from ideal_robot.errors import InputError
from scenes.workers import LostError

if TYPE_CHECKING:
    from dask.distributed import Client

PATIENCE = 60.0
"""How long a cluster may be without a worker, or its scheduler without an answer, while tasks are left [s]."""
_ANSWERS = 5.0
"""How long the scheduler has to say which workers there are [s]; it is asked as often."""
_FETCHED = 1.0
"""How long a result may take to come, which is a few kilobytes [s]; later it is asked for again."""
_LOOK = 0.02
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
        time.sleep(_LOOK)


def _workers(client: Client) -> int:
    """Workers that the scheduler knows; 0 if it does not answer."""
    try:
        return len(client.sync(client.scheduler.ncores, callback_timeout=_ANSWERS))  # type: ignore[union-attr]
    except Exception:  # a scheduler that has gone, hangs, or is another one by now
        return 0
