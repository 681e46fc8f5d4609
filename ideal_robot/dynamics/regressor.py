"""The rigid body as a linear form of its parameters: torque = A(q, qd, qdd) p, [G] (5) and (6).

Parameters are Pinocchio's ten per link, all links joined to a joint by fixed joints merged:
m [kg], mx my mz [kg m], Ixx Ixy Iyy Ixz Iyz Izz [kg m²] about the joint frame's origin and axes. The regressor is
compiled, which is about five times as fast as a call of Pinocchio a sample; Pinocchio is the reference of its test.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.dynamics.newton_euler import (
    Chain,
    _cross,
    _turned_back,
    chain_of,
    frames_of,
    inverse_dynamics,
    joint_frames,
)
from ideal_robot.jit import jit


@jit(inline="always")
def _axes_seen_behind(chain: Chain, i: int, R: Array, p: Array, z: Array, v: Array, x: Array) -> None:
    """Axes ``z``, ``v`` of the joints up to i as body i's frame sees them, from those seen by the body before it."""
    for j in range(i):
        _cross(z[j], p[i], x)
        for r in range(3):
            x[r] += v[j, r]
        _turned_back(R[i], x, v[j])
        for r in range(3):
            x[r] = z[j, r]
        _turned_back(R[i], x, z[j])
    slides = chain.prismatic[i] > 0.5
    for r in range(3):
        z[i, r] = 0.0 if slides else chain.ratio[i] * chain.axis[i, r]
        v[i, r] = chain.ratio[i] * chain.axis[i, r] if slides else 0.0


@jit(inline="always")
def _link_columns(z: Array, v: Array, j: int, w: Array, wd: Array, a: Array, row: Array) -> None:
    """What a body's ten parameters add to the torque of joint j, written to ``row (10,)``.

    With the body's angular velocity ω and the acceleration a of its frame's origin against gravity, and u = z × ω, the
    column of the mass is vᵀa, those of the first moments a × z + v × ω̇ + ω (vᵀω) - v (ωᵀω), that of I_ab
    z_a ω̇_b + u_a ω_b, symmetric in a and b.
    """
    w0, w1, w2, d0, d1, d2 = w[0], w[1], w[2], wd[0], wd[1], wd[2]
    a0, a1, a2 = a[0], a[1], a[2]
    ww = w0 * w0 + w1 * w1 + w2 * w2
    z0, z1, z2, v0, v1, v2 = z[j, 0], z[j, 1], z[j, 2], v[j, 0], v[j, 1], v[j, 2]
    u0, u1, u2 = z1 * w2 - z2 * w1, z2 * w0 - z0 * w2, z0 * w1 - z1 * w0
    vw = v0 * w0 + v1 * w1 + v2 * w2
    row[0] = v0 * a0 + v1 * a1 + v2 * a2
    row[1] = a1 * z2 - a2 * z1 + v1 * d2 - v2 * d1 + w0 * vw - v0 * ww
    row[2] = a2 * z0 - a0 * z2 + v2 * d0 - v0 * d2 + w1 * vw - v1 * ww
    row[3] = a0 * z1 - a1 * z0 + v0 * d1 - v1 * d0 + w2 * vw - v2 * ww
    row[4] = z0 * d0 + u0 * w0
    row[5] = z0 * d1 + z1 * d0 + u0 * w1 + u1 * w0
    row[6] = z1 * d1 + u1 * w1
    row[7] = z0 * d2 + z2 * d0 + u0 * w2 + u2 * w0
    row[8] = z1 * d2 + z2 * d1 + u1 * w2 + u2 * w1
    row[9] = z2 * d2 + u2 * w2


@jit()
def fill_columns(chain: Chain, q: Array, qd: Array, qdd: Array, place: Array, result: Array) -> None:
    """Adds the columns of the regressor to ``result (n, P, N)``: samples last, as filters along time want them.

    The torque about joint j's axis z that body i's wrench (f, m) makes is zᵀm + vᵀf, with v = z × (way from j to i); a
    prismatic joint has z = 0 and its axis for v. A joint coupled to a coordinate by a ratio has its axis times the
    ratio, and its torque is added to that coordinate's.

    Args:
        chain: kinematics and gravity; its inertias do not matter.
        q, qd, qdd: joint positions, velocities and accelerations ``(N, n)`` [rad, rad/s, rad/s²].
        place: where each of the ``10 b`` columns goes, -1 for unused columns.
        result: array to which the columns are added.
    """
    N, b = len(q), len(chain.mass)
    # Without coupled joints nothing has to be added up, which saves a fifth of the time.
    alone = b == q.shape[1]
    R, p = frames_of(chain)
    w, wd, a = np.empty(3), np.empty(3), np.empty(3)
    x, y, s = np.empty(3), np.empty(3), np.empty(3)
    z, v, row = np.empty((b, 3)), np.empty((b, 3)), np.empty(10)
    for k in range(N):
        joint_frames(chain, q[k], R, p)
        for r in range(3):
            w[r], wd[r], a[r] = 0.0, 0.0, -chain.gravity[r]
        for i in range(b):
            speed = chain.ratio[i] * qd[k, chain.coordinate[i]]
            acceleration = chain.ratio[i] * qdd[k, chain.coordinate[i]]
            # The frame's motion, as in ``torque_at``.
            _cross(wd, p[i], x)
            _cross(w, p[i], y)
            _cross(w, y, s)
            for r in range(3):
                a[r] += x[r] + s[r]
            _turned_back(R[i], a, x)
            _turned_back(R[i], w, y)
            _turned_back(R[i], wd, s)
            for r in range(3):
                a[r], w[r], wd[r] = x[r], y[r], s[r]
            axis = chain.axis[i]
            _cross(w, axis, x)
            for r in range(3):
                if chain.prismatic[i] > 0.5:
                    a[r] += 2.0 * x[r] * speed + axis[r] * acceleration
                else:
                    wd[r] += x[r] * speed + axis[r] * acceleration
                    w[r] += axis[r] * speed
            _axes_seen_behind(chain, i, R, p, z, v, x)
            for j in range(i + 1):
                _link_columns(z, v, j, w, wd, a, row)
                for c in range(10):
                    column = place[10 * i + c]
                    if column >= 0:
                        if alone:
                            result[j, column, k] = row[c]
                        else:
                            result[chain.coordinate[j], column, k] += row[c]


LINK_PARAMETERS = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
LINK_UNITS = ("kg", "kg m", "kg m", "kg m", *["kg m²"] * 6)


def regressor(model: pin.Model, q: Array, qd: Array, qdd: Array, columns: Sequence[int] | None = None) -> Array:
    """Regressor of the joint torques, [G] (5), for many samples.

    Args:
        model: the kinematics, a serial chain; its inertias do not matter.
        q, qd, qdd: joint positions, velocities and accelerations ``(N, n)`` [rad, rad/s, rad/s²; m for prismatic].
        columns: indices of the wanted columns; zeros for any beyond ``10 b``; all if None.

    Returns:
        ``A`` of shape ``(N, n, 10 b)``, of ``b`` links (``n`` where no joint follows another one), so that
        ``A @ link_parameters(model)`` are the torques ``(N, n)`` [N m]. In memory the samples of an element are
        neighbours: filters along time find them so.

    Raises:
        InputError: the model branches, or a joint has more than one degree of freedom.
    """
    count = 10 * (model.njoints - 1)
    wanted = np.arange(count) if columns is None else np.asarray(columns, dtype=int)
    place = np.full(count, -1)
    links = np.flatnonzero(wanted < count)
    place[wanted[links]] = links
    result = np.zeros((model.nv, len(wanted), len(q)))
    q, qd, qdd = (np.ascontiguousarray(values, dtype=float) for values in (q, qd, qdd))
    fill_columns(chain_of(model), q, qd, qdd, place, result)
    return result.transpose(2, 0, 1)


def link_parameters(model: pin.Model) -> Array:
    """The model's own inertias as parameters ``(10 b,)``."""
    return np.concatenate([inertia.toDynamicParameters() for inertia in list(model.inertias)[1:]])


def with_link_parameters(model: pin.Model, parameters: Array) -> pin.Model:
    """A copy of the model with other inertias ``(10 b,)``.

    They need not be physically possible: ``pin.rnea`` is linear in them whatever they are.
    """
    copy = model.copy()
    for i in range(1, model.njoints):
        m, *rest = parameters[10 * (i - 1) : 10 * i]
        # Pinocchio stores mass, centre of mass and central inertia; a massless link may still have first moments in a
        # linear solution, so zero is replaced by the smallest mass for which they can be written as m·c.
        mass = m if abs(m) > 1e-9 else 1e-9
        first = np.array(rest[:3])
        c = first / mass
        ixx, ixy, iyy, ixz, iyz, izz = rest[3:]
        about_origin = np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])
        skew = pin.skew(c)
        # The constructor rejects impossible bodies; the setters do not.
        body = pin.Inertia.Identity()
        central = about_origin + mass * skew @ skew
        body.mass, body.lever, body.inertia = mass, c, 0.5 * (central + central.T)
        copy.inertias[i] = body
    return copy


def torques(model: pin.Model, q: Array, qd: Array, qdd: Array) -> Array:
    """Inverse dynamics of the model's own inertias for many samples, ``(N, n)`` each.

    Args:
        model: kinematics and inertias.
        q, qd, qdd: joint positions, velocities and accelerations [rad, rad/s, rad/s²].
    """
    q, qd, qdd = (np.ascontiguousarray(values, dtype=float) for values in (q, qd, qdd))
    return inverse_dynamics(chain_of(model), q, qd, qdd)
