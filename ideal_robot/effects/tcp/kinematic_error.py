"""Joints that sit elsewhere than the drawings say."""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects.base import Effect, EffectParameter
from ideal_robot.effects.domain import TCP_POSITION
from ideal_robot.effects.loop_change import LoopChange
from ideal_robot.effects.signals import Signals
from ideal_robot.effects.tcp.at_tool import LEVER


class KinematicError(Effect):
    """Errors of one joint's Denavit–Hartenberg parameters: shifts along and turns about its axis and the common normal.

        delta x = da x_j + dd z_j + dalpha x_j × (x - p_j) + dtheta z_j × (x - p_j)

    ``x_j`` is the common normal of the joint's axis and the next one; it turns with the joint. ``d`` and ``theta`` of
    the first joint are left out: they are where the measuring device stands.
    """

    name = "kinematic_error"
    domain = TCP_POSITION
    depends_on_joint = False
    geometric = True
    coefficient_names = ("a", "d", "alpha", "theta")
    coefficient_units = ("m", "m", "rad", "rad")
    source = "J. Denavit, R. S. Hartenberg 1955; first-order kinematic calibration"

    def usable(self, signals: Signals, joint: int) -> bool:
        """The frames have to be known."""
        return signals.frames is not None

    def columns(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> Array:
        """See ``Effect.columns``. Shape ``(N, 3, 4)``."""
        frames = signals.frames
        if frames is None:
            return np.zeros((len(signals.t), 3, 4))
        x, z = frames.normal[:, joint - 1], frames.axis[:, joint - 1]
        lever = frames.tool - frames.position[:, joint - 1]
        columns = np.stack([x, z, np.cross(x, lever), np.cross(z, lever)], axis=2)
        if joint == 1:
            columns[:, :, [1, 3]] = 0.0
        columns[:, :, np.max(np.abs(columns), axis=(0, 1)) < LEVER] = 0.0
        return columns

    def parameters(self, coefficients: Array, std: Array, theta: tuple[float, ...],
                   theta_std: tuple[float, ...]) -> list[EffectParameter]:
        """See ``Effect.parameters``. Those that can be seen at all."""
        every = super().parameters(coefficients, std, theta, theta_std)
        return [parameter for parameter in every if parameter.value != 0.0]

    def loop_change(self, coefficients: tuple[float, ...], theta: tuple[float, ...]) -> LoopChange:
        """The arm's geometry behind the joint."""
        return LoopChange(geometry=(coefficients[0], coefficients[1], coefficients[2], coefficients[3]))
