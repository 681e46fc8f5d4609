"""Removes implausible samples: missing numbers, spikes, frozen torques, jumping positions and clocks.

Single bad samples are removed and named; a recording with too many is refused. A recording without any is returned
unchanged. Identification, diagnosis and stiffness use the same check.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from ideal_robot.signals.sampling import LONGEST_PAUSE

_NAMED = 8
"""Columns that a warning names; a line on the screen holds no more."""
_SLOWEST = 0.5
"""Samples further apart than this are of no use for an arm, so they are not in seconds [s]."""
_FARTHEST = 30.0
"""No arm of ours reaches further [m]."""
_LEAVING = 1.05
"""Share of a joint limit beyond which a position cannot be one."""


def require_seconds(t: Array, quickest: float = np.inf, *, file: str | None = None) -> None:
    """Raises InputError for times that rise too fast to be seconds.

    Args:
        t, file: times ``(N,)`` [s], and where they come from.
        quickest: how many times as fast the motion may be for the arm to be able to make it: where less than a thousand
            times, the times are no milliseconds.
    """
    step = float(np.median(np.abs(np.diff(t)))) if len(t) > 1 else 0.0
    if not step > _SLOWEST or quickest < 1e3:
        return
    factor, unit = next((pair for pair in ((1e3, "milliseconds"), (1e6, "microseconds"))
                         if step / pair[0] <= _SLOWEST or quickest < 1e3 * pair[0]), (1e9, "nanoseconds"))
    raise InputError(f"samples are {step:.4g} s apart; that looks like {unit}, seconds are expected: divide t by "
                     f"{factor:.0e}", file=file, field="t", value=step)


def require_joint_units(q: Array, robot: Robot, *, file: str | None = None, column: str = "q") -> None:
    """Raises InputError for positions far outside the joint limits, as in degrees, millimetres or motor angles.

    A joint with limits of a full turn may have been turned further: its positions are accepted if they are not degrees.

    Args:
        q, robot: joint positions ``(N, n)`` [rad, or m where a joint slides], and their limits.
        file, column: the file that they come from, and their name without the joint.
    """
    largest = np.max(np.abs(q), axis=0, initial=0.0)
    span = np.maximum(np.abs(robot.q_min), np.abs(robot.q_max))
    beyond = largest / np.where(np.isfinite(span) & (span > 0), span, np.inf)
    turning = ~robot.prismatic
    in_limits = bool(np.all(np.radians(largest)[turning] <= _LEAVING * span[turning]))
    degrees = in_limits and bool(np.any(beyond[turning] > 3.0))
    for j in np.flatnonzero(beyond > _LEAVING):
        if robot.prismatic[j]:
            unit, guess = "m", ("they look like millimetres, metres are expected: divide by 1000"
                                if 1e-3 * largest[j] <= _LEAVING * span[j] else "wrong robot, or not in metres?")
        elif not degrees and _all_angles(robot)[j]:
            continue
        else:
            unit, ratio = "rad", abs(float(robot.gear_ratio[j]))
            geared = ratio > 1.0 and largest[j] <= _LEAVING * span[j] * ratio
            guesses = ['degrees, radians are expected (of a recording: unit = "deg" in --columns)'] * degrees
            if geared:
                guesses.append("the motor's own angles, before its gear: divide by its ratio "
                               f"{ratio:g} (of a recording: factor = {1.0 / ratio:.6g} in --columns)")
            guess = (f"they look like {', or like '.join(guesses)}" if guesses
                     else "wrong robot, not in radians, or the motor's own angles, before its gear?")
        raise InputError(f"positions up to {largest[j]:.4g} leave the joint limit of {span[j]:.4g} {unit}; {guess}",
                         file=file, field=f"{column}_{j + 1}", value=round(float(largest[j]), 4))


def wound_up(q: Array, robot: Robot) -> list[str]:
    """A warning for each joint with limits of a full turn that was turned beyond them; positions ``(N, n)`` [rad]."""
    largest = np.max(np.abs(q), axis=0, initial=0.0)
    span = np.maximum(np.abs(robot.q_min), np.abs(robot.q_max))
    return [f"turned-on: q_{j + 1} reaches {largest[j]:.3g} rad, beyond the URDF's ±{span[j]:.3g} rad; the angle is "
            "taken as it is" for j in np.flatnonzero((largest > _LEAVING * span) & _all_angles(robot))]


def _all_angles(robot: Robot) -> NDArray[np.bool_]:
    """Which joints turn and have limits that hold every angle ``(n,)``."""
    return np.asarray(~robot.prismatic & (robot.q_max - robot.q_min >= _WHOLE_TURN))


def require_metres(position: Array, *, file: str | None = None, column: str = "x") -> None:
    """Raises InputError for a TCP position that is too far away to be in metres.

    Args:
        position: one coordinate ``(N,)`` [m]; NaN where it was not measured.
        file, column: the file that it comes from, and its name.
    """
    farthest = float(np.max(np.abs(position), initial=0.0, where=np.isfinite(position)))
    if farthest > _FARTHEST:
        raise InputError("that far away looks like millimetres, metres are expected: divide by 1000", file=file,
                         field=column, value=round(farthest, 3))


_WHOLE_TURN = 2.0 * np.pi * 0.97
"""Range of a joint from which on its limits hold practically every angle; makers stop some degrees short [rad]."""
MOST_LEFT_OUT = 0.05
"""Largest share of samples that may be left out."""
_NAMED_PAUSE = 1.0
"""Time between two samples from which on a pause is told [s]."""
_HALF = 2
"""Samples to either side that a sample is compared with: bursts of up to two are seen."""
_WINDOW = 2 * _HALF + 1  # both sides, and the sample itself
_FASTEST = 15.0
"""No joint of an arm moves faster [rad/s, m/s]; a motor that is logged at its own side does ..."""
_FASTER = 4.0
"""... and no sample is this many times as fast as nearly all others of its own."""
_STRONGER = 50.0
"""How many times as far from its neighbours as nearly all others a spike of a torque lies ..."""
_BEYOND = 2.0
"""... and how many times the span of the signal."""
_STANDS, _MOVES = 0.5, 0.05
"""A torque that is the same to the last bit so long [s] while its joint moves so far [rad, m] stands still ..."""
_COARSE = 20
"""... unless runs of equal values a twentieth as long are usual: then it is the channel's resolution."""
_DRIVES = 10.0
"""How many times its largest torque no drive gives; peaks of two to three times the rated one are usual."""

_LARGEST = 1.0e9
"""No arm has larger positions, torques, currents or forces in any usual unit [rad, m, N m, A, N]."""


def plausible(recording: Recording, positions: Sequence[str], torques: Sequence[str], tau_max: Array | None = None
              ) -> tuple[Recording, list[str]]:
    """The recording without implausible samples, and named warnings.

    Args:
        recording: to be checked.
        positions, torques: columns of joint positions [rad, m], and of torques, currents or forces.
        tau_max: largest torque of each joint's drive ``(n,)`` [N m], where ``torques`` are torques; inf where unknown.

    Raises:
        InputError: time runs backwards or jumps, a position jumps and stays, more than ``MOST_LEFT_OUT`` is bad, a
            column of impossible values.
    """
    recording, warnings = only_numbers(recording, ["t", *positions, *torques])
    warnings += checked_time(recording.t, recording.source)
    recording, spikes = without_spikes(recording, positions, torques)
    warnings += spikes
    for name in positions:
        _refuse_jump(recording, name)
    recording, stuck = _moving_channels(recording, positions, torques)
    warnings += stuck
    for name in (*positions, *torques):
        largest = float(np.max(np.abs(recording.columns[name]), initial=0.0))
        if largest > _LARGEST:
            raise InputError("values that are impossible for an arm; check the column's unit, or leave the column out",
                             file=recording.source, field=name, value=f"{largest:.3g}")
    for name, most in zip(torques, () if tau_max is None else tau_max, strict=False):
        usual = float(np.quantile(np.abs(recording.columns[name]), 0.9, method="lower")) if len(recording.t) else 0.0
        if usual > _DRIVES * most:
            raise InputError(f"a tenth of the values is beyond {usual:.3g}, and the drive gives {most:.3g} N m; check "
                             "the column's unit and the drive gain", file=recording.source, field=name,
                             value=f"{usual:.3g}")
    return recording, warnings


def without_spikes(recording: Recording, positions: Sequence[str], torques: Sequence[str] = ()
                   ) -> tuple[Recording, list[str]]:
    """The recording without samples that lie far from those before and behind them, and a warning for each column.

    Raises InputError where more than ``MOST_LEFT_OUT`` is bad.

    Args:
        recording: with numbers in all of these columns.
        positions, torques: columns of joint positions or commands [rad, m], and of torques, currents or forces.
    """
    spikes = {name: _position_spikes(recording.columns[name], recording.t) for name in positions}
    spikes |= {name: _torque_spikes(recording.columns[name]) for name in torques}
    warnings, bad = [], np.zeros(len(recording.t), dtype=bool)
    for name, mask in spikes.items():
        if mask.any():
            first = int(np.argmax(mask))
            warnings.append(f"spike: {np.count_nonzero(mask)} samples of {name} that cannot be are left out (first at "
                            f"t = {recording.t[first]:.6g} s: {recording.columns[name][first]:.4g})")
            bad |= mask
    if bad.any():
        worst = max(spikes, key=lambda name: np.count_nonzero(spikes[name]))
        recording = _without(recording, bad, worst, "are spikes")
    return recording, warnings


def checked_time(t: Array, source: str, quickest: float = np.inf) -> list[str]:
    """Warnings about times; raises InputError if not finite, not increasing, or with a pause beyond ``LONGEST_PAUSE``.

    Args:
        t, source: the times ``(N,)`` [s], and where they come from.
        quickest: see ``require_seconds``.
    """
    if not np.all(np.isfinite(t)):
        raise InputError("times are not numbers", file=source, field="t")
    require_seconds(t, quickest, file=source)
    steps = np.diff(t)
    backwards = np.flatnonzero(steps <= 0)
    if len(backwards):
        k = int(backwards[0])
        raise InputError(f"time does not increase at sample {k + 1} (t = {t[k + 1]:.6g} s after {t[k]:.6g} s); sort "
                         "the samples or cut the recording there", file=source, field="t")
    if len(steps) == 0:
        return []
    k = int(np.argmax(steps))
    if steps[k] > LONGEST_PAUSE:
        raise InputError(f"the clock jumps by {steps[k]:.6g} s at sample {k + 1}; cut the recording there", file=source,
                         field="t", value=float(t[k + 1]))
    if steps[k] > max(_NAMED_PAUSE, 5.0 * float(np.median(steps))):
        return [f"pause: {np.count_nonzero(steps > max(_NAMED_PAUSE, 5.0 * float(np.median(steps))))} pauses, the "
                f"longest of {steps[k]:.4g} s after t = {t[k]:.6g} s; nothing near them is used"]
    return []


def text_columns(recording: Recording) -> list[str]:
    """A warning that names the columns of text that the recording's file holds besides."""
    names = [str(name) for name in recording.meta.get("left_out", ())]
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return [f"text-column: {', '.join(names[:_NAMED])}{more} not of numbers, left out"] if names else []


def only_numbers(recording: Recording, needed: Sequence[str]) -> tuple[Recording, list[str]]:
    """The recording without samples that are not finite in one of the columns ``needed``, and a warning.

    Raises InputError where more than ``MOST_LEFT_OUT`` are not finite.
    """
    bad = np.zeros(len(recording.t), dtype=bool)
    worst = ""
    for name in needed:
        mask = ~np.isfinite(recording.columns[name])
        if mask.any() and not worst:
            worst = name
        bad |= mask
    if not bad.any():
        return recording, []
    return (_without(recording, bad, worst, "are not numbers (NaN)"),
            [f"not-a-number: {bad.sum()} samples with NaN (first in {worst}) are left out"])


def without_rows(recording: Recording, bad: NDArray[np.bool_]) -> Recording:
    """The recording without some of its samples, ``bad (N,)``."""
    return replace(recording, columns={name: np.ascontiguousarray(values[~bad])
                                       for name, values in recording.columns.items()})


def _without(recording: Recording, bad: NDArray[np.bool_], column: str, what: str) -> Recording:
    if bad.mean() > MOST_LEFT_OUT:
        raise InputError(f"{bad.sum()} of {len(bad)} samples {what}; at most {100 * MOST_LEFT_OUT:g} % can be left out",
                         file=recording.source, field=column)
    return without_rows(recording, bad)


def _away(values: Array) -> Array:
    """Distance of each sample from the median of its neighbourhood ``(N,)``."""
    return np.asarray(np.abs(values - median_filter(values, _WINDOW, mode="nearest")))


def _position_spikes(q: Array, t: Array) -> NDArray[np.bool_]:
    if len(q) < 2 * _WINDOW:
        return np.zeros(len(q), dtype=bool)
    around = np.pad(t, _HALF, mode="edge")
    time = np.maximum(0.5 * (around[2 * _HALF:] - around[: -2 * _HALF]), _HALF * float(np.median(np.diff(t))))
    return np.asarray(_away(q) > fastest(q, t) * time)


def fastest(q: Array, t: Array) -> float:
    """Largest speed between samples ``(N,)`` of a position that is not a jump [rad/s, m/s]."""
    steps = np.diff(t)
    usual = np.abs(np.diff(q)) / np.maximum(steps, 1e-3 * float(np.median(steps)))
    return max(_FASTEST, _FASTER * float(np.quantile(usual, 0.99)))


def _torque_spikes(tau: Array) -> NDArray[np.bool_]:
    if len(tau) < 2 * _WINDOW:
        return np.zeros(len(tau), dtype=bool)
    low, high = np.quantile(tau, [0.005, 0.995])
    # A quick check first: a spike is outside the signal's usual span.
    if not np.any((tau > high + (high - low)) | (tau < low - (high - low))):
        return np.zeros(len(tau), dtype=bool)
    away = _away(tau)
    return np.asarray((away > _STRONGER * np.quantile(away, 0.95)) & (away > _BEYOND * (high - low)) & (away > 0))


def _moving_channels(recording: Recording, positions: Sequence[str], torques: Sequence[str]
                     ) -> tuple[Recording, list[str]]:
    """The recording without the samples of torques that stand still while their joints move, and their names."""
    bad, warnings = np.zeros(len(recording.t), dtype=bool), []
    for name in torques:
        position = f"q_{name.rsplit('_', 1)[-1]}"
        mask = (_standing(recording.columns[name], recording.columns[position], recording.t)
                if position in positions else np.zeros(len(recording.t), dtype=bool))
        if not mask.any():
            continue
        first, lasts = int(np.argmax(mask)), float(np.sum(np.diff(recording.t)[mask[1:]]))
        value = recording.columns[name][first]
        text = f"stands at {value:.6g} for {lasts:.3g} s from t = {recording.t[first]:.6g} s on"
        if mask.mean() > MOST_LEFT_OUT:
            raise InputError(f"{text}, while its joint moves; cut the recording there, or leave it out",
                             file=recording.source, field=name)
        warnings.append(f"stuck: {name} {text}, while its joint moves; these samples are left out")
        bad |= mask
    return (_without(recording, bad, "tau", "stand still") if bad.any() else recording), warnings


def _standing(tau: Array, q: Array, t: Array) -> NDArray[np.bool_]:
    """Samples ``(N,)`` of runs in which a torque does not change at all while its joint moves."""
    ends = np.flatnonzero(np.append(np.diff(tau) != 0.0, True)) if len(tau) else np.empty(0, dtype=int)
    begins = np.concatenate([[0], ends[:-1] + 1]).astype(int) if len(ends) else ends
    lasts = t[ends] - t[begins]
    standing = np.zeros(len(tau), dtype=bool)
    if not np.any(lasts >= _STANDS):
        return standing
    travel = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(q)))])
    # At its largest value the drive limits the torque, so such runs are not frozen values.
    shorter = lasts[lasts < lasts.max()]
    usual = float(np.quantile(shorter, 0.99)) if len(shorter) else np.inf
    long = ((lasts >= max(_STANDS, _COARSE * usual)) & (travel[ends] - travel[begins] >= _MOVES)
            & (np.abs(tau[begins]) < np.max(np.abs(tau))))
    for begin, end in zip(begins[long], ends[long], strict=True):
        standing[begin : end + 1] = True
    return standing


def _refuse_jump(recording: Recording, name: str) -> None:
    q, t = recording.columns[name], recording.t
    if len(q) < 2 * _WINDOW:
        return
    steps, times = np.abs(np.diff(q)), np.diff(t)
    usual = float(np.median(times))
    # After a pause the arm may be elsewhere.
    jumps = (steps > fastest(q, t) * np.maximum(times, _HALF * usual)) & (times < 5.0 * usual)
    if jumps.any():
        k = int(np.argmax(jumps))
        raise InputError(f"the position jumps by {q[k + 1] - q[k]:.4g} from one sample to the next at t = "
                         f"{t[k]:.6g} s; cut the recording there", file=recording.source, field=name)
