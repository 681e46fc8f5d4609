"""What the simulated arm refuses: postures and gears that cannot be."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.robots.robot import Robot
from sim.arm.kernel import P_ELASTIC, P_ROTOR, P_STIFFNESS
from sim.arm.world import STEP


def checked_posture(robot: Robot, q0: Array) -> Array:
    """A posture to start from, as a new array ``(n,)``.

    Raises:
        InputError: wrong size, not finite, outside the joint limits.
    """
    q = np.array(q0, dtype=float)
    if q.shape != (robot.n,) or not np.isfinite(q).all():
        raise InputError(f"expected {robot.n} finite joint angles", field="q0", value=q.tolist())
    if np.any(q < robot.q_min) or np.any(q > robot.q_max):
        raise InputError("posture is outside the joint limits", field="q0", value=np.round(q, 4).tolist())
    return q


def require_integrable(model: pin.Model, q: Array, p: Array) -> None:
    """Refuses gears whose fastest oscillation the 0.5 ms step cannot follow.

    The oscillations of links M, rotors J and springs K have the squared frequencies √K (M⁻¹ + J⁻¹) √K.

    Args:
        model: the true links.
        q: posture in which it is judged ``(n,)`` [rad].
        p: parameter block of the drives.

    Raises:
        InputError: beyond 1.2 / step, where semi-implicit integration is about to go wrong (its bound is 2 / step).
    """
    elastic = p[P_ELASTIC] > 0.0
    if not elastic.any():
        return
    mass = pin.crba(model, model.createData(), q)
    mass = np.triu(mass) + np.triu(mass, 1).T
    root = np.sqrt(p[P_STIFFNESS])
    rotor = np.where(elastic, 1.0 / np.where(elastic, p[P_ROTOR], 1.0), 0.0)
    fastest = float(np.sqrt(np.linalg.eigvalsh(root[:, None] * (np.linalg.inv(mass) + np.diag(rotor)) * root).max()))
    if fastest * STEP > 1.2:
        raise InputError(f"gears are too stiff for the {STEP * 1e3} ms step (fastest oscillation "
                         f"{fastest / 2 / np.pi:.0f} Hz); use inf for a rigid gear", field="world.stiffness")
