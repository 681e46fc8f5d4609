"""Blocks of time: on which of them is selected, and on which is reported."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np


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
    number = np.arange(count)
    # Fold numbers run through the blocks, so that each fold is spread over the whole recording.
    if held_out:
        selecting = number % 4 != 2
        fold = np.full(count, -1)
        fold[selecting] = np.arange(int(selecting.sum())) % 6
    else:
        fold = number % 8
    return Blocks(tuple(int(e) for e in edges), fold, int(fold.max()) + 1)
