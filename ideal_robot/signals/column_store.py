"""Columns of a recording while it is made: in memory, or of a long one in a file without a name."""

from __future__ import annotations

import mmap
import tempfile
from collections.abc import Sequence

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.file_array import file_of
from ideal_robot.row_log import KEPT


class ColumnStore:
    """Columns of equal length that are filled piece by piece and then become those of a ``Recording`` without a copy.

    Args:
        names: of the columns.
        length: rows of each; more than ``row_log.KEPT`` of them are in a file, of which only what is being used is in
            memory.
    """

    def __init__(self, names: Sequence[str], length: int) -> None:
        self._map: mmap.mmap | None = None
        if length <= KEPT:
            self._columns = {name: np.empty(length) for name in names}
            return
        with tempfile.TemporaryFile() as file:
            file.truncate(8 * length * len(names))
            self._map = mmap.mmap(file.fileno(), 0)
        whole = np.frombuffer(self._map).reshape(len(names), length)
        self._columns = dict(zip(names, whole, strict=True))

    @property
    def in_memory(self) -> bool:
        """Whether the columns are held in memory."""
        return self._map is None

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
        if self._map is not None and hasattr(self._map, "madvise"):
            self._map.madvise(mmap.MADV_DONTNEED)

    def finished(self) -> dict[str, Array]:
        """The columns, read-only from now on."""
        self.release()
        for column in self._columns.values():
            column.setflags(write=False)
        return self._columns


def in_file(values: Array) -> bool:
    """Whether a read-only array is a column of a ``ColumnStore`` that is in a file."""
    return file_of(values) is not None
