"""Candidates: an effect at a joint, with values of theta to start from and columns ready for the regression."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.channels.motor_torque import Experiment
from ideal_robot.diagnosis.statistics.cross_products import Columns, Data
from ideal_robot.effects import Effect, Signals


@dataclass(frozen=True)
class Candidate:
    """An effect at a joint with fixed theta.

    Attributes:
        effect, joint, theta: see ``Effect``.
        tries: how many values of theta were looked at to arrive here; p-values pay for them.
    """

    effect: Effect
    joint: int
    theta: tuple[float, ...] = ()
    tries: int = 1

    @property
    def key(self) -> str:
        """Name of its group of columns."""
        return f"{self.place}@{','.join(f'{value:.9g}' for value in self.theta)}"

    @property
    def place(self) -> str:
        """Effect, channel and joint without theta: what competes with itself over theta."""
        return f"{self.effect.name}:{self.effect.channel(self.joint)}:{self.joint}:{id(self.effect)}"

    @property
    def label(self) -> str:
        """For people."""
        return f"{self.effect.name}, joint {self.joint}" if self.joint else f"{self.effect.name}, whole arm"

    @property
    def cost(self) -> int:
        """Number of parameters."""
        return len(self.effect.coefficient_names) + len(self.theta)

    def columns(self, experiment: Experiment, data: Data) -> Columns:
        """Its columns at the rows of the regression."""
        return prepared(experiment, data, self.effect.columns(experiment.signals, self.joint, self.theta))


def prepared(experiment: Experiment, data: Data, columns: Array) -> Columns:
    """Raw columns ``(N_raw, c, m)`` filtered, decimated and masked; channels that are zero are not touched."""
    channels = np.flatnonzero(np.any(columns != 0.0, axis=(0, 2)))
    small = experiment.decimate(np.ascontiguousarray(columns[:, channels]))
    values = small * data.use[:, channels, None]
    return Columns(np.ascontiguousarray(values), tuple(int(j) for j in channels))


def candidates(library: tuple[Effect, ...], signals: Signals, undecided: dict[int, str],
               absorbed: bool) -> Iterator[list[Candidate]]:
    """For every effect and joint the list of its starts, joints that move too little left out.

    Args:
        library: effects to try.
        signals: of the recording.
        undecided: joints that cannot be decided.
        absorbed: whether effects may be tried that the model's own parameters can take over.
    """
    for effect in library:
        if effect.absorbed_by_base and not absorbed:
            continue
        for joint in effect.joints(signals):
            if joint in undecided or not effect.usable(signals, joint):
                continue
            if effect.scanned:
                yield [Candidate(effect, joint)]
                continue
            starts = effect.starts(signals, joint)
            yield [Candidate(effect, joint, theta, len(starts)) for theta in starts]
