"""A field as one measurement: value and slope of its polynomial, unbiased whatever its order, as sure as they say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from scipy.stats import chi2

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from planning.line.deviation_model import Expected, PathDeviation
from planning.line.deviation_sensor import Reading, fuse_reading
from planning.line.fusion import DeviationFilter
from planning.line.line_follower import LineFollower
from planning.line.measurement import Measurement, extended, polynomial_measurement, widened
from planning.path.kinematics import InverseKinematics
from tests.planning.cell import Constant, T, kr6, profile, reference

NOISE, COMMON, YAW = 3e-5, 4e-5, 0.002
AHEAD = np.linspace(0.03, 0.12, 5)


def field(t: float, s: np.ndarray, value: np.ndarray, sigma: float = NOISE) -> Measurement:
    covariance = sigma**2 * np.eye(len(s)) + COMMON**2
    return Measurement(t, s, value, covariance, bias=np.column_stack([s - s.mean() + 0.07]))


def of_points(t: float, s: np.ndarray, value: np.ndarray) -> Measurement:
    return Measurement(t, s, value, NOISE**2 * np.eye(len(s)))


def model() -> PathDeviation:
    # All of the path lies in the window, so that the state to compare with stays the same one.
    return PathDeviation(reference(), ahead=0.5, behind=0.05, knot=0.04)


def test_value_and_slope_in_the_middle_of_the_field() -> None:
    s = 0.2 + AHEAD
    measured, polynomial = polynomial_measurement(field(0.0, s, 0.004 - 0.03 * (s - 0.275)))
    assert polynomial.centre == pytest.approx(0.275)
    np.testing.assert_allclose(measured.value, [0.004, -0.03], atol=1e-12)
    # Five even points: a fifth of the variance for the mean, σ²/Σ(s - s_0)² for the slope; what they share adds to
    # the mean.
    expected = np.diag([NOISE**2 / 5 + COMMON**2, NOISE**2 / np.sum((s - 0.275) ** 2)])
    np.testing.assert_allclose(measured.covariance, expected, rtol=1e-9, atol=1e-16)
    np.testing.assert_allclose(measured.bias, [[0.07], [1.0]], atol=1e-12)


def test_an_order_too_low_for_the_line_leaves_no_bias_in_the_map() -> None:
    """A bend that single fields cannot tell from noise, and all of them together can."""
    rng = np.random.default_rng(1)
    fusion = DeviationFilter(model())

    def bent(s: np.ndarray) -> np.ndarray:
        return 0.003 + 0.05 * (s - 0.25) ** 2

    orders = []
    for k in range(400):
        s = 0.3 * (k % 50) / 50 + AHEAD
        measured, polynomial = polynomial_measurement(field(0.02 * k, s, bent(s) + 1e-4 * rng.standard_normal(5), 1e-4))
        orders.append(len(polynomial.coefficients) - 1)
        fusion.update(measured)
    assert orders.count(1) > 380
    where = np.linspace(0.08, 0.35, 28)
    # A straight line through the points passes 0.05 mm beside the bend in their middle, in every field the same way.
    assert abs(np.mean(fusion.mean(where)[:, 0] - bent(where))) < 1e-5


def test_innovations_and_errors_are_as_large_as_the_filter_says() -> None:
    """Late and unordered fields of 60 lines drawn from the prior, with a camera turned by an unknown angle."""
    nis = dof = nees = count = 0.0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        deviation, fusion = model(), DeviationFilter(model(), biases={"camera": (YAW,)}, gate=20.0, significance=1e-9)
        x, P = deviation.prior()
        truth = rng.multivariate_normal(x, P)
        yaw = YAW * rng.standard_normal()
        for k in rng.permutation(20):
            s = 0.014 * k + AHEAD + rng.normal(0.0, 1e-3, 5)
            exact = field(0.02 * float(k), s, deviation.basis(s)[:, 0] @ truth)
            value = exact.value + yaw * exact.bias[:, 0] + NOISE * rng.normal(size=5) + COMMON * rng.normal()  # type: ignore[index]
            fused = fusion.update(polynomial_measurement(field(exact.t, s, value))[0])
            assert fused.dof == 2
            nis, dof = nis + fused.nis, dof + fused.dof
        where = np.array([0.05, 0.2, 0.35])
        H = deviation.basis(where)[:, 0]
        error = H @ (fusion.state - truth)
        spread = H @ fusion.kf.P[: deviation.size, : deviation.size] @ H.T
        nees, count = nees + float(error @ np.linalg.solve(spread, error)), count + 3
    assert chi2.ppf(0.025, dof) < nis < chi2.ppf(0.975, dof)
    assert chi2.ppf(0.025, count) < nees < chi2.ppf(0.975, count)


def test_order_of_fields_does_not_matter() -> None:
    rng = np.random.default_rng(2)
    fields = [polynomial_measurement(field(0.02 * k, 0.014 * k + AHEAD, 0.004 + NOISE * rng.normal(size=5)))[0]
              for k in range(8)]
    straight, mixed = DeviationFilter(model()), DeviationFilter(model())
    for k in range(8):
        straight.update(fields[k])
        mixed.update(fields[(5 * k + 3) % 8])
    where = np.linspace(0.0, 0.3, 20)
    np.testing.assert_allclose(straight.mean(where), mixed.mean(where), rtol=1e-5, atol=1e-10)


def test_value_and_slope_count_together_or_not_at_all() -> None:
    fusion = DeviationFilter(model(), confirm=0)
    for k in range(8):
        s = 0.014 * k + AHEAD
        fusion.update(polynomial_measurement(field(0.02 * k, s, np.full(5, 0.004)))[0])
    wrong = polynomial_measurement(field(0.2, AHEAD + 0.1, 0.004 + 0.05 * (AHEAD - 0.075)))[0]
    before = fusion.state.copy()
    fused = fusion.update(wrong)
    assert fused.dof == 0
    assert fused.used.tolist() == [False, False]
    np.testing.assert_array_equal(fusion.state, before)


def test_a_combination_of_another_shape_is_refused() -> None:
    measured = Measurement(0.0, AHEAD, np.zeros(2), np.eye(2), combination=np.ones((2, 4)))
    with pytest.raises(InputError, match="combination"):
        DeviationFilter(model()).update(measured)


# How sure a measurement has to be, and what it is worth.

@pytest.mark.parametrize("count", [1, 2, 5])
def test_of_good_measurements_as_many_are_left_out_as_the_significance_says(count: int) -> None:
    """Of 1500 that are as uncertain as they say, each alone against a map that is known exactly."""
    rng, left_out = np.random.default_rng(count), 0
    for _ in range(1500):
        fusion = DeviationFilter(Constant(1e-12), gate=50.0, significance=0.05, confirm=0)
        left_out += not fusion.update(of_points(0.0, AHEAD[:count], NOISE * rng.standard_normal(count))).dof
    assert left_out / 1500 == pytest.approx(0.05, abs=0.018)


def test_a_single_value_is_left_out_beyond_the_gate_and_not_before() -> None:
    for deviations, used in ((3.99, True), (4.01, False)):
        fusion = DeviationFilter(Constant(1e-12), significance=1e-9)
        value = np.array([0.0, 0.0, deviations * NOISE])
        assert bool(fusion.update(of_points(0.0, AHEAD[:3], value)).used[2]) == used


@pytest.mark.parametrize("count", [1, 3, 5])
def test_however_far_off_a_measurement_is_it_is_as_likely_as_an_outlier(count: int) -> None:
    """Logarithm of the likelihood: half the normalised square less, up to the bound that only outliers are beyond."""
    def likelihood(off: float) -> float:
        fusion = DeviationFilter(Constant(1e-12), gate=1e6, significance=1e-4)
        return fusion.update(of_points(0.0, AHEAD[:count], np.full(count, off * NOISE))).likelihood

    best, bound = likelihood(0.0), float(chi2.isf(1e-4, count))
    assert likelihood(1.0) - best == pytest.approx(-0.5 * count, rel=1e-6)
    for off in (10.0, 1000.0):
        assert likelihood(off) - best == pytest.approx(-0.5 * bound, rel=1e-6)


def test_what_no_state_holds_widens_a_value_along_its_direction() -> None:
    """Variances of what the model leaves out, as seen along unit vectors: Σ g² σ², on the diagonal alone."""
    rng = np.random.default_rng(8)
    angle, variance = rng.uniform(0.0, 6.0, 4), rng.uniform(1e-9, 1e-8, (4, 2))
    direction = np.column_stack([np.cos(angle), np.sin(angle)])
    covariance = np.cov(rng.standard_normal((4, 30)))
    expected = covariance + np.diag(np.cos(angle) ** 2 * variance[:, 0] + np.sin(angle) ** 2 * variance[:, 1])
    argument = covariance.copy()
    np.testing.assert_allclose(widened(argument, direction, variance), expected, rtol=1e-12)
    np.testing.assert_array_equal(argument, covariance)


def test_a_nonlinear_measurement_has_the_jacobian_and_the_moments_of_its_product() -> None:
    """z = o + exp(r) (g·x - o): derivatives by difference; mean and variance over many draws of x and r."""
    rng, size = np.random.default_rng(9), 3
    x = np.array([0.002, -0.001, 0.003, 0.1])
    root = np.diag([2e-4, 3e-4, 2e-4, 0.1]) @ (np.eye(4) + 0.3 * rng.standard_normal((4, 4)))
    P, g, origin, R = root @ root.T, rng.standard_normal((2, size)), np.array([0.004, 0.006]), 1e-10 * np.eye(2)

    def h(state: Array) -> Array:
        along = state[..., :size] @ g.T
        return np.asarray(origin + np.exp(state[..., size:]) * (along - origin))

    z = h(x + rng.standard_normal((20_000, 4)) @ root.T)
    H = np.column_stack([g, np.zeros(2)])
    value, noise = extended(H, h(x), R, x, P, origin, (size, size))
    for j in range(4):
        step = 1e-6 * np.eye(4)[j]
        np.testing.assert_allclose(H[:, j], (h(x + step) - h(x - step)) / 2e-6, atol=1e-7)
    # What the linear equation predicts, and what the product's second-order part adds to mean and covariance.
    np.testing.assert_allclose(z.mean(axis=0) - h(x), H @ x - value, atol=4.0 * z.std(axis=0).max() / np.sqrt(20_000))
    np.testing.assert_allclose(np.cov(z.T), H @ P @ H.T + noise - R, rtol=0.06)


# A further sensor: what it tells is the line's place, wherever the tool was and in whatever direction it looks.

@pytest.mark.parametrize("off", [0.0, 0.004, -0.003])
@pytest.mark.parametrize("slant", [0.0, 0.5, -0.8])
@pytest.mark.parametrize("at", [(0.0, 0.0, 0.0), (0.02, 0.01, 0.0)])
def test_a_reading_tells_where_the_line_is_not_where_the_tool_was(off: float, slant: float,
                                                                  at: tuple[float, float, float]) -> None:
    """[L] (5): a tool beside the reference sees a line that is 6 mm beside it that much nearer or farther."""
    line = 0.006
    model = PathDeviation(reference(), up=Expected(), ahead=0.4)
    f = LineFollower(kr6(), reference(), profile(), 25, fusion=DeviationFilter(model))
    kinematics, s = InverseKinematics(kr6()), 0.0
    frame = reference().frames(np.zeros(1))
    place = pin.SE3(reference().rotation(s), frame.position[0] + off * frame.normal[0])
    q = kinematics.refine([place], f.q_start[None])[0]
    for k in range(4):
        f.observe(k * T, q)
    pose = f.history.pose(T)
    point = pose.act(np.array(at))
    foot, lateral, height = reference().project(point[None], at[0])
    here = reference().frames(foot)
    sensed = np.cos(slant) * here.normal[0] + np.sin(slant) * here.up[0]
    # Of a line that runs beside the reference at its height, as far as the sensor looks along its direction.
    value = np.cos(slant) * (line - lateral[0]) - np.sin(slant) * height[0]
    direction = None if slant == 0.0 else 3.0 * (pose.rotation.T @ sensed)
    fused = fuse_reading(f, Reading(T, at, float(value), 1e-10, direction), "laser")
    assert fused.used.all()
    rows = np.array([[np.cos(slant), np.sin(slant)]]) @ f.fusion.model.basis(foot)[0]
    assert (rows @ f.fusion.state)[0] == pytest.approx(np.cos(slant) * line, abs=2e-5)


@pytest.mark.parametrize(("change", "field"), [({"at": (0.0, 0.0)}, "at"), ({"direction": (1.0, 0.0)}, "direction"),
                                               ({"direction": (0.0, 0.0, 0.0)}, "direction")])
def test_a_reading_of_another_shape_is_refused_by_the_sensors_name(change: dict[str, object], field: str) -> None:
    f = LineFollower(kr6(), reference(), profile(), 25)
    for k in range(4):
        f.observe(k * T, f.q_start)
    good = Reading(T, (0.0, 0.0, 0.0), 0.001, 1e-8)
    assert fuse_reading(f, good, "laser").used.all()
    with pytest.raises(InputError) as refused:
        fuse_reading(f, replace(good, **change), "laser")  # type: ignore[arg-type]
    assert refused.value.field == f"laser: {field}"
