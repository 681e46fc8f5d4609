r"""Smoothing of the sensed path x_s to the desired path x_d ([L] 4.1, Fig. 2): continuous whatever the sensors say.

The desired deviation :math:`d(t)` follows the estimated one, :math:`r(t)`, as the minimum of

.. math:: \int (d - r)^2 + \omega^{-6}\, \dddot d^{\,2} \; dt

over the horizon, from the position, velocity and acceleration that the plan has at the first instant that may still be
changed. Looking ahead, it has no delay: a wave of frequency :math:`f` passes with the gain
:math:`1/(1 + (2 \pi f/\omega)^6)`.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from ideal_robot.arrays import Array


class Smoother:
    """The minimum above, solved beforehand for several cutoff frequencies; at run time one matrix product.

    The stiffest cutoff whose plan does not correct with more than ``acceleration`` is taken: small changes of the
    estimate are followed quickly, a line that was just found is approached gently.

    Args:
        samples: length of the plan in cycles.
        t_ipo: cycle [s].
        cutoff: highest cutoff frequency [Hz]; softer ones are each a factor 1.4 below, down to 1 Hz.
        acceleration: largest one of corrections, beyond the estimate's own acceleration [m/s²].
    """

    def __init__(self, samples: int, t_ipo: float, cutoff: float = 15.0, acceleration: float = 4.0) -> None:
        self.samples, self._t, self._acceleration = samples, t_ipo, acceleration
        self._laws = _laws(samples, t_ipo, cutoff)
        self._bend_at = np.maximum(np.arange(samples - 1) - 1, 0)

    def plan(self, state: Array, estimate: Array) -> Array:
        """Positions, velocities and accelerations of the next cycles.

        Args:
            state: position, velocity and acceleration at the last instant that stays, ``(3, directions)``.
            estimate: the estimated deviation at the ``samples`` following cycles ``(samples, directions)`` [m].

        Returns:
            shape ``(3, samples, directions)`` [m, m/s, m/s²].
        """
        stacked = np.concatenate([state, estimate])
        rise = estimate[1:] - estimate[:-1]
        bend = (rise[1:] - rise[:-1])[self._bend_at] / self._t**2
        for law in self._laws:
            planned = (law @ stacked).reshape(3, self.samples, -1)
            if np.abs(planned[2, :-1] - bend).max() <= self._acceleration:
                break
        return np.asarray(planned)


@lru_cache(maxsize=8)
def _laws(samples: int, T: float, cutoff: float) -> tuple[Array, ...]:
    """Matrices ``(3 samples, 3 + samples)`` from first state and estimate to the plan, the stiffest first."""
    A = np.array([[1.0, T, 0.5 * T**2], [0.0, 1.0, T], [0.0, 0.0, 1.0]])
    B = np.array([T**3 / 6.0, T**2 / 2.0, T])
    # States after each cycle from the first state and the jerks, jerk constant over a cycle.
    free, forced = np.zeros((samples, 3, 3)), np.zeros((samples, 3, samples))
    power = np.eye(3)
    for i in range(samples):
        power = A @ power
        free[i] = power
    response = [B]
    for _ in range(samples - 1):
        response.append(A @ response[-1])
    for i in range(samples):
        for j in range(i + 1):
            forced[i, :, j] = response[i - j]
    G = forced[:, 0]
    laws = []
    frequency = cutoff
    while True:
        weight = (2.0 * np.pi * frequency) ** -6
        jerk = np.linalg.solve(G.T @ G + weight * np.eye(samples), G.T)
        # Columns: first state (3), then the estimate's samples.
        law = np.concatenate(
            [free - np.einsum("isj,jk,kl->isl", forced, jerk, free[:, 0]), np.einsum("isj,jk->isk", forced, jerk)],
            axis=2,
        )
        law = np.ascontiguousarray(law.transpose(1, 0, 2).reshape(3 * samples, 3 + samples))
        law.setflags(write=False)
        laws.append(law)
        frequency /= 1.4
        if frequency < 1.0:
            return tuple(laws)
