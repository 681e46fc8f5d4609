"""Kinematic effects: wrong zeros and places of joints, links that grow with temperature."""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects.base import TCP_POSITION, Effect, EffectParameter, Theta
from ideal_robot.effects.friction import WarmingEffect
from ideal_robot.effects.signals import LEVER, Signals


class ZeroError(Effect):
    """Zero error of a joint: the true angle is ``q_j + e``, ``delta tau = e d tau_rigid/d q_j`` on all joints.

    Free masses would absorb most of it, so it is only searched with a given model.
    """

    name = "zero_error"
    coefficient_names = ("angle",)
    coefficient_units = ("rad",)
    # An error of the encoder's zero is some degrees [rad]; a larger one would be another mounting.
    within = (-0.2, 0.2)
    absorbed_by_base = True
    changes = "zero"
    source = "derivative of [G] (5) by one angle"

    def usable(self, signals: Signals, joint: int) -> bool:
        """Whether the signals can show the effect: they need a rigid-body function that depends on the angle."""
        if signals.rigid is None:
            return False
        return bool(np.max(np.abs(self.columns(signals, joint, ()))) > 1e-6 * np.max(np.abs(signals.load)) + 1e-12)

    def columns(self, signals: Signals, joint: int, theta: Theta) -> Array:
        """Columns of shape ``(N, n, 1)``; see ``Effect.columns``."""
        if signals.derivatives is None:
            return np.zeros((len(signals.t), signals.n, 1))
        return signals.derivatives.by(joint)[0][:, :, None]


class GeometryChange(Effect):
    """A change of the arm's geometry; with parallel axes another joint's may be equivalent."""

    domain = TCP_POSITION


class KinematicError(GeometryChange):
    """Errors of one joint's Denavit–Hartenberg parameters: shifts along and turns about its axis and the common normal.

        delta x = da x_j + dd z_j + dalpha x_j × (x - p_j) + dtheta z_j × (x - p_j)

    ``x_j`` is the common normal of the joint's axis and the next one; it turns with the joint. ``d`` and ``theta`` of
    the first joint are left out: they are equivalent to the place of the measuring device.
    """

    name = "kinematic_error"
    coefficient_names = ("a", "d", "alpha", "theta")
    coefficient_units = ("m", "m", "rad", "rad")
    changes = "geometry"
    source = "J. Denavit, R. S. Hartenberg 1955; first-order kinematic calibration"

    def columns(self, signals: Signals, joint: int, theta: Theta) -> Array:
        """Columns of shape ``(N, 3, 4)``; see ``Effect.columns``."""
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

    def parameters(self, coefficients: Array, std: Array, theta: Theta, theta_std: Theta) -> list[EffectParameter]:
        """The numbers to report: only those that the measurements can show; see ``Effect.parameters``."""
        every = super().parameters(coefficients, std, theta, theta_std)
        return [parameter for parameter in every if parameter.value != 0.0]


class ThermalGrowth(GeometryChange, WarmingEffect):
    """Thermal growth of the link behind a joint: ``delta x = e w (p_(j+1) - p_j)``."""

    name = "thermal_growth"
    coefficient_names = ("strain",)
    coefficient_units = ("1",)
    source = "linear expansion, 12e-6/K for steel, 24e-6/K for aluminium"
    nowhere = ("how warm a link is when a path begins does not follow from the time since a "
               "recording began, and the positional interface gives no temperature")

    def columns(self, signals: Signals, joint: int, theta: Theta) -> Array:
        """Columns of shape ``(N, 3, 1)``; see ``Effect.columns``."""
        frames = signals.frames
        if frames is None:
            return np.zeros((len(signals.t), 3, 1))
        end = frames.tool
        if joint < signals.n:
            end, axis = frames.position[:, joint], frames.axis[:, joint]
            if np.allclose(frames.jacobian[:, :, joint], axis, atol=1e-9):
                # The displacement of a prismatic joint behind the link is not part of the link's length.
                end = end - axis * signals.q[:, joint, None]
        warm = self.warmth(signals, joint, theta)
        return np.asarray(((end - frames.position[:, joint - 1]) * warm[:, None])[:, :, None])
