"""The motion for training and adaptation: about a path, but different from it."""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array, eased, held

REST_BEFORE, REST_AFTER = 0.9, 0.6
"""How long the arm rests at the start and at the end of the motion [s]."""


def training_motion(path: Array, t_ipo: float) -> Array:
    """Smooth joint motion ``(M, n)`` [rad] about a path ``(N, n)`` [rad], as fast as it: [G]'s training motion.

    Sinusoids of different frequencies and phases per joint about the path's middle, with amplitudes of the path's own
    range (at least 3°), faded in and out; rest before and behind.
    """
    low, high = path.min(axis=0), path.max(axis=0)
    amplitude = np.maximum(0.5 * (high - low), np.radians(3.0))
    speed = np.maximum(np.max(np.abs(np.diff(path, axis=0)), axis=0) / t_ipo, 0.1)
    length = 8.0
    t = np.arange(0.0, length, t_ipo)
    fade = eased(np.clip(np.minimum(t, length - t) / 1.0, 0.0, 1.0))
    rate = np.clip(speed / amplitude, 1.0, 2 * np.pi * 0.8)
    phase = 2.4 * np.arange(path.shape[1])
    waves = 0.7 * np.sin(np.outer(t, rate * 0.55) + phase) + 0.45 * np.sin(np.outer(t, rate * 1.25) + 1.7 * phase)
    q = 0.5 * (low + high) + 0.8 * amplitude * fade[:, None] * waves
    return held(q, before=round(REST_BEFORE / t_ipo), after=round(REST_AFTER / t_ipo))
