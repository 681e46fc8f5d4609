"""Blocks of time: on which of them is selected, and on which is reported."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any
from weakref import WeakKeyDictionary

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

    @cached_property
    def selecting_samples(self) -> np.ndarray:
        """Which samples select and estimate ``(N,)``."""
        return np.asarray(self.selecting[self.of_samples()])

    def without_folds(self) -> Blocks:
        """The same blocks, all of which estimate and none of which is left out in turn."""
        return replace(self, fold=np.zeros(self.count, dtype=int), folds=0)

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


def time_blocks(samples: int, dt: float, held_out: bool) -> Blocks:
    """Cuts a recording into about 32 blocks of time, of half a second at least.

    Args:
        samples: how many there are.
        dt: between them [s].
        held_out: whether every fourth block only reports.
    """
    count = int(np.clip(samples * dt / 0.5, 8, 32))
    number = np.arange(count)
    selecting = number % 4 != 2 if held_out else number >= 0
    # Folds are numbered through, so that each is spread over the whole recording.
    fold = np.where(selecting, (np.cumsum(selecting) - 1) % (6 if held_out else 8), -1)
    edges = np.linspace(0, samples, count + 1).astype(int)
    return Blocks(tuple(int(e) for e in edges), fold, int(fold.max()) + 1)


# Cross-products of columns, block by block in time: all fits, folds and tests are made from these small matrices.
#
# The rows of a recording (samples × channels) are many, the columns few. With ``X_b`` the rows of a block ``b`` every
# least-squares fit on some blocks and its error on others is a function of ``X_b' X_b``; so the rows are touched once.

@dataclass(frozen=True, eq=False)
class Columns:
    """Columns that are zero outside some channels.

    Attributes:
        values: ``(N, k, m)``: ``m`` columns on ``k`` channels.
        channels: which channels these are, ascending, from 0.
        alike: whether the columns are pieces of one curve, in one unit.
        own: of each column's squares the share ``(m,)`` that is not of the form of the model's own parameters; None
            where all of it may be the columns' own.
        in_blocks: of channels that were asked for, which columns act there, and their values block by block.
        products: with other columns, as far as they were asked for.
    """

    values: Array
    channels: tuple[int, ...]
    alike: bool = False
    own: Array | None = None
    in_blocks: dict[Any, tuple[np.ndarray, Array]] = field(default_factory=dict, init=False, repr=False)
    products: WeakKeyDictionary[Columns, dict[Any, Any]] = field(default_factory=WeakKeyDictionary, init=False,
                                                                 repr=False)

    @property
    def m(self) -> int:
        """Number of columns."""
        return int(self.values.shape[2])

    @classmethod
    def side_by_side(cls, parts: Sequence[Columns]) -> Columns:
        """Groups of as many columns each as one group."""
        channels = tuple(sorted({j for part in parts for j in part.channels}))
        values = np.zeros((len(parts[0].values), len(channels), sum(part.m for part in parts)))
        for i, part in enumerate(parts):
            values[:, [channels.index(j) for j in part.channels], i * part.m : (i + 1) * part.m] = part.values
        own = None if parts[0].own is None else np.concatenate([part.own for part in parts])
        return cls(values, channels, parts[0].alike, own)

    def part(self, i: int, count: int) -> Columns:
        """The ``i``-th of as many groups that stand side by side."""
        m = self.m // count
        mine = slice(i * m, (i + 1) * m)
        values, own = self.values[:, :, mine], None if self.own is None else self.own[mine]
        acting = np.flatnonzero(values.any(axis=(0, 2))) if len(self.channels) > 1 else np.arange(len(self.channels))
        return Columns(values[:, acting], tuple(self.channels[k] for k in acting), self.alike, own)

    def without(self, form: Columns) -> Array:
        """What of the columns ``(N, k, m)`` those of ``form``, on the same channels, cannot make."""
        own, theirs = (columns.values.reshape(-1, columns.m) for columns in (self, form))
        return np.asarray(own - theirs @ np.linalg.lstsq(theirs, own, rcond=None)[0]).reshape(self.values.shape)


@dataclass(frozen=True)
class Gram:
    """Cross-products of ``m`` columns with each other, block by block, and on each channel of those that act there.

    Attributes:
        size: number of the columns ``m``.
        parts: for each channel which columns act ``(k,)``, and their products ``(B, k, k)``.
    """

    size: int
    parts: list[tuple[np.ndarray, Array]]

    def summed(self, weights: Array, rows: Array) -> Array:
        """Sum over channels with weights ``(c,)`` and over blocks with weights ``(…, B)``: ``(…, m, m)``."""
        result = np.zeros((*rows.shape[:-1], self.size, self.size))
        for weight, (index, G) in zip(weights, self.parts, strict=True):
            result[..., index[:, None], index] += weight * np.tensordot(rows, G, 1)
        return result

    def squares(self, v: Array) -> Array:
        """Squares of the columns times ``v``, one ``(m,)`` or one for each block ``(B, m)``: ``(B, c)``."""
        return np.column_stack([np.maximum(quadratic(G, v[..., index]), 0.0) for index, G in self.parts])


class Design:
    """Named groups of columns, ``W`` and ``y`` among them, and their cross-products, each computed once.

    Args:
        y: ``(N, c)``.
        W: ``(N, c, p)``.
        use: samples that count ``(N, c)``.
        blocks: of the ``N`` samples.
    """

    def __init__(self, y: Array, W: Array, use: np.ndarray, blocks: Blocks) -> None:
        self.blocks, self.use, self.c = blocks, use, y.shape[1]
        everywhere = tuple(range(self.c))
        self.W = Columns(W * use[:, :, None], everywhere)
        self.y = Columns((y * use)[:, :, None], everywhere)
        self.count = np.add.reduceat(use.astype(float), blocks.edges[:-1], axis=0)
        # Weights of the channels by folds and prior, as the model's parameters leave them, with that prior.
        self.of_model: dict[tuple[int, int], tuple[Array, Array | None]] = {}
        self.groups = {"W": self.W, "y": self.y}
        self._gram: tuple[list[Columns], Gram] = [], Gram(0, [])

    def bare(self, blocks: Blocks) -> Design:
        """The same rows without any other group, in blocks with the same edges and maybe other folds."""
        design = copy.copy(self)
        design.blocks, design.groups = blocks, {"W": self.W, "y": self.y}
        return design

    def add(self, key: str, columns: Columns) -> None:
        """Adds or replaces a group."""
        self.groups[key] = columns

    def drop(self, key: str) -> None:
        """Forgets a group."""
        self.forget_products(key)
        self.groups.pop(key, None)

    def forget_products(self, key: str) -> None:
        """Forgets the cross-products of a group that is hardly asked for again; they are made anew where it is."""
        if key in self.groups:
            self.groups[key].in_blocks.clear()
            self.groups[key].products.clear()

    def cross(self, a: str, b: str) -> dict[int, Array]:
        """``a_b' b_b`` for each block ``(B, k_a, k_b)`` of the columns that act on each channel that both act on."""
        left, right = self.groups[a], self.groups[b]
        products = left.products.setdefault(right, {})
        if "cross" not in products:
            products["cross"] = {j: np.swapaxes(self.acting(left, j)[1], 1, 2) @ self.acting(right, j)[1]
                                 for j in left.channels if j in right.channels}
        by_channel: dict[int, Array] = products["cross"]
        return by_channel

    def total(self, a: str, b: str) -> Array:
        """``a' b`` of all selecting blocks together, for each channel of ``a`` ``(k, m_a, m_b)``."""
        left, right, blocks = self.groups[a], self.groups[b], self.blocks
        products = left.products.setdefault(right, {})
        if blocks.folds not in products:
            result, rows = np.zeros((len(left.channels), left.m, right.m)), blocks.selecting_samples[:, None]
            for i, j in enumerate(left.channels):
                if left is right:
                    result[i] = left.values[:, i].T @ (left.values[:, i] * rows)
                elif j in right.channels:
                    acting, selecting = self._selecting(right, j)
                    result[i][:, acting] = left.values[:, i].T @ selecting
            products[blocks.folds] = result
        return np.asarray(products[blocks.folds])

    def _selecting(self, columns: Columns, j: int) -> tuple[np.ndarray, Array]:
        """Which columns act on one channel, and their rows ``(N, m)``, zero where they do not select."""
        key = j, self.blocks.folds
        if key not in columns.in_blocks:
            acting = self.acting(columns, j)[0]
            values = columns.values[:, columns.channels.index(j), acting]
            columns.in_blocks[key] = acting, values * self.blocks.selecting_samples[:, None]
        return columns.in_blocks[key]

    def acting(self, columns: Columns, j: int) -> tuple[np.ndarray, Array]:
        """Which columns act on one channel, and their rows block by block ``(B, L, m)``.

        Of the model's parameters a joint feels those of the links behind it.
        """
        if j not in columns.in_blocks:
            values = columns.values[:, columns.channels.index(j)]
            acting = np.flatnonzero(values.any(axis=0)) if columns.m > 1 else np.arange(columns.m)
            columns.in_blocks[j] = acting, self.blocks.cut(values[:, acting])
        return columns.in_blocks[j]

    def gram(self, keys: list[str]) -> Gram:
        """Cross-products of several groups side by side with each other, and with ``y`` last."""
        groups = [self.groups[key] for key in (*keys, "y")]
        if self._gram[0] != groups:
            self._gram = groups, Gram(sum(group.m for group in groups),
                                      [self._on_channel([*keys, "y"], j) for j in range(self.c)])
        return self._gram[1]

    def _on_channel(self, keys: list[str], j: int) -> tuple[np.ndarray, Array]:
        places, index = self._places(keys, j)
        products = np.empty((self.blocks.count, len(index), len(index)))
        for i, (a, left) in enumerate(places):
            for b, right in places[: i + 1]:
                # A candidate's products with W and y are known from its test.
                half = np.swapaxes(self.cross(b, a)[j], 1, 2) if a == "y" else self.cross(a, b)[j]
                products[:, left, right] = half
                products[:, right, left] = np.swapaxes(half, 1, 2)
        return index, products

    def _places(self, keys: list[str], j: int) -> tuple[list[tuple[str, slice]], np.ndarray]:
        """Where groups stand among the columns that act on a channel, and where these stand among all."""
        places, index, column, first = [], [], 0, 0
        for key in keys:
            group = self.groups[key]
            if j in group.channels:
                acting = first + self.acting(group, j)[0]
                places.append((key, slice(column, column + len(acting))))
                index.append(acting)
                column += len(acting)
            first += group.m
        return places, np.concatenate(index)

    def beside(self, key: str, keys: list[str], j: int) -> tuple[Array, Array]:
        """Products of one more group on a channel: with those of ``gram(keys) (B, m, k)``, with itself.

        Args:
            key, keys: of the group, and of the others.
            j: one of its channels, from 0.
        """
        places, index = self._places([*keys, "y"], j)
        ours, m, B = self.acting(self.groups[key], j)[0], self.groups[key].m, self.blocks.count
        with_others, with_itself = np.zeros((B, m, len(index))), np.zeros((B, m, m))
        for other, place in places:
            with_others[:, ours, place] = self.cross(key, other)[j]
        with_itself[:, ours[:, None], ours] = self.cross(key, key)[j]
        return with_others, with_itself


def quadratic(G: Array, v: Array) -> Array:
    """``v' G v`` for stacked matrices ``(…, m, m)``."""
    return np.asarray(np.sum(times(G, v) * v, axis=-1))


def times(A: Array, v: Array) -> Array:
    """``A v`` for stacked matrices and vectors."""
    return np.asarray((A @ v[..., None])[..., 0])
