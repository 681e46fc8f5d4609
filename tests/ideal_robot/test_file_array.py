"""Large arrays lie in files and are arrays like any other."""

from __future__ import annotations

import numpy as np
import pytest

from ideal_robot import file_array
from ideal_robot.file_array import file_of, let_go, new_array


@pytest.mark.parametrize("most", [10, 10_000])
def test_an_array_holds_what_is_written_wherever_it_lies(monkeypatch: pytest.MonkeyPatch, most: int) -> None:
    monkeypatch.setattr(file_array, "IN_MEMORY", most)
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
