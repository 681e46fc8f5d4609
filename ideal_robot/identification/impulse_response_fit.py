"""Decoupled linear models of each joint's closed loop, [G] (7): impulse responses from one simple trajectory.

    q(k) = Σ g(l) q_d(k - l) ,  l = m_d … m

Sinusoids excite few frequencies and friction leaves residuals that no linear response explains, so plain least squares
would fit wild coefficients to them. Both estimators of [G] are here: least squares extended by rows that say that the
response is smooth, dies out and has static gain one, and the information filter (inverse-covariance Kalman filter,
Maybeck 1979), which starts from the same knowledge and goes on with every sample.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.loop.impulse_response import LinearLoop
from ideal_robot.loop.information_filter import InformationFilter
from ideal_robot.signals.recording import Recording

METHODS = ("extended_ls", "information_filter")

_LONGEST_DEGREE = 8


@dataclass(frozen=True)
class LinearLoopFit:
    """Impulse responses of ``n`` joints as identified.

    Attributes:
        loop: the responses.
        relative_degree: ``m_d`` of each joint: cycles before a command shows in the position.
        std: standard deviations of the coefficients ``(m + 1, n)``; zero below the relative degree.
        error_percent: residual over the motion about its start, in norms ``(n,)`` [%].
    """

    loop: LinearLoop
    relative_degree: tuple[int, ...]
    std: Array
    error_percent: Array


def identify_linear_loop(recordings: Sequence[Recording], t_cycle: float, *, lags: int = 25,
                         method: str = "extended_ls") -> LinearLoopFit:
    """Identifies the impulse response of each joint; the relative degree is found from the data.

    Args:
        recordings: with ``q_c_i`` (or ``q_d_i``) and ``q_i``, starting at rest.
        t_cycle: sampling time of the model [s]: the interpolation cycle.
        lags: longest lag ``m``.
        method: ``extended_ls`` or ``information_filter``; they differ in how they compute, not in what they assume.

    Raises:
        InputError: unknown method, missing commands, unsuitable sampling, too short, a joint that does not move.
    """
    if method not in METHODS:
        raise InputError(f"expected one of {', '.join(METHODS)}", field="method", value=method)
    solve = _extended_ls if method == "extended_ls" else _information_filter
    data = [_sampled(r, t_cycle) for r in recordings]
    n = recordings[0].n
    g, std, error, degree = np.zeros((lags + 1, n)), np.zeros((lags + 1, n)), np.empty(n), []
    for j in range(n):
        X, y = _rows([(q_d[:, j], q[:, j]) for q_d, q in data], lags)
        if len(y) < 3 * lags or np.std(y) < 1e-4:
            raise InputError("the joint hardly moves, or the recording is too short for this many lags",
                             file=recordings[0].source, field=f"q_{j + 1}")
        noise = _noise(X, y)
        m_d = _relative_degree(X, y, noise)
        degree.append(m_d)
        g[m_d:, j], std[m_d:, j] = solve(X[:, m_d:], y, noise)
        error[j] = 100.0 * float(np.linalg.norm(y - X @ g[:, j]) / np.linalg.norm(y))
    return LinearLoopFit(LinearLoop(g, t_cycle), tuple(degree), std, error)


def _sampled(recording: Recording, t_cycle: float) -> tuple[Array, Array]:
    step = float(np.median(np.diff(recording.t)))
    every = round(t_cycle / step)
    if every < 1 or abs(every * step - t_cycle) > 0.02 * t_cycle:
        raise InputError(f"the sampling step must divide the cycle of {1e3 * t_cycle:g} ms", file=recording.source,
                         field="t", value=f"{1e3 * step:.4g} ms")
    return recording.joints("q_c" if recording.has("q_c") else "q_d")[::every], recording.joints("q")[::every]


def _rows(series: Sequence[tuple[Array, Array]], lags: int) -> tuple[Array, Array]:
    """Delayed commands ``(N, lags + 1)`` and positions, both about where each recording starts."""
    X, y = [], []
    for q_d, q in series:
        X.append(np.stack([q_d[lags - lag: len(q_d) - lag] for lag in range(lags + 1)], axis=1) - q_d[0])
        y.append(q[lags:] - q[0])
    return np.concatenate(X), np.concatenate(y)


def _noise(X: Array, y: Array) -> float:
    """Standard deviation with which a sample counts, so that correlated residuals are not taken for so many news."""
    A = X.T @ X
    g = np.linalg.solve(A + 1e-9 * np.trace(A) * np.eye(len(A)), X.T @ y)
    e = y - X @ g
    power = np.correlate(e, e, "full")[len(e) - 1: len(e) + 199]
    correlated = 1.0 + 2.0 * float(np.sum(np.maximum(power[1:] / power[0], 0.0)))
    return float(np.std(e) * np.sqrt(correlated)) + 1e-9


def _knowledge(size: int) -> list[tuple[Array, Array, float]]:
    """What is known before, as measurements ``(H, z, σ)``: smooth, dying out, static gain one."""
    return [(np.diff(np.eye(size), 2, axis=0), np.zeros(size - 2), 0.3),
            (np.diag(np.exp(0.1 * np.arange(size))), np.zeros(size), 1.0),
            (np.ones((1, size)), np.ones(1), 1e-4)]


def _extended_ls(X: Array, y: Array, noise: float) -> tuple[Array, Array]:
    """One least-squares problem: the samples' rows, extended by those of the knowledge."""
    rows = [X / noise, *[H / sigma for H, _, sigma in _knowledge(X.shape[1])]]
    rhs = [y / noise, *[z / sigma for _, z, sigma in _knowledge(X.shape[1])]]
    W = np.concatenate(rows)
    g = np.linalg.lstsq(W, np.concatenate(rhs), rcond=None)[0]
    return np.asarray(g), np.sqrt(np.diag(np.linalg.inv(W.T @ W)))


def _information_filter(X: Array, y: Array, noise: float) -> tuple[Array, Array]:
    """The filter takes the knowledge first, then the samples one by one as they come."""
    estimate = InformationFilter(X.shape[1])
    for H, z, sigma in _knowledge(X.shape[1]):
        estimate.update(H, z, sigma)
    for x, value in zip(X, y, strict=True):
        estimate.update(x[None], np.array([value]), noise)
    return estimate.solve(), np.sqrt(np.diag(np.linalg.inv(estimate.matrix)))


def _relative_degree(X: Array, y: Array, noise: float) -> int:
    """The largest number of leading coefficients that may be zero without the weighted error growing clearly.

    Data and knowledge count together: forcing too many to zero lets the rest go wild, which costs as much as a misfit.
    """
    costs = []
    for m_d in range(min(_LONGEST_DEGREE, X.shape[1] - 3)):
        g, _ = _extended_ls(X[:, m_d:], y, noise)
        cost = float(np.sum(((y - X[:, m_d:] @ g) / noise) ** 2))
        costs.append(cost + sum(float(np.sum(((z - H @ g) / s) ** 2)) for H, z, s in _knowledge(len(g))))
    best = min(costs)
    return max(m_d for m_d, cost in enumerate(costs) if cost < best + 4.0)
