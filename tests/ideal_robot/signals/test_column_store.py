"""Recordings longer than memory should hold: their columns are in a file, and they are written piece by piece."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from ideal_robot.row_log import KEPT
from ideal_robot.signals.column_store import ColumnStore, in_file
from ideal_robot.signals.recording import WRITTEN_ROWS, Recording


def stored_recording(length: int) -> tuple[Recording, bool]:
    store = ColumnStore(["t", "q_1"], length)
    for first in range(0, length, 5000):
        rows = np.arange(first, min(first + 5000, length))
        store.fill("t", first, 0.002 * rows)
        store.fill("q_1", first, np.where(rows % 7 == 0, np.nan, np.sin(rows)))
        store.release()
    return Recording(store.finished()), store.in_memory


@pytest.mark.parametrize("length", [100, KEPT, KEPT + 1, 3 * KEPT])
def test_columns_are_the_same_wherever_they_are(length: int) -> None:
    found, in_memory = stored_recording(length)
    assert in_memory == (length <= KEPT)
    rows = np.arange(length)
    plain = Recording.from_arrays(0.002 * rows, q=np.where(rows % 7 == 0, np.nan, np.sin(rows))[:, None])
    assert found.hash == plain.hash
    # Of a long one nothing is copied into memory.
    assert all(in_file(column) for column in found.columns.values()) == (not in_memory)
    with pytest.raises(ValueError, match="read-only"):
        found.columns["q_1"][0] = 1.0


@pytest.mark.parametrize("ending", [".parquet", ".csv"])
def test_long_recordings_are_written_in_pieces(tmp_path: Path, ending: str) -> None:
    found, _ = stored_recording(2 * WRITTEN_ROWS + 10)
    place = found.write(tmp_path / f"long{ending}")
    if ending == ".parquet":
        assert pq.ParquetFile(place).num_row_groups == 3
    read = Recording.read(place)
    for name, values in found.columns.items():
        np.testing.assert_array_equal(read.columns[name], values)
