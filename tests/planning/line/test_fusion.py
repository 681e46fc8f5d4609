"""Fusion along the path: right estimates, honest variances, any order, any direction, no lying sensor."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from planning.force.surface_forecast import SmoothSurface
from planning.line.deviation_model import DeviationModel, Expected, PathDeviation
from planning.line.fusion import DeviationFilter
from planning.line.measurement import Fused, Measurement
from tests.planning.cell import Constant, reference

NOISE = 5e-5
AHEAD = np.linspace(0.03, 0.12, 5)


def points(t: float, s: Array, value: Array, sigma: float = NOISE, **more: object) -> Measurement:
    return Measurement(t, s, value, sigma**2 * np.eye(len(s)), **more)  # type: ignore[arg-type]


def path_model(directions: int = 1) -> PathDeviation:
    return PathDeviation(reference(), up=Expected() if directions > 1 else None, ahead=0.3)


class Truth:
    """A deviation drawn from the very process that the model assumes, carried along the path with it."""

    def __init__(self, rng: np.random.Generator, directions: int = 1) -> None:
        self.model, self.rng = path_model(directions), rng
        x, P = self.model.prior()
        self.x = x + np.linalg.cholesky(P + 1e-18 * np.eye(len(x))) @ rng.normal(size=len(x))

    def travel(self, s: float) -> None:
        while (step := self.model.travel(s)) is not None:
            F, Q = step
            self.x = F @ self.x + np.sqrt(np.diag(Q)) * self.rng.normal(size=len(self.x))

    def at(self, s: Array) -> Array:
        return self.model.basis(s) @ self.x

    def seen(self, fusion: DeviationFilter, count: int, turned: Callable[[int], float] | None = None
             ) -> Iterator[tuple[int, float, Fused]]:
        """Fields on the way, by a camera turned by an angle [rad] or of one without an error: number, place, fused."""
        for k in range(count):
            s = 0.014 * k
            self.travel(s)
            fusion.travel(s)
            value = self.at(s + AHEAD)[:, 0] + NOISE * self.rng.normal(size=5)
            if turned is not None:
                value = value + turned(k) * AHEAD
            yield k, s, fusion.update(points(0.02 * k, s + AHEAD, value,
                                             bias=None if turned is None else AHEAD[:, None]))


def ride(
    seed: int, yaw: float = 0.0, biases: dict[str, tuple[float, ...]] | None = None
) -> tuple[float, int, float, int]:
    """One pass over the line: summed normalised innovations and estimation errors, with their degrees of freedom."""
    rng = np.random.default_rng(seed)
    truth, fusion = Truth(rng), DeviationFilter(path_model(), biases=biases, significance=1e-9, gate=20.0)
    nis, dof, nees, count = 0.0, 0, 0.0, 0
    for k in range(50):
        s = 0.014 * k
        truth.travel(s)
        fusion.travel(s)
        places = s + AHEAD + rng.normal(0.0, 1e-3, 5)
        value = truth.at(places)[:, 0] + NOISE * rng.normal(size=5) + yaw * AHEAD
        fused = fusion.update(points(0.02 * k, places, value, bias=AHEAD[:, None] if biases else None))
        nis, dof = nis + fused.nis, dof + fused.dof
        if k == 40:
            where = s + np.array([0.0, 0.05, 0.2])
            H = fusion.model.basis(where)[:, 0]
            P = H @ fusion.kf.P[: fusion.model.size, : fusion.model.size] @ H.T
            error = H @ fusion.state - truth.at(where)[:, 0]
            nees, count = float(error @ np.linalg.solve(P, error)), 3
    return nis, dof, nees, count


def test_innovations_and_errors_are_as_large_as_the_filter_says() -> None:
    # 100 runs of a deviation that is what the model says: sums of squares are chi-squared, within 95 % each.
    runs = np.array([ride(seed) for seed in range(100)])
    for total, dof in ((runs[:, 0].sum(), runs[:, 1].sum()), (runs[:, 2].sum(), runs[:, 3].sum())):
        assert chi2.ppf(0.025, dof) < total < chi2.ppf(0.975, dof)


def test_single_runs_are_within_their_bounds_as_often_as_they_should() -> None:
    runs = np.array([ride(seed) for seed in range(100, 200)])
    inside = [chi2.ppf(0.025, n) < x < chi2.ppf(0.975, n) for x, n in zip(runs[:, 0], runs[:, 1], strict=True)]
    # Of 100 runs 95 are expected; fewer than 88 would happen by chance once in 500 times.
    assert np.sum(inside) >= 88


@pytest.mark.parametrize("make", [path_model, lambda: Constant(0.02)])
@settings(max_examples=20, deadline=None)
@given(order=st.permutations(range(8)))
def test_order_of_measurements_of_a_static_deviation_does_not_matter(make: type, order: list[int]) -> None:
    rng = np.random.default_rng(3)
    batch = [points(0.02 * k, 0.014 * k + AHEAD, 0.004 + NOISE * rng.normal(size=5)) for k in range(8)]
    straight, mixed = DeviationFilter(make()), DeviationFilter(make())
    for k in range(8):
        straight.update(batch[k])
        mixed.update(batch[order[k]])
    where = np.linspace(0.0, 0.3, 20)
    for a, b in zip(straight.deviation(where), mixed.deviation(where), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-5, atol=1e-10)


def test_a_measurement_older_than_the_memory_is_left_out_with_a_reason() -> None:
    fusion, up = DeviationFilter(SmoothSurface(0.065)), np.array([[0.0, 1.0]])
    for k in range(30):
        fusion.update(points(0.02 * k, np.full(1, 0.005 * k), np.zeros(1), direction=up, at=0.005 * k))
    fused = fusion.update(points(0.0, np.zeros(1), np.full(1, 1e-4), direction=up, at=0.0))
    assert (fused.dof, fused.reason) == (0, "too late")
    assert not fusion.mean(np.array([0.15])).any()


@pytest.mark.parametrize("model", [path_model(), Constant(0.02)])
def test_one_measurement_is_enough_to_go_on(model: DeviationModel) -> None:
    fusion = DeviationFilter(model)
    fusion.update(points(0.0, AHEAD, np.full(5, 0.007)))
    mean, variance = fusion.deviation(AHEAD)
    np.testing.assert_allclose(mean[:, 0], 0.007, atol=1e-4)
    assert np.all(variance < 1e-8)


def test_estimate_is_the_least_squares_solution_with_the_prior() -> None:
    rng, fusion = np.random.default_rng(5), DeviationFilter(path_model())
    rows, values = [], []
    for k in range(6):
        s, value = 0.014 * k + AHEAD, 0.003 + 1e-4 * rng.normal(size=5)
        fusion.update(points(0.02 * k, s, value, 1e-4))
        rows.append(fusion.model.basis(s)[:, 0])
        values.append(value)
    H, z = np.vstack(rows) / 1e-4, np.concatenate(values) / 1e-4
    _, P = fusion.model.prior()
    solution = P @ H.T @ np.linalg.solve(H @ P @ H.T + np.eye(len(z)), z)
    np.testing.assert_allclose(fusion.state, solution, atol=1e-8)


def test_variance_grows_ahead_of_what_was_seen_up_to_the_prior() -> None:
    fusion = DeviationFilter(path_model())
    for k in range(10):
        fusion.update(points(0.02 * k, 0.01 * k + AHEAD, np.full(5, 0.002)))
    s = np.linspace(0.2, 0.33, 8)
    _, variance = fusion.deviation(s)
    assert np.all(np.diff(variance[:, 0]) > 0)
    assert variance[-1, 0] < np.diag(fusion.model.prior()[1])[0]


def test_rigid_displacement_is_recognised_and_carried_ahead() -> None:
    path = reference()
    shift = np.array([0.008, -0.003, 0.0])
    fusion = DeviationFilter(path_model())
    for k in range(30):
        s = 0.014 * k + AHEAD
        fusion.travel(0.014 * k)
        fusion.update(points(0.02 * k, s, path.frames(s).normal @ shift))
    ahead = np.array([0.014 * 29 + 0.25])
    mean, variance = fusion.deviation(ahead)
    assert abs(mean[0, 0] - (path.frames(ahead).normal @ shift)[0]) < 3 * np.sqrt(variance[0, 0])
    assert abs(mean[0, 0] - (path.frames(ahead).normal @ shift)[0]) < 2e-3


def test_map_survives_the_moving_window() -> None:
    truth, fusion = Truth(np.random.default_rng(6)), DeviationFilter(path_model())
    for k, s, _ in truth.seen(fusion, 60):
        places = np.array([s - 0.03, s, s + 0.03]) if k > 10 else s + AHEAD[:1]
        mean, _ = fusion.deviation(places)
        assert np.max(np.abs(mean - truth.at(places))) < 2e-4


def test_errors_of_the_sensor_are_told_apart_from_the_deviation() -> None:
    yaw = 0.002
    truth = Truth(np.random.default_rng(7))
    fusion = DeviationFilter(path_model(), biases={"camera": (0.005,)})
    *_, (_, s, _) = truth.seen(fusion, 40, lambda k: yaw)
    estimate, sigma = fusion.bias("camera")
    assert abs(estimate[0] - yaw) < 3 * sigma[0]
    assert sigma[0] < 2e-4
    mean, _ = fusion.deviation(np.array([s]))
    assert abs(mean[0, 0] - truth.at(np.array([s]))[0, 0]) < 1e-4


def lie(fusion: DeviationFilter, k: int, value: Array) -> Fused:
    s = 0.014 * k
    fusion.travel(s)
    return fusion.update(points(0.02 * k, s + AHEAD, value))


def test_single_wrong_points_are_left_out() -> None:
    fusion = DeviationFilter(path_model())
    for k in range(10):
        lie(fusion, k, np.full(5, 0.004))
    value = np.full(5, 0.004)
    value[2] += 0.005
    fused = lie(fusion, 10, value)
    np.testing.assert_array_equal(fused.used, [True, True, False, True, True])
    assert fused.reason == "some values beyond the gate"
    assert fusion.deviation(0.14 + AHEAD)[0][2, 0] == pytest.approx(0.004, abs=1e-4)


def test_garbage_for_half_a_second_does_not_get_into_the_map() -> None:
    rng, fusion = np.random.default_rng(8), DeviationFilter(path_model())
    for k in range(10):
        lie(fusion, k, np.full(5, 0.004))
    before = fusion.deviation(0.126 + AHEAD)[0]
    used = [lie(fusion, k, rng.uniform(-0.03, 0.03, 5)).dof for k in range(10, 35)]
    assert np.sum(used) <= 3
    np.testing.assert_allclose(fusion.deviation(0.126 + AHEAD)[0][:2], before[:2], atol=3e-4)


def test_map_that_was_wrong_is_replaced_when_the_sensor_insists() -> None:
    fusion = DeviationFilter(path_model(), confirm=6)
    for k in range(4):
        lie(fusion, k, np.full(5, -0.01))
    reasons = [lie(fusion, k, np.full(5, 0.006)).reason for k in range(4, 14)]
    assert reasons.index("map replaced") == 5
    assert fusion.deviation(np.array([0.2]))[0][0, 0] == pytest.approx(0.006, abs=1e-4)


def test_a_surface_under_the_tool_has_no_rival() -> None:
    """A rival neither goes along with the tool nor back to a late measurement."""
    fusion, up = DeviationFilter(SmoothSurface(0.065), confirm=3), np.array([[0.0, 1.0]])
    results = [fusion.update(points(0.02 * k, np.full(1, 0.002 * k), np.full(1, 0.0 if k < 20 else 0.05), direction=up,
                                    at=0.002 * k)) for k in range(40)]
    assert not any(result.dof for result in results[20:])
    assert "map replaced" not in {result.reason for result in results}


@settings(max_examples=30, deadline=None)
@given(st.floats(0.2, np.pi - 0.2), st.floats(-np.pi, np.pi))
def test_two_sensors_need_not_be_orthogonal(between: float, first: float) -> None:
    deviation = np.array([0.004, -0.002])
    fusion = DeviationFilter(Constant(0.02, directions=2))
    for sensor, angle, sigma in (("camera", first, 3e-5), ("force", first + between, 1e-4)):
        g = np.array([[np.cos(angle), np.sin(angle)]])
        fusion.update(points(0.0, np.zeros(1), g @ deviation, sigma, direction=g, sensor=sensor))
    mean, variance = fusion.deviation(np.zeros(1))
    np.testing.assert_allclose(mean[0], deviation, atol=3e-5)
    assert np.all(np.sqrt(variance[0]) < 2e-4 / np.sin(between))


def test_camera_and_force_share_one_map() -> None:
    rng = np.random.default_rng(9)
    truth, fusion = Truth(rng, 2), DeviationFilter(path_model(2))
    lateral, height = np.array([1.0, 0.0]), np.array([0.0, 1.0])
    for k in range(120):
        s = 0.004 * k
        truth.travel(s)
        fusion.travel(s)
        if k % 5 == 0:
            places = s + AHEAD
            value = truth.at(places) @ lateral + NOISE * rng.normal(size=5)
            fusion.update(points(0.012 * k, places, value, direction=np.tile(lateral, (5, 1))))
        places = np.array([s])
        value = truth.at(places) @ height + 1e-4 * rng.normal(size=1)
        fusion.update(points(0.012 * k, places, value, 1e-4, direction=height[None], sensor="force"))
    mean, variance = fusion.deviation(places)
    error = mean - truth.at(places)
    assert np.all(np.abs(error) < 4 * np.sqrt(variance))
    assert abs(error[0, 0]) < 1e-4
    assert abs(error[0, 1]) < 3e-4


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"value": np.zeros(4)}, "measurement.value"),
        ({"covariance": np.eye(3)}, "measurement.covariance"),
        ({"direction": np.zeros((5, 2))}, "measurement.direction"),
        ({"value": np.full(5, np.nan)}, "measurement of camera"),
    ],
)
def test_measurements_that_do_not_fit_are_refused(change: dict[str, Array], field: str) -> None:
    values: dict[str, Array] = {"s": AHEAD, "value": np.zeros(5), "covariance": np.eye(5), **change}
    with pytest.raises(InputError) as refused:
        DeviationFilter(path_model()).update(Measurement(t=0.0, **values))
    assert refused.value.field == field


@pytest.mark.parametrize("knocked", [0.003, 0.006])
def test_a_sensor_that_is_moved_little_is_found_though_one_thought_of_it_before(knocked: float) -> None:
    """With one hypothesis at a time, begun by a stray measurement before the knock, the map was up to 0.8 mm off."""
    for seed in range(12):
        truth = Truth(np.random.default_rng(seed))
        fusion = DeviationFilter(path_model(), biases={"camera": (0.003,)}, moved={"camera": (0.01,)})
        for k, s, fused in truth.seen(fusion, 50, lambda k: 0.001 + knocked * (k >= 30)):
            assert k >= 30 or fused.reason != "sensor moved"
            here = np.array([s + 0.03])
            assert k < 30 or abs(fusion.mean(here)[0, 0] - truth.at(here)[0, 0]) < 1e-4


def test_a_sensor_that_is_moved_changes_its_own_error_and_not_the_map() -> None:
    truth = Truth(np.random.default_rng(11))
    fusion = DeviationFilter(path_model(), biases={"camera": (0.003,)}, moved={"camera": (0.01,)})
    knocked, reasons = 0.009, []
    for k, _, fused in truth.seen(fusion, 60, lambda k: 0.001 + knocked * (k >= 30)):
        reasons.append(fused.reason)
        if k == 29:
            assert fusion.bias("camera")[0][0] == pytest.approx(0.001, abs=4 * fusion.bias("camera")[1][0])
    assert "sensor moved" in reasons[30:34]
    assert "sensor moved" not in reasons[:30] + reasons[34:]
    yaw, sigma = fusion.bias("camera")
    assert yaw[0] == pytest.approx(0.001 + knocked, abs=4 * sigma[0])
    places = 0.014 * 59 + AHEAD
    mean, variance = fusion.deviation(places)
    assert np.all(np.abs(mean[:, 0] - truth.at(places)[:, 0]) < 5 * np.sqrt(variance[:, 0]))


# What is looked back on.

def test_the_smoother_knows_at_the_end_what_the_filter_did_not_as_it_passed() -> None:
    """Places seen before the camera's mounting error showed are set right, and the variance says by how much."""
    smoothed, filtered, consistent, count = 0.0, 0.0, 0.0, 0
    for seed in range(12):
        rng = np.random.default_rng(seed)
        truth, fusion = Truth(rng), DeviationFilter(path_model(), biases={"camera": (0.01,)}, gate=20.0)
        yaw, s = 0.01 * rng.standard_normal(), 0.014 * np.arange(50)
        actual, passed = np.zeros((2, 50))
        for k in range(50):
            truth.travel(s[k])
            fusion.travel(s[k])
            actual[k], passed[k] = truth.at(s[k : k + 1])[0, 0], fusion.mean(s[k : k + 1])[0, 0]
            places = s[k] + AHEAD
            value = truth.at(places)[:, 0] + AHEAD * yaw + NOISE * rng.standard_normal(5)
            fusion.update(points(0.02 * k, places, value, bias=AHEAD[:, None]))
        mean, variance = fusion.looked_back(s[3:])
        error = mean[:, 0] - actual[3:]
        smoothed, filtered = smoothed + float(error @ error), filtered + float(np.sum((passed - actual)[3:] ** 2))
        consistent, count = consistent + float(np.sum(error**2 / variance[:, 0])), count + len(error)
        now, sure = fusion.looked_back(s[-1:]), fusion.deviation(s[-1:])
        np.testing.assert_allclose(now, sure, atol=1e-9)
    assert smoothed < 0.7 * filtered
    # Errors of neighbouring places are alike, so their number counts for less than it is.
    assert 0.5 < consistent / count < 1.6


def test_an_error_that_is_known_to_be_none_does_not_keep_from_looking_back() -> None:
    """Its variance is zero, and no covariance with it can be inverted: stamps that are not estimated, say."""
    fusion, s = DeviationFilter(path_model(), biases={"camera": (0.0,)}), 0.014 * np.arange(30)
    for k, place in enumerate(s):
        fusion.travel(place)
        fusion.update(points(0.02 * k, place + AHEAD, np.full(5, 0.002), bias=AHEAD[:, None]))
    mean, variance = fusion.looked_back(s[3:])
    np.testing.assert_allclose(mean, 0.002, atol=2e-4)
    assert np.isfinite(variance).all()


def test_of_a_map_that_was_replaced_nothing_is_looked_back_on() -> None:
    fusion = DeviationFilter(path_model(), confirm=3)
    for k in range(30):
        s = 0.014 * k
        fusion.travel(s)
        fusion.update(points(0.02 * k, s + AHEAD, np.full(5, 0.002 if k < 20 else 0.012)))
    mean, _ = fusion.looked_back(np.array([0.05, 0.35]))
    assert np.isnan(mean[0]).all()
    assert mean[1, 0] == pytest.approx(0.012, abs=1e-4)


def test_without_a_doubt_no_sensor_is_thought_to_be_moved() -> None:
    truth, before = Truth(np.random.default_rng(5)), 0
    fusion = DeviationFilter(path_model(), biases={"camera": (0.003,)}, moved={"camera": (0.01,)})
    for *_, fused in truth.seen(fusion, 60, lambda k: 0.0):
        assert fused.nis > 5.0 or len(fusion.hypotheses.shaken) <= before
        before = len(fusion.hypotheses.shaken)
