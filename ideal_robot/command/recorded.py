"""Prepares recordings for the fit of a command law: even instants, one low-pass, interpolated commands."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from ideal_robot.arrays import Array, interpolated
from ideal_robot.command.fit import Stretch
from ideal_robot.command.motion import Bodies, Motion
from ideal_robot.signals.error_budget import position_noise
from ideal_robot.signals.filters import lowpass
from ideal_robot.signals.preprocess import chosen_cutoff, evenly_sampled
from ideal_robot.signals.recording import Recording

STILL = 0.05
"""Speed below which a joint counts as reversing, over the root mean square of its speed."""
_UPDATES = 0.2
"""Share of the samples of a moving joint that change its command, from which on it changes with every sample."""
_FINE = 9.0
"""Samples a period of the low-pass's cut-off, for derivatives; a third of them are rows of the law."""
_START, _FEW = 0.05, 5
"""Beginning of a recording from which its first speed is found [s], and the samples that it has at least."""
_MOVES, _FORGOTTEN = 0.3, 1.0
"""Share of its usual speed from which on a joint is in motion; a controller remembers so long what was before [s]."""
_RESTS = 0.2
"""Shortest rest [s]: joints that reverse are slow for less."""
_LONGEST = 0.1
"""Cycle that is looked for at most [s]."""

Torque = Callable[[Array, Array, Array, Array, float], Array]
"""Torque of a model ``(N, n)`` for instants ``(N,)``, positions, velocities, accelerations, and the cut-off [Hz]."""


def commands_of(recording: Recording) -> str:
    """Prefix of the columns with the commands: ``q_c``, or ``q_d`` where there is none, or empty."""
    return next((name for name in ("q_c", "q_d") if recording.has(name)), "")


def with_commands(recording: Recording) -> Recording:
    """The recording with ``q_d_i`` for commands where it has no column ``q_c_i`` at all."""
    if commands_of(recording) != "q_d" or any(f"q_c_{i + 1}" in recording.columns for i in range(recording.n)):
        return recording
    columns = {f"q_c_{i + 1}": recording.columns[f"q_d_{i + 1}"] for i in range(recording.n)}
    return replace(recording, columns={**recording.columns, **columns})


def moving_at_start(t: Array, q: Array) -> int | None:
    """The joint, from 0, that moves fastest when a recording starts, relative to its usual speed; None at rest.

    Otherwise the controller's state at the start would be unknown. The initial speed is that of a parabola through the
    first 50 ms, so that an arm that starts from rest has none.

    Args:
        t, q: times ``(N,)`` [s] and positions ``(N, n)`` [rad].
    """
    few = min(len(t), max(_FEW, int(np.searchsorted(t, t[0] + _START)) + 1))
    first = np.abs(np.polynomial.polynomial.polyfit(t[:few] - t[0], q[:few], 2)[1])
    share = first / np.maximum(_usual_speed(t, q), 1e-9)
    # Encoder steps of a joint that rests are no motion.
    share[np.ptp(q, axis=0) < 1e-3] = 0.0
    j = int(np.argmax(share))
    return j if share[j] > _MOVES else None


def first_rest(t: Array, q: Array) -> float | None:
    """Time at which all joints of a recording rest for the first time, for 0.2 s at least [s].

    None where they never do, or hardly move afterwards.

    Args:
        t, q: times ``(N,)`` [s] and positions ``(N, n)`` [rad].
    """
    later, usual = np.searchsorted(t, t + _RESTS), np.maximum(_usual_speed(t, q), 1e-9)
    rows = np.flatnonzero(later < len(t))
    moved = np.abs(q[later[rows]] - q[rows]) / (t[later[rows]] - t[rows])[:, None]
    rests = rows[np.all(moved < STILL * usual, axis=1)]
    if not len(rests) or np.any(_usual_speed(t[rests[0]:], q[rests[0]:]) < 0.5 * usual):
        return None
    return float(t[rests[0]])


def _usual_speed(t: Array, q: Array) -> Array:
    return np.asarray(np.sqrt(np.mean(np.gradient(q, t, axis=0) ** 2, axis=0)))


def update_instants(t: Array, q_c: Array) -> np.ndarray:
    """Indices of rows with a new command ``(M,)`` in a recording ``t (N,)``, ``q_c (N, n)`` [s, rad].

    A log that is faster than the commands has each command several times.
    """
    changed = np.any(np.diff(q_c, axis=0) != 0.0, axis=1)
    rows = np.flatnonzero(changed) + 1
    if len(rows) < 10:
        return np.arange(len(t))
    gaps = np.diff(rows)
    every = int(np.median(gaps))
    if every <= 1 or t[every] - t[0] > _LONGEST:
        return np.arange(len(t))
    # Without motion commands are renewed, too, with the same value: the usual step is used there.
    filled = [np.arange(0, rows[0], every)[::1] + rows[0] % every] if rows[0] >= every else [np.zeros(1, dtype=int)]
    for a, b in zip(rows, [*rows[1:], len(t)], strict=True):
        filled.append(np.arange(a, max(b - every // 2, a + 1), every))
    return np.unique(np.concatenate(filled))


def command_cycle(recordings: Sequence[Recording], name: str) -> float:
    """Time from command to command [s], found from the instants at which the logged commands change."""
    steps = []
    for recording in recordings:
        rows = update_instants(recording.t, recording.joints(name))
        steps.append(np.diff(recording.t[rows]))
    # Controllers keep whole microseconds; stamps differ by less.
    return round(float(np.median(np.concatenate(steps))), 6)


def usual_cutoff(recordings: Sequence[Recording]) -> float:
    """Default cut-off of the low-pass [Hz], which preserves the joints' motion."""
    cutoffs = []
    for recording in recordings:
        even = evenly_sampled(recording, columns=False)
        cutoffs.append(chosen_cutoff(even.q, float(even.t[1] - even.t[0])))
    return float(np.median(cutoffs))


def stretches_of(recordings: Sequence[Recording], name: str, *, cutoff: float | None = None,
                 bodies: Bodies | None = None, torque: Torque | None = None, measured: bool = True,
                 still: Array | None = None) -> list[Stretch]:
    """The recordings' intervals without gaps, low-passed.

    Args:
        recordings: with ``q_i`` and the commands.
        name: of the commands' columns.
        cutoff: of the low-pass [Hz]; from the motion if None.
        bodies: of the arm, where they are known.
        torque: of the identified model; None where there is none.
        measured: whether the law is fitted with the measured torque, not with the model's.
        still: speed below which a joint is treated as reversing ``(n,)`` [rad/s]; from the motion if None.
    """
    cutoff = usual_cutoff(recordings) if cutoff is None else cutoff
    result = []
    if still is None:
        speeds = [np.gradient(r.joints("q"), r.t, axis=0) for r in recordings]
        still = STILL * np.maximum(np.sqrt(np.mean(np.concatenate(
            [lowpass(v, float(np.median(np.diff(r.t))), cutoff) for v, r in zip(speeds, recordings, strict=True)])**2,
            axis=0)), 1e-9)
    for recording in recordings:
        even = evenly_sampled(recording, columns=False)
        dt = float(even.t[1] - even.t[0])
        rows = update_instants(recording.t, recording.joints(name))
        command = interpolated(even.t, recording.t[rows], recording.joints(name, rows))
        # Low-passed signals need few samples, with a margin for derivatives.
        every = max(1, int(1.0 / (_FINE * cutoff * dt)))
        smooth = lowpass(even.q, dt, cutoff)
        own = Motion.of(smooth[::every], every * dt, still, bodies)
        used = own
        if torque is not None:
            # Friction reverses abruptly, while measured torque has passed the low-pass.
            fine = Motion.of(smooth, dt, still)
            used = own.with_torque(lowpass(torque(even.t, fine.q, fine.qd, fine.qdd, cutoff), dt, cutoff)[::every])
            own = own.with_torque(lowpass(even.tau, dt, cutoff)[::every]) if measured else used
        edge = int(np.ceil(1.0 / (cutoff * dt)))
        holes = np.convolve(even.hole, np.ones(2 * edge + 1), mode="same") > 0 if even.hole.any() else even.hole
        first = edge if moving_at_start(even.t, even.q) is None else max(edge, round(_FORGOTTEN / dt))
        kept = np.arange(-(-first // every), (len(even.t) - edge) // every, max(1, round(_FINE / 3.0)))
        result.append(Stretch(own, used, (used, used), lowpass(command, dt, cutoff)[::every],
                              even.q[::every], position_noise(recording, even.q, dt), kept[~holes[every * kept]]))
    return result
