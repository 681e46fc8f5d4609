"""A log of any length keeps a bounded number of rows in memory and loses none."""

from __future__ import annotations

import pickle

import numpy as np

from ideal_robot.row_log import KEPT, RowLog


def test_numbers_and_rows_read_like_lists() -> None:
    numbers, rows = RowLog(), RowLog()
    for i in range(3):
        numbers.append(0.5 * i)
        rows.append((i, 10.0 * i))
    assert list(numbers) == [0.0, 0.5, 1.0]
    assert numbers[-1] == 1.0
    assert isinstance(numbers[-1], float)
    assert len(rows) == 3
    assert rows
    assert not RowLog()
    np.testing.assert_array_equal(np.array(rows), [[0, 0], [1, 10], [2, 20]])
    np.testing.assert_array_equal(numbers[:2], [0.0, 0.5])
    np.testing.assert_array_equal(np.array(numbers, dtype=bool), [False, True, True])
    assert np.array(RowLog()).shape == (0,)


def test_a_long_log_keeps_few_rows_and_loses_none() -> None:
    log, count = RowLog(), 2 * KEPT + 700
    for i in range(count):
        log.append(np.array([i, -i]))
        assert log.kept <= KEPT
    expected = np.arange(count)[:, None] * [1.0, -1.0]
    np.testing.assert_array_equal(np.array(log), expected)
    assert all(len(rows) <= KEPT for _, rows in log.blocks())
    np.testing.assert_array_equal(log[5], [5, -5])
    np.testing.assert_array_equal(log[-1], [count - 1, 1 - count])
    np.testing.assert_array_equal(np.array(pickle.loads(pickle.dumps(log))), expected)
    np.testing.assert_array_equal(log.mapped(), expected)
    log.reserve(1)
    assert not log.next_row.any()
