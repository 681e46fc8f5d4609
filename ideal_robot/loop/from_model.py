"""Makes the flat arrays for feedforward and simulation of the loop from an identified model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.dynamics.newton_euler import Chain, chain_of, frames_of, joint_frames, mass_matrix
from ideal_robot.effects import FittedEffect, Signals
from ideal_robot.errors import InputError
from ideal_robot.friction.table import Friction, braking, distance_with
from ideal_robot.loop.loop import Cascade, CommandPath, Compensation, Drives, Loop, checked, low_pass_taps
from ideal_robot.model.arm_with_effects import chain_with, changes_of, stiffness_with
from ideal_robot.model.model import Model
from ideal_robot.model.parametrisation import ControllerModel
from ideal_robot.robots.robot import Robot, spread_postures
from ideal_robot.tolerances import CREEP

# Rotor inertias with which the closed loop can be computed.
#
# For a base joint, motion determines only the sum of the rotor's inertia and that of its links. Without rotor inertia
# in the robot data, all of the sum may be assigned to the links, with a motor without inertia, which no simulation can
# follow. A share of the links' inertia is then assigned to the rotor; the sum, and with it the motor torque of a motion
# behind rigid gears, stays what was identified.

_SHARE = 0.5
"""Rotor inertia over the least inertia that the links hold against the joint, where the rotor is not known. Assumed:
gears are chosen so that both sides are alike."""


def with_rotors(chain: Chain, rotor_inertia: Array, q_min: Array, q_max: Array) -> tuple[Chain, Array]:
    """The chain and the rotor inertias ``(n,)``, each at least a fixed share of its joint's inertia.

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
    n = len(chain.armature)
    (R, p), M = frames_of(chain), np.empty((n, n))
    least = np.full(n, np.inf)
    for q in spread_postures(q_min, q_max):
        joint_frames(chain, q, R, p)
        mass_matrix(chain, R, p, M)
        least = np.minimum(least, 1.0 / np.diag(np.linalg.inv(M)))
    return np.asarray(least)


def with_effects(loop: Loop, effects: tuple[FittedEffect, ...]) -> Loop:
    """The loop with the effects that act in it, each by its ``Effect.loop_change``."""
    drives, friction = loop.drives, loop.friction
    sizes, per_load, presliding = friction.sizes.copy(), friction.per_load.copy(), np.zeros(loop.n)
    offset, rotor, gain = drives.offset.copy(), drives.rotor_inertia.copy(), drives.gain.copy()
    half_gap, gap_load = drives.half_gap.copy(), drives.gap_load.copy()
    ripples, uneven = [drives.ripple], [drives.uneven]
    changes = changes_of(effects)
    for effect, change in changes:
        j = effect.joint - 1
        if change.friction_curve:
            sizes[j] += _curve(effect, friction.speeds)
        if change.friction_shares is not None:
            dry, rising = change.friction_shares
            # The law's terms beyond dry friction at standstill rise with speed.
            still = np.array(sizes[:, :, :1])
            sizes += rising * (sizes - still) + dry * still
        per_load[j] += change.friction_per_load, change.friction_per_driven_load
        presliding[j] = max(presliding[j], change.presliding)
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
    braking(sizes)
    distance = np.maximum(distance_with(friction, sizes), presliding)
    return loop.changed(
        chain=chain_with(loop.chain, changes),
        friction=Friction(friction.speeds, sizes, np.maximum(per_load, 0.0), distance),
        drives=Drives(rotor, offset, gain, np.concatenate(ripples), stiffness_with(drives.stiffness, changes),
                      drives.damping, np.concatenate(uneven), half_gap, gap_load),
        terms=(*loop.terms, *(effect for effect, change in changes if change.torque)))


def _curve(effect: FittedEffect, speeds: Array) -> Array:
    """Dry and fluid friction of the effect at constant speeds ``(n, m)``, forward and backward ``(2, m, 2)`` [N m].

    At speed zero it is the limit from the side of the motion.
    """
    sizes = np.empty((2, speeds.shape[1], 2))
    for side, sense in enumerate((1.0, -1.0)):
        qd = sense * np.maximum(speeds, CREEP).T
        still = np.zeros_like(qd)
        signals = Signals(np.arange(float(len(qd))), still, qd, still, still, still, still)
        whole, fluid = (sense * effect.contribution(replace(signals, sliding=np.full_like(qd, direction)))
                        [:, effect.joint - 1] for direction in (sense, 0.0))
        sizes[side] = np.column_stack([whole - fluid, fluid])
    return sizes


_LAG_MAX = 0.01
"""Largest lag of the measured velocity that is believed [s]: a differentiator lags by some cycles of its loop, which
are of 0.25 to 2 ms."""
_FASTEST = 150.0
"""A gear on which the rotor would oscillate faster than this counts as rigid [Hz]: at the 14 Hz that are asked of
an arm its oscillation adds less than a hundredth of its twist."""


def loop_model(model: Model, robot: Robot, *, delay: int = 0) -> Loop:
    """The identified closed loop of an arm.

    Args:
        model: identified model; its controller is needed, its stiffness is optional (rigid gears without).
        robot: cycle times and limits.
        delay: cycles between hand-over of a command and the start of its interpolation, beyond those of the recording
            that the controller was identified from (the standard path planner in force or not, [G] 5.2.3).

    Raises:
        InputError: model and robot do not belong together, or the model has no controller.
    """
    model.require_arm(robot)
    controller = model.controller
    if controller is None:
        raise InputError("the model holds no controller; identify it from recordings with commands (q_c_i), or give "
                         "one with --controller (a file of data-sheet gains, or class for what arms usually have)",
                         field="controller")
    n = model.n
    k_v, k_ff, k_p, k_i = cascade_gains(controller)
    # The fraction of the delay beyond whole cycles, and the low-pass, form the command filter.
    identified = int(controller.delay / robot.t_ipo)
    whole, rest = delay + identified, controller.delay - identified * robot.t_ipo
    chain, rotor_inertia = with_rotors(chain_of(model.dynamics), np.array(model.rotor_inertia), robot.q_min,
                                       robot.q_max)
    none = np.zeros((0, 3, n))
    loop = Loop(
        chain,
        Drives(rotor_inertia, np.array(model.offset), np.ones(n), none, _elastic(model, rotor_inertia),
               np.zeros(n) if model.gears is None else model.gears.known_damping, none, np.zeros(n), np.zeros(n)),
        Friction.of(model.friction, robot.v_max),
        Cascade(k_v, k_ff, _or(controller.acceleration, np.zeros(n)) / k_p, controller.rate_filter, k_p, k_i,
                np.clip(controller.k_2 / k_p, 0.0, _LAG_MAX), robot.tau_max, controller.integrated),
        Compensation(_or(controller.compensation, np.zeros(n)), _or(controller.v_compensation, np.ones(n)),
                     _or(controller.bodies, np.zeros(n)), controller.schedule, controller.coupled,
                     _or(controller.scheduled_at, np.ones(n)), chain_of(robot.pinocchio), sheet_rotors(model, robot)),
        CommandPath(low_pass_taps(controller.filter_time, controller.filter_order, robot.t_position, n,
                                  dead_time=rest),
                    whole, robot.t_ipo, robot.t_position, robot.t_velocity, robot.q_min, robot.q_max, robot.v_max))
    if model.effects:
        loop = with_effects(loop, model.effects)
        chain, rotor_inertia = with_rotors(loop.chain, loop.drives.rotor_inertia, robot.q_min, robot.q_max)
        loop = loop.changed(chain=chain, rotor_inertia=rotor_inertia)
    return checked(loop)


def _or(value: Array | None, usual: Array) -> Array:
    return usual if value is None else value


def sheet_rotors(model: Model, robot: Robot) -> Array:
    """Rotor inertias of the data sheet ``(n,)`` [kg m²]; the identified ones where it has none."""
    return np.where(robot.rotor_inertia > 0.0, robot.rotor_inertia, np.maximum(model.rotor_inertia, 0.0))


def _elastic(model: Model, rotor_inertia: Array) -> Array:
    """Stiffness ``(n,)`` [N m/rad]; ``inf`` where it is not known or the gear is as good as rigid."""
    if model.gears is None:
        return np.full(model.n, np.inf)
    stiffness = model.gears.rigid_if_unknown
    return np.where(stiffness <= (2 * np.pi * _FASTEST) ** 2 * rotor_inertia, stiffness, np.inf)


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
