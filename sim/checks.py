"""What the simulated arm refuses: postures, commands and gears that cannot be."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ideal_robot.errors import InputError, LimitError
from ideal_robot.interface import Array
from ideal_robot.robot import Robot
from sim.kernel import P_ELASTIC, P_ROTOR, P_STIFFNESS
from sim.world import STEP


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


def checked_command(robot: Robot, q_c: Array, before: Array, t_ipo: float) -> Array:
    """A command that the controller accepts, as a new array ``(n,)``.

    Raises:
        InputError: wrong size or not finite.
        LimitError: outside the joint limits, or more than twice the velocity limit away from the command before.
    """
    q = np.array(q_c, dtype=float)
    if q.shape != (robot.n,) or not np.isfinite(q).all():
        raise InputError(f"a command must be {robot.n} finite joint angles", field="q_c", value=q.tolist())
    outside = (q < robot.q_min) | (q > robot.q_max)
    if outside.any():
        j = int(np.argmax(outside))
        limit = robot.q_min[j] if q[j] < robot.q_min[j] else robot.q_max[j]
        raise LimitError(j + 1, "commanded angle [rad]", q[j], limit, "command angles within the joint limits")
    speed = np.abs(q - before) / t_ipo
    fast = speed > 2.0 * robot.v_max
    if fast.any():
        j = int(np.argmax(fast))
        raise LimitError(j + 1, "commanded velocity [rad/s]", speed[j], 2.0 * robot.v_max[j],
                         "hand over a path that starts where the arm is and keeps the velocity limits")
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
