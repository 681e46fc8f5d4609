"""Writes every cycle of a run to a file as it happens, so that it is kept even if the program is killed."""

from __future__ import annotations

import fcntl
import json
import multiprocessing
import os
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.robots.interface import RobotState
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from ideal_robot.whole_file import OutputError, make_folder, remove_empty, write_text
from scenes.online.processes import called
from scenes.online.result import FollowResult
from scenes.result import Progress

ROWS, META = "journal.rows", "journal.json"
_QUANTITIES = ("q_d", "q_c", "q", "tau")


class Journal:
    """Appends rows of 64-bit numbers to a file: the system has each as soon as it is written, whatever follows.

    Nothing is kept in memory, however long the run.

    Args:
        folder: of the run; made if it is not there.
        robot: the arm.
        meta: metadata of the recording.

    Attributes:
        unwritten: cycles that the disk did not take.
    """

    def __init__(self, folder: Path, robot: Robot, meta: dict[str, Any]) -> None:
        self._made = make_folder(folder)
        self._folder, self._robot = folder, robot
        self._meta = {"robot": robot.name, "cycle_time": robot.t_ipo, "source": "follow",
                      "units": {"t": "s", "q_d": "rad", "q_c": "rad", "q": "rad", "tau": "N m", "current": "A"}, **meta,
                      "gain": robot.drive_gain.tolist()}
        write_text(folder / META, json.dumps(self._meta) + "\n")
        self._row = np.zeros(2 + len(_QUANTITIES) * robot.n)
        self._each = self._row[2:].reshape(len(_QUANTITIES), robot.n)
        self.unwritten = 0
        self._rows = self._begun = 0
        try:
            self._file = (folder / ROWS).open("w+b", buffering=0)
        except OSError as error:
            raise OutputError.of(folder / ROWS, error) from error

    def begin(self) -> None:
        """Restarts the time of the run: the next row is its first."""
        self._begun = self._rows

    def add(self, t: float, state: RobotState, q_d: Array, q_c: Array) -> None:
        """Adds the row of one cycle; rows that the disk does not take are missing.

        Args:
            t: time of the run that belongs to the state [s].
            state: of the arm at the end of the cycle; its time is the controller's.
            q_d: desired position of the cycle ``(n,)`` [rad].
            q_c: commanded position of the cycle ``(n,)`` [rad].
        """
        self._row[0], self._row[1] = t, state.t
        for values, row in zip((q_d, q_c, state.q, state.tau), self._each, strict=True):
            row[:] = values
        try:
            # Written at its own offset, so that the next row overwrites one that a full disk took only in part.
            whole = os.pwrite(self._file.fileno(), self._row.data, self._row.nbytes * self._rows) == self._row.nbytes
        except OSError:
            whole = False
        self._rows += whole
        self.unwritten += not whole

    def recording(self) -> Recording:
        """The rows so far as a recording, even where the folder has been removed meanwhile."""
        return _recording(self._values(), dict(self._meta))

    def times(self) -> Array:
        """The time of the run and the controller's time ``(2, N)`` [s] in the rows since ``begin``."""
        return self._values()[self._begun :, :2].T

    def _values(self) -> Array:
        self._file.seek(0)
        values = np.fromfile(self._file, dtype=np.float64, count=self._rows * len(self._row))
        return values.reshape(-1, len(self._row))

    def close(self) -> None:
        """Closes the file; it is removed where it has no row, as in a run without an arm."""
        self._file.close()
        if not self._rows:
            remove(self._folder)
            remove_empty(self._made)


@contextmanager
def owned(folder: Path) -> Iterator[None]:
    """Locks the folder, which is made if needed, for this run within the block, so that its journal is its own.

    The system releases the lock when the process ends, for whatever reason.

    Raises:
        InputError: another run is under way in it.
    """
    made = make_folder(folder)
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InputError("another run is under way in this folder; wait for its end, or give another one",
                             field="--out", value=str(folder)) from None
        yield
    finally:
        os.close(descriptor)
        remove_empty(made)


def remove(folder: Path) -> None:
    """Removes the journal after the recording of the run is written."""
    (folder / ROWS).unlink(missing_ok=True)
    (folder / META).unlink(missing_ok=True)


def left_behind(folder: Path) -> Recording | None:
    """The recording that a killed run left in its folder; None where there is none, or none that can be read."""
    try:
        recording = _recording(*journal_rows(folder))
    except (OSError, ValueError, KeyError, TypeError, OverflowError, RecursionError):
        return None
    return recording if len(recording.t) else None


def journal_rows(folder: Path, first: int = 0, count: int = -1) -> tuple[Array, dict[str, Any]]:
    """Rows of a journal ``(N, 2 + 4 n)`` and its metadata, also while it is being written.

    A row holds the time of the run and that of the controller [s], then ``q_d``, ``q_c``, ``q`` and ``tau``.

    Args:
        folder: of the run.
        first: row to begin with.
        count: of rows; -1 for all that are there.

    Raises:
        OSError, ValueError, KeyError, TypeError: there is none, or it is no journal.
    """
    meta = json.loads((folder / META).read_text(encoding="utf-8"))
    n = len(meta["gain"])
    size = 2 + len(_QUANTITIES) * n
    values = np.fromfile(folder / ROWS, dtype=np.float64, offset=8 * size * first,
                         count=size * count if count >= 0 else -1)
    # An incomplete row is dropped.
    return values[: len(values) // size * size].reshape(-1, size), meta


def rescue(folder: Path) -> Path | None:
    """Writes a recording from a killed run's journal, removes the journal, and returns the recording's path."""
    recording = left_behind(folder)
    place = None if recording is None else recording.write(folder / "recording_killed.parquet")
    remove(folder)
    return place


def _recording(rows: Array, meta: dict[str, Any]) -> Recording:
    gain = np.array(meta.pop("gain"), dtype=float)
    n = len(gain)
    columns = {name: rows[:, 2 + i * n : 2 + (i + 1) * n] for i, name in enumerate(_QUANTITIES)}
    tau = columns.pop("tau")
    if np.isfinite(tau).all():
        columns |= {"current": tau / gain, "tau": tau}
    # The controller's time runs through calibration and run; that of the run restarts.
    return Recording.from_arrays(rows[:, 1], meta=meta, source="follow", **columns)


# Recording and page of a run are written by a separate process.
#
# Tables and plots take more memory than all the rest: the process that commands an arm does not load them.

def written(result: FollowResult, folder: Path) -> FollowResult:
    """Writes recording, page and figures of a run into its folder; returns the result with their paths.

    Raises:
        OutputError: they cannot be written; the journal of the run is kept.
    """
    placed: FollowResult = _elsewhere("scenes.online.page:write_run", result, folder)
    return placed


def rescued(folder: Path) -> Path | None:
    """Writes a recording from a killed run's journal in its folder and returns its path; None where there is none."""
    if not ((folder / ROWS).is_file() and (folder / META).is_file()):
        return None
    place: Path | None = _elsewhere("scenes.online.journal:rescue", folder)
    return place


def _elsewhere(work: str, *given: Any) -> Any:
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        try:
            return pool.submit(called, work, *given).result()
        except BrokenProcessPool as error:
            raise OutputError(f"{given[-1]}: the process that writes recording and page was ended; the next run makes "
                              "a recording of the journal in this folder") from error


# Progress that is shown when no answer waits for it: drawing a bar takes a lock and writes to a terminal.

class Later:
    """A ``scenes.result.Progress`` that stores the newest progress until ``catch_up`` shows it."""

    def __init__(self, progress: Progress) -> None:
        self._progress = progress
        self._newest: tuple[float, str] | None = None

    def __call__(self, done: float, text: str) -> None:
        """Keeps a share of the whole and what is being done."""
        self._newest = done, text

    def catch_up(self) -> None:
        """Shows the newest stored progress."""
        newest, self._newest = self._newest, None
        if newest is not None:
            self._progress(*newest)
