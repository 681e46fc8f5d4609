"""Long series are thinned, short ones are not, and no peak is lost from a drawing."""

from __future__ import annotations

import numpy as np

from scenes.thinned import MOST, extremes, step


def test_a_normal_series_is_whole() -> None:
    assert step(MOST) == step(0) == 1
    np.testing.assert_array_equal(extremes(np.zeros(MOST)), np.arange(MOST))


def test_the_extremes_of_a_long_series_are_drawn() -> None:
    values = np.random.default_rng(0).standard_normal(7 * MOST + 13)
    values[[123_457, 400_001]] = 50.0, -50.0
    rows = extremes(values)
    assert len(rows) <= MOST
    assert np.all(np.diff(rows) > 0)
    assert {123_457, 400_001} <= set(rows)
    assert len(values[:: step(len(values))]) <= MOST
