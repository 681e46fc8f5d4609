"""Rows of numbers that are added one by one; of long logs only the last rows are held in memory."""

from __future__ import annotations

import math
import mmap
import os
import tempfile
import weakref
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import DTypeLike

from ideal_robot.arrays import Array
from ideal_robot.whole_file import OutputError

IN_MEMORY = 500_000
"""Values of an array that is held in memory; a larger one lies in a file."""


def new_array(*shape: int) -> Array:
    """An array of that shape to be filled, all zero if it lies in a file."""
    count = math.prod(shape)
    return np.empty(shape) if count <= IN_MEMORY else in_new_file(count).reshape(shape)


def in_new_file(count: int) -> Array:
    """So many zeros in a file without a name.

    Raises:
        OutputError: the folder for temporary files has no room for it.
    """
    try:
        with tempfile.TemporaryFile() as file:
            # Room that is only promised would end the program where it is written to and not there.
            if hasattr(os, "posix_fallocate"):
                os.posix_fallocate(file.fileno(), 0, 8 * count)
            else:
                file.truncate(8 * count)
            return np.frombuffer(mmap.mmap(file.fileno(), 0))
    except OSError as error:
        raise no_room(error) from error


def no_room(error: OSError) -> OutputError:
    """What is said where the folder for temporary files has no room."""
    return OutputError(f"{tempfile.gettempdir()}: temporary files cannot be written ({error.strerror or error}); make "
                       "room, or set TMPDIR to another folder")


@contextmanager
def temporary_folder() -> Iterator[Path]:
    """Yields a folder that is removed when the block ends; OutputError where it cannot be written."""
    try:
        with tempfile.TemporaryDirectory(prefix="ideal-robot-") as folder:
            yield Path(folder)
    except OSError as error:
        raise no_room(error) from error


def file_of(values: Array) -> mmap.mmap | None:
    """The file that an array lies in; None where it is in memory."""
    owner: object = values
    while isinstance(owner, np.ndarray) and owner.base is not None:
        owner = owner.base
    if isinstance(owner, memoryview):
        owner = owner.obj
    return owner if isinstance(owner, mmap.mmap) else None


def let_go(*arrays: Array) -> None:
    """What was read or written of arrays in files need not stay in memory; nothing happens to other ones."""
    for values in arrays:
        file = file_of(values)
        if file is not None and hasattr(file, "madvise"):
            file.madvise(mmap.MADV_DONTNEED)


KEPT = 32768
"""Rows held in memory at most; a power of two times the first ones."""
_BEGIN = 512  # rows at first: doubled as they fill
_BLOCK = 4096
"""Rows that are read at a time."""


class RowLog:
    """Rows of equal width, appended; all but the last ``KEPT`` are in a file without a name, which ends with the log.

    Reads like a list of arrays, or of numbers where numbers were appended; ``np.array(log)`` is all of it. Rows that
    no file takes, as the disk is full, stay in memory: adding one never fails, which an arm that moves relies on. Who
    adds rows looks at ``refused`` now and then and ends.

    Args:
        width: values in a row; None: as many as the first one that is appended has.

    Attributes:
        rows: how many rows are filled; whoever fills ``next_row`` counts it.
        refused: why rows are in memory that should be in the file, or None.
    """

    def __init__(self, width: int | None = None) -> None:
        self._numbers = False
        self._log = np.zeros((_BEGIN, width or 0))
        self._file: IO[bytes] | None = None
        self._stored = np.zeros((0, width or 0))
        self._first = 0
        self.rows = 0
        self.refused: OutputError | None = None

    @property
    def next_row(self) -> Array:
        """The row that is filled next."""
        return self._log[self.rows - self._first]

    @property
    def kept(self) -> int:
        """Rows there is memory for."""
        return len(self._log)

    def reserve(self, count: int) -> None:
        """Makes room for ``count`` further rows."""
        if self.rows - self._first + count <= len(self._log):
            return
        if len(self._log) >= KEPT:
            try:
                self._store()
                return
            except OutputError as error:
                self.refused = error
        self._log = np.concatenate([self._log, np.zeros_like(self._log)])

    def append(self, value: Any) -> None:
        """One more row ``(width,)``, or one more number."""
        if not self.rows and not self._log.shape[1]:
            shape = np.shape(value)
            self._numbers = not shape
            self._log = np.zeros((_BEGIN, shape[0] if shape else 1))
        self.reserve(1)
        self.next_row[:] = value
        self.rows += 1

    def row(self, i: int) -> Array:
        """Row ``i``, counted from 0; not to be written to."""
        return self._stored[i] if i < self._first else self._log[i - self._first]

    def mapped(self) -> Array:
        """All rows ``(N, width)``: a copy, of a long log the file, which is read where it is used."""
        if not self._first:
            return self._log[: self.rows].copy()
        self._store()
        return self._stored

    def column(self, i: int) -> Array:
        """Value ``i`` of all rows ``(N,)``, a copy."""
        found = np.empty(self.rows)
        for first, rows in self.blocks():
            found[first : first + len(rows)] = rows[:, i]
        return found

    def blocks(self) -> Iterator[tuple[int, Array]]:
        """All rows in blocks, copied: number of the first one, and the rows."""
        width = self._log.shape[1]
        for first in range(0, self._first, _BLOCK):
            count = min(_BLOCK, self._first - first)
            raw = os.pread(self._file.fileno(), 8 * width * count, 8 * width * first)  # type: ignore[union-attr]
            yield first, np.frombuffer(raw).reshape(count, width)
        for first in range(self._first, self.rows, _BLOCK):
            yield first, self._log[first - self._first : min(first + _BLOCK, self.rows) - self._first].copy()

    def _store(self) -> None:
        """Brings the rows in memory to the file; what was handed out before stays valid."""
        try:
            if self._file is None:
                self._file = tempfile.TemporaryFile(buffering=0)  # noqa: SIM115 (open as long as the log is)
                weakref.finalize(self, self._file.close)
            _write(self._file.fileno(), self._log[: self.rows - self._first], 8 * self._log.shape[1] * self._first)
        except OSError as error:
            raise no_room(error) from error
        self.refused = None
        # The row that is filled next may have been begun already.
        begun = self._log[self.rows - self._first :][:1].copy()
        self._log[:] = 0.0
        self._log[: len(begun)] = begun
        self._first = self.rows
        self._stored = np.asarray(np.memmap(self._file, dtype=float, mode="r", shape=(self.rows, self._log.shape[1])))

    def __len__(self) -> int:
        return self.rows

    def __iter__(self) -> Iterator[Any]:
        for _, rows in self.blocks():
            yield from rows[:, 0].tolist() if self._numbers else rows

    def __getitem__(self, i: int | slice) -> Any:
        if isinstance(i, slice):
            return np.asarray(self)[i]
        if not -self.rows <= i < self.rows:
            raise IndexError(i)
        row = self.row(i % self.rows)
        return float(row[0]) if self._numbers else row.copy()

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> Array:
        if not self.rows:
            return np.empty(0, dtype=dtype)
        whole = np.empty((self.rows, self._log.shape[1]))
        for first, rows in self.blocks():
            whole[first : first + len(rows)] = rows
        found = whole[:, 0] if self._numbers else whole
        return found if dtype is None else found.astype(dtype, copy=False)

    def __reduce__(self) -> Any:
        return _made_of, (np.asarray(self),)


def _write(descriptor: int, rows: Array, place: int) -> None:
    """Writes rows at a place of a file; a full disk may take a part of them before it says so."""
    left = np.ascontiguousarray(rows).data.cast("B")
    while left:
        count = os.pwrite(descriptor, left, place)
        left, place = left[count:], place + count


def _made_of(values: Array) -> RowLog:
    log = RowLog()
    for value in values:
        log.append(value)
    return log


class ColumnStore:
    """Columns of equal length that are filled piece by piece and then become those of a ``Recording`` without a copy.

    Args:
        names: of the columns.
        length: rows of each.
        in_memory: whether they are held in memory, not in a file of which only what is being used is there; None: up to
            ``row_log.KEPT`` rows are.
    """

    def __init__(self, names: Sequence[str], length: int, in_memory: bool | None = None) -> None:
        self.in_memory = length <= KEPT if in_memory is None else in_memory
        """Whether the columns are held in memory."""
        columns = [np.empty(length) for _ in names] if self.in_memory else in_new_file(len(names) * length).reshape(
            len(names), length)
        self._columns = dict(zip(names, columns, strict=True))

    def fill(self, name: str, first: int, values: Array) -> None:
        """Writes a piece of a column.

        Args:
            name: of the column.
            first: row at which the piece begins.
            values: ``(m,)``.
        """
        self._columns[name][first : first + len(values)] = values

    def release(self) -> None:
        """What was filled need not stay in memory: to be called after every piece."""
        let_go(*list(self._columns.values())[:1])

    def finished(self) -> dict[str, Array]:
        """The columns, read-only from now on."""
        self.release()
        for column in self._columns.values():
            column.setflags(write=False)
        return self._columns


def in_file(values: Array) -> bool:
    """Whether a read-only array is a column of a ``ColumnStore`` that is in a file."""
    return file_of(values) is not None
