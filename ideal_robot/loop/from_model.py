"""From an identified model to the flat arrays that the feedforward and the simulation of the loop compute with."""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.dynamics.newton_euler import Chain, chain_of, inverse_dynamics, joint_frames, mass_matrix
from ideal_robot.effects import FittedEffect, Signals
from ideal_robot.errors import InputError
from ideal_robot.loop.loop_model import LoopModel, low_pass_taps, velocity_grid
from ideal_robot.model.arm_with_effects import chain_with, changes_of, stiffness_with
from ideal_robot.model.model import Model
from ideal_robot.model.parametrisation import ControllerModel
from ideal_robot.robots.robot import Robot, spread_postures

# Rotor inertias that the closed loop can be computed with.
#
# Of a base joint, motion tells the sum of the rotor's inertia and that of the links it moves, nothing more. Where the
# robot data have no rotor inertia either, all of the sum may have gone to the links: a motor without inertia behind its
# gear, which no drive is and no simulation can follow. A share of the links' inertia then counts to the rotor; the sum,
# and with it the motor torque of a motion behind rigid gears, stays what was identified.

_SHARE = 0.5
"""Rotor inertia over the least inertia that the links hold against the joint, where the rotor is not known."""


def with_rotors(chain: Chain, rotor_inertia: Array, q_min: Array, q_max: Array) -> tuple[Chain, Array]:
    """The chain and the rotor inertias ``(n,)``, none of them less than a share of what its joint moves.

    Args:
        chain: rigid bodies of the arm.
        rotor_inertia: as identified, reflected to the joint side ``(n,)`` [kg m², kg where a joint slides].
        q_min, q_max: position limits ``(n,)`` [rad or m].
    """
    least = _least_inertia(chain, q_min, q_max)
    short = rotor_inertia < 0.2 * _SHARE * least
    # The mass matrix stays positive definite as long as the shares add up to less than one.
    share = min(_SHARE, 0.8 / max(int(short.sum()), 1))
    moved = np.where(short, share * least - rotor_inertia, 0.0)
    return chain._replace(armature=chain.armature - moved), rotor_inertia + moved


def _least_inertia(chain: Chain, q_min: Array, q_max: Array) -> Array:
    """Least inertia ``(n,)`` that each joint feels of the links while the others are free, over postures."""
    n = len(chain.mass)
    R, p, M = np.empty((n, 3, 3)), np.empty((n, 3)), np.empty((n, n))
    least = np.full(n, np.inf)
    for q in spread_postures(q_min, q_max):
        joint_frames(chain, q, R, p)
        mass_matrix(chain, R, p, M)
        least = np.minimum(least, 1.0 / np.diag(np.linalg.inv(M)))
    return np.asarray(least)


def further_torque(loop: LoopModel, t: Array, q: Array, qd: Array, qdd: Array, load: Array, sliding: Array) -> Array:
    """Sum of the torques of ``loop.terms`` along a motion of the motors ``(N, n)`` [N m].

    Args:
        loop, t: the identified loop, and instants ``(N,)`` [s].
        q, qd, qdd: motor angles, velocities and accelerations ``(N, n)`` [rad, rad/s, rad/s²].
        load: torque at the gear outputs [N m].
        sliding: how far dry friction has turned since the last reversal, -1 to 1.
    """
    if not loop.terms:
        return np.zeros_like(q)
    signals = Signals(t, q, qd, qdd, load, load, np.zeros_like(load), sliding=sliding,
                      rigid=lambda q, qd, qdd: inverse_dynamics(loop.chain, q, qd, qdd))
    return np.asarray(np.sum([effect.contribution(signals) for effect in loop.terms], axis=0))


def with_effects(loop: LoopModel, effects: tuple[FittedEffect, ...]) -> LoopModel:
    """The loop with the effects added that act in it: each says where and by how much (``Effect.loop_change``)."""
    torque, load, bend = loop.friction_torque.copy(), loop.friction_load.copy(), loop.friction_bend.copy()
    driven = loop.friction_driven.copy()
    offset, rotor, gain = loop.offset.copy(), loop.rotor_inertia.copy(), loop.gain.copy()
    half_gap, gap_load = loop.half_gap.copy(), loop.gap_load.copy()
    ripples, uneven = [loop.ripple], [loop.uneven]
    changes = changes_of(effects)
    for effect, change in changes:
        j = effect.joint - 1
        if change.friction_curve:
            for side, sense in enumerate((1.0, -1.0)):
                torque[side] += sense * _curve(effect, sense * loop.friction_velocity)
        load[j] += change.friction_per_load
        driven[j] += change.friction_per_driven_load
        bend[j] = max(bend[j], change.presliding)
        offset[j] += change.offset
        gain[j] *= 1.0 + change.gain
        if change.rotor_inertia:
            rotor[j] = max(rotor[j] + change.rotor_inertia, 0.0)
        if change.half_gap:
            half_gap[j], gap_load[j] = max(half_gap[j] + change.half_gap, 0.0), change.gap_load
        for wave, rows in ((change.ripple, ripples), (change.uneven, uneven)):
            if wave is not None:
                rows.append(np.zeros((1, 3, loop.n)))
                rows[-1][0, :, j] = wave
    stiffness = stiffness_with(loop.stiffness, changes)
    return loop.replace(
        chain=chain_with(loop.chain, changes), friction_torque=np.maximum(torque, 0.0),
        friction_load=np.maximum(load, 0.0), friction_driven=np.maximum(driven, 0.0), friction_bend=bend,
        offset=offset, rotor_inertia=rotor, gain=gain, stiffness=stiffness, half_gap=half_gap, gap_load=gap_load,
        ripple=_joined(ripples, loop.n), uneven=_joined(uneven, loop.n),
        # Where there was no dry friction, what is found is all of it.
        friction_dry=np.where(loop.friction_torque[:, 0].mean(axis=0) > 0.0, loop.friction_dry,
                              np.where(torque[:, 0].mean(axis=0) > 0.0, torque[:, 0].mean(axis=0), 1.0)),
        terms=(*loop.terms, *(effect for effect, change in changes if change.torque)))


def _joined(rows: list[Array], n: int) -> Array:
    parts = [row for row in rows if len(row)]
    return np.concatenate(parts) if parts else np.zeros((0, 3, n))


def _curve(effect: FittedEffect, speeds: Array) -> Array:
    """The effect's torque at constant speeds ``(m, n)``; at speed zero the limit from the side that was asked for."""
    sense = 1.0 if float(speeds.sum()) >= 0.0 else -1.0
    qd = np.where(speeds == 0.0, sense * 1e-9, speeds)
    still = np.zeros_like(qd)
    return effect.contribution(Signals(np.arange(float(len(qd))), still, qd, still, still, still, still))


_LAG_MAX = 0.01
"""Largest lag of the measured velocity that is believed [s]."""
_FASTEST = 150.0
"""A gear on which the rotor would oscillate faster than this counts as rigid [Hz]."""


def loop_model(model: Model, robot: Robot, *, delay: int | None = None) -> LoopModel:
    """The identified closed loop of an arm.

    Args:
        model: identified model; its controller is needed, its stiffness is optional (rigid gears without).
        robot: cycle times and limits.
        delay: cycles between hand-over of a command and the start of its interpolation, where it is known better than
            identified (the standard path planner in force or not, [G] 5.2.3).

    Raises:
        InputError: model and robot do not belong together, or the model has no controller.
    """
    model.require_arm(robot)
    controller = model.controller
    if controller is None:
        raise InputError("the model holds no controller; identify it from recordings with commands (q_c_i)",
                         field="controller")
    n, laws = model.n, model.friction.laws
    grid = velocity_grid(robot.v_max)
    k_v, k_ff, k_p, k_i = cascade_gains(controller)
    whole = round(controller.delay / robot.t_ipo) if delay is None else delay
    # What the delay has beyond whole cycles, and the low-pass, make the command filter.
    rest = max(0.0, controller.delay - round(controller.delay / robot.t_ipo) * robot.t_ipo)
    chain, rotor_inertia = with_rotors(chain_of(model.dynamics), np.array(model.rotor_inertia), robot.q_min,
                                       robot.q_max)
    loop = LoopModel(
        chain=chain,
        rotor_inertia=rotor_inertia,
        friction_velocity=grid,
        friction_torque=_unloaded_friction(model, grid),
        friction_load=np.array([law.coefficients[-1, 0] if law.loaded else 0.0 for law in laws]),
        friction_bend=np.array([law.shape[-1, 0] if law.presliding else 0.0 for law in laws]),
        offset=np.array(model.offset),
        stiffness=_elastic(model, rotor_inertia),
        damping=np.zeros(n) if model.damping is None else np.array(model.damping),
        k_v=k_v, k_ff=k_ff, k_p=k_p, k_i=k_i,
        t_filter=np.clip(controller.k_2 / k_p, 0.0, _LAG_MAX),
        command_filter=low_pass_taps(controller.filter_time, controller.filter_order, robot.t_position, n,
                                     dead_time=rest),
        delay=whole,
        t_ipo=robot.t_ipo, t_position=robot.t_position, t_velocity=robot.t_velocity,
        tau_max=np.array(robot.tau_max), q_min=np.array(robot.q_min), q_max=np.array(robot.q_max),
        v_max=np.array(robot.v_max), ripple=np.zeros((0, 3, n)),
    )
    if not model.effects:
        return loop
    loop = with_effects(loop, model.effects)
    chain, rotor_inertia = with_rotors(loop.chain, loop.rotor_inertia, robot.q_min, robot.q_max)
    return loop.replace(chain=chain, rotor_inertia=rotor_inertia)


def _unloaded_friction(model: Model, grid: Array) -> Array:
    """What friction brakes with at the speeds ``grid (m, n)``, forward and backward ``(2, m, n)`` [N m]."""
    # At speed 0 the table holds the limit from above: what the joint has to overcome.
    speeds = np.maximum(grid, 1e-9)
    unloaded = np.stack([model.friction.torque(speeds), -model.friction.torque(-speeds)])
    return np.maximum(unloaded, 0.0)


def _elastic(model: Model, rotor_inertia: Array) -> Array:
    """Stiffness ``(n,)`` [N m/rad]; ``inf`` where none is known or the gear cannot be told from a rigid one."""
    if model.stiffness is None:
        return np.full(model.n, np.inf)
    # An unknown one (NaN) is not below the limit either.
    return np.where(model.stiffness <= (2 * np.pi * _FASTEST) ** 2 * rotor_inertia, model.stiffness, np.inf)


def cascade_gains(controller: ControllerModel) -> tuple[Array, Array, Array, Array]:
    """``k_v``, ``k_ff``, ``k_p``, ``k_i`` of the cascade ``u = k_v e + k_ff ė + (k_ff - 1) q̇``, ``τ = k_p u + k_i ∫u``.

    Comparing it with [G] (16), (17): ``k_D - k_1 = k_p``, ``k_D = k_p k_ff``, ``k_P = k_p k_v``. The term ``k_2 q̈`` of
    (16) is the first-order lag of the measured velocity, ``k_2 = k_p t_filter``.
    """
    k_p = controller.k_d - controller.k_1
    if np.any(k_p <= 0):
        raise InputError("the controller has no positive velocity gain k_d - k_1; identify it with faster motions",
                         field="controller", value=np.round(k_p, 3).tolist())
    return controller.k_p / k_p, controller.k_d / k_p, k_p, controller.k_i * k_p / controller.t_cycle
