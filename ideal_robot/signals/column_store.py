"""Columns of a recording while it is made: in memory, or of a long one in a file without a name."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.file_array import file_of, in_new_file, let_go
from ideal_robot.row_log import KEPT


class ColumnStore:
    """Columns of equal length that are filled piece by piece and then become those of a ``Recording`` without a copy.

    Args:
        names: of the columns.
        length: rows of each; more than ``row_log.KEPT`` of them are in a file, of which only what is being used is in
            memory.
    """

    def __init__(self, names: Sequence[str], length: int) -> None:
        self.in_memory = length <= KEPT
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
