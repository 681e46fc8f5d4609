"""Whitened rows of a regression and the products of their columns, block by block in time.

A regression has a measurement, the derivatives of the model by its parameters, and columns of causes. Each channel has
its coloured noise; its autoregression turns rows into innovations, whose products suffice for estimates and scores.
Products of a group with another are made once for each noise.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.channels.blocks import Columns, time_blocks
from ideal_robot.diagnosis.channels.regression import FEWEST_ROWS, MOST_BLOCKS
from ideal_robot.estimate.gaussian import Posterior, posterior
from ideal_robot.estimate.noise import ColouredNoise, Free, without_kicks


@dataclass
class _Channel:
    """Rows of one channel: noise, level, and what was made of groups with this noise.

    Attributes:
        use: rows that are used ``(N,)``.
        noise: of the channel.
        weight: inverse square of the innovations' size in units of the noise's.
        rows: of each group its columns that act here and their innovations block by block ``(B, L, m)``.
        products: of two groups ``(B, m_a, m_b)``.
        totals: acting columns of either, and the sums of their products over blocks ``(m_a, m_b)``.
    """

    use: np.ndarray
    noise: ColouredNoise
    weight: float = 1.0
    rows: dict[str, tuple[np.ndarray, Array]] = field(default_factory=dict)
    products: dict[tuple[str, str], Array] = field(default_factory=dict)
    totals: dict[tuple[str, str], tuple[np.ndarray, np.ndarray, Array]] = field(default_factory=dict)

    def forget(self, key: str) -> None:
        """Forgets what was made of a group."""
        self.rows.pop(key, None)
        for pair in [pair for pair in self.products if key in pair]:
            del self.products[pair]
        for pair in [pair for pair in self.totals if key in pair]:
            del self.totals[pair]


class System:
    """Rows of all channels in units of their noise.

    Args:
        y: measured minus predicted ``(N, c)``, in the channels' units.
        base: derivatives by the parameters that are always there ``(N, c, p)``.
        use: rows that are used ``(N, c)``.
        root: matrix ``R (p, k)``, the parameters' prior covariance being ``R R'``, in whose units they are fitted; None
            without a prior.
    """

    def __init__(self, y: Array, base: Array, use: np.ndarray, root: Array | None = None) -> None:
        self.N, self.c = y.shape
        self.root = np.eye(base.shape[2]) if root is None else root
        if root is not None:
            base = base @ root
        self.y, self.use, self.p = y, use, base.shape[2]
        self.precision = np.zeros((self.p, self.p)) if root is None else np.eye(self.p)
        everywhere = tuple(range(self.c))
        self.groups = {"W": Columns(base * use[:, :, None], everywhere),
                       "y": Columns((y * use)[:, :, None], everywhere)}
        self._posteriors: dict[tuple[str, ...], Posterior] = {}
        self._besides: dict[tuple[str, tuple[str, ...]], tuple[Array, Array, Array]] = {}
        self.edges = np.array(time_blocks(self.N, MOST_BLOCKS, FEWEST_ROWS).edges)
        flat = ColouredNoise.of_autocovariance(np.array([1.0, 0.0]))
        self.channels = [_Channel(use[:, j].copy(), flat) for j in range(self.c)]

    @property
    def blocks(self) -> int:
        """Number of blocks of time."""
        return len(self.edges) - 1

    @property
    def count(self) -> Array:
        """Rows that are used in each channel ``(c,)``."""
        return np.array([float(channel.use.sum()) for channel in self.channels])

    @property
    def block_of_row(self) -> np.ndarray:
        """Block of each row ``(N,)``."""
        return np.repeat(np.arange(self.blocks), np.diff(self.edges))

    def add(self, key: str, columns: Columns) -> None:
        """Adds a group of columns, in the channels' units; a group of the same name is kept."""
        self.groups.setdefault(key, columns)

    def drop(self, key: str) -> None:
        """Removes a group of columns."""
        self.groups.pop(key, None)
        for kept in [kept for kept in self._posteriors if key in kept]:
            del self._posteriors[kept]
        for pair in [pair for pair in self._besides if key == pair[0] or key in pair[1]]:
            del self._besides[pair]
        for channel in self.channels:
            channel.forget(key)

    def _forget_sums(self) -> None:
        """Forgets what was summed over channels with other noise or levels."""
        self._posteriors.clear()
        self._besides.clear()

    # Noise of the channels.

    def with_noise(self, residual: Array, free: Sequence[Free | None] | None = None) -> None:
        """Sets the noise of each channel from a residual.

        Args:
            residual: ``(N, c)``, in the channels' units.
            free: of each channel columns that may hold causes; the part of the residual along them is no noise.
        """
        self._forget_sums()
        for j, channel in enumerate(self.channels):
            if not channel.use.any():
                continue
            r = np.where(channel.use, residual[:, j], 0.0)
            own = None if free is None else free[j]
            if own is not None:
                r = r - own.columns @ (own.columns.T @ r)
            noise = ColouredNoise.fit(r, channel.use)
            kept = without_kicks(noise.whiten(r, channel.use), channel.use)
            noise = noise if np.array_equal(kept, channel.use) else ColouredNoise.fit(r, kept)
            self.channels[j] = _Channel(kept, noise if own is None else ColouredNoise.beside(r, kept, own))

    def take_noise(self, noise: Sequence[ColouredNoise]) -> None:
        """Sets a given noise for each channel, unless it has that already."""
        for j, (channel, own) in enumerate(zip(self.channels, noise, strict=True)):
            if channel.noise is not own:
                self._forget_sums()
                self.channels[j] = _Channel(channel.use, own)

    def with_levels(self, keys: Sequence[str]) -> Posterior:
        """Sets each channel's noise level from the residual of groups; returns their posterior at these levels."""
        for _ in range(2):
            fitted = self.posterior(keys)
            self._forget_sums()
            left = self.squares(keys, fitted.mean)
            for channel, squares, count in zip(self.channels, left, self.count, strict=True):
                channel.weight = count / squares if count and squares > 0.0 else 0.0
        return self.posterior(keys)

    # Products of whitened columns.

    def _rows(self, j: int, key: str) -> tuple[np.ndarray, Array]:
        channel, group = self.channels[j], self.groups[key]
        if key not in channel.rows:
            values = group.values[:, group.channels.index(j)]
            acting = np.flatnonzero(values.any(axis=0)) if group.m > 1 else np.arange(group.m)
            white = channel.noise.whiten(values[:, acting], channel.use)
            longest = int(np.max(np.diff(self.edges)))
            blocks = np.zeros((self.blocks, longest, len(acting)))
            for b, (first, end) in enumerate(zip(self.edges[:-1], self.edges[1:], strict=True)):
                blocks[b, : end - first] = white[first:end]
            channel.rows[key] = acting, blocks
        return channel.rows[key]

    def product(self, j: int, a: str, b: str) -> tuple[np.ndarray, np.ndarray, Array]:
        """Products of innovations of two groups: acting columns of each, and ``a'b`` block by block ``(B, m_a, m_b)``.

        Args:
            j: the channel, from 0.
            a, b: names of the groups.
        """
        (left, rows_a), (right, rows_b) = self._rows(j, a), self._rows(j, b)
        products = self.channels[j].products
        if (a, b) not in products:
            products[a, b] = np.swapaxes(products[b, a], 1, 2) if (b, a) in products else \
                np.swapaxes(rows_a, 1, 2) @ rows_b
        return left, right, products[a, b]

    def total(self, j: int, a: str, b: str) -> tuple[np.ndarray, np.ndarray, Array]:
        """The sum of ``product`` over all blocks: acting columns of each, and ``a'b`` ``(m_a, m_b)``.

        Args:
            j: the channel, from 0.
            a, b: names of the groups.
        """
        totals = self.channels[j].totals
        if (a, b) not in totals:
            left, right, products = self.product(j, a, b)
            totals[a, b] = left, right, products.sum(axis=0)
        return totals[a, b]

    def places(self, keys: Sequence[str]) -> dict[str, slice]:
        """Columns of each group in the matrix of all of them."""
        ends = np.cumsum([0, *(self.groups[key].m for key in keys)])
        return {key: slice(int(first), int(end)) for key, first, end in zip(keys, ends[:-1], ends[1:], strict=True)}

    def gram_of_all(self, keys: Sequence[str]) -> Array:
        """Weighted products of groups with each other and with ``y``, over all blocks ``(P + 1, P + 1)``."""
        return self._assembled(keys, self.total, ())

    def gram(self, keys: Sequence[str]) -> Array:
        """Weighted products of groups with each other and with ``y``, the last, by blocks ``(B, P + 1, P + 1)``."""
        return self._assembled(keys, self.product, (self.blocks,))

    def _assembled(self, keys: Sequence[str], of: Callable[[int, str, str], tuple[np.ndarray, np.ndarray, Array]],
                   leading: tuple[int, ...]) -> Array:
        """Weighted products of groups and ``y`` in one matrix ``(*leading, P + 1, P + 1)``.

        Args:
            keys: names of the groups.
            of: products of two of them in a channel, see ``product`` and ``total``.
            leading: first dimensions of these.
        """
        places = self.places([*keys, "y"])
        size = places["y"].stop
        whole = np.zeros((*leading, size, size))
        for j, channel in enumerate(self.channels):
            here = [key for key in places if j in self.groups[key].channels] if channel.weight else []
            for k, a in enumerate(here):
                for b in here[: k + 1]:
                    left, right, product = of(j, a, b)
                    rows, columns = places[a].start + left, places[b].start + right
                    product = channel.weight * product
                    whole[..., rows[:, None], columns] += product
                    if a != b:
                        whole[..., columns[:, None], rows] += np.swapaxes(product, -1, -2)
        return whole

    def full_precision(self, keys: Sequence[str], more: dict[str, Array] | None = None) -> Array:
        """Prior precision of all columns ``(P, P)``: of those that are always present, and ``more`` by groups."""
        places = self.places(keys)
        P = max((place.stop for place in places.values()), default=0)
        precision = np.zeros((P, P))
        if "W" in places:
            precision[: self.p, : self.p] = self.precision
        for key, own in (more or {}).items():
            place = places[key]
            precision[place, place] = own
        return precision

    def posterior(self, keys: Sequence[str], more: dict[str, Array] | None = None) -> Posterior:
        """Posterior of coefficients of groups, fitted together; ``more`` are prior precisions of groups."""
        if more:
            return posterior(self.gram_of_all(keys), self.full_precision(keys, more))
        kept = tuple(keys)
        if kept not in self._posteriors:
            self._posteriors[kept] = posterior(self.gram_of_all(keys), self.full_precision(keys))
        return self._posteriors[kept]

    def squares(self, keys: Sequence[str], mean: Array) -> Array:
        """Squared residual of coefficients in each channel, in units of its noise, unweighted ``(c,)``."""
        places, v = self.places([*keys, "y"]), np.append(-mean, 1.0)
        result = np.zeros(self.c)
        for j, channel in enumerate(self.channels):
            if not channel.use.any():
                continue
            left = sum(rows @ v[places[key].start + acting] for key in places if j in self.groups[key].channels
                       for acting, rows in [self._rows(j, key)])
            result[j] = float(np.sum(np.square(left)))
        return result

    def beside(self, key: str, keys: Sequence[str]) -> tuple[Array, Array, Array]:
        """Weighted products of one more group with others ``(m, P)``, with itself ``(m, m)`` and with ``y (m,)``."""
        asked = key, tuple(keys)
        if asked not in self._besides:
            self._besides[asked] = self._summed_beside(key, keys)
        return self._besides[asked]

    def _summed_beside(self, key: str, keys: Sequence[str]) -> tuple[Array, Array, Array]:
        """See ``beside``."""
        places, group = self.places([*keys, "y"]), self.groups[key]
        products, own = np.zeros((group.m, places["y"].stop)), np.zeros((group.m, group.m))
        for j in group.channels:
            weight = self.channels[j].weight
            if not weight:
                continue
            for other in places:
                if j in self.groups[other].channels:
                    left, right, product = self.total(j, key, other)
                    products[left[:, None], places[other].start + right] += weight * product
            left, right, product = self.total(j, key, key)
            own[left[:, None], right] += weight * product
        return products[:, :-1], own, products[:, -1]

    def residual(self, keys: Sequence[str], mean: Array) -> Array:
        """Residual of ``y`` with coefficients ``(P,)``, or those of each row ``(N, P)``, in its units ``(N, c)``."""
        r, places = (self.y * self.use).copy(), self.places(keys)
        for key, place in places.items():
            group, own = self.groups[key], mean[..., place]
            r[:, list(group.channels)] -= (group.values @ own if own.ndim == 1
                                           else np.einsum("nkm,nm->nk", group.values, own))
        return r
