"""Measurements of the deviation from the reference, their equation, and the result of their fusion."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol

import numpy as np
import pinocchio as pin
from filterpy.kalman import KalmanFilter
from numpy.typing import NDArray

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.estimate.cholesky import factor, solve
from ideal_robot.jit import jit
from sensing.camera.camera_model import CameraModel
from sensing.camera.line_detection import PoseAt, PredictedLine, predicted_by_rows
from sensing.camera.line_polynomial import LinePolynomial, fit_of_lowest_order


@dataclass(frozen=True)
class Measurement:
    """Deviations from the reference that one sensor measured at one instant, whatever the sensor.

    Attributes:
        t: instant of measurement, not of arrival [s].
        s: arc lengths of the reference of the measured deviations ``(m,)`` [m].
        value: deviations ``(m,)`` [m]: components of Δx_r along ``direction``; or ``(k,)`` combinations of them.
        covariance: of the values ``(m, m)`` [m²], or ``(k, k)``.
        direction: sensed directions as components along the path's normal and up, ``(m, directions)``; they need not be
            orthogonal to each other. None for purely lateral.
        sensor: name of the sensor, for its own errors and statistics.
        bias: how much each error of the sensor adds to the values, ``(m, b)``; see ``DeviationFilter``.
        combination: how the values follow from the deviations at ``s``, ``(k, m)``, such as value and slope of a
            polynomial through them; they are then accepted or rejected together. None where each deviation is a value.
        origin: where the sensor was along the directions ``(m,)`` [m], if its first error is the logarithm of a ratio
            that multiplies the distances from there; that depends on the deviation, so ``bias`` says nothing of it.
        at: arc length at which the tool was [m]; None where it does not matter.
    """

    t: float
    s: Array
    value: Array
    covariance: Array
    direction: Array | None = None
    sensor: str = "camera"
    bias: Array | None = None
    combination: Array | None = None
    origin: Array | None = None
    at: float | None = None


@dataclass(frozen=True)
class Fused:
    """The result of fusing a measurement.

    Attributes:
        used: which values were used ``(m,)``, or ``(k,)`` where they are combinations.
        innovation: values minus their predictions ``(m,)`` or ``(k,)`` [m].
        nis: normalised innovation squared of the values that went in; ``dof`` on average if all is consistent.
        dof: number of values that went in.
        reason: why values were left out; empty if none were.
        likelihood: logarithm of the measurement's likelihood before it went in, but for a constant.
        sigma: predicted standard deviation of the first innovation [m].
    """

    used: Array
    innovation: Array
    nis: float
    dof: int
    reason: str = ""
    likelihood: float = 0.0
    sigma: float = float("inf")


def check(measurement: Measurement, directions: int) -> None:
    """Raises ``InputError`` where shapes do not fit each other, or the model, or values are not finite."""
    m = k = len(measurement.s)
    shapes: dict[str, tuple[tuple[int, ...], tuple[int, ...]]] = {}
    if measurement.combination is not None:
        k = len(measurement.value)
        shapes["combination"] = (measurement.combination.shape, (k, m))
    shapes |= {"value": (measurement.value.shape, (k,)), "covariance": (measurement.covariance.shape, (k, k))}
    if measurement.direction is not None:
        shapes["direction"] = (measurement.direction.shape, (m, directions))
    for key, (shape, expected) in shapes.items():
        if shape != expected:
            raise InputError(f"expected shape {expected}", field=f"measurement.{key}", value=shape)
    if not (np.isfinite(measurement.value).all() and np.isfinite(measurement.covariance).all()):
        raise InputError("expected finite numbers", field=f"measurement of {measurement.sensor}")


SEEN_AHEAD = 0.06
"""Way ahead of the tool, near which the points of a camera's field are looked for on the reference [m]."""

# Data that the line follower and the camera exchange: points seen, and where to search for the next ones.

class SeenLine(Protocol):
    """The data of a camera field that a follower needs; ``sensing.camera.line_detection.LineField`` is one."""

    @property
    def t(self) -> float:
        """Instant of exposure [s]."""

    @property
    def points_tcp(self) -> Array:
        """Line points in the tool frame ``(m, 3)`` [m]."""

    @property
    def sigma(self) -> Array:
        """Lateral standard deviations of the line points ``(m,)`` [m]."""

    @property
    def used(self) -> NDArray[np.bool_]:
        """Which of the line points are valid ``(m,)``."""

    @property
    def seen(self) -> bool:
        """Whether there is a measurement at all."""


@dataclass(frozen=True)
class LineAhead:
    """A prediction of the line at some places ahead.

    Attributes:
        s: arc lengths of the reference ``(m,)`` [m].
        points: line points in the base frame ``(m, 3)`` [m].
        tangents: unit tangents ``(m, 3)``.
        up: unit surface normals ``(m, 3)``.
        sigma: lateral standard deviations ``(m,)`` [m].
        covariance: of the lateral predictions ``(m, m)`` [m²]; None where the line has the predicted shape.
    """

    s: Array
    points: Array
    tangents: Array
    up: Array
    sigma: Array
    covariance: Array | None = None

    def seen_by(self, camera: CameraModel, t: float, pose_at: PoseAt) -> PredictedLine:
        """The prediction for a picture: each point in the tool frame at the exposure of its own row.

        Args:
            camera: as it is calibrated.
            t: mid-exposure of the picture's middle row [s].
            pose_at: pose of the TCP in the base frame at a time [s].
        """
        return predicted_by_rows(self.seen_from(pose_at(t)), camera, t, pose_at)

    def seen_from(self, pose: pin.SE3) -> PredictedLine:
        """The prediction in the tool frame, for the line detection."""
        return PredictedLine.from_base(self.points, self.tangents, self.up.mean(axis=0), pose,
                                       float(self.sigma.max()), self.covariance)


# One field as one measurement: the polynomial through its points, by its value and slope in their middle ([L] 5).

def polynomial_measurement(points: Measurement) -> tuple[Measurement, LinePolynomial]:
    r"""Value and slope of the deviation in the middle of a field, with their covariance.

    [L] 5: the line is "represented by a polynomial which is computed from 5 detected line points". Its coefficients
    are a linear combination of the points' deviations, c = A Δ, so everything that holds of the points carries over
    without approximation, also what the points have in common:

    .. math:: z = A \Delta,\quad H = A H_\Delta,\quad R = A R_\Delta A^T,\quad B = A B_\Delta

    with the first two rows of A, the value and the slope. The filter so compares the field's polynomial with the one
    that the same fit makes of its map: an order too low for the line leaves no bias in the map.
    Raises ``SensingError`` for fewer than two usable points.

    Args:
        points: deviations of the single points, at least two, with the sensor's errors.
    """
    polynomial = fit_of_lowest_order(points.s, points.value, np.sqrt(np.diag(points.covariance)))
    A = polynomial.combination[:2] / np.array([1.0, polynomial.scale])[:, None]
    bias = None if points.bias is None else A @ points.bias
    measurement = replace(points, value=A @ points.value, covariance=A @ points.covariance @ A.T, bias=bias,
                          combination=A)
    return measurement, polynomial


# The measurement equation and its compiled arithmetic, which runs several times in each cycle.

class Innovation(NamedTuple):
    """Innovation of a measurement: value, covariance, normalised square, logarithm of determinant."""

    value: Array
    covariance: Array
    nis: float
    log_det: float


class Equation(NamedTuple):
    """Measurement equation z = H x + v with the covariance R of v, its sensor, and how its values are gated."""

    H: Array
    z: Array
    R: Array
    sensor: str
    whole: bool

    def innovation(self, kf: KalmanFilter) -> Innovation:
        """The measurement minus what a filter's state predicts of it."""
        return Innovation(*_compared(kf.x, kf.P, self.H, self.z, self.R))


@jit()
def rows_along(direction: Array, basis: Array) -> Array:  # pragma: no cover
    """Components of a basis ``(m, d, n)`` along directions ``(m, d)``: ``(m, n)``."""
    m, d, n = basis.shape
    rows = np.zeros((m, n))
    for i in range(m):
        for j in range(d):
            g = direction[i, j]
            if g != 0.0:
                for k in range(n):
                    rows[i, k] += g * basis[i, j, k]
    return rows


@jit()
def widened(covariance: Array, direction: Array, variance: Array) -> Array:  # pragma: no cover
    """The covariance of values, enlarged by the variance of shapes that the state cannot represent.

    Args:
        covariance: of the values ``(m, m)`` [m²].
        direction: along which each is seen ``(m, d)``.
        variance: of these shapes ``(m, d)`` [m²].
    """
    wider = covariance.copy()
    for i in range(len(direction)):
        for j in range(direction.shape[1]):
            wider[i, i] += direction[i, j] ** 2 * variance[i, j]
    return wider


@jit()
def extended(H: Array, z: Array, R: Array, x: Array, P: Array, origin: Array,  # pragma: no cover
             at: tuple[int, int]) -> tuple[Array, Array]:
    r"""Linearises a measurement about the estimated state: fills the Jacobian ``H (m, n)``, returns values and noise.

    With the logarithm r of a ratio of the distances from the sensor's place o (an extended Kalman filter, [L] 4.3):

    .. math:: z = o + e^r\, (g^T \Delta x_r - o) + v

    A stiffness is positive, however large the error of its estimate: with a negative ratio a rising force would mean
    that the surface recedes. The second-order terms, with :math:`d = g^T \Delta x_r - o`, its variances :math:`G_{ij}`,
    :math:`\sigma_r^2` and covariances :math:`c_i`, add to the mean :math:`e^r (c_i + d_i \sigma_r^2 / 2)` and noise
    with the covariance

    .. math:: e^{2 r} \left( G_{ij} \sigma_r^2 + c_i c_j + \sigma_r^2 (d_i c_j + d_j c_i)
              + \tfrac{1}{2} \sigma_r^4 d_i d_j \right)

    (a second-order filter: Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation,
    10.3.2). Without it values far from the sensor's place make r falsely certain.

    Args:
        H: rows of the linear equation, changed.
        z: values ``(m,)`` [m].
        R: covariance of their noise ``(m, m)`` [m²].
        x: state ``(n,)``.
        P: its covariance ``(n, n)``.
        origin: o ``(m,)`` [m].
        at: number of states of the deviation, the first ones, and which state is r.
    """
    size, at_r = at
    g = H[:, :size].copy()
    variances = (g @ P[:size, :size].copy()) @ g.T
    common = g @ P[:size, at_r].copy()
    r, variance, ratio = x[at_r], P[at_r, at_r], np.exp(x[at_r])
    distance = g @ x[:size].copy() - origin
    value, noise = z.copy(), R.copy()
    for i in range(len(z)):
        for k in range(size):
            H[i, k] *= ratio
        H[i, at_r] = ratio * distance[i]
        # Linear in r about its estimate; the remaining terms, and those of second order, are moved into the value.
        value[i] += ratio * (distance[i] * (r - 0.5 * variance) - common[i]) - (1.0 - ratio) * origin[i]
        for j in range(len(z)):
            noise[i, j] += ratio**2 * (
                variances[i, j] * variance + common[i] * common[j]
                + variance * (distance[i] * common[j] + distance[j] * common[i])
                + 0.5 * variance**2 * distance[i] * distance[j])
    return value, noise


@jit()
def _compared(x: Array, P: Array, H: Array, z: Array, R: Array) -> tuple[Array, Array, float, float]:
    """Innovation, its covariance, its normalised square, the logarithm of the covariance's determinant.

    The last two are no numbers, and within no gate, where the covariance is not positive definite.
    """
    innovation, S = z - H @ x, H @ P @ H.T + R
    L, weighted = S.copy(), innovation.copy()
    if not factor(L):
        return innovation, S, np.nan, np.nan
    solve(L, weighted)
    nis = log_det = 0.0
    for i in range(len(z)):
        nis += innovation[i] * weighted[i]
        log_det += 2.0 * np.log(L[i, i])
    return innovation, S, nis, log_det


@jit()
def within(innovation: Array, S: Array, gate: float) -> tuple[NDArray[np.bool_], int]:  # pragma: no cover
    """Which values are within the gate ``(m,)``, and how many.

    Args:
        innovation: ``(m,)``.
        S: its covariance ``(m, m)``.
        gate: in standard deviations.
    """
    used, count = np.zeros(len(innovation), dtype=np.bool_), 0
    for i in range(len(innovation)):
        used[i] = innovation[i] ** 2 <= gate**2 * S[i, i]
        count += used[i]
    return used, count


@jit()
def mean_and_variance(H: Array, x: Array, P: Array) -> tuple[Array, Array]:  # pragma: no cover
    """Mean and variance of linear functions ``H`` of a state, ``(m,)`` each.

    Args:
        H: the functions' rows ``(m, n)``.
        x: the state ``(n,)``.
        P: its covariance ``(n, n)``.
    """
    HP, variance = H @ P, np.zeros(len(H))
    for i in range(len(H)):
        for k in range(H.shape[1]):
            variance[i] += HP[i, k] * H[i, k]
    return H @ x, variance
