r"""Adapts the model of another arm of the same type to this arm, from one motion of this arm.

Arms of a type have the same gears and controllers, but castings of other weight, and motors that are mounted with their
ripple at another angle. Both appear in the torques of any motion:

.. math:: \tau - \tau_{model} = Y \Delta p + F z f(|\dot q|)^T x + \sum_k a_k \cos(k q) + b_k \sin(k q)

with Y the regressor of the links, rotors and offsets [G] (6), friction's terms f, and the ripple's orders k those of
the model. These are normal equations of ``learned_friction``: links are as heavy as the model's within some percent,
rotors nearly so, and a ripple is as large as the model's, at any angle. Parameters that the motion does not determine
keep their values. Errors of friction are estimated but not kept, as friction changes and adaptation follows it. Rows in
which a joint rests, or has just reversed, are not used, as friction of any size up to the dry one may act. Links move
as the arm does, behind its gears.

Whether it is another arm at all is asked first, by the probability of the torques under either (the evidence). The very
arm that the model was identified from has the model's base parameters, as exactly as their covariance says [J] (16),
and its ripple; what friction and a heavier tool explain of its torques, adaptation finds. So its motion counts like one
more of those that the model was identified from.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.dynamics import full_regressor
from ideal_robot.dynamics.consistent_inertias import consistent_parameters, parameter_scales
from ideal_robot.effects import FittedEffect
from ideal_robot.errors import IdealRobotError, InputError
from ideal_robot.estimate.gaussian import Posterior
from ideal_robot.feedforward.friction_at_work import CUTOFF
from ideal_robot.feedforward.learned_friction import SLIDES, estimated, evidence, noise_variance, unknown_mass
from ideal_robot.friction.table import largest_speeds
from ideal_robot.friction.terms import OWN, SHARED, TERMS, friction_terms
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.filters import lowpass
from ideal_robot.signals.preprocess import FilteredSignals, preprocess
from ideal_robot.signals.recording import Recording

RIPPLE = "torque_ripple"
LINK, ROTOR = 0.1, 0.03
"""Standard deviations of a link's weight and of single parameters of it over a body's of that size, and of a rotor:
castings differ by some percent, what is wound and turned by less."""
OFFSET = 0.03
"""Of the offset over dry friction. One that may be large takes what is weight, which bends the gears."""


def arm_of_its_type(recording: Recording, model: Model, robot: Robot) -> Model:
    """The model adapted to the recorded arm; ``model`` itself where no possible bodies explain its torques.

    Raises InputError for a recording of another number of joints, or one that is too short.

    Args:
        recording: a motion in free space of that arm, logged several times a cycle: ``t`` [s], ``q_i`` [rad], ``tau_i``
            [N m]. Read once a cycle, at its end, torques show less inertia than there is (``friction_adaptation``).
        model, robot: of an arm of the same type, and the type.
    """
    if recording.n != model.n:
        raise InputError(f"the recording has {recording.n} joints, the model has {model.n}", file=recording.source,
                         field="q_i")
    s = preprocess(recording, cutoff=CUTOFF)
    if not np.isfinite(s.tau).all() or s.dt > 0.5 * robot.t_ipo:
        return model
    ripple = tuple(effect for effect in model.effects if effect.name == RIPPLE)
    bare = replace(model, effects=tuple(effect for effect in model.effects if effect.name != RIPPLE))
    dry = _dry(model)
    direction = model.friction.direction(s.q, s.qd)
    slides = np.abs(s.decimate(direction)) > SLIDES
    std = np.broadcast_to(np.sqrt(noise_variance(dry, s.factor * s.dt, model.noise_std)), slides.shape)[slides]
    arm = _behind_gears(s, model, direction * dry)
    bend = model.rigid_body(*arm) - model.rigid_body(s.q, s.qd, s.qdd)
    residuals = [s.decimate(s.tau - bend - variant.inverse_dynamics(s.q, s.qd, s.qdd, t=s.t - s.t[0]))[slides] / std
                 for variant in (model, bare)]
    layout, root, own = model.base.layout, _root(model, dry, robot), _own_root(model)
    # Prior of a ripple: the model's amplitude, at any angle.
    size = np.repeat([np.linalg.norm(effect.coefficients) / np.sqrt(2.0) for effect in ripple], 2)
    counts = s.decimate_motion(lambda rows: _bodies(s, model, arm, rows))[slides] / std[:, None]
    bodies = counts @ root
    friction = s.decimate(_friction(s, direction, dry, robot))[slides] / std[:, None]
    waves = s.decimate(_waves(s, ripple))[slides] / std[:, None] * size
    other = estimated(np.hstack([bodies, friction, waves]), residuals[1])
    # Hypothesis of the same arm: the model's uncertainty, an offset, friction and a heavier tool explain the residual.
    very = estimated(np.column_stack([counts[:, model.base.independent] @ own, bodies[:, layout.offsets],
                                      bodies[:, -1], friction]), residuals[0])
    try:
        if evidence(very) >= evidence(other):
            return _with_bodies(model, own, very, np.array(model.consistent))
        sizes = (size * other.mean[len(other.mean) - len(size) :]).reshape(-1, 2)
        waving = tuple(replace(effect, coefficients=(float(a), float(b)), std=(), parameters=())
                       for effect, (a, b) in zip(ripple, sizes, strict=True))
        return _with_bodies(replace(bare, effects=(*bare.effects, *waving)), model.base.grouping @ root, other,
                            _nearby(model, root @ other.mean[: root.shape[1]],
                                    other.mean[layout.size : layout.size + layout.bodies]))
    except IdealRobotError:  # impossible bodies: the torques have another cause
        return model


def _with_bodies(model: Model, root: Array, solution: Posterior, nearby: Array) -> Model:
    """The model with the base parameters of ``solution``, its first entries being factors of ``root``'s columns."""
    some = slice(root.shape[1])
    values = model.base_values + root @ solution.mean[some]
    full = consistent_parameters(model.base, values, root @ solution.covariance[some, some] @ root.T, nearby).full
    return replace(model, base_values=values, consistent=full)


def _nearby(model: Model, change: Array, heavier: Array) -> Array:
    """Physically possible full parameters ``(p,)``: values for what no motion determines, e.g. a rotor's share."""
    layout, full = model.base.layout, np.array(model.consistent)
    full[layout.links] *= np.repeat(np.maximum(1.0 + LINK * heavier, 0.1), 10)
    full[layout.rotors] = np.maximum(full[layout.rotors] + change[layout.rotors], 0.0)
    full[layout.offsets] += change[layout.offsets]
    return full


def _dry(model: Model) -> Array:
    """Dry friction ``(n,)`` [N m]."""
    return np.asarray(np.maximum(model.friction.dry, 1e-6))


class _ArmMotion(NamedTuple):
    """Positions, velocities and accelerations of the arm, ``(N, n)`` each."""

    q: Array
    qd: Array
    qdd: Array


def _behind_gears(s: FilteredSignals, model: Model, friction: Array) -> _ArmMotion:
    """Motion of the arm behind its gears as in ``smoothed_window``."""
    if model.known_stiffness is None:
        return _ArmMotion(s.q, s.qd, s.qdd)
    transmitted = lowpass(s.tau, s.dt, s.cutoff) - model.rotor_inertia * s.qdd - model.offset - friction
    q = s.q - transmitted / model.known_stiffness
    qd = np.gradient(q, s.dt, axis=0)
    return _ArmMotion(q, qd, np.gradient(qd, s.dt, axis=0))


def _bodies(s: FilteredSignals, model: Model, arm: _ArmMotion, rows: slice) -> Array:
    """What links, which move as the arm does, rotors and offsets count ``(k, n, p)`` [N m]."""
    counts = full_regressor(model.kinematics, arm.q[rows], arm.qd[rows], arm.qdd[rows])
    joint = np.arange(model.n)
    counts[:, joint, model.base.layout.rotors.start + joint] = s.qdd[rows]
    return counts


def _friction(s: FilteredSignals, direction: Array, dry: Array, robot: Robot) -> Array:
    """What friction's terms count, those that joints share and each joint's own ``(N, n, 2 + n TERMS)`` [N m]."""
    n, v_max = len(dry), largest_speeds(robot.v_max)
    columns = np.zeros((len(s.qd), n, 2 + n * TERMS))
    for i in range(n):
        terms = dry[i] * friction_terms(s.qd[:, i] / v_max[i], direction[:, i])
        columns[:, i, :2] = SHARED * terms[:, :2]
        columns[:, i, 2 + i * TERMS : 2 + (i + 1) * TERMS] = OWN * terms
    return columns


def _waves(s: FilteredSignals, ripple: tuple[FittedEffect, ...]) -> Array:
    """Cosine and sine of every ripple ``(N, n, 2 m)``."""
    columns = np.zeros((*s.q.shape, 2 * len(ripple)))
    for place, effect in enumerate(ripple):
        joint = effect.joint - 1
        phase = effect.theta[0] * s.q[:, joint]
        columns[:, joint, 2 * place], columns[:, joint, 2 * place + 1] = np.cos(phase), np.sin(phase)
    return columns


def _own_root(model: Model) -> Array:
    """A root of the covariance of the model's own base parameters ``(b, b)``."""
    covariance = model.covariance[: model.base.count, : model.base.count]
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    share = np.where(std > 0.0, std, 1.0)
    eigenvalues, vectors = np.linalg.eigh(covariance / np.outer(share, share))
    return np.asarray(std[:, None] * vectors * np.sqrt(np.maximum(eigenvalues, 0.0)))


def _root(model: Model, dry: Array, robot: Robot) -> Array:
    """A root of the covariance of bodies, rotors and offsets ``(p, p + links + 1)``; last come weights and the tool."""
    layout, full = model.base.layout, np.array(model.consistent)
    single = np.concatenate([LINK * parameter_scales(full, layout)[layout.links], ROTOR * full[layout.rotors],
                             OFFSET * dry])
    weights, tool = np.zeros((layout.size, layout.bodies)), np.zeros(layout.size)
    for i in range(layout.bodies):
        weights[layout.link(i), i] = LINK * full[layout.link(i)]
    kilogram = pin.Inertia(1.0, robot.tool_place, np.zeros((3, 3)))
    tool[layout.carried_by(0)] = unknown_mass(dry) * kilogram.toDynamicParameters()
    return np.column_stack([np.diag(single), weights, tool])
