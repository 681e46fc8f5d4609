"""The estimator against direct computation, and noise that is found again."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import linalg, signal, stats

from ideal_robot.estimate.gaussian import joined, posterior
from ideal_robot.estimate.noise import ColouredNoise, Free, position_in_stretch, without_kicks
from ideal_robot.estimate.score import evidence


def problem(seed: int, blocks: int = 6) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(20 * blocks, 4))
    y = X @ rng.normal(size=4) + rng.normal(size=len(X))
    precision = np.diag(rng.uniform(0.1, 3.0, 4))
    stacked = np.column_stack([X, y]).reshape(blocks, 20, 5)
    return X, y, precision, np.swapaxes(stacked, 1, 2) @ stacked


@pytest.mark.parametrize("seed", range(5))
def test_the_score_is_the_density_of_each_block_given_those_before(seed: int) -> None:
    X, y, precision, products = problem(seed)
    whole = np.eye(len(y)) + X @ np.linalg.inv(precision) @ X.T
    density = [float(stats.multivariate_normal.logpdf(y[:n], np.zeros(n), whole[:n, :n])) + 0.5 * n * np.log(2 * np.pi)
               for n in range(20, len(y) + 1, 20)]
    in_turn = np.diff([0.0, *(evidence(some, precision) for some in np.cumsum(products, axis=0))])
    assert in_turn == pytest.approx(np.diff([0.0, *density]), rel=1e-6)
    assert evidence(products.sum(axis=0), precision) == pytest.approx(density[-1], rel=1e-6)


@pytest.mark.parametrize("seed", range(5))
def test_one_more_group_is_the_ratio_of_two_densities(seed: int) -> None:
    X, y, precision, _ = problem(seed)
    rng = np.random.default_rng(seed + 100)
    C, std = rng.normal(size=(len(y), 2)), np.array([0.3, 2.0])

    def density(columns: np.ndarray, prior: np.ndarray) -> float:
        covariance = np.eye(len(y)) + columns @ prior @ columns.T
        return float(stats.multivariate_normal.logpdf(y, np.zeros(len(y)), covariance))

    before = np.linalg.inv(precision)
    both = linalg.block_diag(before, np.diag(std**2))
    expected = density(np.column_stack([X, C]), both) - density(X, before)
    rows = np.column_stack([X, y])
    one = joined(posterior(rows.T @ rows, precision), C.T @ X, C.T @ C, C.T @ y, np.diag(std))
    assert one.evidence == pytest.approx(expected, rel=1e-6)
    together = np.column_stack([X, C])
    A = np.linalg.inv(both) + together.T @ together
    assert one.mean == pytest.approx(np.linalg.solve(A, together.T @ y)[4:], rel=1e-6)
    assert one.covariance == pytest.approx(np.linalg.inv(A)[4:, 4:], rel=1e-6)


@pytest.mark.parametrize("loud", [1.0, 1e2, 1e3])
def test_what_is_known_to_rounding_is_weighed_rightly_however_far_above_its_noise_a_signal_is(loud: float) -> None:
    """Against least squares of the rows themselves, without products of columns.

    A billionth of each column's squares, added against rounding, cost thousands of nats in recordings without noise.
    """
    rng = np.random.default_rng(5)
    X = rng.normal(size=(400, 12)) @ (np.eye(12) + 0.9)
    y = loud * X @ rng.normal(size=12) + rng.normal(size=400)
    size = np.concatenate([np.full(6, loud), np.full(6, 3.0 * loud)])
    Q, R = np.linalg.qr(np.vstack([X * size, np.eye(12)]))
    padded = np.concatenate([y, np.zeros(12)])
    left = padded - Q @ (Q.T @ padded)
    expected = -0.5 * left @ left - np.log(np.abs(np.diag(R))).sum()
    rows = np.column_stack([X * size, y])
    assert evidence(rows.T @ rows, np.eye(12)) == pytest.approx(expected, abs=0.1)
    one = joined(posterior(rows[:, [*range(6), 12]].T @ rows[:, [*range(6), 12]], np.eye(6)),
                 rows[:, 6:12].T @ rows[:, :6], rows[:, 6:12].T @ rows[:, 6:12], rows[:, 6:12].T @ y, np.eye(6))
    six = evidence(rows[:, [*range(6), 12]].T @ rows[:, [*range(6), 12]], np.eye(6))
    assert six + one.evidence == pytest.approx(expected, abs=0.1)


def test_numbers_have_the_scatter_that_they_say_under_coloured_noise() -> None:
    """RMS of (estimate − truth)/σ over many draws of noise with a memory of ten rows."""
    rng = np.random.default_rng(3)
    t = np.arange(3000)
    X = np.column_stack([np.sin(0.05 * t), np.sign(np.sin(0.013 * t)), np.ones(len(t))])
    use = (t % 500) > 20
    ratios = []
    for _ in range(60):
        noise = signal.lfilter([1.0], [1.0, -0.9], rng.normal(size=len(t)))
        y = X @ np.array([1.0, -2.0, 0.5]) + noise
        rough = y - X @ np.linalg.lstsq(X[use], y[use], rcond=None)[0]
        model = ColouredNoise.fit(rough, use)
        rows = model.whiten(np.column_stack([X, y]), use)
        fitted = posterior(rows.T @ rows)
        ratios.append((fitted.mean - [1.0, -2.0, 0.5]) / fitted.std)
    rms = np.sqrt(np.mean(np.square(ratios), axis=0))
    assert np.all((rms > 0.75) & (rms < 1.3)), rms


def test_innovations_are_white_and_of_unit_size() -> None:
    rng = np.random.default_rng(5)
    true = [1.0, -1.3, 0.6]
    noise = 0.2 * signal.lfilter([1.0], true, rng.normal(size=20000))
    use = np.ones(len(noise), dtype=bool)
    model = ColouredNoise.fit(noise, use)
    assert model.predictors[2] == pytest.approx([1.3, -0.6, 0.0, 0.0], abs=0.03)
    assert model.std == pytest.approx(float(np.std(noise)), rel=0.02)
    white = model.whiten(noise, use)
    assert np.std(white) == pytest.approx(1.0, rel=0.03)
    assert abs(np.corrcoef(white[1:], white[:-1])[0, 1]) < 0.03
    assert model.colour == pytest.approx((1.0 / 0.3) ** 2 * 0.04 / np.var(noise), rel=0.15)


def test_a_stretch_begins_anew() -> None:
    use = np.array([0, 1, 1, 0, 0, 1, 1, 1], dtype=bool)
    assert position_in_stretch(use).tolist() == [-1, 0, 1, -1, -1, 0, 1, 2]
    model = ColouredNoise.of_autocovariance(np.array([2.0, 1.0, 0.5]))
    values = np.array([9.0, 1.0, 2.0, 9.0, 9.0, 3.0, 1.0, 1.0])
    white = model.whiten(values, use)
    altered = model.whiten(np.where(use, values, -50.0), use)
    assert white == pytest.approx(altered)
    assert white[[0, 3, 4]] == pytest.approx(0.0)
    assert white[1] == pytest.approx(1.0 / np.sqrt(2.0))


def test_kicks_are_no_noise() -> None:
    rng = np.random.default_rng(6)
    values, use = rng.normal(size=2000), np.ones(2000, dtype=bool)
    values[[100, 700]] = 40.0, -25.0
    assert np.flatnonzero(~without_kicks(values, use)).tolist() == [100, 700]


def smooth(rows: int, count: int) -> Free:
    """The slowest cosines of some rows, orthonormal."""
    return Free.of(np.linalg.qr(np.cos(np.pi * np.arange(count) * np.linspace(0.0, 1.0, rows)[:, None]))[0])


@pytest.mark.parametrize(("rows", "count"), [(230, 46), (700, 100)])
def test_noise_is_not_smaller_where_columns_took_it(rows: int, count: int) -> None:
    """Fitted to what slow columns leave, white noise had a quarter to a tenth of its power where it is slow."""
    rng, free, use = np.random.default_rng(1), smooth(rows, count), np.ones(rows, dtype=bool)
    noises = rng.normal(size=(20, rows))
    found = [ColouredNoise.beside(noise + free.columns @ rng.normal(size=count), use, free) for noise in noises]
    assert np.median([noise.colour for noise in found]) == pytest.approx(1.0, abs=0.1)
    assert np.median([noise.std for noise in found]) == pytest.approx(1.0, abs=0.05)
    taken = [ColouredNoise.fit(noise - free.columns @ (free.columns.T @ noise), use).colour for noise in noises]
    assert np.median(taken) < 0.3


def test_noise_that_is_fast_is_small_where_it_is_slow() -> None:
    rng, free, use = np.random.default_rng(2), smooth(4000, 60), np.ones(4000, dtype=bool)
    fast = signal.lfilter([1.0], [1.0, 0.8], rng.normal(size=4000))
    assert ColouredNoise.beside(fast, use, free).colour == pytest.approx(0.2 / 1.8, rel=0.2)
