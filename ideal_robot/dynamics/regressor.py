"""The rigid body as a linear form of its parameters: torque = A(q, qd, qdd) p, [G] (5) and (6).

Parameters are Pinocchio's ten per link, all links joined to a joint by fixed joints merged:
m [kg], mx my mz [kg m], Ixx Ixy Iyy Ixz Iyz Izz [kg m²] about the joint frame's origin and axes.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.dynamics.newton_euler import chain_of, inverse_dynamics
from ideal_robot.dynamics.serial_regressor import fill_columns

LINK_PARAMETERS = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
LINK_UNITS = ("kg", "kg m", "kg m", "kg m", *["kg m²"] * 6)


def regressor(model: pin.Model, q: Array, qd: Array, qdd: Array, columns: Sequence[int] | None = None) -> Array:
    """Regressor of the joint torques, [G] (5), for many samples.

    Args:
        model: the kinematics, a serial chain; its inertias do not matter.
        q: joint positions ``(N, n)`` [rad; m for prismatic].
        qd: joint velocities ``(N, n)`` [rad/s].
        qdd: joint accelerations ``(N, n)`` [rad/s²].
        columns: those wanted of the ``10 n``, zeros for any beyond; all if None.

    Returns:
        ``A`` of shape ``(N, n, 10 n)`` so that ``A @ link_parameters(model)`` are the torques ``(N, n)`` [N m]. In
        memory the samples of an element are neighbours: filters along time find them so.

    Raises:
        InputError: the model branches, or a joint has more than one degree of freedom.
    """
    wanted = np.arange(10 * model.nv) if columns is None else np.asarray(columns, dtype=int)
    place = np.full(10 * model.nv, -1)
    links = np.flatnonzero(wanted < 10 * model.nv)
    place[wanted[links]] = links
    result = np.zeros((model.nv, len(wanted), len(q)))
    q, qd, qdd = (np.ascontiguousarray(values, dtype=float) for values in (q, qd, qdd))
    fill_columns(chain_of(model), q, qd, qdd, place, result)
    return result.transpose(2, 0, 1)


def split_regressor(model: pin.Model, q: Array, qd: Array, qdd: Array) -> tuple[Array, Array, Array]:
    """The three parts of [G] (6): of ``M(q) qdd``, of ``c(q, qd)`` and of ``g(q)``, each ``(N, n, 10 n)``.

    Args:
        model: kinematics; its inertias do not matter.
        q: joint positions ``(N, n)`` [rad].
        qd: joint velocities ``(N, n)`` [rad/s].
        qdd: joint accelerations ``(N, n)`` [rad/s²].
    """
    still = np.zeros_like(q)
    gravity = regressor(model, q, still, still)
    inertia = regressor(model, q, still, qdd) - gravity
    velocity = regressor(model, q, qd, still) - gravity
    return inertia, velocity, gravity


def link_parameters(model: pin.Model) -> Array:
    """The model's own inertias as parameters ``(10 n,)``."""
    return np.concatenate([inertia.toDynamicParameters() for inertia in list(model.inertias)[1:]])


def with_link_parameters(model: pin.Model, parameters: Array) -> pin.Model:
    """A copy of the model with other inertias ``(10 n,)``.

    They need not be physically possible: ``pin.rnea`` is linear in them and asks for nothing more.
    """
    copy = model.copy()
    for i in range(1, model.njoints):
        m, *rest = parameters[10 * (i - 1) : 10 * i]
        # Pinocchio keeps mass, centre of mass and central inertia; a massless link may still carry first moments
        # in a linear solution, so the smallest mass that lets them be written as m·c stands in for zero.
        mass = m if abs(m) > 1e-9 else 1e-9
        first = np.array(rest[:3])
        c = first / mass
        ixx, ixy, iyy, ixz, iyz, izz = rest[3:]
        about_origin = np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])
        skew = pin.skew(c)
        # The constructor refuses what cannot be a body; the setters do not.
        body = pin.Inertia.Identity()
        central = about_origin + mass * skew @ skew
        body.mass, body.lever, body.inertia = mass, c, 0.5 * (central + central.T)
        copy.inertias[i] = body
    return copy


def torques(model: pin.Model, q: Array, qd: Array, qdd: Array) -> Array:
    """Inverse dynamics of the model's own inertias for many samples, ``(N, n)`` each.

    Args:
        model: kinematics and inertias.
        q: joint positions ``(N, n)`` [rad].
        qd: joint velocities ``(N, n)`` [rad/s].
        qdd: joint accelerations ``(N, n)`` [rad/s²].
    """
    q, qd, qdd = (np.ascontiguousarray(values, dtype=float) for values in (q, qd, qdd))
    return inverse_dynamics(chain_of(model), q, qd, qdd)
