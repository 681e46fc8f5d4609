"""The equation of a measurement, and its arithmetic, which runs several times in each cycle: compiled."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from filterpy.kalman import KalmanFilter
from numpy.typing import NDArray

from ideal_robot.arrays import Array
from ideal_robot.jit import jit


class Innovation(NamedTuple):
    """What a measurement says beyond a state: value, covariance, normalised square, logarithm of determinant."""

    value: Array
    covariance: Array
    nis: float
    log_det: float


class Equation(NamedTuple):
    """z = H x + v with the covariance R of v, of which sensor, and whether its values count all or none."""

    H: Array
    z: Array
    R: Array
    sensor: str
    whole: bool

    def innovation(self, kf: KalmanFilter) -> Innovation:
        """What it says beyond a filter's state."""
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
    """A covariance with the variances of what no state holds in it.

    Args:
        covariance: of the values ``(m, m)`` [m²].
        direction: along which each is seen ``(m, d)``.
        variance: of what no state holds ``(m, d)`` [m²].
    """
    wider = covariance.copy()
    for i in range(len(direction)):
        for j in range(direction.shape[1]):
            wider[i, i] += direction[i, j] ** 2 * variance[i, j]
    return wider


@jit()
def extended(H: Array, z: Array, R: Array, x: Array, P: Array, origin: Array,  # pragma: no cover
             at: tuple[int, int]) -> tuple[Array, Array]:
    r"""About the state that is estimated: the Jacobian goes into ``H (m, n)``; values and their noise are returned.

    With a ratio r of the distances from the sensor's place o (an extended Kalman filter, [L] 4.3):

    .. math:: z = g^T \Delta x_r + r\, (g^T \Delta x_r - o) + v

    The product's second-order part is noise whose covariance follows from that of its factors, and its mean is theirs
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
    size, ratio = at
    g = H[:, :size].copy()
    along = g @ P[:size, :size].copy()
    common = g @ P[:size, ratio].copy()
    noise = R + P[ratio, ratio] * (along @ g.T)
    value = z - common
    for i in range(len(z)):
        predicted = 0.0
        for k in range(size):
            predicted += g[i, k] * x[k]
            H[i, k] *= 1.0 + x[ratio]
        H[i, ratio] = predicted - origin[i]
        value[i] += x[ratio] * predicted
        for j in range(len(z)):
            noise[i, j] += common[i] * common[j]
    return value, noise


@jit()
def _compared(x: Array, P: Array, H: Array, z: Array, R: Array) -> tuple[Array, Array, float, float]:
    """Innovation, its covariance, its normalised square, the logarithm of the covariance's determinant.

    Args:
        x: state ``(n,)``.
        P: its covariance ``(n, n)``.
        H: rows ``(m, n)``.
        z: values ``(m,)``.
        R: their covariance ``(m, m)``.
    """
    innovation, S = z - H @ x, H @ P @ H.T + R
    nis: float = np.sum(innovation * np.linalg.solve(S, innovation))
    return innovation, S, nis, np.linalg.slogdet(S)[1]


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
    """Of linear functions of a state, ``(m,)`` each.

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
