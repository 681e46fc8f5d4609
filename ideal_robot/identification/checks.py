"""What is wrong with recordings, before they are used.

Errors stop; warnings have a name, so that people and programs can look for them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ideal_robot.errors import InputError
from ideal_robot.identification.weighted_least_squares import Solution
from ideal_robot.model.model import Model
from ideal_robot.robots import SHIPPED
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.plausible import (
    MOST_LEFT_OUT,
    only_numbers,
    plausible,
    require_joint_units,
    require_metres,
    without_spikes,
)
from ideal_robot.signals.recording import Recording
from ideal_robot.signals.sampling import at_sampling_instants

_MINIMUM_DURATION = 1.0
STILL = 1e-3
"""A joint whose position stays within this does not move [rad or m]."""
_NEARLY_ALL = (0.01, 0.99)
"""Quantiles between which practically all samples lie; spikes lie beyond."""
_NAMED = 8
"""Parameters that a warning names; a line on the screen holds no more."""


def checked(recordings: Sequence[Recording], robot: Robot, *, commands: bool = False
            ) -> tuple[list[Recording], list[str]]:
    """Recordings ready for identification, with ``tau_i``, and named warnings.

    Args:
        recordings: as they were read.
        robot: joints, limits, drive gains.
        commands: whether the commands ``q_c_i``, where there are any, are used too.

    Raises:
        InputError: columns missing, other joint count, time that does not increase, too short, no torque, degrees,
            commands that the joints do not follow.
    """
    result, warnings = [], []
    for recording in recordings:
        recording, texts = _checked(recording, robot)
        if commands:
            recording, more = _with_commands(recording, robot)
            texts += more
        result.append(recording)
        warnings += [f"{text} [{recording.source}]" for text in texts]
    return result, warnings


def require_distinct(recordings: Sequence[Recording]) -> None:
    """Raises InputError where two recordings are the same one: it would count twice, or judge what it has found."""
    known: dict[str, Recording] = {}
    for recording in recordings:
        if (other := known.setdefault(recording.hash, recording)) is not recording:
            raise InputError(f"holds the same samples as {other.source}; give each recording once, and another one to "
                             "validate with", file=recording.source, field="recording")


def require_motion(recordings: Sequence[Recording]) -> None:
    """Raises InputError where no joint moves in any of the recordings."""
    if recordings and all((np.ptp(recording.joints("q"), axis=0) < STILL).all() for recording in recordings):
        raise InputError(f"no joint moves (none by {STILL:g} rad or m); record a motion, e.g. that of "
                         "plan-identification", file=recordings[0].source, field="q_i")


def _require_all_joints(recording: Recording, robot: Robot) -> None:
    """Raises InputError where a joint of the robot has no position, or the recording has more joints."""
    count, n, source = recording.n, robot.n, recording.source
    later = any(f"q_{j}" in recording.columns for j in (0, *range(count + 2, n + 1)))
    if count == 0 or (count < n and later):
        raise InputError(f"column is missing; q_1 to q_{n} of the robot {robot.name} are needed", file=source,
                         field=f"q_{count + 1}")
    if count != n:
        raise InputError(f"the recording has {count} joints (q_1 to q_{count}), the robot {robot.name} has {n}",
                         file=source, field="q_i")


def _checked(recording: Recording, robot: Robot) -> tuple[Recording, list[str]]:
    source, n, warnings = recording.source, robot.n, []
    _require_all_joints(recording, robot)
    arm = recording.meta.get("robot")
    if arm in SHIPPED and robot.name in SHIPPED and arm != robot.name:
        raise InputError(f"the recording is of {arm}, not of {robot.name}; give --robot {arm}", file=source,
                         field="robot", value=arm)
    recording = _in_robot_order(recording, robot)
    if not recording.has("tau"):
        recording, text = _with_torque(recording, robot)
        warnings += text
    # Units first, of practically all samples: degrees would look like jumps, and a jump like degrees.
    q = recording.joints("q")
    if np.isfinite(q).all(axis=1).any():
        require_joint_units(np.nanquantile(q, _NEARLY_ALL, axis=0), robot, file=source)
    names = range(1, n + 1)
    recording, text = plausible(recording, [f"q_{i}" for i in names], [f"tau_{i}" for i in names], robot.tau_max)
    warnings += text
    t = recording.t
    if len(t) < 100 or t[-1] - t[0] < _MINIMUM_DURATION:
        raise InputError(f"too short: at least {_MINIMUM_DURATION:g} s and 100 samples are needed", file=source,
                         field="t", value=f"{len(t)} samples, {t[-1] - t[0]:.3g} s" if len(t) else "0 samples")
    q, tau = recording.joints("q"), recording.joints("tau")
    require_joint_units(q, robot, file=source)
    for name in "xyz":
        if name in recording.columns:
            require_metres(recording.columns[name], file=source, column=name)
    if not np.any(np.abs(tau) > 0):
        raise InputError("every torque is zero; is this the torque column?", file=source, field="tau_i")
    for j in range(n):
        if not np.any(np.abs(tau[:, j]) > 0):
            raise InputError("all values are zero; the torque of every joint is needed", file=source,
                             field=f"tau_{j + 1}")
        if np.ptp(q[:, j]) < STILL:
            warnings.append(f"joint-never-moves: joint {j + 1} stays within {np.ptp(q[:, j]):.2g}; its friction and "
                            "inertia cannot be identified")
        if np.ptp(tau[:, j]) == 0.0:
            warnings.append(f"constant-torque: tau_{j + 1} never changes")
    recording, spread = at_sampling_instants(recording)
    if spread > 0.0:
        warnings.append(f"irregular-sampling: samples were taken {1e3 * spread:.2g} ms (standard deviation) off their "
                        "stamps, as the positions of all joints say alike; the instants are taken from these")
    return recording, warnings


def _with_commands(recording: Recording, robot: Robot) -> tuple[Recording, list[str]]:
    """The recording without the samples whose commands are no numbers or spikes, and what is wrong with the commands.

    A model has the controllers of all joints or of none: commands that one joint lacks are left out. Raises InputError
    for degrees, or commands that are farther from their joint's motion than standing still is.
    """
    names = [f"q_c_{i + 1}" for i in range(robot.n)]
    missing = [name for name in names if name not in recording.columns]
    if len(missing) == robot.n:
        return recording, []
    gone = {name: float(np.mean(~np.isfinite(recording.columns[name]))) for name in names if name not in missing}
    empty = [f"{name} has no number in {100 * share:.0f} % of the samples" for name, share in gone.items()
             if share > MOST_LEFT_OUT]
    if missing or empty:
        why = "; ".join([f"{name} is missing" for name in missing] + empty)
        columns = {name: values for name, values in recording.columns.items() if name not in names}
        return replace(recording, columns=columns), [f"no-controller: {why}; {names[0]} to {names[-1]} are needed"]
    recording, warnings = only_numbers(recording, names)
    q_c = recording.joints("q_c")
    require_joint_units(np.quantile(q_c, _NEARLY_ALL, axis=0), robot, file=recording.source, column="q_c")
    recording, spikes = without_spikes(recording, names)
    warnings += spikes
    q_c, q = recording.joints("q_c"), recording.joints("q")
    error, motion = np.std(q_c - q, axis=0), np.std(q, axis=0)
    for j in np.flatnonzero((error > motion) & (np.ptp(q, axis=0) > STILL) & (np.ptp(q_c, axis=0) > STILL)):
        raise InputError(f"the joint does not follow this command: they differ by {error[j]:.3g} (standard deviation), "
                         f"q_{j + 1} moves by {motion[j]:.3g}; is it another joint's, or in another unit?",
                         file=recording.source, field=names[j])
    return recording, warnings


def _in_robot_order(recording: Recording, robot: Robot) -> Recording:
    """Columns renumbered where the recording names its joints (bags do, often in alphabetical order)."""
    recorded, wanted = recording.meta.get("joints"), list(robot.pinocchio.names)[1:]
    if not isinstance(recorded, list) or recorded == wanted:
        return recording
    names = [str(name) for name in recorded]
    # Names that are numbers and nothing else count from the base.
    for labels, own in ((names, wanted), (_bare(names), _bare(wanted)),
                        (_bare(names), [str(i + 1) for i in range(robot.n)])):
        if sorted(labels) == sorted(own):
            order = [labels.index(name) for name in own]
            break
    else:
        raise InputError(f"the recording is of the joints {', '.join(names)}; those of {robot.name} are "
                         f"{', '.join(wanted)}; give the URDF of the recorded arm, or one with its names",
                         file=recording.source, field="joints")
    columns = dict(recording.columns)
    for prefix in {name.rsplit("_", 1)[0] for name in columns if name.endswith("_1")}:
        if recording.has(prefix):
            for i, j in enumerate(order):
                columns[f"{prefix}_{i + 1}"] = recording.columns[f"{prefix}_{j + 1}"]
    return replace(recording, columns=columns, meta={**recording.meta, "joints": wanted})


def _bare(names: list[str]) -> list[str]:
    """The names without what all of them begin and end with, as an arm's name and "joint"."""
    short = [name[_shared(names):] for name in names]
    ending = _shared([name[::-1] for name in short])
    return [name[: len(name) - ending] for name in short]


def _shared(names: list[str]) -> int:
    """How many characters all names begin with alike."""
    # What the first and the last one in their order share, those between share as well.
    first, last = min(names), max(names)
    return next((i for i, (a, b) in enumerate(zip(first, last, strict=False)) if a != b), min(len(first), len(last)))


def _with_torque(recording: Recording, robot: Robot) -> tuple[Recording, list[str]]:
    if not recording.has("current"):
        missing = next(f"tau_{i + 1}" for i in range(recording.n) if f"tau_{i + 1}" not in recording.columns)
        raise InputError(f"column is missing; tau_1 to tau_{recording.n} [N m] or current_1 to current_{recording.n} "
                         "[A] are needed", file=recording.source, field=missing)
    tau = recording.joints("current") * robot.drive_gain
    columns = {**recording.columns, **{f"tau_{i + 1}": np.ascontiguousarray(tau[:, i]) for i in range(recording.n)}}
    return replace(recording, columns=columns), list(filter(None, [robot.unknown_drive_gain]))


def _some(names: Sequence[str]) -> str:
    """The first names, and how many more there are: each parameter has its standard deviation beside it anyway."""
    more = len(names) - _NAMED
    return ", ".join(names[:_NAMED]) + (f" and {more} more" if more > 0 else "")


def excitation_warnings(model: Model, solution: Solution, wrong_sign: Sequence[int] = ()) -> list[str]:
    """What the data do not show, from the solution's statistics.

    Args:
        model, solution: what was identified, and how well.
        wrong_sign: joints, counted from 0, that behave as if their torque had the wrong sign.
    """
    warnings = []
    parameters = model.parameters
    within_friction = {f"offset_{j + 1}" for j, law in enumerate(model.friction.laws) if law.holds_offset}
    silent = [p.name for p, dark in zip(parameters, solution.unexcited, strict=False)
              if dark and p.name not in within_friction]
    if silent:
        warnings.append(f"not-excited: the motion says nothing about {_some(silent)}; nominal values are kept")
    vague = [p.name for p, dark in zip(parameters, solution.unexcited, strict=False)
             if not dark and p.std > 0.3 * abs(p.value)]
    if vague:
        warnings.append(f"poorly-excited: standard deviation above 30 % of the value for {_some(vague)}")
    if solution.condition_number_scaled > 200.0:
        warnings.append(f"ill-conditioned: condition number {solution.condition_number_scaled:.3g} with scaled "
                        "columns; a motion from plan-identification excites better")
    bounds = [p.name for p, held in zip(parameters, solution.at_bound, strict=False) if held]
    if bounds:
        warnings.append(f"friction-at-bound: {', '.join(bounds)} would be negative and is held at zero; the motion has "
                        "too few speeds to tell friction apart, or something that is not friction acts like it")
    warnings += [f"wrong-sign: the torque of joint {j + 1} has the wrong sign: friction would drive the joint and its "
                 f"inertia be negative; multiply tau_{j + 1} by -1" for j in wrong_sign]
    return warnings
