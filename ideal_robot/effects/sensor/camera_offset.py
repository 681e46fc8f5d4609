"""A camera that is mounted elsewhere, or turned, against what its hand-eye calibration says."""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects.base import EffectParameter
from ideal_robot.effects.loop_change import LoopChange
from ideal_robot.effects.sensor.seen_line import ACROSS, ALONG, YAW, SeenLineEffect
from ideal_robot.effects.signals import Signals


class CameraOffset(SeenLineEffect):
    """Measured points are shifted along the tool's x and y axis and turned by psi about the camera's optical axis.

    ``du = (dx, dy, 0) + psi z × (u - u_axis)``. A pitched or rolled camera at height h above the surface shifts its
    points by h times the angle, and is reported as such. A shift across a line to which the tool keeps its heading is
    the same as another line; it is only fitted where the heading changes.
    """

    name = "camera_offset"
    needs = (ALONG, YAW)
    coefficient_names = ("along", "yaw", "across")
    coefficient_units = ("m", "rad", "m")
    source = "[L] 4.4: calibration of the camera's mounting"

    def columns(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> Array:
        """See ``Effect.columns``. Shape ``(N, 1, 2)``, or ``(N, 1, 3)`` where a shift across the line can be seen."""
        names = (*self.needs, ACROSS) if ACROSS in signals.extra else self.needs
        return np.stack([signals.extra[name] for name in names], axis=-1)[:, None, :]

    def parameters(self, coefficients: Array, std: Array, theta: tuple[float, ...],
                   theta_std: tuple[float, ...]) -> list[EffectParameter]:
        """See ``Effect.parameters``. What can be seen of the mounting."""
        return [EffectParameter(name, float(value), float(s), unit) for name, unit, value, s in
                zip(self.coefficient_names, self.coefficient_units, coefficients, std, strict=False)]

    def loop_change(self, coefficients: tuple[float, ...], theta: tuple[float, ...]) -> LoopChange:
        """The points that the camera measures."""
        along, yaw, across = (*coefficients, 0.0)[:3]
        return LoopChange(picture=(0.0, 0.0, along, yaw, across))
