"""What a residual depends on: splines over each signal, against a null distribution from the residual itself.

Under the null hypothesis the sign of the residual in a block of time has nothing to do with the signal. Flipping the
signs of whole blocks at random leaves all correlation within blocks as it is, and gives the distribution of the
explained squares without dependence; also where the motion repeats itself, where shifting in time would fail.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

from ideal_robot.effects import Signals
from ideal_robot.effects.unknown import Unknown, signal_of
from ideal_robot.interface import Array

_FLIPS = 400


@dataclass(frozen=True)
class Dependence:
    """Dependence of one channel's residual on one curve.

    Attributes:
        channel: index of the channel.
        term: the spline over the signals it was tried on.
        share: share of the residual's squares that the curve explains.
        expected: share it explains by chance, from the flipped blocks.
        p_value: of ``share`` under the null hypothesis.
    """

    channel: int
    term: Unknown
    share: float
    expected: float
    p_value: float

    @property
    def names(self) -> list[str]:
        """Signals it depends on, ``sign(qd_j)`` among them for a directed curve."""
        extra = [f"sign(qd_{self.channel + 1})"] if self.term.directed else []
        return [*self.term.depends_on, *extra]


def signal_names(signals: Signals, channel: int) -> list[str]:
    """Signals of one channel's residual that are worth looking at, those that hardly vary left out."""
    n = signals.n
    names = ["t"]
    for kind in ("q", "qd", "qdd"):
        names += [f"{kind}_{i + 1}" for i in range(n)]
    own = min(channel, n - 1) + 1
    names += [f"load_{own}"]
    if signals.temperature is not None:
        names += [f"temp_{own}"]
    names += list(signals.extra)
    return [name for name in names if _varies(signal_of(signals, name))]


def terms(signals: Signals, channel: int, pairs: bool, head: str = "tau") -> list[Unknown]:
    """Curves to try on a channel: single signals, directed ones, and with ``pairs`` products of two."""
    names = signal_names(signals, channel)
    result = [Unknown((name,), False, (_knots(signal_of(signals, name), 16 if name == "t" else 9),), head=head)
              for name in names]
    directed = [name for name in names if name.startswith(("q_", "load_", "temp_")) or name == "t"]
    if head == "tau":
        result += [Unknown((name,), True, (_knots(signal_of(signals, name), 9),)) for name in directed]
    if pairs:
        j = channel + 1
        own = [f"{kind}_{j}" for kind in ("q", "qd")]
        smooth = [name for name in names if name.startswith(("q_", "qd_"))]
        both = {tuple(sorted((a, b))) for a in own for b in smooth if a != b and a in names}
        both |= {tuple(sorted((a, b))) for a in smooth for b in smooth
                 if a != b and a.split("_")[0] == b.split("_")[0]}
        result += [Unknown(pair, False, tuple(_knots(signal_of(signals, name), 2) for name in pair), head=head)
                   for pair in sorted(both)]
    return result


def dependence(residual: Array, use: Array, blocks: np.ndarray, signals: Signals, channel: int, term: Unknown,
               rng: np.random.Generator) -> Dependence:
    """Tests one curve on one channel's residual.

    Args:
        residual, use: ``(N,)``.
        blocks: block of each sample ``(N,)``.
        signals: at the same samples.
        channel: index of the channel.
        term: the curve.
        rng: for the flips.
    """
    columns = term.columns(signals, channel + 1, ())[:, channel]
    r = np.where(use, residual, 0.0)
    columns = columns * use[:, None]
    mean = columns.sum(axis=0) / max(use.sum(), 1)
    columns = (columns - mean) * use[:, None]
    U, s, _ = np.linalg.svd(columns.T @ columns)
    keep = s > 1e-6 * s[0] if s[0] > 0 else np.zeros(len(s), bool)
    if not keep.any():
        return Dependence(channel, term, 0.0, 0.0, 1.0)
    Q = columns @ (U[:, keep] / np.sqrt(s[keep]))
    count = int(blocks.max()) + 1
    parts = np.zeros((count, Q.shape[1]))
    np.add.at(parts, blocks, Q * r[:, None])
    total = max(float(r @ r), 1e-300)
    observed = float(np.sum(parts.sum(axis=0) ** 2))
    flips = rng.choice([-1.0, 1.0], size=(_FLIPS, count))
    null = np.sum((flips @ parts) ** 2, axis=1)
    # A gamma distribution of the same mean and variance carries the p-value below one in ``_FLIPS``.
    mean_null, var_null = float(null.mean()), float(null.var()) + 1e-300
    p = float(stats.gamma.sf(observed, mean_null**2 / var_null, scale=var_null / max(mean_null, 1e-300)))
    return Dependence(channel, term, observed / total, mean_null / total, p)


def time_period(residual: Array, use: Array, t: Array, head: str) -> Unknown | None:
    """The strongest oscillation over time of a residual as a candidate term; None for a short recording."""
    r = np.where(use, residual, 0.0)
    N = len(r)
    if N < 64:
        return None
    dt = float(t[1] - t[0])
    power = np.abs(np.fft.rfft(r, 4 * N)) ** 2
    f = np.fft.rfftfreq(4 * N, dt)
    power[f < 3.0 / (N * dt)] = 0.0
    best = float(f[int(np.argmax(power))])
    return Unknown(("t",), False, ((float(t[0]), float(t[-1])),), 2.0 * np.pi * best, head=head)


def _varies(x: Array) -> bool:
    spread = float(np.percentile(x, 99) - np.percentile(x, 1))
    return bool(np.all(np.isfinite(x)) and spread > 1e-9 * (1.0 + float(np.max(np.abs(x)))))


def _knots(x: Array, intervals: int) -> tuple[float, ...]:
    """Evenly spread knots over the range that holds all but the outermost percent."""
    low, high = np.percentile(x, [0.5, 99.5]) if intervals > 2 else (float(x.min()), float(x.max()))
    count = 2 if intervals <= 2 else intervals + 1
    return tuple(float(v) for v in np.linspace(low, high, count))
