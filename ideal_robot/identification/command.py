"""Identifies the command's law of all joints, with an identified model's torque or from commands and angles alone."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy.interpolate import CubicSpline

from ideal_robot.arrays import Array, held, interpolated
from ideal_robot.command.fit import (
    FittedJoint,
    Stretch,
    blocks_of,
    fit_joint,
    folds,
    probabilities,
    tones,
    variances,
    with_error,
)
from ideal_robot.command.law import PARTS, Column, CommandLaw, JointLaw, Shape
from ideal_robot.command.motion import Bodies, Motion
from ideal_robot.command.recorded import command_cycle, commands_of, stretches_of, usual_cutoff
from ideal_robot.command.response import REST, position_response
from ideal_robot.errors import IdealRobotError, InputError
from ideal_robot.estimate.score import leaves_less
from ideal_robot.identification.checks import STILL
from ideal_robot.loop.from_model import loop_model
from ideal_robot.loop.loop import Loop
from ideal_robot.loop.simulation import simulate
from ideal_robot.model.model import Model
from ideal_robot.progress import Progress, silent
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.filters import lowpass
from ideal_robot.signals.recording import Recording

_COPIED = 1e-9
"""Commands that differ from the measured angles by less are these angles [rad, m]."""
_FOLLOWS = 0.5
"""Share of a command's motion that the law leaves, from which on the joint does not follow it."""
_STEPS = 1e4
"""What ``q_c - q`` is resolved to at least, over its own size; below, nothing is to be corrected."""


_EXCITED = 1e-4
"""Directions of the parameters that move the torque by less than this share of the strongest stay as they are."""


def identify_command(recordings: Sequence[Recording], model: Model, *, torque: bool,
                     progress: Progress = silent) -> CommandLaw:
    """The law of each joint that predicts its commands best.

    Args:
        recordings: with ``q_i`` and ``q_c_i`` (or ``q_d_i``); with ``tau_i`` where ``torque``.
        model: the identified model, or one of the data sheet.
        torque: whether the model's torque is identified, so that the law may have terms of it.
        progress: called with the share done.

    Raises:
        InputError: no commands, commands that are the measured angles, or that the joints do not follow.
    """
    name = commands_of(recordings[0]) if recordings else ""
    if not name:
        raise InputError("no commands; q_c_1, … or q_d_1, … are needed for the command's law",
                         file=recordings[0].source if recordings else None, field="q_c_1")
    for recording in recordings:
        require_commands(recording, name)
    cutoff = usual_cutoff(recordings)
    bodies = Bodies.of(model.dynamics, model.rotor_inertia)
    stretches = stretches_of(recordings, name, cutoff=cutoff, bodies=bodies, torque=(
        lambda t, q, qd, qdd, f: model.inverse_dynamics(q, qd, qdd, t=t - t[0], cutoff=f)) if torque else None)
    if torque and np.any(model.noise_std):
        stretches = _with_unseen(stretches, model, cutoff)
    q = np.concatenate([s.motion.q for s in stretches])
    law = CommandLaw((), command_cycle(recordings, name), stretches[0].motion.still,
                     0.5 * (q.max(axis=0) + q.min(axis=0)), np.maximum(0.5 * np.ptp(q, axis=0), 1e-9),
                     "model" if torque else "none")
    joints: list[FittedJoint] = []
    for j in range(model.n):
        progress(j / model.n, f"command of joint {j + 1}")
        if max(float(np.ptp(s.motion.q[:, j])) for s in stretches) < STILL:
            own = JointLaw(Shape(), (Column("offset"),), np.zeros(1), np.zeros((1, 1)), np.zeros(PARTS), 0.0, 0.0)
            joints.append(FittedJoint(own, tuple(np.zeros(len(s.rows)) for s in stretches)))
            continue
        fitted = fit_joint(stretches, j, law)
        own = fitted.law
        moved = float(np.std(np.concatenate([s.command[s.rows, j] for s in stretches])))
        if own.residual > _FOLLOWS * moved and moved > _STEPS * _COPIED:
            raise InputError(f"the joint does not follow this command: the best law leaves {1e3 * own.residual:.3g} "
                             f"mrad or mm of a motion of {1e3 * moved:.3g}; is it of another joint, of another run, or "
                             "in another unit?", file=recordings[0].source, field=f"{name}_{j + 1}")
        joints.append(fitted)
    law = dataclasses.replace(law, joints=tuple(fitted.law for fitted in joints))
    return _with_errors(law, joints, stretches, bodies, model)


def _with_unseen(stretches: Sequence[Stretch], model: Model, cutoff: float) -> list[Stretch]:
    """The stretches with torques of models that were not identified from the fold that they are to predict.

    A model predicts what it was identified from too well. From the identified one, a step of least squares over the
    other fold's rows leads to what would have been identified from them.

    Args:
        stretches, model: of the recordings, and what was identified from all of them.
        cutoff: of the low-pass of the stretches [Hz].
    """
    noise = np.maximum(model.noise_std, 1e-9 * np.max(model.noise_std))
    counts = [len(s.rows) for s in stretches]
    each_fold = np.split(folds(blocks_of(counts)), np.cumsum([count + 1 for count in counts])[:-1])
    columns, left = [], []
    for s in stretches:
        m = s.motion
        assert m.torque is not None
        assert s.used.torque is not None
        columns.append(lowpass(model.sensitivity(m.q, m.qd, m.qdd), m.dt, cutoff) / noise[:, None])
        left.append((m.torque - s.used.torque) / noise)
    torques = []
    for held_out in range(2):
        kept = [s.rows[fold[:-1] != held_out] for s, fold in zip(stretches, each_fold, strict=True)]
        X = np.concatenate([x[rows].reshape(-1, x.shape[2]) for x, rows in zip(columns, kept, strict=True)])
        y = np.concatenate([x[rows].ravel() for x, rows in zip(left, kept, strict=True)])
        # A torque that does not measure its joint is not used.
        X, y = X[np.isfinite(y)], y[np.isfinite(y)]
        size = np.maximum(np.linalg.norm(X, axis=0), 1e-300)
        step = np.linalg.lstsq(X / size, y, rcond=_EXCITED)[0] / size
        torques.append([s.used.with_torque(s.used.torque + noise * (x @ step))
                        for s, x in zip(stretches, columns, strict=True)])
    return [dataclasses.replace(s, unseen=both) for s, *both in zip(stretches, *torques, strict=True)]


def _with_errors(law: CommandLaw, joints: Sequence[FittedJoint], stretches: Sequence[Stretch], bodies: Bodies,
                 model: Model) -> CommandLaw:
    """The law with the position error of its commands: its residual as the closed loop answers it."""
    dt = stretches[0].motion.dt
    ahead = np.array([own.shape.ahead for own in law.joints])
    after = int(np.ceil(law.ahead / dt)) + 1

    def required(q: Array) -> Array:
        motion = Motion.of(held(q, after=after), dt, law.still, bodies)
        if law.torque == "model":
            motion = motion.with_torque(model.inverse_dynamics(motion.q, motion.qd, motion.qdd))
        return law.commands(motion, len(q), ahead)

    speed = np.maximum(np.std(np.concatenate([s.motion.qd for s in stretches]), axis=0), 10.0 * law.still)
    response = position_response(required, law.middle, speed, dt, 2 * round(REST / dt))
    return dataclasses.replace(law, joints=tuple(
        with_error(fitted, stretches, j, response[:, j]) for j, fitted in enumerate(joints)))


def require_commands(recording: Recording, name: str) -> None:
    """Raises InputError for commands without information: copies of the angles, or another joint's.

    Args:
        recording: with ``q_i``.
        name: of the commands' columns.
    """
    q_c, q = recording.joints(name), recording.joints("q")
    finite = np.isfinite(q_c).all(axis=1) & np.isfinite(q).all(axis=1)
    q_c, q = q_c[finite], q[finite]
    for j in range(recording.n):
        if np.ptp(q[:, j]) > _STEPS * _COPIED and np.max(np.abs(q_c[:, j] - q[:, j]), initial=0.0) < _COPIED:
            raise InputError(f"these are the measured angles q_{j + 1} themselves; log what the controller was given",
                             file=recording.source, field=f"{name}_{j + 1}")
    still = np.std(q, axis=0) < _STEPS * _COPIED
    away = np.std(q_c[:, :, None] - q[:, None, :], axis=0)
    for j in map(int, np.flatnonzero(~still)):
        other = int(np.argmin(away[j]))
        if other != j and not still[other] and away[j, other] < 0.5 * away[j, j] and away[j, j] > np.std(q[:, j]):
            raise InputError(f"this is the command of joint {other + 1}: it differs from q_{other + 1} by "
                             f"{away[j, other]:.3g}, from q_{j + 1} by {away[j, j]:.3g}; exchange the columns",
                             file=recording.source, field=f"{name}_{j + 1}")


def judged(law: CommandLaw, recordings: Sequence[Recording], model: Model, robot: Robot) -> CommandLaw:
    """The law with the residual of [G]'s identified loop on the same recordings, and which of the two is better.

    Args:
        law: as identified from the recordings.
        recordings: with commands.
        model, robot: with the identified controller.
    """
    stretches = stretches_of(recordings, commands_of(recordings[0]), still=law.still)
    try:
        loop = loop_model(model, robot)
        # Finely logged commands are either the received ones or interpolated set points; the assumption with which the
        # loop predicts better is used.
        early = sorted({0.0, law.reached_after(loop.t_ipo)})
        made = min(([_made_by_loop(s, loop, by) for s in stretches] for by in early), key=lambda rows: float(sum(
            np.sum((s.motion.q - own)[s.rows] ** 2) for s, own in zip(stretches, rows, strict=True))))
        own = np.concatenate([law.held_out(s.motion)[s.rows] for s in stretches])
    except IdealRobotError:
        return law
    left = np.concatenate([(s.motion.q - q)[s.rows] for s, q in zip(stretches, made, strict=True)])
    # Measured without the low-pass that is applied for the comparison.
    error = np.array([variances([(s.measured - q)[s.rows, j] for s, q in zip(stretches, made, strict=True)],
                                stretches, j) for j in range(law.n)])
    of_law, of_loop = (np.sqrt(np.mean(x**2, axis=0)) for x in (own, left))
    motions = [s.motion for s in stretches]
    doubt = np.array([probabilities([of_loop[j], of_law[j]], 2 * tones(motions, j))[1] for j in range(law.n)])
    # The loop has more information on gears and friction, and keeps its uncertainty.
    return dataclasses.replace(law, cascade=of_loop, cascade_error=error, leads=leaves_less(own, left), doubt=doubt)


def _made_by_loop(stretch: Stretch, loop: Loop, early: float = 0.0) -> Array:
    """Motor angles that the loop makes of the commands ``(N, n)`` [rad].

    Args:
        stretch: of a recording.
        loop: identified.
        early: by how much a command is handed over before the instant at which it was logged [s].
    """
    t = stretch.motion.dt * np.arange(float(len(stretch.command)))
    at = np.minimum(np.arange(0.0, t[-1], loop.t_ipo) + early, t[-1])
    made = simulate(loop, np.asarray(CubicSpline(t, stretch.command)(at)))
    return np.asarray(interpolated(t, made.t, made.q_m))
