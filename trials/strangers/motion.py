"""Motions for the trials: Fourier series, strokes, and production-like cycles with rests."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ideal_robot.arrays import Array
from trials.strangers.arm import Arm

STEP = 0.0005
"""Time step of all engines [s]."""
KINDS = ("fourier", "strokes", "cycles")


@dataclass(frozen=True)
class Motion:
    """Desired motion of the arm, every ``STEP``.

    Attributes:
        kind: one of ``KINDS``.
        t: time ``(N,)`` [s].
        q, qd, qdd: desired position, velocity and acceleration ``(N, n)``.
    """

    kind: str
    t: Array
    q: Array
    qd: Array
    qdd: Array


def draw_motion(rng: np.random.Generator, arm: Arm, seconds: float, kind: str | None = None) -> Motion:
    """Draws a motion that starts at rest.

    Args:
        rng: source of the draw.
        arm: gives range, velocities and accelerations.
        seconds: how long.
        kind: one of ``KINDS``; drawn if None.
    """
    kind = str(rng.choice(KINDS)) if kind is None else kind
    t = np.arange(round(seconds / STEP)) * STEP
    make = {"fourier": _fourier, "strokes": _strokes, "cycles": _cycles}[kind]
    q = make(rng, arm, t)
    qd = np.gradient(q, STEP, axis=0)
    return Motion(kind, t, q, qd, np.gradient(qd, STEP, axis=0))


def _fourier(rng: np.random.Generator, arm: Arm, t: Array) -> Array:
    base = 2.0 * np.pi / float(rng.choice([8.0, 10.0, 15.0]))
    x = np.zeros((len(t), arm.n))
    for j in range(arm.n):
        for k in range(1, int(rng.integers(4, 9)) + 1):
            a, b = rng.normal(size=2) / k**0.7
            x[:, j] += a * np.cos(k * base * t) + b * np.sin(k * base * t)
    v, a = np.gradient(x, STEP, axis=0), np.gradient(np.gradient(x, STEP, axis=0), STEP, axis=0)
    size = np.minimum.reduce([0.5 * (arm.high - arm.low) / np.max(np.abs(x), axis=0),
                              arm.fast / np.max(np.abs(v), axis=0), arm.quick / np.max(np.abs(a), axis=0)])
    s = np.clip(t / 1.5, 0.0, 1.0)[:, None]
    return 0.5 * (arm.high + arm.low) + x * size * (10 * s**3 - 15 * s**4 + 6 * s**5)


def _strokes(rng: np.random.Generator, arm: Arm, t: Array) -> Array:
    """Septic polynomials between random points, each joint at its own pace."""
    q = np.zeros((len(t), arm.n))
    for j in range(arm.n):
        at, here = 0.0, 0.5 * (arm.low[j] + arm.high[j])
        while at < t[-1]:
            there = float(rng.uniform(arm.low[j], arm.high[j]))
            # Peak velocity of the septic is 2.19 d/T, peak acceleration 7.52 d/T².
            T = max(2.19 * abs(there - here) / (arm.fast[j] * rng.uniform(0.3, 1.0)),
                    float(np.sqrt(7.52 * abs(there - here) / arm.quick[j])), 0.3)
            s = np.clip((t - at) / T, 0.0, 1.0)
            rows = t >= at
            q[rows, j] = (here + (there - here) * (35 * s**4 - 84 * s**5 + 70 * s**6 - 20 * s**7))[rows]
            at, here = at + T, there
    return q


def _cycles(rng: np.random.Generator, arm: Arm, t: Array) -> Array:
    """A job of a few points, repeated: all joints together, at times slower, with rests; some points lie close by."""
    count = int(rng.integers(5, 9))
    points = [0.5 * (arm.low + arm.high)]
    for _ in range(count):
        if rng.random() < 0.35:
            near = points[-1] + 0.1 * (arm.high - arm.low) * rng.uniform(-1, 1, arm.n)
            points.append(np.clip(near, arm.low, arm.high))
        else:
            points.append(rng.uniform(arm.low, arm.high))
    points.append(points[0])
    override = rng.choice([1.0, 1.0, 0.6, 0.3], size=count + 1)
    rests = rng.choice([0.0, 0.1, 0.3, 1.0], size=count + 1)
    q = np.tile(points[0], (len(t), 1))
    at = 0.3
    while at < t[-1]:
        for start, end, share, rest in zip(points[:-1], points[1:], override, rests, strict=True):
            step = np.abs(end - start)
            T = max(float(np.max(1.5 * step / (arm.fast * share))), float(np.max(np.sqrt(9.0 * step / arm.quick))),
                    0.25)
            first = int(np.searchsorted(t, at))
            s = np.clip((t[first:] - at) / T, 0.0, 1.0)[:, None]
            # Acceleration rises and falls like sin², over the first and last third, between them constant speed.
            q[first:] = start + (end - start) * _blended(s)
            at += T + rest
            if at >= t[-1]:
                break
    return q


def _blended(s: Array) -> Array:
    """Way ``0 … 1`` over time ``0 … 1``: thirds of speeding up, of steady speed (1.5), of slowing down."""
    third, peak = 1.0 / 3.0, 1.5

    def rise(u: Array) -> Array:
        x = u / third
        return peak * third * (0.5 * x**2 + (np.cos(2 * np.pi * x) - 1.0) / (4.0 * np.pi**2))

    return np.where(s < third, rise(np.minimum(s, third)),
                    np.where(s < 2 * third, 0.25 + peak * (s - third), 1.0 - rise(np.minimum(1.0 - s, third))))
