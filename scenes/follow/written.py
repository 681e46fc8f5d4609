"""Recording and page of a run, written by a process of its own.

Tables and plots take more memory than all the rest: the process that leads an arm does not load them.
"""

from __future__ import annotations

import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

from ideal_robot.whole_file import OutputError
from scenes.follow.elsewhere import called
from scenes.follow.journal import lies_there
from scenes.follow.result import FollowResult


def written(result: FollowResult, folder: Path) -> FollowResult:
    """Writes recording, page and figures of a run into its folder; returns the result with their places.

    Raises:
        OutputError: they cannot be written; the journal of the run is kept.
    """
    found: FollowResult = _elsewhere("scenes.follow.page:write_run", result, folder)
    return found


def rescued(folder: Path) -> Path | None:
    """Makes a recording of what a run that was killed has left in its folder; None where there is nothing."""
    if not lies_there(folder):
        return None
    found: Path | None = _elsewhere("scenes.follow.journal:rescue", folder)
    return found


def _elsewhere(work: str, *given: Any) -> Any:
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        try:
            return pool.submit(called, work, *given).result()
        except BrokenProcessPool as error:
            raise OutputError(f"{given[-1]}: the process that writes recording and page was ended; the next run makes "
                              "a recording of the journal in this folder") from error

