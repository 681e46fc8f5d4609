r"""Friction of one joint over one step of its motor, as the sum of dry and fluid friction.

**Convention.** Friction is positive where it brakes positive motion. It has two parts, whose sizes depend on velocity
and load:

* *dry* friction of size :math:`D(\dot q, \tau_g) \ge 0`, which goes with the *direction of sliding*. Before a contact
  slides it bends: its force F follows Dahl's model (P. R. Dahl 1968) over the position q,

  .. math:: \frac{dF}{dq} = \frac{D}{d} \Big(1 - \frac{F}{D}\,\mathrm{sign}\,\dot q\Big)
            \quad\Rightarrow\quad
            F(k) = s D + \big(F(k-1) - s D\big)\, e^{-|\Delta q| / d}, \qquad s = \mathrm{sign}\,\Delta q

  with the **presliding distance** d. Load leaves it: a contact that carries more has more places that touch, each as
  stiff as before, so the stiffness D/d grows with D, and a law stays linear. (LuGre's bristles are as stiff under any
  load. Measured arms do not decide: 25 predictions of a UR10e's torques differ by 0.5 ± 0.7 %. The simulated arm has
  LuGre's: by this convention ``ideal`` leaves 2 % more on the path ``edge`` and 6 % more on ``vertical_circle``,
  ``adapted`` no more.) What makes friction another one, temperature, wear, a cause that was found, leaves the stiffness
  (``ideal_robot.friction.table.distance_with``). F is the **presliding state** [N m]. It needs no time and no velocity,
  stays at rest as it is, and does not jump where D does. Where no presliding is known, d is zero and the force jumps
  with the direction of motion;
* *fluid* friction of size :math:`V(|\dot q|)`, which acts at once,

.. math:: \tau_f = F + V \,\mathrm{sign}\,\dot q .

F is linear in D. So a law that is linear in its coefficients, :math:`D = \sum_i c_i D_i`, stays so with presliding:
:math:`F = \sum_i c_i F_i`, each column with a state of its own. The state z of a unit of dry friction, -1 to 1, is the
**direction of sliding**.
"""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.jit import jit
from ideal_robot.tolerances import MOVED_BEFORE, PRESLIDING_BAND, ZERO_CROSSING


@jit()
def presliding_state(dry: float, v: float, state: float, step: float, distance: float) -> float:
    """Presliding state after a step [N m]; for ``dry`` = 1 it is the direction of sliding.

    Args:
        dry: size D at the velocity and load of the step [N m].
        v: velocity of the motor [rad/s]; its sign decides where dry friction jumps.
        state: torque before the step [N m].
        step: displacement of the motor [rad].
        distance: presliding distance [rad]; 0 where dry friction jumps.
    """
    if distance == 0.0:
        return dry * min(max(v / ZERO_CROSSING, -1.0), 1.0)
    if step == 0.0:
        return state
    end = dry if step > 0.0 else -dry
    behind = state - end
    # In gross sliding the difference is zero; skipping the exponential saves time.
    return end + behind * np.exp(-abs(step) / distance) if behind != 0.0 else end


@jit()
def slid(direction: Array, steps: Array, distance: Array) -> Array:
    """Directions of sliding ``(n,)``, -1 to 1, after a step of all joints: ``presliding_state`` of unit size.

    Args:
        direction: directions of motion before the step ``(n,)``.
        steps: displacements of the joints ``(n,)`` [rad].
        distance: presliding distance ``(n,)`` [rad]; where it is 0, the direction is that of the step.
    """
    after = np.empty_like(direction)
    for i in range(len(after)):
        after[i] = presliding_state(1.0, np.sign(steps[i]), direction[i], steps[i], distance[i])
    return after


@jit()
def friction_torque(dry: float, fluid: float, v: float, force: float, step: float, distance: float
                    ) -> tuple[float, float]:
    """Friction torque of a joint and its presliding state after a step [N m], by the equations of this module.

    Args:
        dry, v, step, distance: of ``presliding_state``.
        fluid: size V at the velocity of the step [N m]; it acts against the sign of ``v``.
        force: presliding state before the step [N m].
    """
    force = presliding_state(dry, v, force, step, distance)
    return force + (fluid if v > 0.0 else -fluid if v < 0.0 else 0.0), force


@jit()
def friction_of_sizes(dry: Array, fluid: Array, v: Array, steps: Array, start: Array, distance: Array
                      ) -> tuple[Array, Array]:
    """Friction torques and presliding states along a motion, ``(N, n)`` each [N m]: ``friction_torque`` row by row.

    Args:
        dry, fluid, v, steps: of ``friction_torque``, ``(N, n)`` each; the first step is not taken.
        start: presliding state in the first row ``(n,)`` [N m].
        distance: presliding distance ``(n,)`` [rad].
    """
    torque, force = np.empty_like(v), np.empty_like(v)
    for i in range(v.shape[1]):
        state = start[i]
        for k in range(len(v)):
            torque[k, i], state = friction_torque(dry[k, i], fluid[k, i], v[k, i], state,
                                                  steps[k, i] if k > 0 else 0.0, distance[i])
            force[k, i] = state
    return torque, force


# Measured positions.

def first_direction(qd: Array, distance: Array) -> Array:
    """Direction of sliding ``(n,)``, -1 to 1, in the first row of a motion.

    The joint is assumed to have moved for a tenth of a second before with the velocity of that row; at rest the
    direction is unknown and set to zero.

    Args:
        qd: velocities in the first row ``(n,)`` [rad/s].
        distance: presliding distance ``(n,)`` [rad].
    """
    # Squared, so that the noise of a velocity at rest has no influence.
    return np.asarray(np.sign(qd) * -np.expm1(-((qd * MOVED_BEFORE / distance) ** 2)))


@jit()
def measured_steps(q: Array, distance: Array) -> Array:
    """Steps ``(N, n)`` [rad] of measured positions with noise removed by a dead band; the first one is zero.

    Noise at rest would reduce the presliding state step by step. So only a motion counts that leaves a band of a
    twentieth of the presliding distance about the last position.

    Args:
        q: positions ``(N, n)`` [rad], consecutive in time.
        distance: presliding distance ``(n,)`` [rad].
    """
    steps = np.zeros_like(q)
    for j in range(q.shape[1]):
        band, last = PRESLIDING_BAND * distance[j], q[0, j]
        for k in range(1, len(q)):
            away = q[k, j] - last
            steps[k, j] = max(away - band, 0.0) + min(away + band, 0.0)
            last += steps[k, j]
    return steps


def sliding_direction(q: Array, qd: Array, distance: Array) -> Array:
    """Direction of sliding ``(N, n)``, -1 to 1, along measured positions.

    Args:
        q: positions ``(N, n)`` [rad or m], consecutive in time.
        qd: velocities ``(N, n)``; only the first row is used, see ``first_direction``.
        distance: presliding distance ``(n,)`` [rad or m].
    """
    q, distance = np.ascontiguousarray(q, dtype=float), np.asarray(distance, dtype=float)
    one, steps = np.ones_like(q), measured_steps(q, distance)
    start = first_direction(np.asarray(qd, dtype=float)[0], distance)
    return friction_of_sizes(one, 0.0 * one, steps, steps, start, distance)[1]


def dahl(q: Array, distance: float) -> Array:
    """Direction of sliding ``(N,)`` along exact positions ``(N,)`` of one joint, zero at first; no dead band."""
    one, steps = np.ones((len(q), 1)), np.diff(q, prepend=q[:1])[:, None]
    return np.asarray(friction_of_sizes(one, 0.0 * one, steps, steps, np.zeros(1), np.array([distance]))[1][:, 0])
