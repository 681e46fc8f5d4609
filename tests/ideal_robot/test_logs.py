"""Large arrays lie in files and are arrays like any other."""

from __future__ import annotations

import pickle
import subprocess
import sys

import numpy as np
import pytest

from ideal_robot import row_log
from ideal_robot.row_log import KEPT, RowLog, file_of, let_go, new_array


@pytest.mark.parametrize("most", [10, 10_000])
def test_an_array_holds_what_is_written_wherever_it_lies(monkeypatch: pytest.MonkeyPatch, most: int) -> None:
    monkeypatch.setattr(row_log, "IN_MEMORY", most)
    values = new_array(1000, 3)
    assert (file_of(values) is None) == (most > 3000)
    wanted = np.random.default_rng(0).standard_normal((1000, 3))
    for first in range(0, 1000, 100):
        values[first : first + 100] = wanted[first : first + 100]
        let_go(values)
    np.testing.assert_array_equal(values, wanted)
    assert (file_of(values[5:, 1]) is None) == (file_of(values) is None)


def test_letting_go_does_nothing_to_arrays_in_memory() -> None:
    values = np.arange(5.0)
    let_go(values, np.empty(0))
    np.testing.assert_array_equal(values, np.arange(5.0))


@pytest.mark.skipif(sys.platform != "linux", reason="limits the size of files as Linux does")
def test_no_room_for_a_temporary_file_is_said_before_anything_is_written() -> None:
    """A limit on the size of files stands for the disk."""
    program = """
import resource, signal
import subprocess
import sys

import numpy as np
from ideal_robot.errors import IdealRobotError
from ideal_robot.row_log import in_new_file
from ideal_robot.row_log import KEPT, RowLog
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))
def fill():
    log = RowLog()
    for row in np.arange(2.0 * KEPT + 2).reshape(-1, 2):
        log.append(row)
    assert np.array_equal(np.array(log).ravel(), np.arange(2.0 * KEPT + 2))  # an arm that moves must not wait for it
    raise log.refused
for job in (lambda: in_new_file(10_000), fill):
    try:
        job()
    except IdealRobotError as error:
        print(error)
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("set TMPDIR to another folder") == 2


# A log of any length keeps a bounded number of rows in memory and loses none.

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
