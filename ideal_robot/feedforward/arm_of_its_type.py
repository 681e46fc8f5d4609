r"""The model of one arm from that of another of its type and one motion of this one.

Arms of a type have the same gears and controllers, but castings of other weight, and motors that are mounted with their
ripple at another angle. Both show in the torques of any motion:

.. math:: \tau - \tau_{model} = Y \Delta p + F(0) z \sum_k c_k \phi_k(|\dot q|) + \sum_k a_k \cos(k q) + b_k \sin(k q)

with Y the regressor of the links, rotors and offsets [G] (6), a curve over speed as in ``friction_curve``, and the
ripple's orders k those of the model. It is least squares with a prior: links are as heavy as the model's within some
percent, rotors nearly so, and a ripple is as large as the model's, at any angle. What the motion does not tell stays
as it was. What friction is wrong by is taken out, not kept: it changes while the arm works, and adaptation follows it.
A joint that rests, or has just turned round, is held by friction of any size up to the dry one: its torque tells
nothing. Links move as the arm does, behind its gears.

Whether it is another arm at all is asked first, by the probability of the torques under either (the evidence). What the
very arm leaves that the model was identified from, friction and a heavier tool explain as well, and its model stays
what it is: adaptation finds both.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
from scipy import linalg

from ideal_robot.arrays import Array
from ideal_robot.dynamics import full_regressor
from ideal_robot.dynamics.base_parameters import consistent_parameters, parameter_scales
from ideal_robot.effects import FittedEffect
from ideal_robot.errors import IdealRobotError, InputError
from ideal_robot.feedforward.friction_adaptation import unknown_mass
from ideal_robot.feedforward.friction_curve import SLIDES, SPEEDS, between_nodes, likeness
from ideal_robot.loop.loop_model import largest_speeds
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.preprocess import FilteredSignals, lowpass, preprocess
from ideal_robot.signals.recording import Recording

RIPPLE = "torque_ripple"
CUTOFF = 20.0
"""Of the low-pass on positions [Hz]. Decimated torques are slow enough for the controller to answer ripple fully."""
LINK, SHAPE, ROTOR = 0.1, 0.1, 0.03
"""Standard deviations of a link's weight, of single parameters of it over a body's of that size, and of a rotor."""
OFFSET, FRICTION = 0.03, 0.3
"""Of the offset and of what friction is wrong by at any speed, over dry friction. An offset that may be large takes
what is weight, which bends the gears."""
NOISE, DOUBT = 0.05, 0.15
"""Standard deviations of a torque over dry friction: of one, and where it is asked whose torques they are. Neighbouring
ones share what any model of the very arm is wrong by, and all of them together must not count for another arm."""


def arm_of_its_type(recording: Recording, model: Model, robot: Robot) -> Model:
    """The model of the arm that was recorded; ``model`` itself where no torques say that it is another arm.

    So it is where no bodies that can be explain them.

    Args:
        recording: a motion in free space of that arm, logged several times a cycle: ``t`` [s], ``q_i`` [rad], ``tau_i``
            [N m]. Read once a cycle, at its end, torques show less inertia than there is (``friction_adaptation``).
        model: of an arm of the same type.
        robot: the type.

    Raises:
        InputError: a recording of another number of joints, or too short.
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
    turned = model.friction.turned(s.q, s.qd)
    slides = np.abs(s.decimate(turned)) > SLIDES
    believed, doubted = (np.broadcast_to(np.maximum(share * dry, model.noise_std), slides.shape)[slides]
                         for share in (NOISE, DOUBT))
    arm = _behind_gears(s, model, turned * dry)
    bend = model.rigid_body(*arm) - model.rigid_body(s.q, s.qd, s.qdd)
    left = [s.decimate(s.tau - bend - one.inverse_dynamics(s.q, s.qd, s.qdd, t=s.t - s.t[0]))[slides]
            for one in (model, bare)]
    count = 12 * model.n
    root = _root(model, dry, ripple)
    columns = np.concatenate([s.decimate_motion(lambda rows: _bodies(s, model, arm, rows)),
                              s.decimate(_friction(s, turned, dry, robot)), s.decimate(_waves(s, ripple))],
                             axis=2)[slides]
    tool = columns[:, :count] @ _heavier_tool(model, dry, robot)
    columns = columns @ root
    offsets_and_friction = columns[:, count - model.n : count + len(SPEEDS) * model.n]
    if (_evidence(np.column_stack([offsets_and_friction, tool]) / doubted[:, None], left[0] / doubted)
            >= _evidence(columns / doubted[:, None], left[1] / doubted)):
        return model
    whitened = columns / believed[:, None]
    spread = np.linalg.inv(np.eye(root.shape[1]) + whitened.T @ whitened)
    likely = spread @ (whitened.T @ (left[1] / believed))
    found, covariance = root @ likely, root @ spread @ root.T
    base, waves = model.base, found[count + len(SPEEDS) * model.n :].reshape(-1, 2)
    values = model.base_values + base.of(found[:count])
    try:
        full = consistent_parameters(base, values, base.grouping @ covariance[:count, :count] @ base.grouping.T,
                                     _nearby(model, found[:count], likely[-model.n :])).full
    except IdealRobotError:  # no bodies that can be: torques of something else
        return model
    turned_ripple = tuple(replace(effect, coefficients=(float(a), float(b)), std=(), parameters=())
                          for effect, (a, b) in zip(ripple, waves, strict=True))
    return replace(bare, base_values=values, consistent=full, effects=(*bare.effects, *turned_ripple))


def _nearby(model: Model, found: Array, heavier: Array) -> Array:
    """Possible full parameters ``(12 n,)`` for what no motion tells, such as how a rotor and a link share an inertia.

    Args:
        model: of an arm of the type.
        found: likely differences from it ``(12 n,)``.
        heavier: what of them is a link's weight, over its standard deviation ``(n,)``.
    """
    n, full = model.n, np.array(model.consistent)
    full[: 10 * n] *= np.repeat(np.maximum(1.0 + LINK * heavier, 0.1), 10)
    full[10 * n :] += found[10 * n :]
    full[10 * n : 11 * n] = np.maximum(full[10 * n : 11 * n], 0.0)
    return full


def _heavier_tool(model: Model, dry: Array, robot: Robot) -> Array:
    """What a heavier tool adds to the parameters of the bodies ``(12 n,)``: one standard deviation of its mass."""
    kilogram = pin.Inertia(1.0, robot.tool_place, np.zeros((3, 3)))
    parameters = np.zeros(12 * model.n)
    parameters[10 * model.n - 10 : 10 * model.n] = kilogram.toDynamicParameters()
    return parameters * unknown_mass(dry)


def _dry(model: Model) -> Array:
    """Dry friction ``(n,)`` [N m]."""
    slow = np.full((1, model.n), 1e-9)
    return np.asarray(np.maximum(0.5 * (model.friction.torque(slow) - model.friction.torque(-slow))[0], 1e-6))


def _behind_gears(s: FilteredSignals, model: Model, friction: Array) -> tuple[Array, Array, Array]:
    """Position, velocity and acceleration of the arm, each ``(N, n)``, behind its gears as in ``smoothed_window``."""
    if model.stiffness is None:
        return s.q, s.qd, s.qdd
    transmitted = lowpass(s.tau, s.dt, s.cutoff) - model.rotor_inertia * s.qdd - model.offset - friction
    q = s.q - transmitted / model.stiffness
    qd = np.gradient(q, s.dt, axis=0)
    return q, qd, np.gradient(qd, s.dt, axis=0)


def _bodies(s: FilteredSignals, model: Model, arm: tuple[Array, Array, Array], rows: slice) -> Array:
    """What links, which move as the arm does, rotors and offsets count ``(k, n, 12 n)`` [N m]."""
    n = model.n
    q, qd, qdd = arm
    counts = full_regressor(model.kinematics, q[rows], qd[rows], qdd[rows])
    joint = np.arange(n)
    counts[:, joint, 10 * n + joint] = s.qdd[rows]
    return counts


def _friction(s: FilteredSignals, turned: Array, dry: Array, robot: Robot) -> Array:
    """What friction's curves count ``(N, n, K n)`` [N m]; it is ``turned (N, n)``, -1 to 1."""
    n = len(dry)
    columns = np.zeros((len(s.qd), n, n, len(SPEEDS)))
    v_max = largest_speeds(robot.v_max)
    for i in range(n):
        columns[:, i, i] = dry[i] * turned[:, i, None] * between_nodes(np.abs(s.qd[:, i]) / v_max[i])
    return columns.reshape(len(s.qd), n, len(SPEEDS) * n)


def _waves(s: FilteredSignals, ripple: tuple[FittedEffect, ...]) -> Array:
    """Cosine and sine of every ripple ``(N, n, 2 m)``."""
    columns = np.zeros((*s.q.shape, 2 * len(ripple)))
    for place, effect in enumerate(ripple):
        joint = effect.joint - 1
        phase = effect.theta[0] * s.q[:, joint]
        columns[:, joint, 2 * place], columns[:, joint, 2 * place + 1] = np.cos(phase), np.sin(phase)
    return columns


def _root(model: Model, dry: Array, ripple: tuple[FittedEffect, ...]) -> Array:
    """A root of the prior covariance ``(P, R)``: links, rotors, offsets, friction's curves, ripple."""
    n, full = model.n, np.array(model.consistent)
    bodies = np.zeros((12 * n, n))
    for i in range(n):
        bodies[10 * i : 10 * i + 10, i] = LINK * full[10 * i : 10 * i + 10]
    waves = np.repeat([np.linalg.norm(effect.coefficients) / np.sqrt(2.0) for effect in ripple], 2)
    single = np.concatenate([SHAPE * parameter_scales(full, n)[: 10 * n], ROTOR * full[10 * n : 11 * n], OFFSET * dry])
    curve = FRICTION * np.linalg.cholesky(likeness() + 1e-9 * np.eye(len(SPEEDS)))
    each = linalg.block_diag(np.diag(single), *[curve] * n, np.diag(waves))
    return np.hstack([each, np.vstack([bodies, np.zeros((len(each) - 12 * n, n))])])


def _evidence(columns: Array, left: Array) -> float:
    """Logarithm of the probability of torques ``(M,)`` that are noise and ``columns (M, R)`` of unit variance."""
    curvature = np.eye(columns.shape[1]) + columns.T @ columns
    x = np.linalg.solve(curvature, columns.T @ left)
    logarithm = float(np.linalg.slogdet(curvature)[1])
    return -0.5 * (float(left @ (left - columns @ x)) + logarithm)
