"""A filter at few instants gives what the filter of all samples gives there."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

from ideal_robot.signals.filtered_at import filtered_at
from ideal_robot.signals.preprocess import decimated, decimation_taps, lowpass

STEP = 0.004
SMOOTH = lowpass(np.random.default_rng(0).normal(size=(3000, 4, 2)), STEP, 6.0)
SMOOTH[:, 1, 0] = 0.0


@pytest.mark.parametrize("stride", [1, 3, 7])
def test_decimation_of_every_few_samples(stride: int) -> None:
    factor = 40
    wanted = decimated(SMOOTH, factor)[12:-12]
    at = factor * np.arange(12, 63)
    found = filtered_at(SMOOTH[::stride], at / stride, decimation_taps(factor), fine=stride)
    np.testing.assert_allclose(found, wanted, atol=1e-4 * np.abs(SMOOTH).max())
    np.testing.assert_array_equal(found[:, 1, 0], 0.0)


@pytest.mark.parametrize("stride", [1, 4])
def test_low_pass_between_samples_and_near_the_ends(stride: int) -> None:
    band, reach = 2.0, 500
    kernel = lowpass(np.eye(1, 2 * reach + 1, reach)[0], STEP, band)
    place = np.concatenate([[100.0, 130.25, 131.0], np.arange(150.0, 2800.0, 61.7)])
    found = filtered_at(SMOOTH[::stride], place / stride, kernel, fine=stride, odd=True)
    whole = signal.sosfiltfilt(signal.butter(4, 2 * band * STEP, output="sos"), SMOOTH, axis=0, padlen=1000)
    index = place.astype(int)
    share = (place - index)[:, None, None]
    wanted = (1.0 - share) * whole[index] + share * whole[index + 1]
    np.testing.assert_allclose(found, wanted, atol=2e-3 * np.abs(SMOOTH).max())


def test_a_constant_stays_what_it_is_everywhere() -> None:
    kernel = np.hanning(61)
    np.testing.assert_allclose(filtered_at(np.full((50, 1), 3.0), np.linspace(0.0, 49.0, 33), kernel, odd=True), 3.0)
