"""What effects say of camera and force sensor, put together: how a follower corrects their readings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects.fitted import FittedEffect


@dataclass(frozen=True)
class SensorChange:
    """Errors of the sensors, see ``LoopChange``.

    Attributes:
        latency, latency_rate: by how much later than stamped a picture was taken [s], and its growth [s/s].
        picture: scale [1], cubic [1/m²], shift along [m], yaw [rad], shift across [m] of measured points ``(5,)``.
        wrench: what the force sensor shows when nothing touches the tool ``(6,)`` [N, N m].
        give: compliance beyond what is assumed [m/N].
    """

    latency: float
    latency_rate: float
    picture: Array
    wrench: Array
    give: float

    @classmethod
    def of(cls, effects: Sequence[FittedEffect]) -> SensorChange:
        """Of all effects of a model."""
        changes = [effect.effect.loop_change(effect.coefficients, effect.theta) for effect in effects]
        picture, wrench = np.zeros(5), np.zeros(6)
        for change in changes:
            if change.picture is not None:
                picture += change.picture
            wrench[: len(change.wrench)] += change.wrench
        return cls(sum(change.latency for change in changes), sum(change.latency_rate for change in changes), picture,
                   wrench, sum(change.give for change in changes))

    def late_by(self, t: float) -> float:
        """How much later than ``t`` [s] a picture with that time stamp was taken [s]."""
        return self.latency + self.latency_rate * t

    def points(self, measured: Array, axis: Array) -> Array:
        """Points ``(m, 3)`` in the tool frame [m], as they would be measured without the errors.

        Args:
            measured: in the tool frame ``(m, 3)`` [m].
            axis: where the optical axis meets the surface, in the tool frame ``(3,)`` [m].
        """
        if not self.picture.any():
            return measured
        scale, cubic, along, yaw, across = self.picture
        out = measured - axis
        out[:, 2] = 0.0
        grown = (scale + cubic * np.sum(out**2, axis=1))[:, None] * out
        turned = yaw * np.column_stack([-out[:, 1], out[:, 0], np.zeros(len(out))])
        return np.asarray(measured - grown - turned - np.array([along, across, 0.0]))

    def stiffness(self, assumed: float) -> float:
        """Elasticity of the contact [N/m] where ``assumed`` is what is counted with; [L] (3)."""
        give = 1.0 / assumed + self.give
        return 1.0 / give if give > 0.0 else assumed
