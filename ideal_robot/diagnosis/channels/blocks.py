"""Blocks of time of a recording, and groups of columns for some of its channels."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ideal_robot.arrays import Array


@dataclass(frozen=True)
class Blocks:
    """Consecutive intervals of time.

    Attributes:
        edges: first sample of each block and the end ``(B + 1,)``.
    """

    edges: tuple[int, ...]

    @property
    def count(self) -> int:
        """Number of blocks."""
        return len(self.edges) - 1

    @cached_property
    def of_samples(self) -> np.ndarray:
        """Block of each sample ``(N,)``."""
        return np.repeat(np.arange(self.count), np.diff(self.edges))

    def cut(self, values: Array) -> Array:
        """Rows ``(N, …)`` block by block ``(B, L, …)``; a shorter block ends with zeros."""
        first, end = np.array(self.edges[:-1])[:, None], np.array(self.edges[1:])[:, None]
        rows = first + np.arange(int(np.max(end - first)))
        of_blocks = values[np.minimum(rows, len(values) - 1)]
        of_blocks[rows >= end] = 0.0
        return of_blocks


def time_blocks(samples: int, most: int, fewest_rows: int) -> Blocks:
    """Cuts a recording into blocks of time.

    Args:
        samples: number of samples.
        most: blocks, at most.
        fewest_rows: of a block, at least.
    """
    count = int(np.clip(samples // fewest_rows, 2, most))
    return Blocks(tuple(int(e) for e in np.linspace(0, samples, count + 1).astype(int)))


@dataclass(frozen=True, eq=False)
class Columns:
    """Columns that are zero outside some channels.

    Attributes:
        values: ``(N, k, m)``: ``m`` columns on ``k`` channels.
        channels: numbers of the channels, ascending, from 0.
    """

    values: Array
    channels: tuple[int, ...]

    @property
    def m(self) -> int:
        """Number of columns."""
        return int(self.values.shape[2])
