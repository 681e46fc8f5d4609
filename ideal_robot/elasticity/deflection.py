"""Deflection of elastic gears on a known path: what lies between motor angles and arm angles ([L] 2.1)."""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.dynamics.newton_euler import chain_of, inverse_dynamics
from ideal_robot.model.model import Model


class GearDeflection:
    r"""Deflection :math:`q - q_a = \tau_g / k` with the gear torque of the desired path, [J] (1).

    Sensors are mounted on the arm, encoders on the motors: a sensor value belongs to :math:`\hat q_a = q - \tau_g/k`.
    The torque comes from the path that the arm is following, not from the noisy motor current.

    Args:
        model: identified model; without a stiffness in it the deflection is zero.
        T: cycle of the desired positions [s].
    """

    def __init__(self, model: Model, T: float) -> None:
        self._chain, self._T = chain_of(model.dynamics), T
        stiffness = np.full(model.n, np.inf) if model.stiffness is None else model.stiffness
        self._compliance = np.where(np.isfinite(stiffness), 1.0 / stiffness, 0.0)

    def at(self, q_d: Array) -> Array:
        """Deflection ``(n,)`` [rad] one cycle after row 0 of the horizon ``q_d (n_d ≥ 3, n)`` [rad]."""
        if not self._compliance.any() or len(q_d) < 3:
            return np.zeros(q_d.shape[1])
        v = (q_d[2] - q_d[0]) / (2.0 * self._T)
        a = (q_d[2] - 2.0 * q_d[1] + q_d[0]) / self._T**2
        return np.asarray(self._compliance * inverse_dynamics(self._chain, q_d[1:2], v[None], a[None])[0])
