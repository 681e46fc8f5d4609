"""Impulse responses of the joints' closed loops from recordings with commands, [G] (7)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.identification.loop_recordings import commanded, in_cycle, require_loop
from ideal_robot.loop.impulse_response import LinearLoop
from ideal_robot.signals.recording import Recording
from ideal_robot.signals.sampling import gap_free

_LAGS = 25
"""Longest lag m of an impulse response, 0.3 s at 12 ms: "the first few g(l) are sufficient" ([G] 3.2)."""
_LONGEST_DEGREE = 8
"""Cycles of dead time at most: 0.1 s at 12 ms."""


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


def identify_linear_loop(recordings: Sequence[Recording], t_cycle: float) -> LinearLoopFit:
    """Identifies each joint's impulse response, ``q(k) = Σ g(l) q_d(k - l)`` with ``l = m_d … m``, [G] (7).

    The relative degree ``m_d`` is found from the data. Sinusoids excite few frequencies, and friction leaves residuals
    that no linear response explains: plain least squares fits wild coefficients to them. So the least squares have a
    prior: the response is smooth, decays and has static gain one.

    Recordings have ``q_c_i`` (or ``q_d_i``) and ``q_i`` and start at rest; ``t_cycle`` [s] is the interpolation cycle.
    Raises InputError for missing commands, unsuitable sampling, too short recordings, a joint that does not move.
    """
    require_loop(recordings)
    data = [part for r in recordings for part in _sampled(r, t_cycle)]
    n = recordings[0].n
    g, std, error, degree = np.zeros((_LAGS + 1, n)), np.zeros((_LAGS + 1, n)), np.empty(n), []
    if not data:
        raise InputError(f"the recording is too short: the closed loop needs more than {_LAGS} cycles of "
                         f"{1e3 * t_cycle:g} ms without a gap", file=recordings[0].source, field="t")
    for j in range(n):
        X, y = _rows([(q_d[:, j], q[:, j]) for q_d, q in data])
        if len(y) < 3 * _LAGS or np.std(y) < 1e-4:
            raise InputError("the joint hardly moves, or the recording is too short for this many lags",
                             file=recordings[0].source, field=f"q_{j + 1}")
        noise = _noise(X, y)
        m_d = _relative_degree(X, y, noise)
        degree.append(m_d)
        g[m_d:, j], std[m_d:, j] = _extended_ls(X[:, m_d:], y, noise)
        error[j] = 100.0 * float(np.linalg.norm(y - X @ g[:, j]) / np.linalg.norm(y))
    return LinearLoopFit(LinearLoop(g, t_cycle), tuple(degree), std, error)


def _sampled(recording: Recording, t_cycle: float) -> list[tuple[Array, Array]]:
    """Commands and positions ``(N, n)`` of each stretch without a gap, both about where the recording starts.

    A stretch that is shorter than the response has no row of it and is left out.
    """
    _, every = in_cycle(recording, t_cycle)
    name = commanded(recording)
    start = recording.joints(name, slice(1)), recording.joints("q", slice(1))
    return [(part.joints(name)[::every] - start[0], part.joints("q")[::every] - start[1])
            for part in gap_free(recording, (name, "q"), _LAGS * every + 1)]


def _rows(series: Sequence[tuple[Array, Array]]) -> tuple[Array, Array]:
    """Delayed commands ``(N, _LAGS + 1)`` and positions ``(N,)``."""
    X = [np.stack([q_d[_LAGS - lag: len(q_d) - lag] for lag in range(_LAGS + 1)], axis=1) for q_d, _ in series]
    return np.concatenate(X), np.concatenate([q[_LAGS:] for _, q in series])


def _noise(X: Array, y: Array) -> float:
    """Standard deviation of a sample's noise, enlarged for correlated residuals, which carry less information."""
    A = X.T @ X
    g = np.linalg.solve(A + 1e-9 * np.trace(A) * np.eye(len(A)), X.T @ y)
    e = y - X @ g
    power = np.correlate(e, e, "full")[len(e) - 1: len(e) + 199]
    correlated = 1.0 + 2.0 * float(np.sum(np.maximum(power[1:] / power[0], 0.0)))
    return float(np.std(e) * np.sqrt(correlated)) + 1e-9


def _knowledge(size: int) -> list[tuple[Array, Array, float]]:
    """The prior of an impulse response as measurements ``(H, z, σ)``: smooth, dying out, static gain one."""
    return [(np.diff(np.eye(size), 2, axis=0), np.zeros(size - 2), 0.3),
            (np.diag(np.exp(0.1 * np.arange(size))), np.zeros(size), 1.0),
            (np.ones((1, size)), np.ones(1), 1e-4)]


def _extended_ls(X: Array, y: Array, noise: float) -> tuple[Array, Array]:
    """One least-squares problem: the samples' rows, extended by those of the knowledge."""
    known = _knowledge(X.shape[1])
    W = np.concatenate([X / noise, *[H / sigma for H, _, sigma in known]])
    g = np.linalg.lstsq(W, np.concatenate([y / noise, *[z / sigma for _, z, sigma in known]]), rcond=None)[0]
    return np.asarray(g), np.sqrt(np.diag(np.linalg.inv(W.T @ W)))


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
