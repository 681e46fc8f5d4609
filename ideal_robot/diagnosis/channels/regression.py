"""A regression: measured values, expected values, and the columns of what may change."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy import signal

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.channels.blocks import Blocks, time_blocks
from ideal_robot.effects import (
    ARM_POSITION,
    MOTOR_TORQUE,
    SENSOR,
    TCP_POSITION,
    Domain,
    Effect,
    FittedEffect,
    Frames,
    Signals,
)
from ideal_robot.signals.preprocess import FilteredSignals
from ideal_robot.signals.recording import Recording


@dataclass(frozen=True)
class Regression:
    """The regression of one recording.

    Attributes:
        t: decimated times from the start of the recording ``(N,)`` [s].
        channels, units: names and units of the ``c`` channels.
        y: measured minus predicted ``(N, c)``.
        measured: measured values ``(N, c)``.
        W: derivative of the prediction by the model's parameters ``(N, c, p)``.
        use: samples that are used ``(N, c)``.
        signals: undecimated signals for effects.
        filtered: the filter that made them; its ``decimate`` brings columns of effects to the rows of ``y``.
        undecided: joints (from 1) with too little motion, and why.
        domain: the domain in which its effects act.
        prismatic: which joints slide and are measured in N and m ``(n,)``.
        noise_floor: level of the measurement's own noise per channel ``(c,)``, in the used band.
        absent: channels (from 0) that the recording does not have; none of their samples is used.
    """

    t: Array
    channels: tuple[str, ...]
    units: tuple[str, ...]
    y: Array
    measured: Array
    W: Array
    use: np.ndarray
    signals: Signals
    filtered: FilteredSignals = field(repr=False)
    undecided: dict[int, str]
    noise_floor: Array
    prismatic: tuple[bool, ...]
    domain: Domain = MOTOR_TORQUE
    absent: frozenset[int] = frozenset()

    @property
    def step(self) -> float:
        """Time from one row to the next [s]; a mean for cameras, as the points of a field have the same time."""
        return float(self.t[-1] - self.t[0]) / max(len(self.t) - 1, 1)

    def blocks(self) -> Blocks:
        """Blocks of time of the rows."""
        return time_blocks(len(self.t), MOST_BLOCKS, FEWEST_ROWS)

    def channel_of(self, joint: int) -> int | None:
        """Index of the channel of a joint; None where effects do not belong to one channel, as those of the TCP."""
        return joint - 1 if joint and self.domain != TCP_POSITION else None

    def columns_of(self, effect: Effect, joint: int, theta: tuple[float, ...]) -> Array:
        """Columns ``(N, c, m)`` of an effect at the rows of ``y``; see ``Effect.columns``."""
        key = effect, joint, theta
        if key not in self._columns:
            self._columns[key] = self.filtered.decimate(effect.columns(self.signals, joint, theta))
        return self._columns[key]

    @cached_property
    def _columns(self) -> dict[tuple[Effect, int, tuple[float, ...]], Array]:
        return {}

    def decimated_signals(self) -> Signals:
        """The signals at the rows of ``y``, sampled (not filtered): for plots and dependence measures."""
        s, step, keep = self.signals, self.filtered.factor, self.filtered.keep

        def at(values: Array) -> Array:
            return np.asarray(values[::step][keep])

        sampled: dict[str, Any] = {
            name: at(getattr(s, name)) for name in ("t", "q", "qd", "qdd", "load", "torque", "friction", "weight",
                                                    "temperature", "sliding") if getattr(s, name) is not None}
        frames = None if s.frames is None else Frames(*(at(values) for values in vars(s.frames).values()))
        return replace(s, **sampled, payload=None, rigid=None, bodies=None, gravity_across=None, frames=frames,
                       extra={name: at(values) for name, values in s.extra.items()})


def without_known(made: Regression, effects: Sequence[FittedEffect]) -> Regression:
    """The regression of positions with a model's known effects subtracted.

    New effects are then changes of the known ones. Recorded cameras and force sensors are corrected already.
    """
    known = [effect for effect in effects if effect.domain == made.domain and made.domain != SENSOR]
    if not known:
        return made
    contributions = [made.filtered.decimate(effect.contribution(made.signals)) for effect in known]
    return replace(made, y=np.asarray(made.y - np.sum(contributions, axis=0)))


BAND = 12.5
"""Band in which torques are looked at [Hz]: above it are the loops of the controller and the vibrations of the arm, of
which a rigid body with friction says nothing. In contact as well."""
CUTOFF = 20.0
"""Cut-off of the position filter [Hz]: as far above the band that the filter is flat within it, no further."""
POSITION_BAND = 50.0
"""Band in which positions and forces are looked at [Hz]."""
MOST_BLOCKS = 20
"""Blocks of time that are left out in turn. Eight give the same names; more of them give a standard error."""
FEWEST_ROWS = 8
"""Rows of a block, at least: twice the order of the noise."""
KNOTS = 0.02
"""Distance of the knots of a curve that is not known, a line's or a surface's [m]."""
RESTING = 0.004
"""Share of its top speed below which a joint rests or touches zero. If that takes longer than a period of the position
filter's cut-off, the filter has blurred the direction on which friction depends, and those samples do not count."""
MEMORY = 2.4
"""Periods of the position filter's cut-off for which both filters remember an end, a rest, or a reversal, where
friction goes through zero in a way of its own: these samples do not count."""
OWN = 0.0005
"""Share of the squares of a column that others cannot make, from which on it has something of its own."""
FEWEST = 20
"""Samples or camera fields from which a level is estimated, or a regression made, at least."""
WRENCH = ("fx", "fy", "fz", "mx", "my", "mz")
"""Columns of a force sensor."""
_GAPS = "it holds gaps"


def rms(values: Array, use: np.ndarray) -> Array:
    """Root mean square per channel ``(c,)`` of values ``(N, c)`` over the used samples ``(N, c)``."""
    return np.asarray(np.sqrt((values**2 * use).sum(axis=0) / np.maximum(use.sum(axis=0), 1)))


def spread(values: Array, use: np.ndarray) -> Array:
    """Standard deviation per channel ``(c,)`` of values ``(N, c)`` over the used samples ``(N, c)``."""
    return rms(values - (values * use).sum(axis=0) / np.maximum(use.sum(axis=0), 1), use)


def noise_floor(values: Array, share: float = 1.0) -> Array:
    """Noise of evenly sampled channels ``(N, c)`` from the upper part of their spectrum.

    Effects follow the motion and are slow, so the upper part of the band has only noise; its level is multiplied by the
    whole band. Noise with a falling spectrum is underestimated.
    """
    length = min(len(values), 256)
    f, power = signal.welch(values, nperseg=length, axis=0)
    # A decimation filter falls off at the very end of the band.
    upper = (f >= 0.25) & (f <= 0.42)
    # The median of an average of K periodograms lies below its mean.
    K = max(1.0, 2.0 * len(values) / length - 1.0)
    return np.asarray(np.sqrt(np.median(power[upper], axis=0) / (1.0 - 1.0 / (9.0 * K)) ** 3 * 0.5 * share))


def noise_left(residual: Array, use: np.ndarray) -> tuple[Array, Array]:
    """Two standard deviations ``(c,)`` of the white noise in each channel of a residual, in the channel's unit.

    Both are from third differences, which remove the motion. The first is from their mean square. The second is from
    their median size, which outliers do not raise: it contains encoder steps, jitter and oscillations at the end of the
    band, which do not depend on the motion. With too few samples the first is infinite and the second zero.

    Args:
        residual: of the channels ``(N, c)``.
        use: samples of it that are used ``(N, c)``.
    """
    third, whole = np.diff(residual, 3, axis=0), use[3:] & use[2:-1] & use[1:-2] & use[:-3]
    enough = whole.sum(axis=0) >= FEWEST
    sizes = [np.median(np.abs(d[w])) if known else 0.0 for d, w, known in zip(third.T, whole.T, enough, strict=True)]
    return np.where(enough, rms(third, whole), np.inf) / np.sqrt(20.0), 1.4826 * np.array(sizes) / np.sqrt(20.0)


def unused_columns(recording: Recording, searched: tuple[Regression, ...]) -> dict[str, str]:
    """Columns of a checked recording that measure something but were not used, with the reason.

    The regressions are those of all domains that were searched, that of the motor torques first.
    """
    arm = next((regression for regression in searched if regression.domain == ARM_POSITION), None)
    result = {}
    for prefix in ("qa", "temp"):
        for j, present in enumerate(recording.having(prefix)):
            name = f"{prefix}_{j + 1}"
            if name in recording.columns and not present:
                result[name] = _GAPS
            elif present and prefix == "qa" and (arm is None or not arm.use[:, j].any()):
                result[name] = f"joint {j + 1} has no sample that is used"
    result |= {name: _GAPS for name in "xyz" if not np.all(np.isfinite(recording.columns.get(name, 0.0)))}
    together: list[tuple[tuple[str, ...], str]] = [
        (("qx", "qy", "qz", "qw"), "the tool's orientation is not looked at")]
    if recording.has("tau") and recording.has("current") and not _made_of_current(recording):
        together.append((tuple(f"current_{j + 1}" for j in range(recording.n)), "torques are there"))
    sensors = {name for regression in searched if regression.domain == SENSOR for name in regression.channels}
    wrench = tuple(name for name in WRENCH if name in recording.columns)
    if wrench not in ((), WRENCH[:3], WRENCH):
        together.append((wrench, "fx fy fz are needed, and mx my mz all or none"))
    elif not any(name.startswith(("f", "m", "contact")) for name in sensors):
        together.append((wrench, "too little of it, free or in contact, to tell anything"))
    for names, why in together:
        if present := [name for name in names if name in recording.columns]:
            result[", ".join(present)] = why
    if "cam_t" in recording.columns and not any(name.startswith("line") for name in sensors):
        result["cam_t, line_x_i, line_y_i, line_z_i"] = "too few fields in which the line was seen"
    for name, values in searched[0].signals.extra.items():
        if not np.all(np.isfinite(values)):
            result[name] = _GAPS
        elif np.ptp(values) == 0.0:
            result[name] = "it never changes"
    return result


def _made_of_current(recording: Recording) -> bool:
    """Whether the torques are nothing but the currents times a factor each."""
    tau, current = recording.joints("tau"), recording.joints("current")
    with np.errstate(invalid="ignore", divide="ignore"):
        factor = np.nansum(tau * current, axis=0) / np.nansum(current**2, axis=0)
    return bool(np.allclose(tau, factor * current, rtol=1e-6, atol=1e-9, equal_nan=True))
