"""Logs of number rows that grow one by one; of long logs only the last rows are in memory.

An array that grows by doubling would be copied between two commands of an arm, and an hour of a run at 4 ms with some
hundred values a row is 0.7 GB. Arrays whose size is known beforehand are plain ones, in a file where they are long.
"""

from __future__ import annotations

import math
import mmap
import os
import tempfile
import weakref
from collections.abc import Iterable, Iterator
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
    """Array of ``count`` zeros in a temporary file; raises OutputError where its folder has no space."""
    try:
        with tempfile.TemporaryFile() as file:
            # Allocated now, as writing to a sparse file on a full disk would end the program.
            if hasattr(os, "posix_fallocate"):
                os.posix_fallocate(file.fileno(), 0, 8 * count)
            else:
                file.truncate(8 * count)
            return np.frombuffer(mmap.mmap(file.fileno(), 0))
    except OSError as error:
        raise no_room(error) from error


def no_room(error: OSError) -> OutputError:
    """The error for a folder for temporary files that has no space."""
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
    """Frees the memory pages of arrays in files; other arrays are not affected."""
    for values in arrays:
        file = file_of(values)
        if file is not None and hasattr(file, "madvise"):
            file.madvise(mmap.MADV_DONTNEED)


KEPT = 32768
"""Rows held in memory at most; fewer where they are so wide that they are more than ``IN_MEMORY`` values."""
_PIECE = 512
"""Rows that are made room for at a time, and written to the file: a tenth of a millisecond of a row as long as the
simulated arm's. Whatever is led in real time waits for no more."""
_BLOCK = 4096
"""Rows that are read at a time."""


class RowLog:
    """Appends rows of equal width; all but the last ``KEPT`` are in a temporary file that ends with the log.

    Reads like a list of arrays, or of numbers where numbers were appended; ``np.array(log)`` is all of it. Rows stay in
    memory if the disk is full: adding one never fails, as an arm may be moving. The caller checks ``refused`` now and
    then and stops.

    Args:
        width: values in a row; None: as many as the first one that is appended has.

    Attributes:
        rows: number of filled rows; whoever fills ``next_row`` increments it.
        refused: why rows are in memory that should be in the file, or None.
    """

    def __init__(self, width: int | None = None) -> None:
        self._numbers, self._width = False, width or 0
        self._pieces: list[Array] = []
        self._file: IO[bytes] | None = None
        self._stored = np.zeros((0, self._width))
        self._first = 0
        self.rows = 0
        self.refused: OutputError | None = None

    @property
    def next_row(self) -> Array:
        """The row that is filled next."""
        piece, i = divmod(self.rows - self._first, _PIECE)
        return self._pieces[piece][i]

    @property
    def kept(self) -> int:
        """Capacity: number of rows that fit into the memory reserved so far."""
        return _PIECE * len(self._pieces)

    def reserve(self, count: int) -> None:
        """Makes room for ``count`` further rows."""
        while self.rows - self._first + count > self.kept:
            self._pieces.append(self._empty_piece())

    def append(self, value: Any) -> None:
        """Adds one row ``(width,)``, or one number."""
        if not self._width:
            shape = np.shape(value)
            self._numbers, self._width = not shape, shape[0] if shape else 1
        self.reserve(1)
        self.next_row[:] = value
        self.rows += 1

    def row(self, i: int) -> Array:
        """Row ``i``, counted from 0; read-only."""
        if i < self._first:
            return self._mapped(self._first)[i]
        piece, i = divmod(i - self._first, _PIECE)
        return self._pieces[piece][i]

    def mapped(self) -> Array:
        """All rows ``(N, width)``: a copy, or for a long log the memory-mapped file."""
        if not self._first:
            return np.asarray(self).reshape(self.rows, self._width)
        if len(self._stored) < self.rows:
            for i, piece in enumerate(self._pieces):
                self._to_file(piece, self._first + _PIECE * i)
        return self._mapped(self.rows)

    def column(self, i: int) -> Array:
        """Value ``i`` of all rows ``(N,)``, a copy."""
        values = np.empty(self.rows)
        for first, rows in self.blocks():
            values[first : first + len(rows)] = rows[:, i]
        return values

    def blocks(self) -> Iterator[tuple[int, Array]]:
        """All rows in blocks, copied: number of the first one, and the rows."""
        width = self._width
        for first in range(0, self._first, _BLOCK):
            count = min(_BLOCK, self._first - first)
            raw = os.pread(self._file.fileno(), 8 * width * count, 8 * width * first)  # type: ignore[union-attr]
            yield first, np.frombuffer(raw).reshape(count, width)
        for first in range(self._first, self.rows, _BLOCK):
            begin = (first - self._first) // _PIECE
            pieces = self._pieces[begin : begin + _BLOCK // _PIECE]
            yield first, np.concatenate(pieces)[: self.rows - first]

    def _empty_piece(self) -> Array:
        """The oldest piece, its rows in the file, where as many rows are held as may be; else a new one."""
        piece: Array | None = None
        try:
            most = max(min(KEPT, IN_MEMORY // max(self._width, 1)), _PIECE)
            while self.kept >= most and self.rows - self._first >= _PIECE:
                self._to_file(self._pieces[0], self._first)
                piece, self.refused = self._pieces.pop(0), None
                self._first += _PIECE
        except OutputError as error:
            self.refused = error
        if piece is None:
            return np.zeros((_PIECE, self._width))
        piece[:] = 0.0
        return piece

    def _to_file(self, rows: Array, first: int) -> None:
        """Writes rows to the file; the first of them is number ``first``."""
        try:
            if self._file is None:
                self._file = tempfile.TemporaryFile(buffering=0)  # noqa: SIM115 (open as long as the log is)
                weakref.finalize(self, self._file.close)
            _write(self._file.fileno(), rows, 8 * self._width * first)
        except OSError as error:
            raise no_room(error) from error

    def _mapped(self, count: int) -> Array:
        """The first ``count`` rows at least, which are in the file; what was handed out before stays valid."""
        if len(self._stored) < count:
            self._stored = np.asarray(np.memmap(  # type: ignore[call-overload]
                self._file, dtype=float, mode="r", shape=(count, self._width)))
        return self._stored

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
        whole = np.empty((self.rows, self._width))
        for first, rows in self.blocks():
            whole[first : first + len(rows)] = rows
        values = whole[:, 0] if self._numbers else whole
        return values if dtype is None else values.astype(dtype, copy=False)

    def __reduce__(self) -> Any:
        return _made_of, (np.asarray(self),)


def _write(descriptor: int, rows: Array, place: int) -> None:
    """Writes rows at a place of a file; a full disk may take a part of them before it says so."""
    remaining = np.ascontiguousarray(rows).data.cast("B")
    while remaining:
        count = os.pwrite(descriptor, remaining, place)
        remaining, place = remaining[count:], place + count


def _made_of(values: Array) -> RowLog:
    log = RowLog()
    for value in values:
        log.append(value)
    return log


def new_columns(names: Iterable[str], length: int, in_memory: bool | None = None) -> dict[str, Array]:
    """Empty columns to be filled, which ``finished`` turns into those of a ``Recording`` without a copy.

    Args:
        names, length: of the columns, and rows of each.
        in_memory: whether they are in memory, not in a memory-mapped file; None: up to ``KEPT`` rows are.
    """
    if length <= KEPT if in_memory is None else in_memory:
        return {name: np.empty(length) for name in names}
    names = tuple(names)
    return dict(zip(names, in_new_file(len(names) * length).reshape(len(names), length), strict=True))


def finished(columns: dict[str, Array]) -> dict[str, Array]:
    """The same columns, made read-only."""
    let_go(*columns.values())
    for column in columns.values():
        column.setflags(write=False)
    return columns


def in_file(values: Array) -> bool:
    """Whether an array lies in a file."""
    return file_of(values) is not None
