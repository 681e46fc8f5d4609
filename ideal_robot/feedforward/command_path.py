"""Inverse of the command path: commands for which the position loop receives a desired signal.

Delay, linear interpolation, command low-pass and the position loop's gain and feedforward are linear, so the commands
over the horizon are one regularised least-squares problem with a fixed matrix. Only the first command is used; earlier
commands enter as the free response. Systems whose low-pass is not minimum phase are no special case.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from ideal_robot.arrays import Array
from ideal_robot.loop.loop import Cascade, Loop


@dataclass(frozen=True)
class CommandPathInverse:
    """Gains that give the first command from the desired signal and past commands.

    ``wanted (n, m s)`` are the gains of the signal ``k_v r + k_ff ṙ + k_a r̈`` at the position cycles of the ``m`` next
    interpolation cycles in which the command can act, ``past (n, P)`` those of the commands before, oldest first.
    """

    wanted: Array
    past: Array

    @property
    def n_past(self) -> int:
        """Number of past commands that are needed."""
        return self.past.shape[1]


_SMOOTHNESS = 0.02
"""Weight of the commands' second differences against a position error of the same size: keeps the inverse of the
low-pass from amplifying what the interpolation cannot pass anyway."""


def command_path_inverse(loop: Loop, cycles: int) -> CommandPathInverse:
    """Computes the gains for the first of ``cycles`` commands by one least-squares problem for all of them."""
    s, n = loop.steps_ipo, loop.n
    taps, cascade = loop.path.command_filter, loop.cascade
    # Of two lags in a row 1e-5 is left after 15 times their time constant.
    n_past = int(np.ceil((len(taps) + 15.0 * cascade.t_rate / loop.path.t_position) / s)) + 2
    knots = n_past + cycles
    # Linear interpolation: from the knots to the fine grid, which ends just before the last knot.
    fine = s * (knots - 1)
    interpolation = np.zeros((fine, knots))
    for j in range(fine):
        interpolation[j, j // s] = 1 - (j % s) / s
        interpolation[j, j // s + 1] = (j % s) / s
    wanted, past = np.zeros((n, s * cycles)), np.zeros((n, n_past))
    second = np.diff(np.eye(cycles + 2), 2, axis=0)
    for i in range(n):
        answer = np.zeros(fine)
        answer[: len(taps)] = taps[:fine, i]
        response = linalg.toeplitz(answer, np.zeros(fine))
        # Before the oldest knot the command is assumed constant.
        response[:, 0] += 1.0 - response.sum(axis=1)
        position = response @ interpolation
        signal = position_loop_signal(cascade, i, position, loop.path.t_position)[-s * cycles :] / cascade.k_v[i]
        free, forced, weight = signal[:, :n_past], signal[:, n_past:], _SMOOTHNESS * np.sqrt(s)
        first = np.linalg.pinv(np.vstack([forced, weight * second[:, 2:]]))[0]
        wanted[i] = first[: s * cycles] / cascade.k_v[i]
        past[i] = -first[: s * cycles] @ free
        past[i, -2:] -= first[s * cycles :] @ (weight * second[:, :2])
    return CommandPathInverse(wanted, past)


def position_loop_signal(cascade: Cascade, i: int, r: Array, t_position: float) -> Array:
    """Output of the position loop for its reference, ``k_v r + k_ff ṙ + k_a r̈``, at rest before ``(N, k)`` [rad/s].

    Args:
        cascade, i: of all joints, and which of them, from 0.
        r: references in columns ``(N, k)`` [rad].
        t_position: the loop's cycle [s].
    """
    signal, rate = cascade.k_v[i] * r, r
    passed = -np.expm1(-t_position / cascade.t_rate) if cascade.t_rate > 0.0 else 1.0
    for gain in (cascade.k_ff[i], cascade.k_a[i]):
        rate = passed / t_position * np.diff(rate, axis=0, prepend=rate[:1])
        for row in range(1, len(rate)):
            rate[row] += (1.0 - passed) * rate[row - 1]
        signal = signal + gain * rate
    return np.asarray(signal)
