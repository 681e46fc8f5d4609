"""What a motion repeats does not make a model that is not quite right any surer."""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.identification.regions import regions_of_motion
from ideal_robot.identification.weighted_least_squares import weighted_least_squares


def line(cycles: int, bend: float, *, regional: bool = True) -> tuple[Array, Array]:
    """Offset and slope, and their covariance, of a line through what is bent, seen along one cycle again and again."""
    rng, phase = np.random.default_rng(3), np.linspace(0.0, 2.0 * np.pi * cycles, 100 * cycles, endpoint=False)
    q, qd = np.sin(phase)[:, None], np.cos(phase)[:, None]
    W = np.stack([np.ones_like(q), q], axis=2)
    y = 1.0 + 2.0 * q + bend * q**3 + 0.01 * rng.normal(size=q.shape)
    regions = regions_of_motion(q, qd) if regional else []
    solution = weighted_least_squares(W, y, np.zeros(2), regions=regions)
    return solution.value, solution.covariance


def test_regions_part_the_samples_evenly_and_keep_what_repeats_together() -> None:
    phase = np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False) + 0.001
    q, qd = np.column_stack([np.sin(phase), np.sin(2.0 * phase)]), np.column_stack([np.cos(phase), np.cos(2.0 * phase)])
    regions = regions_of_motion(np.tile(q, (5, 1)), np.tile(qd, (5, 1)))
    assert [len(rows) for rows in regions] == [250] * 8
    assert sorted(np.concatenate(regions)) == list(range(2000))
    for rows in regions:
        # All repetitions of a sample are in its region, but for the few at the borders.
        assert len(set(rows % 400)) <= 50 + 8


def test_repeating_a_cycle_tells_no_more_of_a_model_that_is_not_right() -> None:
    few, many = (np.sqrt(np.diag(line(cycles, 0.3)[1])) for cycles in (4, 64))
    assert np.all(many > 0.8 * few)
    plain = np.sqrt(np.diag(line(64, 0.3, regional=False)[1]))
    # The same range passed at an even pace gives another slope, 2 + 3/5 of the bend.
    other = abs(line(64, 0.3)[0][1] - (2.0 + 0.6 * 0.3))
    assert other > 5.0 * plain[1]
    assert other < 3.0 * many[1]


def test_a_model_that_is_right_is_as_sure_as_without_regions() -> None:
    assert np.allclose(line(16, 0.0)[1], line(16, 0.0, regional=False)[1], rtol=0.0, atol=1e-15)
