r"""Estimates friction at the speeds of a task, from the torques of a similar motion in free space.

Identification drives all joints fast, and a law of few coefficients fits there. A path of the tool moves some joints at
hundredths of a radian per second, where friction falls with speed before it rises, and reverses them. The missing
friction is, joint by joint, friction's terms and an offset of ``learned_friction``, solved for in batch. The direction
of sliding follows Dahl's model (``ideal_robot.friction.presliding``), whose distance is the one with the best fit.
Where the motion has no information, the prior keeps the loop unchanged.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.dynamics.newton_euler import inverse_dynamics
from ideal_robot.errors import InputError
from ideal_robot.estimate.recursive import GATE
from ideal_robot.feedforward.learned_friction import WEIGHT, estimated, evidence, noise_variance
from ideal_robot.friction.presliding import first_direction, measured_steps
from ideal_robot.friction.table import Friction, Presliding, friction_along, friction_sizes, largest_speeds
from ideal_robot.friction.terms import ALONE, TERMS, dry_sizes, friction_terms, table_terms, with_terms
from ideal_robot.loop.loop import Loop, further_torque, ripple_torque
from ideal_robot.signals.preprocess import FilteredSignals, preprocess
from ideal_robot.signals.recording import Recording

CUTOFF = 20.0
"""Of the low-pass on positions; torques up to half of it count [Hz], which a controller answers fully, ripple too."""
BENDS = (0.5, 0.6, 0.7, 0.85, 1.0, 1.2, 1.45, 1.7, 2.0)
"""Angles over which friction turns that are tried, over the loop's."""
BELIEVED = 0.4
"""Standard deviation of the logarithm of that before anything was measured."""


@dataclass(frozen=True)
class FrictionAtWork:
    """Deviations from the identified loop's friction: ``values (n, TERMS)`` of friction's terms.

    ``bend (n,)`` is a factor on the presliding distance [1].
    """

    values: Array
    bend: Array

    def in_loop(self, loop: Loop) -> Loop:
        """The identified loop with this friction."""
        friction = with_terms(loop.friction, table_terms(loop.friction, loop.path.v_max), self.values)
        return loop.changed(friction=friction._replace(distance=loop.friction.distance * self.bend))


def friction_at_work(recording: Recording, loop: Loop) -> FrictionAtWork:
    """Friction of every joint from a motion in free space in both directions at the speeds of the task.

    The recording has ``t`` [s], ``q_i`` [rad], ``tau_i`` [N m], ``loop`` is the identified one. Raises InputError for
    another arm's recording, one without torques, or one too short.
    """
    if recording.n != loop.n:
        raise InputError(f"the recording has {recording.n} joints, the loop has {loop.n}", file=recording.source,
                         field="q_i")
    s = preprocess(recording, cutoff=CUTOFF)
    if not np.isfinite(s.tau).all():
        raise InputError("friction is found from torques; they are missing", file=recording.source, field="tau_i")
    rigid = inverse_dynamics(loop.chain, s.q, s.qd, s.qdd)
    residual = _left(loop, s, rigid)
    fits = [_of_joint(loop, s, rigid[:, j], residual[:, j], j) for j in range(loop.n)]
    return FrictionAtWork(np.array([values for values, _ in fits]), np.array([bend for _, bend in fits]))


def _left(loop: Loop, s: FilteredSignals, rigid: Array) -> Array:
    """What is left of the torque for friction ``(M, n)`` [N m], decimated."""
    ripple = np.array([[ripple_torque(loop.drives.ripple, j, q) for j, q in enumerate(row)] for row in s.q])
    further = further_torque(loop, s.t - s.t[0], s.q, s.qd, s.qdd, rigid, np.sign(s.qd))
    return s.decimate((s.tau - further) / loop.drives.gain - rigid - loop.drives.rotor_inertia * s.qdd
                      - loop.drives.offset - ripple)


def _of_joint(loop: Loop, s: FilteredSignals, load: Array, residual: Array, j: int) -> tuple[Array, float]:
    """Values of friction's terms ``(TERMS,)`` of joint ``j`` and factor on the angle over which friction turns."""
    v, dry = s.qd[:, j], dry_sizes(loop.friction)[j]
    by_load = np.array([friction_sizes(loop.friction, j, *at)[0] - friction_sizes(loop.friction, j, at[0], 0.0)[0]
                        for at in zip(v, load, strict=True)])
    weight = np.full(len(v), WEIGHT * dry)
    std = np.sqrt(noise_variance(dry, s.factor * s.dt))
    best, values, factor = -np.inf, np.zeros(TERMS), 1.0
    for tried in BENDS if loop.friction.distance[j] > 0.0 else (1.0,):
        friction, z = _along(loop, s, load, j, tried)
        terms = dry * friction_terms(v / largest_speeds(loop.path.v_max)[j], z)
        terms[:, 0] += z * by_load
        columns = s.decimate(np.column_stack([ALONE * terms, weight])) / std
        solution = estimated(columns, (residual - s.decimate(friction)) / std)
        score = evidence(solution) - 0.5 * (np.log(tried) / BELIEVED) ** 2
        if score > best:
            best, values, factor = score, np.clip(solution.mean[:TERMS], -GATE, GATE), tried
    return ALONE * values, factor


def _along(loop: Loop, s: FilteredSignals, load: Array, j: int, bend: float) -> tuple[Array, Array]:
    """Friction of joint ``j`` [N m] and its direction of sliding ``(N,)``, presliding distance times a factor."""
    own = loop.friction._replace(distance=loop.friction.distance * bend)
    friction = Friction(*(np.ascontiguousarray(values[j : j + 1]) for values in own))
    v, load = np.ascontiguousarray(s.qd[:, [j]]), np.ascontiguousarray(load[:, None])
    if friction.distance[0] > 0.0:
        steps = measured_steps(np.ascontiguousarray(s.q[:, [j]]), friction.distance)
        start = first_direction(v[0], friction.distance)
    else:
        steps, start = np.zeros_like(v), np.zeros(1)
    before = Presliding(start * friction_sizes(friction, 0, v[0, 0], load[0, 0])[0], start)
    torque, states = friction_along(friction, v, load, steps, before)
    return torque[:, 0], states.direction[:, 0]
