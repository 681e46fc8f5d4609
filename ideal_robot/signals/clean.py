"""Prepares a recording for a regression in one pass, with one note per change.

In order: names and units (the robot's joints, decoupled, their torques), time (numbers, stamps, the instants of
sampling), joints (angles that wrap, brakes, channels that measure nothing), spikes. Identification, diagnosis and
``inspect`` begin here.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

import numpy as np

from ideal_robot.errors import InputError
from ideal_robot.robots import SHIPPED
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.channels import braked, dead_share
from ideal_robot.signals.plausible import (
    MOST_LEFT_OUT,
    only_numbers,
    plausible,
    require_joint_units,
    require_metres,
    text_columns,
    without_rows,
    without_spikes,
    wound_up,
)
from ideal_robot.signals.recording import Recording, of_joints
from ideal_robot.signals.sampling import at_sampling_instants, rising_stamps

MINIMUM_SAMPLES, MINIMUM_DURATION = 100, 1.0
"""A recording with fewer samples, or shorter [s], determines no parameter of an arm."""
STILL = 1e-3
"""A joint whose position stays within this does not move [rad or m]."""
_NEARLY_ALL = (0.01, 0.99)
"""Quantiles between which practically all samples lie; spikes lie beyond."""
_ANGLES = ("q", "q_c", "q_d", "qa")
"""Quantities of joints that wrap where the logger wraps them."""
NO_CONTROLLER = "no-controller"
"""Name of the act that commands were left out, of which one joint has none."""
_MOST_BRAKED = 0.5
"""Share of the samples that brakes may take out, at most; the rest is what identifies."""


@dataclass(frozen=True)
class Cleaned:
    """A prepared recording, and the changes made to it.

    Attributes:
        recording: joints in the robot's order, with ``tau_i`` where torques are used, increasing times, no spikes.
        acts: sentences ``name: what was found and done``, in the order of the pass.
        amperes: whether ``tau_i`` are amperes of joints whose drive gain is not known.
    """

    recording: Recording
    acts: tuple[str, ...]
    amperes: bool = False


def cleaned(recording: Recording, robot: Robot, *, torques: bool = True, commands: bool = False) -> Cleaned:
    """The recording ready for a regression of torques or commands.

    Args:
        recording: as it was read.
        robot: joints, limits, drive gains.
        torques: whether torques are used; without them none is needed.
        commands: whether the commands ``q_c_i``, where there are any, are used too.

    Raises:
        InputError: columns missing, another number of joints, time that runs backwards, too short, no torque, degrees,
            positions that jump, commands that the joints do not follow.
    """
    acts = [str(text) for text in recording.meta.get("reading", ())] + text_columns(recording)
    recording, said = _named(recording, robot)
    acts += said
    amperes = False
    if torques and not recording.has("tau"):
        recording, said = _with_torque(recording, robot)
        acts += said
        amperes = bool(said)
    recording, said = taken_apart(recording, robot)
    acts += said
    source, n = recording.source, robot.n
    names = range(1, n + 1)
    # Units are checked first, as degrees would look like jumps, and a jump like degrees.
    q = recording.joints("q")
    if np.isfinite(q).all(axis=1).any():
        require_joint_units(np.nanquantile(q, _NEARLY_ALL, axis=0), robot, file=source)
    positions, measured = [f"q_{i}" for i in names], list[str]()
    if torques:
        measured = [f"tau_{i}" for i in names]
        recording, said = _measuring(recording)
        acts += said
    recording, said = only_numbers(recording, ["t", *positions, *measured])
    acts += said
    recording, said = rising_stamps(recording)
    acts += said
    recording, said = unwrapped(recording, robot)
    acts += said
    recording, said = plausible(recording, positions, measured, robot.tau_max)
    acts += said
    if torques:
        recording, said = _without_brakes(recording)
        acts += said
    t = recording.t
    if len(t) < MINIMUM_SAMPLES or t[-1] - t[0] < MINIMUM_DURATION:
        raise InputError(f"too short: at least {MINIMUM_DURATION:g} s and {MINIMUM_SAMPLES} samples are needed",
                         file=source, field="t",
                         value=f"{len(t)} samples, {t[-1] - t[0]:.3g} s" if len(t) else "0 samples")
    q = recording.joints("q")
    require_joint_units(q, robot, file=source)
    acts += wound_up(q, robot)
    for name in "xyz":
        if name in recording.columns:
            require_metres(recording.columns[name], file=source, column=name)
    if torques and not recording.joints("tau").any():
        raise InputError("every torque is zero; is this the torque column?", file=source, field="tau_i")
    moved = robot.units("rad")
    for j in range(n):
        if np.ptp(q[:, j]) < STILL:
            unseen = "friction and inertia" if torques else "controller"
            acts.append(f"joint-never-moves: joint {j + 1} stays within {np.ptp(q[:, j]):.2g} {moved[j]}; its {unseen} "
                        "cannot be identified")
    recording, spread = at_sampling_instants(recording)
    if spread > 0.0:
        acts.append(f"irregular-sampling: samples were taken {1e3 * spread:.2g} ms (standard deviation) off their "
                    "stamps, as the positions of all joints say alike; the instants are taken from these")
    if commands:
        recording, said = _with_commands(recording, robot)
        acts += said
    return Cleaned(recording, tuple(acts), amperes)


# Checks of names and units.

def _named(recording: Recording, robot: Robot) -> tuple[Recording, list[str]]:
    """The recording of the robot's joints in the robot's order; raises InputError where it is of another arm."""
    arm = recording.meta.get("robot")
    if arm in SHIPPED and robot.name in SHIPPED and arm != robot.name:
        raise InputError(f"the recording is of {arm}, not of {robot.name}; give --robot {arm}", file=recording.source,
                         field="robot", value=arm)
    recording, acts = _in_robot_order(recording, robot)
    count, n, source = recording.n, robot.n, recording.source
    later = any(f"q_{j}" in recording.columns for j in (0, *range(count + 2, n + 1)))
    if count == 0 or (count < n and later):
        raise InputError(f"column is missing; q_1 to q_{n} of the robot {robot.name} are needed (a map of other names: "
                         "--columns)", file=source, field=f"q_{count + 1}")
    if count != n:
        raise InputError(f"the recording has {count} joints (q_1 to q_{count}), the robot {robot.name} has {n}; choose "
                         "with --joints" if count > n else
                         f"the recording has {count} joints (q_1 to q_{count}), the robot {robot.name} has {n}",
                         file=source, field="q_i")
    return recording, acts


def _in_robot_order(recording: Recording, robot: Robot) -> tuple[Recording, list[str]]:
    """Columns renumbered where the recording names its joints, as bags do, often in alphabetical order.

    Joints of a gripper or of wheels in the same messages are left out, and named.
    """
    recorded, wanted = recording.meta.get("joints"), list(robot.joint_names)
    if not isinstance(recorded, list) or recorded == wanted:
        return recording, []
    names = [str(name) for name in recorded]
    if len(names) > len(wanted) and (own := _arms_own(names, wanted)):
        columns, meta = of_joints(recording.columns, {"joints": names}, own, recording.source)
        said = [str(text) for text in meta["reading"]]
        return replace(recording, columns=columns, meta={**recording.meta, "joints": wanted}), said
    # Names that are only numbers are counted from the base.
    for labels, own in ((names, wanted), (_bare(names), _bare(wanted)),
                        (_bare(names), [str(i + 1) for i in range(robot.n)])):
        if sorted(labels) == sorted(own):
            order = [labels.index(name) for name in own]
            break
    else:
        raise InputError(f"the recording is of the joints {', '.join(names)}; those of {robot.name} are "
                         f"{', '.join(wanted)}; give the URDF of the recorded arm, or one with its names, or choose "
                         "with --joints", file=recording.source, field="joints")
    columns = dict(recording.columns)
    for prefix in {name.rsplit("_", 1)[0] for name in columns if name.endswith("_1")}:
        if recording.has(prefix):
            for i, j in enumerate(order):
                columns[f"{prefix}_{i + 1}"] = recording.columns[f"{prefix}_{j + 1}"]
    return replace(recording, columns=columns, meta={**recording.meta, "joints": wanted}), []


def _arms_own(names: list[str], wanted: list[str]) -> list[str]:
    """Those of more names than the arm's that are the arm's, in its order; empty where that is not certain.

    Names that are the URDF's, perhaps with something before or behind; else names of one text whose numbers are all of
    1 to n.
    """
    if set(wanted) <= set(names):
        return wanted
    for fits in (str.endswith, str.startswith):
        found = [[name for name in names if fits(name, own)] for own in wanted]
        if all(len(each) == 1 for each in found) and len({each[0] for each in found}) == len(wanted):
            return [each[0] for each in found]
    groups: dict[str, dict[int, str]] = {}
    for name in names:
        if number := re.search(r"(\d+)(?!.*\d)", name):
            groups.setdefault(name[: number.start()] + "#" + name[number.end() :], {})[int(number[1])] = name
    whole = [group for group in groups.values() if sorted(group) == list(range(1, len(wanted) + 1))]
    return [whole[0][i + 1] for i in range(len(wanted))] if len(whole) == 1 else []


def _bare(names: list[str]) -> list[str]:
    """The names without what all of them begin and end with, as an arm's name and "joint"."""
    short = [name[_shared(names):] for name in names]
    ending = _shared([name[::-1] for name in short])
    return [name[: len(name) - ending] for name in short]


def _shared(names: list[str]) -> int:
    """How many characters all names begin with alike."""
    # The common prefix of the first and the last name in alphabetical order is common to all.
    first, last = min(names), max(names)
    return next((i for i, (a, b) in enumerate(zip(first, last, strict=False)) if a != b), min(len(first), len(last)))


def _with_torque(recording: Recording, robot: Robot) -> tuple[Recording, list[str]]:
    if not recording.has("current"):
        missing = next(f"tau_{i + 1}" for i in range(recording.n) if f"tau_{i + 1}" not in recording.columns)
        raise InputError(f"column is missing; tau_1 to tau_{recording.n} [N m] or current_1 to current_{recording.n} "
                         "[A] are needed (a map of other names: --columns)", file=recording.source, field=missing)
    tau = recording.joints("current") * robot.drive_gain
    columns = {**recording.columns, **{f"tau_{i + 1}": np.ascontiguousarray(tau[:, i]) for i in range(recording.n)}}
    return replace(recording, columns=columns), list(filter(None, [robot.unknown_drive_gain]))


def _measuring(recording: Recording) -> tuple[Recording, list[str]]:
    """The recording with zeros for a torque that is hardly ever a number: as any other channel that measures nothing.

    Where no channel measures anything the numbers are wanted of all, and refused where they are missing.
    """
    empty = {}
    for j in range(recording.n):
        name = f"tau_{j + 1}"
        gone = float(np.mean(~np.isfinite(recording.columns[name]))) if len(recording.t) else 0.0
        if gone > dead_share():
            empty[name] = gone
    if not empty or len(empty) == recording.n:
        return recording, []
    zeros = {name: np.zeros(len(recording.t)) for name in empty}
    acts = [f"not-a-number: {name} has no number in {100 * gone:.0f} % of the samples" for name, gone in empty.items()]
    return replace(recording, columns={**recording.columns, **zeros}), acts


# Checks of joint angles.

def unwrapped(recording: Recording, robot: Robot) -> tuple[Recording, list[str]]:
    """The recording with angles unwrapped where the logger wraps them at a whole turn, and the unwrapped joints.

    A step between samples of nearly a whole turn is caused by the logger.
    """
    columns, acts = dict(recording.columns), []
    for j in np.flatnonzero(~robot.prismatic):
        for kind in _ANGLES:
            name = f"{kind}_{j + 1}"
            values = columns.get(name)
            if values is None or len(values) < 2 or not np.all(np.isfinite(values)):
                continue
            turns = np.round(np.diff(values) / (2.0 * np.pi))
            rest = np.abs(np.diff(values) - 2.0 * np.pi * turns)
            # A step within a quarter turn of whole turns is a wrap of the counter, as no joint moves so far in a
            # sample.
            wraps = (turns != 0.0) & (rest < 0.5 * np.pi)
            if not wraps.any():
                continue
            shift = np.concatenate([[0.0], np.cumsum(np.where(wraps, turns, 0.0))])
            columns[name] = values - 2.0 * np.pi * shift
            acts.append(f"wrapped: {name} wraps by a whole turn at {np.count_nonzero(wraps)} samples (first at t = "
                        f"{recording.t[int(np.argmax(wraps)) + 1]:.6g} s); it is unwrapped")
        measured = columns.get(f"q_{j + 1}")
        for kind in _ANGLES[1:]:
            led = columns.get(f"{kind}_{j + 1}")
            if measured is not None and led is not None and acts and np.all(np.isfinite(led)):
                # Commands and arm angles are shifted to the turn of the measured angle.
                columns[f"{kind}_{j + 1}"] = led - 2.0 * np.pi * np.round(
                    float(np.median(led - measured)) / (2.0 * np.pi))
    return (replace(recording, columns=columns), acts) if acts else (recording, [])


def taken_apart(recording: Recording, robot: Robot) -> tuple[Recording, list[str]]:
    """The recording with the URDF's joint angles, computed from those of a controller that couples joints.

    Angles q' = C q of a controller do work τ'ᵀ dq' = τᵀ dq, so τ = Cᵀ τ'. Recordings of this program have the URDF's
    joints already.

    Args:
        recording: its angles may wrap.
        robot: its ``counted`` is C.
    """
    coupled = np.argwhere((robot.counted != 0.0) & ~np.eye(robot.n, dtype=bool))
    if not len(coupled) or "robot" in recording.meta:
        return recording, []
    recording, acts = unwrapped(recording, robot)
    columns, apart = dict(recording.columns), np.linalg.inv(robot.counted)
    for kind, matrix in (*((kind, apart) for kind in (*_ANGLES, "qd")), ("tau", robot.counted.T)):
        if recording.has(kind):
            values = recording.joints(kind) @ matrix.T
            columns.update({f"{kind}_{i + 1}": np.ascontiguousarray(values[:, i]) for i in range(robot.n)})
    pairs = ", ".join(f"joint {i + 1} with {robot.counted[i, j]:+g} of joint {j + 1}" for i, j in coupled)
    return replace(recording, columns=columns), [
        *acts, f"coupled: the controller counts {pairs} (table coupled of the robot's data); they are taken apart"]


def _without_brakes(recording: Recording) -> tuple[Recording, list[str]]:
    """The recording without samples at which brakes hold a joint: the motor is off, whatever weighs on the joint."""
    held = braked(recording)
    if not held.any():
        return recording, []
    shares = [f"tau_{j + 1} {100 * share:.2g} %" for j, share in enumerate(held.mean(axis=0)) if share > 0.0]
    text = (f"brakes: torques are exactly zero while their joints stand ({', '.join(shares)} of the samples): motors "
            "off, brakes on")
    rows = np.asarray(held.any(axis=1))
    if rows.mean() > _MOST_BRAKED:
        return recording, [f"{text}; that is most of the recording, and nothing is left out"]
    return without_rows(recording, rows), [f"{text}; these samples are left out"]


# Checks of commands.

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
        return replace(recording, columns=columns), [f"{NO_CONTROLLER}: {why}; {names[0]} to {names[-1]} are needed"]
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

