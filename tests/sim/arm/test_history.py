"""A long run keeps a bounded number of rows in memory and loses none."""

from __future__ import annotations

import numpy as np

from sim.arm.history import KEPT, History
from sim.arm.kernel import LOGGED


def fill(history: History, rows: int) -> None:
    for _ in range(rows):
        history.reserve(1)
        history.next_row[:] = history.rows + np.arange(len(history.next_row)) / 100.0
        history.next_row[0] = history.rows * history.step
        history.rows += 1


def test_rows_in_memory_are_bounded_and_all_rows_are_there() -> None:
    history, rows = History(1, 0.002), 3 * KEPT + 500
    fill(history, rows)
    assert history.kept <= KEPT
    early = history.columns()
    fill(history, KEPT)
    assert history.kept <= KEPT
    found = history.columns()
    assert len(early["t"]) == rows
    assert len(found["t"]) == rows + KEPT
    np.testing.assert_allclose(found["t"], 0.002 * np.arange(rows + KEPT))
    for i, name in enumerate(LOGGED):
        np.testing.assert_array_equal(found[name][:, 0], np.arange(rows + KEPT) + (1 + i) / 100.0)


def test_a_pose_of_long_ago_is_known() -> None:
    history = History(1, 0.002)
    fill(history, KEPT + 100)
    now = np.zeros(1)
    for row in (3, KEPT - 1, KEPT, KEPT + 50):
        at = history.pose(row * 0.002, 1e9, now, now)
        np.testing.assert_allclose(at, row + (1 + LOGGED.index("q_a")) / 100.0, atol=1e-9)
