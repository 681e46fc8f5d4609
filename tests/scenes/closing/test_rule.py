"""The rule by which a change is kept."""

from __future__ import annotations

import numpy as np
import pytest

from scenes.closing.rule import Comparison

RNG = np.random.default_rng(5)


def along(sizes: np.ndarray, noise: float = 0.02) -> np.ndarray:
    """Deviations whose size differs from piece to piece, with the noise of one play."""
    return np.repeat(sizes, 30) * (1.0 + noise * RNG.normal(size=30 * len(sizes)))


def test_the_standard_error_is_that_of_what_happens() -> None:
    """Pieces of very different size, each as likely to gain as to lose: one standard error is a sixth of the trials."""
    kept = [0, 0]
    for _ in range(600):
        sizes = RNG.lognormal(sigma=1.0, size=40)
        for k, spread in enumerate((0.3, 0.0)):
            gain = np.exp(spread * RNG.normal(size=(2, 40)))
            kept[k] += Comparison.of(along(sizes * gain[0]), along(sizes * gain[1])).falls
    assert 0.08 < kept[0] / 600 < 0.24
    # What noise alone changes is less than what no arm repeats.
    assert kept[1] == 0


@pytest.mark.parametrize(("share", "falls"), [(0.99, False), (0.95, True), (0.5, True)])
def test_a_change_that_acts_alike_everywhere_has_to_do_more_than_the_arm_repeats(share: float, falls: bool) -> None:
    sizes = RNG.lognormal(size=40)
    found = Comparison.of(along(sizes, 0.001), share * along(sizes, 0.001))
    assert found.falls is falls
    assert found.after == pytest.approx(share * found.before, rel=0.01)


def test_a_change_where_friction_turns_round_is_kept() -> None:
    """Errors that stand at three reversals, in a tenth of the motion, and fall there alone."""
    sizes = np.ones(60)
    sizes[[7, 8, 27, 28, 47, 48]] = 10.0
    better = np.where(sizes > 1.0, 5.0, 1.0)
    assert Comparison.of(along(sizes), along(better)).falls


def test_what_one_piece_gains_and_another_loses_is_not_kept() -> None:
    sizes = np.ones(40)
    sizes[3], sizes[20] = 6.0, 2.0
    other = np.ones(40)
    other[3], other[20] = 3.0, 5.0
    found = Comparison.of(along(sizes), along(other))
    assert found.after < found.before
    assert not found.falls
    assert "one is asked for" in found.reason(1e3, "mm")


def test_a_change_for_the_worse_is_never_kept() -> None:
    sizes = RNG.lognormal(size=40)
    found = Comparison.of(along(sizes), 1.1 * along(sizes))
    assert found.rises
    assert not found.falls
    assert "does not fall" in found.reason(1.0, "N")


def test_vectors_count_by_their_length_and_other_counts_of_rows_by_their_share() -> None:
    before = np.abs(RNG.normal(size=(400, 3)))
    found = Comparison.of(before, 0.5 * before[::2])
    assert found.before == pytest.approx(np.sqrt(np.mean(np.sum(before**2, axis=1))))
    assert found.falls


def test_what_cannot_be_measured_does_not_fall() -> None:
    assert not Comparison.of(np.ones(100), np.empty(0)).falls
    assert not Comparison.of(np.empty(0), np.empty(0)).falls
