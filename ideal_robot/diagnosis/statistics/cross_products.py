"""Cross-products of columns, block by block in time: all fits, folds and tests are made from these small matrices.

The rows of a recording (samples × channels) are many, the columns few. With ``X_b`` the rows of a block ``b`` every
least-squares fit on some blocks and its error on others is a function of ``X_b' X_b``; so the rows are touched once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ideal_robot.arrays import Array


@dataclass(frozen=True)
class Columns:
    """Columns that are zero outside some channels.

    Attributes:
        values: ``(N, k, m)``: ``m`` columns on ``k`` channels.
        channels: which channels these are, ascending, from 0.
    """

    values: Array
    channels: tuple[int, ...]

    @property
    def m(self) -> int:
        """Number of columns."""
        return int(self.values.shape[2])


@dataclass(frozen=True)
class Blocks:
    """Consecutive stretches of time and what they are used for.

    Attributes:
        edges: first sample of each block and the end ``(B + 1,)``.
        fold: fold of each block, from 0; -1 for blocks that only the report sees.
        folds: number of folds.
    """

    edges: tuple[int, ...]
    fold: np.ndarray
    folds: int

    @property
    def count(self) -> int:
        """Number of blocks."""
        return len(self.edges) - 1

    def of_samples(self) -> np.ndarray:
        """Block of each sample ``(N,)``."""
        return np.repeat(np.arange(self.count), np.diff(self.edges))


def time_blocks(samples: int, dt: float, held_out: bool) -> Blocks:
    """Cuts ``samples`` into about 32 blocks, of half a second at least; every fourth is held out if asked for."""
    count = int(np.clip(samples * dt / 0.5, 8, 32))
    edges = np.linspace(0, samples, count + 1).astype(int)
    number = np.arange(count)
    # Fold numbers run through the blocks, so that each fold is spread over the whole recording.
    if held_out:
        selecting = number % 4 != 2
        fold = np.full(count, -1)
        fold[selecting] = np.arange(int(selecting.sum())) % 6
    else:
        fold = number % 8
    return Blocks(tuple(int(e) for e in edges), fold, int(fold.max()) + 1)


class Data:
    """The rows of a recording, ready for cross-products.

    Args:
        y: ``(N, c)``.
        W: ``(N, c, p)``.
        use: samples that count ``(N, c)``.
        blocks: of the ``N`` samples.
    """

    def __init__(self, y: Array, W: Array, use: np.ndarray, blocks: Blocks) -> None:
        self.blocks = blocks
        self.use = use
        self.c = y.shape[1]
        everywhere = tuple(range(self.c))
        self.W = Columns(W * use[:, :, None], everywhere)
        self.y = Columns((y * use)[:, :, None], everywhere)
        self.count = np.array([[float(use[a:b, j].sum()) for j in range(self.c)]
                               for a, b in zip(blocks.edges[:-1], blocks.edges[1:], strict=True)])

    def masked(self, columns: Array) -> Columns:
        """Columns ``(N, c, m)`` with unused samples set to zero and empty channels dropped."""
        channels = tuple(int(j) for j in np.flatnonzero(np.any(columns != 0.0, axis=(0, 2))))
        kept = columns[:, list(channels)] * self.use[:, list(channels), None]
        return Columns(np.ascontiguousarray(kept), channels)

    def cross(self, a: Columns, b: Columns) -> Array:
        """``a_b' b_b`` for each block and channel, ``(B, c, m_a, m_b)``."""
        result = np.zeros((self.blocks.count, self.c, a.m, b.m))
        edges = self.blocks.edges
        for j in set(a.channels) & set(b.channels):
            left, right = a.values[:, a.channels.index(j)], b.values[:, b.channels.index(j)]
            for k in range(self.blocks.count):
                rows = slice(edges[k], edges[k + 1])
                result[k, j] = left[rows].T @ right[rows]
        return result
