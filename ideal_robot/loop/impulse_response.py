"""Linear decoupled model of each joint's closed loop: its impulse response, [G] (7).

    q_i(k) = Σ_l g_i(l) q_d,i(k - l) ,   l = m_d … m

Everything the linear methods do — predicting, inverting, learning — works with the response as a matrix.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.loop.loop import Loop
from ideal_robot.loop.simulation import simulate


class Measurement(NamedTuple):
    """``z = H x + noise``: matrix ``H (r, size)``, values ``z (r,)``, and the noise's standard deviation."""

    H: Array
    z: Array
    sigma: float


def least_squares(*measurements: Measurement) -> Array:
    """The most likely unknowns ``x (size,)``; of smallest norm where measurements do not determine them.

    A prior is a measurement like any other.
    """
    rows = np.concatenate([one.H / one.sigma for one in measurements])
    return np.asarray(np.linalg.lstsq(rows, np.concatenate([one.z / one.sigma for one in measurements]), rcond=None)[0])


@dataclass(frozen=True)
class LinearLoop:
    """Impulse responses of ``n`` decoupled joints at the interpolation cycle [s].

    Row ``l`` of ``g (m + 1, n)`` is the response ``l`` cycles after the command.
    """

    g: Array
    t_ipo: float

    def __post_init__(self) -> None:
        if self.g.ndim != 2 or not np.all(np.isfinite(self.g)):
            raise InputError("expected finite impulse responses (m + 1, n)", field="g", value=self.g.shape)
        self.g.setflags(write=False)

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.g.shape[1])

    def predict(self, q_c: Array) -> Array:
        """Response ``(N, n)`` [rad] to the commands ``q_c (N, n)``, at rest at ``q_c[0]`` before, [G] (7).

        The static gain of the response is used as it is, so the result shows a response that does not sum to 1.
        """
        moved = q_c - q_c[0]
        return np.column_stack([np.convolve(moved[:, i], self.g[:, i])[: len(q_c)] for i in range(self.n)]) + q_c[0]

    def matrix(self, joint: int, rows: int, columns: int) -> Array:
        """Matrix ``G (rows, columns)`` of [G] (11): from commands to responses, both from cycle 0 on.

        Args:
            joint: from 0.
            rows, columns: cycles of the answer and of the command.
        """
        lag = np.arange(rows)[:, None] - np.arange(columns)[None, :]
        inside = (lag >= 0) & (lag < len(self.g))
        return np.where(inside, self.g[np.clip(lag, 0, len(self.g) - 1), joint], 0.0)

    @classmethod
    def of(cls, loop: Loop, q: Array, length: int = 40, step: float = 2e-3) -> LinearLoop:
        """Linearises the identified loop at ``q``: response of the arm to a small step.

        Args:
            loop, q: the identified loop, and the working point ``(n,)`` [rad].
            length: cycles after which the response has ended.
            step: size of the step [rad].
        """
        # Friction, ripple, backlash and transmission errors are left out: linearised at a point they would act as
        # springs.
        none, friction = np.zeros((0, 3, loop.n)), loop.friction
        smooth = loop.changed(sizes=np.zeros_like(friction.sizes), per_load=np.zeros_like(friction.per_load),
                              ripple=none, uneven=none, half_gap=np.zeros(loop.n), terms=())
        rest = np.tile(np.asarray(q, dtype=float), (length + 2, 1))
        still = simulate(smooth, rest).q_a
        g = np.empty((length + 1, loop.n))
        for i in range(loop.n):
            moved = rest.copy()
            moved[1:, i] += step
            g[:, i] = np.diff((simulate(smooth, moved).q_a - still)[:, i])[: length + 1] / step
        return cls(g / g.sum(axis=0), loop.t_ipo)

    @classmethod
    def identify(cls, q_c: Array, q: Array, t_ipo: float, *, delay: int = 1, length: int = 25,
                 prior: float = 1e-3) -> LinearLoop:
        """Estimates the responses from one motion by least squares ([G] 3.2).

        Args:
            q_c: commands ``(N, n)`` [rad], handed over at ``t_k``.
            q: answers at the same instants ``(N, n)`` [rad], motor or arm side.
            t_ipo: the cycle [s].
            delay: relative degree ``m_d``: cycles before which nothing answers.
            length: last cycle ``m`` of the response.
            prior: standard deviation of the response [rad] at which data and prior (a response that is smooth and sums
                to 1) have equal weight.

        Raises:
            InputError: a joint does not move, or there are fewer samples than coefficients.
        """
        N, n = q.shape
        if length + 1 >= N:
            raise InputError(f"needs more than {length + 1} cycles", field="q_c", value=N)
        g = np.zeros((length + 1, n))
        count = length + 1 - delay
        second = np.diff(np.eye(count), 2, axis=0)
        for i in range(n):
            moved, answer = q_c[:, i] - q_c[0, i], q[:, i] - q[0, i]
            if np.ptp(moved) < 1e-3:
                raise InputError("the joint hardly moves; give it a sinusoid of some degrees", field=f"q_c_{i + 1}")
            padded = np.concatenate([np.zeros(length), moved])
            rows = np.column_stack([padded[length - lag : length - lag + N] for lag in range(delay, length + 1)])
            g[delay:, i] = least_squares(
                Measurement(second, np.zeros(len(second)), prior * np.sqrt(N)),
                Measurement(np.ones((1, count)), np.ones(1), 1e-6), Measurement(rows, answer, prior))
        return cls(g / g.sum(axis=0), t_ipo)
