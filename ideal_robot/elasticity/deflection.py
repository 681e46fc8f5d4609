"""Deflection of elastic gears on a known path: what lies between motor angles and arm angles ([L] 2.1)."""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.dynamics.newton_euler import chain_of, inverse_dynamics
from ideal_robot.model.arm_with_effects import chain_with, changes_of, stiffness_with
from ideal_robot.model.gear_gap import side_of_gap
from ideal_robot.model.model import Model


class GearDeflection:
    r"""Deflection :math:`q - q_a = \tau_g / k` with the gear torque of the desired path, [J] (1).

    Sensors are mounted on the arm, encoders on the motors: a sensor value belongs to :math:`\hat q_a = q - \tau_g/k`.
    The torque comes from the path that the arm is following, not from the noisy motor current. Found effects count:
    what the arm carries besides, how stiff its gears are, how unevenly they turn and which side of their play they are
    on.

    Args:
        model: identified model; without a stiffness in it the deflection is zero.
        T: cycle of the desired positions [s].
    """

    def __init__(self, model: Model, T: float) -> None:
        self._T = T
        changes = changes_of(model.effects)
        self._chain = chain_with(chain_of(model.dynamics), changes)
        known = np.full(model.n, np.inf) if model.stiffness is None else np.array(model.stiffness)
        stiffness = stiffness_with(known, changes)
        self._compliance = np.where(np.isfinite(stiffness), 1.0 / stiffness, 0.0)
        self._bends = bool(self._compliance.any())
        self._gears = [(effect.joint - 1, change) for effect, change in changes
                       if change.uneven is not None or change.half_gap]

    def at(self, q_d: Array) -> Array:
        """Deflection ``(n,)`` [rad] one cycle after row 0 of the horizon ``q_d (n_d ≥ 3, n)`` [rad]."""
        return np.asarray(self.along(q_d[:3])[1]) if len(q_d) > 2 else np.zeros(q_d.shape[1])

    def along(self, q_d: Array) -> Array:
        """Deflections ``(K, n)`` [rad] on a whole path ``(K, n)`` [rad]; zero at both ends, where nothing is known."""
        deflection = np.zeros(q_d.shape)
        if len(q_d) < 3 or not (self._bends or self._gears):
            return deflection
        q, inside = q_d[1:-1], deflection[1:-1]
        v = (q_d[2:] - q_d[:-2]) / (2.0 * self._T)
        a = (q_d[2:] - 2.0 * q + q_d[:-2]) / self._T**2
        load = inverse_dynamics(self._chain, q, v, a)
        inside[:] = self._compliance * load
        for j, change in self._gears:
            if change.uneven is not None:
                order, cosine, sine = change.uneven
                inside[:, j] -= cosine * np.cos(order * q[:, j]) + sine * np.sin(order * q[:, j])
            if change.half_gap:
                inside[:, j] += change.half_gap * side_of_gap(load[:, j], v[:, j], np.array(change.gap_load))
        return deflection
