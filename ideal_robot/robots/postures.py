"""Postures all over an arm's range, the same ones every time."""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array


def spread_postures(q_min: Array, q_max: Array, count: int = 128) -> Array:
    """Halton points ``(count, n)`` between the limits; of joints that turn further, half a turn to either side.

    Args:
        q_min: lower position limits ``(n,)`` [rad or m].
        q_max: upper position limits ``(n,)`` [rad or m].
        count: how many.
    """
    low, high = np.clip(q_min, -np.pi, np.pi), np.clip(q_max, -np.pi, np.pi)
    spread = np.column_stack([_radical_inverse(count, base) for base in _primes(len(low))])
    return np.asarray(low + spread * (high - low))


def _radical_inverse(count: int, base: int) -> Array:
    """The numbers from 0 on, their digits in a base written behind the point ``(count,)``."""
    left, digit, found = np.arange(count), 1.0 / base, np.zeros(count)
    while left.any():
        found += (left % base) * digit
        left, digit = left // base, digit / base
    return found


def _primes(count: int) -> list[int]:
    found: list[int] = []
    candidate = 2
    while len(found) < count:
        if all(candidate % prime for prime in found):
            found.append(candidate)
        candidate += 1
    return found
