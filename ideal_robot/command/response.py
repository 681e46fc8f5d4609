"""Response of a position to its command while all joints move, and the motion that follows a commanded path.

A law gives the commands of a motion. Its inverse is the closed loop: with ``P(jω)`` the response of a joint's command
to its own position, from a pulse along a motion without a reversal, ``1/P`` is that of the position to its command.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ideal_robot.arrays import Array, held

Required = Callable[[Array], Array]
"""Commands ``(N, n)`` [rad] that make a motion ``(N, n)`` [rad], whatever it rests with at the start."""

REST = 1.5
"""Rest before and behind a path that its error is looked for with, and the length of a pulse's answer [s]: several
times as long as controllers remember."""
WIDTH, PULSE = 1.5, 0.2
"""Of the pulse: its standard deviation in cycles, since narrower ones splines through a path do not follow, and its
largest speed over the joint's, so that none reverses and no friction turns."""
_BAND = 0.15
"""Frequency up to which the response is used, over the commands' own: beyond a fifth splines do not follow."""
_LARGEST = 2.0
"""Of the response of position to command: a resonance of a quarter of critical damping."""
_ROUNDS = 30
"""Newton's steps at most."""
_DONE = 1e-3
"""Share of the error that the last step may have."""


def pulse_answers(required: Required, middle: Array, speed: Array, dt: float, steps: Array) -> tuple[Array, Array]:
    """A pulse ``(N,)``, and each joint's change of commands for a pulse of its position while all move ``(N, n)``.

    Args:
        required: see ``Required``.
        middle, speed: posture ``(n,)`` [rad] and speeds ``(n,)`` [rad/s] of the motion on which the pulse is given.
        dt, steps: distance of rows [s], and the rows, with 0 where the pulse is ``(N,)``.
    """
    line, pulse = middle + steps[:, None] * dt * speed, np.exp(-0.5 * (steps / WIDTH) ** 2)
    unchanged, answers = required(line), np.empty_like(line)
    for j in range(len(middle)):
        # The pulse's largest slope is e^(-1/2) times its height over its width.
        size, changed = PULSE * float(speed[j]) * dt * WIDTH * np.exp(0.5), line.copy()
        changed[:, j] += size * pulse
        answers[:, j] = (required(changed) - unchanged)[:, j] / size
    return pulse, answers


def position_response(required: Required, middle: Array, speed: Array, dt: float, rows: int) -> Array:
    """Response of each joint's position to its command ``(rows // 2 + 1, n)``, at the frequencies of ``rfft``.

    It is at most ``_LARGEST``, and fades out towards the frequencies that rows do not resolve.

    Args:
        required: see ``Required``.
        middle, speed: posture ``(n,)`` [rad] and speeds ``(n,)`` [rad/s] of the motion on which a pulse is given.
        dt, rows: distance of rows [s], and how many there are.
    """
    count = min(rows, round(REST / dt))
    pulse, answers = pulse_answers(required, middle, speed, dt, np.arange(float(count)) - 0.5 * count)
    own, band = np.fft.rfft(pulse, rows), np.exp(-0.5 * (np.fft.rfftfreq(rows) / _BAND) ** 4)
    # The band is zero where the pulse's spectrum is.
    P = np.fft.rfft(answers, rows, axis=0) / np.where(band > _DONE, own, 1.0)[:, None]
    return np.asarray(band[:, None] * np.conj(P) / np.maximum(np.abs(P), 1.0 / _LARGEST) ** 2)


def uncorrected(required: Required, q_d: Array, dt: float, still: Array) -> Array:
    """Error ``q_d - q (N, n)`` [rad] if a path is commanded without correction.

    The motion ``q`` is computed whose commands are the path, by Newton's steps with each joint's own response, ``e ← e
    + (required(q_d - e) - q_d) / P``. The iterations are needed for friction, gravity and the other joints.

    Args:
        required: see ``Required``.
        q_d, dt: path ``(N, n)`` [rad], and the distance of its rows [s].
        still: speed below which a joint is treated as reversing ``(n,)`` [rad/s].
    """
    rest = round(REST / dt)
    path = held(q_d, before=rest, after=rest)
    speed = np.maximum(np.std(np.gradient(q_d, dt, axis=0), axis=0), 10.0 * still)
    # The taper keeps an end at another place than the start from wrapping around to the start.
    taper = np.minimum(1.0, np.arange(len(path))[::-1] / rest)[:, None]
    inverse = position_response(required, np.mean(q_d, axis=0), speed, dt, len(path))

    def step(error: Array) -> Array:
        missing = taper * (required(path - error) - path)
        return np.asarray(np.fft.irfft(np.fft.rfft(missing, axis=0) * inverse, len(path), axis=0))

    error = np.zeros_like(path)
    more, share = step(error), 1.0
    for _ in range(_ROUNDS):
        tried = error + share * more
        after = step(tried)
        if float(np.std(after)) < float(np.std(more)):
            error, more = tried, after
        else:
            share *= 0.5
        if float(np.std(more)) <= _DONE * float(np.std(error)):
            break
    return np.asarray(error[rest : rest + len(q_d)])
