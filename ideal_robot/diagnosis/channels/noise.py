"""Level of the measurement's own noise, from parts of the spectrum where the motion is not."""

from __future__ import annotations

import numpy as np
from scipy import signal

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.channels.regression import Regression
from ideal_robot.signals.preprocess import FilteredSignals

_FEWEST = 20
"""Differences from which a level is estimated, at least."""


def noise_above_band(filtered: FilteredSignals) -> Array:
    """Noise of the torque in the band that is looked at ``(n,)`` [N m]: the floor of its spectrum above that band."""
    rate = 1.0 / filtered.dt
    band = min(filtered.cutoff_decimation, 0.5 * rate)
    f, power = signal.welch(filtered.tau, fs=rate, nperseg=min(len(filtered.tau), 1024), axis=0)
    above = f >= 0.8 * f[-1]
    return np.sqrt(np.median(power[above], axis=0) / np.log(2.0) * band)


def noise_in_band(y: Array, torque: Regression) -> Array:
    """Noise of measured positions in the band that is looked at ``(c,)``.

    Effects follow the motion and are slow against the band's end; so the floor of the spectrum over the band's upper
    part, where only noise is left, times the whole band. Noise whose spectrum falls is underestimated by that.

    Args:
        y: residual at the decimated rows ``(N, c)``.
        torque: whose filters made them.
    """
    rate = 1.0 / (torque.filtered.dt * torque.filtered.factor)
    length = min(len(y), 256)
    f, power = signal.welch(y, fs=rate, nperseg=length, axis=0)
    # The decimation filter falls off at the very end of the band.
    upper = (f >= 0.25 * rate) & (f <= 0.42 * rate)
    # The median of an average of K periodograms lies below its mean.
    K = max(1.0, 2.0 * len(y) / length - 1.0)
    return np.asarray(np.sqrt(np.median(power[upper], axis=0) / (1.0 - 1.0 / (9.0 * K)) ** 3 * 0.5 * rate))


def noise_left(residual: Array, use: np.ndarray) -> Array:
    """What a residual ``(N, c)`` holds of white noise ``(c,)``; infinite where too few samples count.

    Its third differences, in which no motion is left, over stretches that count ``(N, c)``: never more than noise, and
    for a residual that is nothing else all of it.
    """
    third, whole = _third_differences(residual, use)
    count = whole.sum(axis=0)
    squares = (third**2 * whole).sum(axis=0) / np.maximum(count, 1)
    return np.where(count >= _FEWEST, np.sqrt(squares / 20.0), np.inf)


def usual_noise(residual: Array, use: np.ndarray) -> Array:
    """The same from the median of their sizes ``(c,)``, which kicks do not raise; zero where too few samples count.

    What changes from each sample to the next all the time depends on nothing that the motion does: encoder steps and
    jitter that a controller hands on, and oscillations at the end of the band. Above it the controller damps them, so
    that the spectrum there does not show them.
    """
    third, whole = _third_differences(residual, use)
    sizes = [np.median(np.abs(d[w])) if w.sum() >= _FEWEST else 0.0 for d, w in zip(third.T, whole.T, strict=True)]
    return np.asarray(1.4826 * np.array(sizes) / np.sqrt(20.0))


def _third_differences(residual: Array, use: np.ndarray) -> tuple[Array, np.ndarray]:
    """Third differences ``(N - 3, c)``, and where all samples of one count."""
    return np.diff(residual, 3, axis=0), use[3:] & use[2:-1] & use[1:-2] & use[:-3]
