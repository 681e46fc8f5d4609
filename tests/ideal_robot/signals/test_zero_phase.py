"""The filter over all columns at once gives what SciPy gives column by column."""

import numpy as np
import pytest
from scipy import signal

from ideal_robot.signals.preprocess import lowpass
from ideal_robot.signals.zero_phase import forwards_and_backwards


@pytest.mark.parametrize(("order", "cutoff"), [(1, 0.3), (4, 0.02), (5, 0.4)])
def test_as_scipy_has_it(order: int, cutoff: float) -> None:
    values = np.cumsum(np.random.default_rng(1).standard_normal((500, 7)), axis=0)
    sections = signal.butter(order, cutoff, output="sos")
    wanted = signal.sosfiltfilt(sections, values, axis=0, padlen=120)
    np.testing.assert_allclose(forwards_and_backwards(sections, values, 120), wanted, rtol=0.0, atol=1e-12)


def test_any_shape_and_columns_of_numbers_that_are_none() -> None:
    values = np.random.default_rng(2).standard_normal((300, 2, 3))
    values[:, 1, 2] = np.nan
    found = lowpass(values, 0.01, 5.0)
    assert found.shape == values.shape
    assert np.isnan(found[:, 1, 2]).all()
    np.testing.assert_array_equal(found[:, 0, 1], lowpass(values[:, 0, 1], 0.01, 5.0))
