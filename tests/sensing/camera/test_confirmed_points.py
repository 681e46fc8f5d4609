"""A point is held against the line of the other points, not against one that it has drawn itself."""

from __future__ import annotations

import numpy as np

from sensing.camera.confirmed_points import confirmed_points

ALONG = np.linspace(0.0, 0.09, 5)
LINE = 2e-4 + 0.01 * ALONG
TOLERANCE = 5e-4


def test_points_on_a_line_confirm_each_other_whichever_are_there() -> None:
    noise = 1e-4 * np.array([1.0, -1.0, 0.5, -0.5, 1.0])
    for there in ([0, 1, 2, 3, 4], [0, 3, 4], [0, 2, 4], [1, 2, 3]):
        used = np.isin(np.arange(5), there)
        assert np.array_equal(confirmed_points(ALONG, LINE + 0.2 * noise, used, TOLERANCE), used)


def test_a_wrong_point_far_from_the_others_leaves_no_measurement() -> None:
    """From a field of 10^4 on wood: a streak beside a scratch, alone at one end, 1.6 mm off and within 0.4 mm of the
    straight line through all three."""
    deviation = np.array([-1.324e-3, 0.0, 0.0, 0.289e-3, 0.267e-3])
    used = np.array([True, False, False, True, True])
    fitted = np.polyval(np.polyfit(ALONG[used], deviation[used], 1), ALONG[used])
    assert np.max(np.abs(deviation[used] - fitted)) < TOLERANCE
    # Which of three it is nobody can tell: two are left, too few for a measurement.
    assert confirmed_points(ALONG, deviation, used, TOLERANCE).sum() == 2


def test_the_wrong_one_of_five_is_found_wherever_it_is() -> None:
    for i in range(5):
        deviation = LINE.copy()
        deviation[i] += 1.2e-3
        kept = confirmed_points(ALONG, deviation, np.ones(5, dtype=bool), TOLERANCE)
        assert np.array_equal(np.flatnonzero(~kept), [i])
