"""The arm changed by effects: its loads, stiffness of its gears, direction of gravity."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.dynamics.newton_euler import Chain, chain_of
from ideal_robot.effects import FittedEffect, LoopChange

Changes = list[tuple[FittedEffect, LoopChange]]


def changes_of(effects: tuple[FittedEffect, ...]) -> Changes:
    """The effects that act in the loop, each with its change."""
    every = [(effect, effect.effect.loop_change(effect.coefficients, effect.theta)) for effect in effects]
    return [(effect, change) for effect, change in every if not change.nowhere]


def chain_with(chain: Chain, changes: Changes) -> Chain:
    """The rigid body with bodies added to its links, changed gravity and changed joint zeros."""
    mass, com, inertia = chain.mass.copy(), chain.com.copy(), chain.inertia.copy()
    gravity, rotation, position = chain.gravity.copy(), chain.rotation.copy(), chain.position.copy()
    for effect, change in changes:
        # A body of the whole arm (joint 0) is added to the last link.
        j = int(chain.own[effect.joint - 1]) if effect.joint > 0 else -1
        if change.body:
            mass[j], com[j], inertia[j] = _joined_bodies(mass[j], com[j], inertia[j], change.body)
        if change.gravity is not None:
            gravity[:2] += change.gravity
        if change.zero:
            if chain.prismatic[j] > 0.5:
                position[j] += change.zero * rotation[j] @ chain.axis[j]
            else:
                rotation[j] = rotation[j] @ _turn(chain.axis[j], change.zero)
    return chain._replace(mass=mass, com=com, inertia=inertia, gravity=gravity, rotation=rotation, position=position)


def dynamics_with(dynamics: pin.Model, changes: Changes) -> pin.Model:
    """``chain_with`` for Pinocchio: a copy of a serial model."""
    if not changes:
        return dynamics.copy()
    model, chain = dynamics.copy(), chain_with(chain_of(dynamics), changes)
    for j in range(model.njoints - 1):
        model.inertias[j + 1] = pin.Inertia(float(chain.mass[j]), chain.com[j], chain.inertia[j])
        model.jointPlacements[j + 1] = pin.SE3(chain.rotation[j], chain.position[j])
    model.gravity.linear = chain.gravity
    return model


def stiffness_with(stiffness: Array, changes: Changes) -> Array:
    """Stiffness of the gears ``(n,)`` [N m/rad], changed from the known one; ``inf`` for rigid ones.

    An effect found in torques replaces the known compliance, as it is the whole compliance of the gear; later ones, and
    those found beyond the known deflection, are added. Arm angles take precedence over torques.
    """
    stiffness = np.array(stiffness, dtype=float)
    from_arm_angle = {effect.joint for effect, change in changes if change.from_arm_angle}
    replaced: set[int] = set()
    for effect, change in changes:
        j = effect.joint - 1
        if effect.joint in from_arm_angle and not change.from_arm_angle:
            continue
        compliance = 1.0 / stiffness[j] if np.isfinite(stiffness[j]) else 0.0
        if change.gear_compliance is not None:
            compliance = change.gear_compliance + (compliance if j in replaced else 0.0)
            replaced.add(j)
        elif change.further_compliance is not None:
            compliance += change.further_compliance
        else:
            continue
        stiffness[j] = 1.0 / compliance if compliance > 0.0 else np.inf
    return stiffness


def _joined_bodies(mass: float, com: Array, inertia: Array, body: tuple[float, ...]) -> tuple[float, Array, Array]:
    """Mass, centre and inertia about it of a link with a body of up to ten parameters, [G] (5), added at its origin."""
    m, x, y, z, xx, xy, yy, xz, yz, zz = (*body, *(0.0,) * (10 - len(body)))
    about = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    moment = mass * com + np.array([x, y, z])
    # A removed body may outweigh the identified link: the rest then has moments but no mass.
    total = max(mass + m, 1e-6)
    centre = moment / total
    sizes, axes = np.linalg.eigh(inertia + about + mass * _steiner(com) - total * _steiner(centre))
    # Poorly determined inertias of a body found in torques may be negative; those of a link must not be.
    return total, centre, np.asarray(axes * np.maximum(sizes, 1e-6) @ axes.T)


def _steiner(c: Array) -> Array:
    return np.asarray((c @ c) * np.eye(3) - np.outer(c, c))


def _turn(axis: Array, angle: float) -> Array:
    """Rodrigues' formula."""
    K = np.array([[0.0, -axis[2], axis[1]], [axis[2], 0.0, -axis[0]], [-axis[1], axis[0], 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K)


_SLOW = 5e-3
"""Where the direction of motion decides, the side changes about this speed [rad/s]."""


def side_of_gap(load: Array, qd: Array, gap_load: Array) -> Array:
    """Side of the backlash on which the motor pushes the arm ``(…, n)``, -1 … 1: by load or direction of motion.

    Args:
        load, qd: torque at the gear outputs [N m], and arm velocities [rad/s], ``(…, n)`` each.
        gap_load: load over which the backlash is crossed ``(n,)`` [N m]; 0 where the direction of motion decides.
    """
    width = np.where(np.asarray(gap_load) > 0.0, gap_load, 1.0)
    return np.asarray(np.where(np.asarray(gap_load) > 0.0, np.tanh(load / width), np.tanh(qd / _SLOW)))
