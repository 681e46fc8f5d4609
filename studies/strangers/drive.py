"""What happens in a drive, compiled: the controller, the level of dry friction, and torques that effects add.

Engines differ in how bodies, springs and standstill are integrated; what a drive does with a current is the same in
three of them, another make in the fourth (``observer_step``). The formulas are not those of the effect library on
purpose, where nature leaves a choice.
"""

from __future__ import annotations

import math

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.jit import jit
from studies.strangers.arm import STEP

# Rows of the parameter block, columns are joints. Dry friction:
(COULOMB, SURPLUS, V_SURPLUS, SURPLUS_SHAPE, DRY_THERMAL, THERMAL_TIME, LOAD, DRIVING, PLACE, PLACE_ORDER, DRAG,
 DRAG_AXIS, DRAG_FROM, DRAG_SIDE) = range(14)
# Friction of the fluid:
(VISCOUS, VISCOUS_SIDE, DEGRESSIVE, V_DEGRESSIVE, VISCOUS_THERMAL) = range(14, 19)
# Torques that depend on place or time:
(RIPPLE, RIPPLE_ORDER, PHASE, CABLE, CABLE_REST, HARDENING, BUMP, BUMP_AT, BUMP_WIDTH, HOSE, HOSE_FROM, HOSE_SIDE,
 PULSE, PULSE_RATE) = range(19, 33)
# What is commanded against what acts:
(GAIN, OFFSET) = range(33, 35)
# Controller:
(C_KV, C_KFF, C_KP, C_KI, C_LIMIT, C_FILTER) = range(35, 41)
# Drive of the other make: inertia it reckons with [kg m²], bandwidths of its loop and of its observer [rad/s], time
# constant of its current loop [s], step of its encoder [rad].
(O_INERTIA, O_PACE, O_WATCH, O_CURRENT, O_COUNT) = range(41, 46)
ROWS = 46
# Rows of the result of ``drive_step``: torque the controller believes in, torque that acts on the rotor, level of dry
# friction, coefficient of fluid friction.
(BELIEVED, ACTING, LEVEL, FLUID) = range(4)
RESULTS = 4
# Rows of the controller's state: filtered velocity, last position, integral, torque.
STATES = 4
# The same of the other make: estimates of position, velocity and disturbing acceleration, torque of the next cycle and
# of this one, torque by the current that flows.
(SEEN_Q, SEEN_V, DISTURBED, NEXT, NOW, CURRENT) = range(6)
OBSERVER_STATES = 6
# Maxwell slip: four elements, each a spring that slides at a share of the level. After a reversal all slide at
# twice their own way; together they then follow Dahl's curve of the joint's way, in straight pieces.
_ELEMENT_WAY = np.array([0.125, 0.375, 0.75, 1.5])
_ELEMENT_SHARE = np.array([0.068, 0.210, 0.276, 0.446])
ELEMENTS = 4


def parameters(n: int) -> Array:
    """An empty block ``(ROWS, n)``: no friction, no effect, no gain errors; scales at which nothing divides by zero."""
    block = np.zeros((ROWS, n))
    for row in (V_SURPLUS, V_DEGRESSIVE, THERMAL_TIME, BUMP_WIDTH, GAIN):
        block[row] = 1.0
    block[SURPLUS_SHAPE] = 2.0
    block[DRAG_AXIS] = -1.0
    block[C_LIMIT] = np.inf
    return block


@jit(inline="always")
def dry_level(P: Array, j: int, t: float, q: Array, v: float, load: float) -> float:
    """Level of dry friction of a joint [N m]: what it is once the joint slides.

    Args:
        P: parameter block ``(ROWS, n)``.
        j: joint, from 0.
        t: time, for warming up [s].
        q: motor positions on the joint side ``(n,)`` [rad].
        v: velocity of the joint [rad/s].
        load: torque at the gear's output [N m].
    """
    warm = 1.0 - math.exp(-t / P[THERMAL_TIME, j])
    level = P[COULOMB, j] * (1.0 - P[DRY_THERMAL, j] * warm)
    if P[SURPLUS, j] != 0.0:
        ratio = abs(v) / P[V_SURPLUS, j]
        shape = P[SURPLUS_SHAPE, j]
        level += P[SURPLUS, j] * (1.0 / (1.0 + ratio * ratio) if shape == 0.0 else math.exp(-(ratio**shape)))
    level += P[LOAD, j] * abs(load)
    if load * v > 0.0:
        level += P[DRIVING, j] * abs(load)
    if P[PLACE, j] != 0.0:
        level += P[PLACE, j] * (1.0 + math.sin(P[PLACE_ORDER, j] * q[j] + P[PHASE, j]))
    other = int(P[DRAG_AXIS, j])
    if other >= 0:
        level += P[DRAG, j] * max(0.0, P[DRAG_SIDE, j] * (q[other] - P[DRAG_FROM, j]))
    return max(level, 0.0)


@jit(inline="always")
def fluid(P: Array, j: int, t: float, v: float) -> float:
    """Fluid friction over velocity [N m s/rad]; always positive, so that engines can take it implicitly.

    Args:
        P: parameter block ``(ROWS, n)``.
        j: joint, from 0.
        t: time, for warming up [s].
        v: velocity of the joint [rad/s].
    """
    warm = 1.0 - math.exp(-t / P[THERMAL_TIME, j])
    side = P[VISCOUS_SIDE, j] if v > 0.0 else 0.0
    return max(P[VISCOUS, j] * (1.0 - P[VISCOUS_THERMAL, j] * warm) + side
               + P[DEGRESSIVE, j] / (P[V_DEGRESSIVE, j] + abs(v)), 0.0)


@jit(inline="always")
def resisted(P: Array, j: int, t: float, q: float) -> float:
    """Torque of place and time that the motor works against [N m].

    Args:
        P: parameter block ``(ROWS, n)``.
        j: joint, from 0.
        t: time [s].
        q: position of the joint [rad].
    """
    torque = 0.0
    if P[RIPPLE, j] != 0.0:
        angle = P[RIPPLE_ORDER, j] * q
        torque += P[RIPPLE, j] * (math.cos(angle + P[PHASE, j]) + 0.15 * math.cos(2.0 * angle))
    if P[CABLE, j] != 0.0:
        x = q - P[CABLE_REST, j]
        torque += P[CABLE, j] * x * (1.0 + P[HARDENING, j] * x * x)
    if P[BUMP, j] != 0.0:
        x = (q - P[BUMP_AT, j]) / P[BUMP_WIDTH, j]
        torque += P[BUMP, j] * math.exp(-x * x) * (1.0 + 1.5 * math.tanh(x))
    if P[HOSE, j] != 0.0:
        x = max(0.0, P[HOSE_SIDE, j] * (q - P[HOSE_FROM, j]))
        torque += P[HOSE, j] * P[HOSE_SIDE, j] * (x + 2.0 * x * x)
    if P[PULSE, j] != 0.0:
        torque += P[PULSE, j] * math.tanh(3.0 * math.sin(2.0 * math.pi * P[PULSE_RATE, j] * t + P[PHASE, j]))
    return torque


@jit()
def drive_step(k: int, every: int, P: Array, x: Array, moved: Array, wanted: Array, out: Array) -> None:
    """One step of all drives.

    Args:
        k: number of the step.
        every: steps per cycle of the controller.
        P: parameter block ``(ROWS, n)``.
        x: state of the controller ``(STATES, n)``, changed in place.
        moved: motor position on the joint side [rad], torque at the gear's output [N m], motor velocity on the joint
            side [rad/s], ``(3, n)``.
        wanted: desired position [rad] and velocity [rad/s], torque added ahead of the loops [N m], ``(3, n)``.
        out: ``(RESULTS, n)``, the result.
    """
    t, q, load, v = k * STEP, moved[0], moved[1], moved[2]
    for j in range(q.shape[0]):
        if k == 0:
            x[1, j] = q[j]
            x[3, j] = wanted[2, j]
        if k % every == 0:
            dt = every * STEP
            x[0, j] += P[C_FILTER, j] * ((q[j] - x[1, j]) / dt - x[0, j])
            x[1, j] = q[j]
            error = P[C_KV, j] * (wanted[0, j] - q[j]) + P[C_KFF, j] * wanted[1, j] - x[0, j]
            torque = wanted[2, j] + P[C_KP, j] * error + x[2, j]
            limit = P[C_LIMIT, j]
            if abs(torque) <= limit:
                x[2, j] += P[C_KI, j] * dt * error
            x[3, j] = min(max(torque, -limit), limit)
        # An offset and a gain of the current measurement: the controller works with what it reads.
        out[BELIEVED, j] = x[3, j]
        out[ACTING, j] = (x[3, j] - P[OFFSET, j]) / P[GAIN, j] - resisted(P, j, t, q[j])
        out[LEVEL, j] = dry_level(P, j, t, q, v[j], load[j])
        out[FLUID, j] = fluid(P, j, t, v[j])


@jit()
def observer_step(k: int, every: int, P: Array, x: Array, moved: Array, wanted: Array, out: Array) -> None:
    """One step of all drives of the other make: state feedback that takes off what a disturbance observer sees.

    Linear active disturbance rejection, its bandwidths being its only gains (Gao 2003); the observer is the discrete
    current one (Miklosovic, Radke & Gao 2006). It reads its encoder's steps, its torque is set a cycle later, and a
    current loop follows. The current that flows is what the drive reports.

    Args:
        k: number of the step.
        every: steps per cycle of the controller.
        P: parameter block ``(ROWS, n)``.
        x: state of the controller ``(OBSERVER_STATES, n)``, changed in place.
        moved: as for ``drive_step``.
        wanted: desired position, velocity and acceleration ``(3, n)`` [rad, s].
        out: ``(RESULTS, n)``, the result.
    """
    t, q, load, v, dt = k * STEP, moved[0], moved[1], moved[2], every * STEP
    for j in range(q.shape[0]):
        if k % every == 0:
            pace, pole = P[O_PACE, j], math.exp(-P[O_WATCH, j] * dt)
            pushed = x[CURRENT, j] / P[O_INERTIA, j] + x[DISTURBED, j]
            predicted = x[SEEN_Q, j] + dt * x[SEEN_V, j] + 0.5 * dt * dt * pushed
            error = P[O_COUNT, j] * round(q[j] / P[O_COUNT, j]) - predicted
            x[SEEN_Q, j] = predicted + (1.0 - pole**3) * error
            x[SEEN_V, j] += dt * pushed + 1.5 / dt * (1.0 - pole) ** 2 * (1.0 + pole) * error
            x[DISTURBED, j] += (1.0 - pole) ** 3 / dt**2 * error
            x[NOW, j] = x[NEXT, j]
            x[NEXT, j] = P[O_INERTIA, j] * (wanted[2, j] + pace * pace * (wanted[0, j] - x[SEEN_Q, j])
                                            + 2.0 * pace * (wanted[1, j] - x[SEEN_V, j]) - x[DISTURBED, j])
        x[CURRENT, j] += (1.0 - math.exp(-STEP / P[O_CURRENT, j])) * (x[NOW, j] - x[CURRENT, j])
        out[BELIEVED, j] = x[CURRENT, j]
        out[ACTING, j] = (x[CURRENT, j] - P[OFFSET, j]) / P[GAIN, j] - resisted(P, j, t, q[j])
        out[LEVEL, j] = dry_level(P, j, t, q, v[j], load[j])
        out[FLUID, j] = fluid(P, j, t, v[j])


@jit()
def slipped(level: Array, way: Array, damping: Array, v: Array, x: Array, out: Array) -> None:
    """Friction of Maxwell's elements in the next step (Al-Bender, Lampaert & Swevers 2005): its memory is not local.

    Args:
        level: of dry friction ``(n,)`` [N m].
        way: after a reversal, over which most of the level is turned ``(n,)`` [rad].
        damping: of the elements that stick, were it all of them ``(n,)`` [N m s/rad].
        v: velocity ``(n,)`` [rad/s].
        x: force of each element over its share of the level, -1 … 1, ``(ELEMENTS, n)``, changed in place.
        out: ``(n,)``, the result [N m].
    """
    for j in range(v.shape[0]):
        out[j] = 0.0
        for i in range(ELEMENTS):
            pulled = x[i, j] + v[j] * STEP / (_ELEMENT_WAY[i] * way[j])
            x[i, j] = min(max(pulled, -1.0), 1.0)
            out[j] += _ELEMENT_SHARE[i] * (level[j] * x[i, j] + (damping[j] * v[j] if x[i, j] == pulled else 0.0))
