"""Blocks of time: on which of them is selected, and on which is reported."""

from __future__ import annotations

import copy
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ideal_robot.arrays import Array


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

    @property
    def selecting(self) -> np.ndarray:
        """Which blocks select and estimate, not only report ``(B,)``."""
        return np.asarray(self.fold >= 0)

    def without_folds(self) -> Blocks:
        """The same blocks, all of which estimate and none of which is left out in turn."""
        return replace(self, fold=np.zeros(self.count, dtype=int), folds=0)

    def of_samples(self) -> np.ndarray:
        """Block of each sample ``(N,)``."""
        return np.repeat(np.arange(self.count), np.diff(self.edges))


def time_blocks(samples: int, dt: float, held_out: bool) -> Blocks:
    """Cuts a recording into about 32 blocks of time, of half a second at least.

    Args:
        samples: how many there are.
        dt: between them [s].
        held_out: whether every fourth block only reports.
    """
    count = int(np.clip(samples * dt / 0.5, 8, 32))
    edges = np.linspace(0, samples, count + 1).astype(int)
    return numbered_blocks(tuple(int(e) for e in edges), held_out, 6 if held_out else 8)


def numbered_blocks(edges: tuple[int, ...], held_out: bool, folds: int) -> Blocks:
    """Blocks between edges, their folds numbered through so that each is spread over the whole recording.

    Args:
        edges: first sample of each block, and the end.
        held_out: whether every fourth block only reports.
        folds: how many.
    """
    number = np.arange(len(edges) - 1)
    selecting = number % 4 != 2 if held_out else number >= 0
    fold = np.where(selecting, (np.cumsum(selecting) - 1) % folds, -1)
    return Blocks(edges, fold, int(fold.max()) + 1)


# Cross-products of columns, block by block in time: all fits, folds and tests are made from these small matrices.
#
# The rows of a recording (samples × channels) are many, the columns few. With ``X_b`` the rows of a block ``b`` every
# least-squares fit on some blocks and its error on others is a function of ``X_b' X_b``; so the rows are touched once.

@dataclass(frozen=True)
class Columns:
    """Columns that are zero outside some channels.

    Attributes:
        values: ``(N, k, m)``: ``m`` columns on ``k`` channels.
        channels: which channels these are, ascending, from 0.
        alike: whether the columns are pieces of one curve, in one unit.
        own: of each column's squares the share ``(m,)`` that is not of the form of the model's own parameters; None
            where all of it may be the columns' own.
        in_blocks: of channels that were asked for, which columns act there, and their values block by block.
    """

    values: Array
    channels: tuple[int, ...]
    alike: bool = False
    own: Array | None = None
    in_blocks: dict[int, tuple[np.ndarray, Array]] = field(default_factory=dict, compare=False, repr=False)

    @property
    def m(self) -> int:
        """Number of columns."""
        return int(self.values.shape[2])

    def without(self, form: Columns) -> Array:
        """What of the columns ``(N, k, m)`` those of ``form``, on the same channels, cannot make."""
        own, theirs = (one.values.reshape(-1, one.m) for one in (self, form))
        return np.asarray(own - theirs @ np.linalg.lstsq(theirs, own, rcond=None)[0]).reshape(self.values.shape)


class BlockProducts:
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
        self.count = np.add.reduceat(use.astype(float), blocks.edges[:-1], axis=0)

    def in_folds_of(self, blocks: Blocks) -> BlockProducts:
        """The same rows in blocks with the same edges and other folds."""
        made = copy.copy(self)
        made.blocks = blocks
        return made

    @cached_property
    def of_rows(self) -> dict[str, dict[str, Array]]:
        """Cross-products of ``W`` and ``y``, which are in every fit."""
        across = self.cross(self.W, self.y)
        return {"W": {"W": self.cross(self.W, self.W), "y": across},
                "y": {"W": np.swapaxes(across, 2, 3), "y": self.cross(self.y, self.y)}}

    def cross(self, a: Columns, b: Columns) -> Array:
        """``a_b' b_b`` for each block and channel, ``(B, c, m_a, m_b)``."""
        result = np.zeros((self.blocks.count, self.c, a.m, b.m))
        for j in set(a.channels) & set(b.channels):
            (ours, left), (theirs, right) = self._in_blocks(a, j), self._in_blocks(b, j)
            result[:, j, ours[:, None], theirs] = np.swapaxes(left, 1, 2) @ right
        return result

    def _in_blocks(self, columns: Columns, j: int) -> tuple[np.ndarray, Array]:
        """Which columns act on one channel, and their rows block by block ``(B, L, m)``.

        A shorter block ends with zeros. Of the model's parameters a joint feels those of the links behind it.
        """
        if j not in columns.in_blocks:
            values = columns.values[:, columns.channels.index(j)]
            acting = np.flatnonzero(values.any(axis=0))
            first, end = np.array(self.blocks.edges[:-1])[:, None], np.array(self.blocks.edges[1:])[:, None]
            rows = first + np.arange(int(np.max(end - first)))
            of_blocks = values[np.minimum(rows, len(values) - 1)[:, :, None], acting]
            columns.in_blocks[j] = acting, np.where((rows < end)[:, :, None], of_blocks, 0.0)
        return columns.in_blocks[j]
