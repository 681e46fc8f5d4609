"""Rotors that turn rigidly with their links, which PyBullet has no term for."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from sim.arm.world import STEP


class RigidRotors:
    """Splits the torque of drives with rigid gears between links and rotors.

    The reflected rotor inertia J belongs on the diagonal of the mass matrix and nowhere else: added to the inertia of
    a link it would also load the joints before it. So the links get τ - J q̈, with

        (M + J) q̈ = τ + τ_touch - h(q, q̇)

    from Pinocchio's forward dynamics of the same links with rotors. What touches the arm is not known before the
    step; τ_touch is what the step before had too much: M q̈ + h less the torque it was given. Free motion is exact,
    contact is felt by the rotors half a millisecond late.

    Args:
        links: the true links.
        inertia: rotor inertia of the joints with rigid gears, 0 elsewhere ``(n,)`` [kg m²].
    """

    def __init__(self, links: pin.Model, inertia: Array) -> None:
        self._links, self._links_data = links, links.createData()
        self._with_rotors = links.copy()
        self._with_rotors.armature = inertia
        self._data = self._with_rotors.createData()
        self._inertia = inertia
        self._touch = np.zeros(len(inertia))

    def share(self, q: Array, qd: Array, torque: Array) -> None:
        """Takes from ``torque (n,)`` [N m], in place, what accelerates the rotors.

        Args:
            q: arm angles ``(n,)`` [rad].
            qd: arm velocities ``(n,)`` [rad/s].
            torque: of the drives ``(n,)`` [N m]; changed.
        """
        acceleration = pin.aba(self._with_rotors, self._data, q, qd, torque + self._touch)
        torque -= self._inertia * acceleration

    def feel(self, q: Array, qd: Array, qd_after: Array, torque: Array) -> None:
        """Learns what touched the links in a step from ``q, qd`` to velocity ``qd_after`` under ``torque (n,)``.

        Args:
            q: arm angles before the step ``(n,)`` [rad].
            qd: arm velocities before it ``(n,)`` [rad/s].
            qd_after: arm velocities after it ``(n,)`` [rad/s].
            torque: on the links during it ``(n,)`` [N m].
        """
        self._touch = pin.rnea(self._links, self._links_data, q, qd, (qd_after - qd) / STEP) - torque
