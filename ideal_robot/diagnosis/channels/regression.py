"""A regression: what was measured, what the model expects, and what may be changed in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects import MOTOR_TORQUE, SENSOR, Domain, FittedEffect, Signals
from ideal_robot.signals.preprocess import FilteredSignals


@dataclass(frozen=True)
class Regression:
    """The regression of one recording.

    Attributes:
        t: decimated times from the start of the recording ``(N,)`` [s].
        channels, units: names and units of the ``c`` channels.
        y: measured minus predicted ``(N, c)``.
        measured: what was measured ``(N, c)``.
        W: derivative of the prediction by the model's parameters ``(N, c, p)``.
        use: samples that count ``(N, c)``.
        signals: undecimated signals for effects.
        filtered: the filter that made them; ``decimate`` brings columns of effects to the rows of ``y``.
        undecided: joints (from 1) that move too little, with the reason.
        domain: where its effects act.
        prismatic: which joints slide and are measured in N and m ``(n,)``.
        noise_floor: level of the measurement's own noise per channel ``(c,)``, in the band that is looked at.
        absent: channels (from 0) that the recording does not have; none of their samples counts.
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

    def channel_of(self, joint: int) -> int | None:
        """Index of the channel of a joint; None where effects do not belong to one channel."""
        return joint - 1 if joint else None

    @property
    def recorded(self) -> np.ndarray:
        """Which channels the recording has ``(c,)``."""
        return np.array([j not in self.absent for j in range(len(self.channels))])

    def decimate(self, columns: Array) -> Array:
        """Filters and decimates columns ``(N_raw, …)`` to the rows of ``y``; untouched zeros stay exactly zero."""
        return self.filtered.decimate(columns)

    def decimated_signals(self) -> Signals:
        """The signals at the rows of ``y``, sampled (not filtered): for plots and dependence measures."""
        s, step, keep = self.signals, self.filtered.factor, self.filtered.keep

        def at(values: Array) -> Array:
            return np.asarray(values[::step][keep])

        return replace(s, t=at(s.t), q=at(s.q), qd=at(s.qd), qdd=at(s.qdd), load=at(s.load), torque=at(s.torque),
                       friction=at(s.friction), weight=None if s.weight is None else at(s.weight), payload=None,
                       rigid=None, bodies=None, gravity_across=None, frames=None,
                       temperature=None if s.temperature is None else at(s.temperature),
                       sliding=None if s.sliding is None else at(s.sliding),
                       extra={name: at(values) for name, values in s.extra.items()})


Positions = TypeVar("Positions", bound=Regression)


def without_known(made: Positions, effects: Sequence[FittedEffect]) -> Positions:
    """The regression of positions with what a model's effects already say of them taken away.

    What is found then is a change of what is known, not the same thing once more. Readings of cameras and force sensors
    are corrected before they are recorded.

    Args:
        made: of arm angles or of the TCP.
        effects: of the model.
    """
    known = [effect for effect in effects if effect.domain == made.domain and made.domain != SENSOR]
    if not known:
        return made
    said = [made.decimate(effect.contribution(made.signals)) for effect in known]
    return replace(made, y=np.asarray(made.y - np.sum(said, axis=0)))
