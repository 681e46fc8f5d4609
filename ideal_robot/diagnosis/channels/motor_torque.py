"""Makes a regression of motor torques from a recording and a model: measured, expected, free parameters.

One row per joint and time step: the motor torque minus the model's, and the derivative of the model with respect to
all of its parameters (``ideal_robot.model.parametrisation``), both through the same decimation filter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy import interpolate, ndimage

from ideal_robot.arrays import Array, interpolated
from ideal_robot.diagnosis.channels.regression import (
    BAND,
    CUTOFF,
    MEMORY,
    POSITION_BAND,
    RESTING,
    Regression,
    noise_floor,
)
from ideal_robot.dynamics import regressor
from ideal_robot.dynamics.base_parameters import full_regressor
from ideal_robot.dynamics.newton_euler import chain_of, gravity_across, inverse_dynamics
from ideal_robot.effects import MOTOR_TORQUE, Signals
from ideal_robot.effects.registry import find
from ideal_robot.effects.signals import constant_of_weight
from ideal_robot.estimate.score import CLEAR
from ideal_robot.model.model import Model
from ideal_robot.model.parametrisation import friction_places, friction_sensitivity
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.channels import clipped, stands
from ideal_robot.signals.cutoff import thinned
from ideal_robot.signals.preprocess import FilteredSignals, preprocess
from ideal_robot.signals.recording import Recording, is_known_column

ROWS = 150_000
"""Rows of the regression (samples × joints) that are looked at, at most; longer recordings are decimated further."""
_BRISTLES = 0.003
"""Travel since a reversal or rest that does not count [rad or m]: three times the millimetre or milliradian over which
the bristles of a drive yield."""


def torque_regression(recording: Recording, robot: Robot, model: Model, *, cutoff: float | None = None,
                      shared: bool = True, reversal_width: Array | None = None,
                      payload: bool = False) -> Regression:
    """Builds the regression of the motor torques.

    Args:
        recording: with ``q_i`` and ``tau_i``.
        robot: the robot that the URDF describes.
        model: model of the prediction, whose parameters may change.
        cutoff: of the position filter [Hz], from the data if None.
        reversal_width: speed over which dry friction changes sign ``(n,)`` [rad/s]; from the noise of the position if
            None.
        payload: whether effects need the regressor of a body on the last link.
        shared: whether the joints share inertias; False gives each joint its own copy of all parameters.

    Raises:
        InputError: see ``preprocess``.
    """
    n = robot.n
    recorded = _filtered(recording, cutoff)
    # With position or force channels all samples are kept, as they average the noise.
    more = {"x", "y", "z", "fx", "cam_t"} & recording.columns.keys() or recording.having("qa").any()
    filtered = _differentiated(recorded if more else _thinned(recorded))
    q, qd, qdd = filtered.q, filtered.qd, filtered.qdd
    t = filtered.t - filtered.t[0]
    noise_velocity = _small_velocity(recording, filtered)
    extra = {name: values for name, values in filtered.columns.items() if not is_known_column(name)}

    def body_on(link: int) -> Array:
        # A copy, as a view would keep the whole regressor in memory.
        return regressor(robot.pinocchio, q, qd, qdd)[:, :, model.base.layout.carried_by(link)].copy()

    payload = payload or any(e.effect.loop_change(e.coefficients, e.theta).body for e in model.effects)
    body = body_on(0) if payload else None
    still = np.zeros_like(q)
    signals = Signals(t, q, qd, qdd, still, still, still, filtered.temperature, extra=extra, payload=body,
                      v_small=noise_velocity, cutoff=filtered.cutoff, bodies=body_on if payload else None,
                      tool=np.array(robot.tool_place, dtype=float))
    load = inverse_dynamics(chain_of(model._exact_model), q, qd, qdd)
    # For a long recording the bodies' columns at all samples would need the most memory.
    bodies = filtered.decimate_motion(lambda some: full_regressor(robot.pinocchio, q[some], qd[some], qdd[some],
                                                                  model.base.independent))
    W = np.concatenate([bodies, filtered.decimate(friction_sensitivity(model.friction, q, qd, load))], axis=2)
    use, undecided = _counting_rows(recording, filtered, noise_velocity, robot)
    measured = filtered.decimate(filtered.tau)
    noise, prismatic = noise_floor(recorded.tau, 1.0 / recorded.factor), tuple(map(bool, robot.prismatic))
    result = Regression(filtered.t_decimated - filtered.t[0], tuple(f"tau_{j + 1}" for j in range(n)),
                        robot.units("N m"), measured, measured, W, use, signals, filtered, undecided, noise, prismatic)
    result = with_reversal_width(result, model, noise_velocity if reversal_width is None else reversal_width)
    return result if shared else replace(result, W=_own_copies(result.W))


def _filtered(recording: Recording, cutoff: float | None) -> FilteredSignals:
    """The recording behind both filters, with no more rows than ``ROWS``."""
    # The median step gives the rate, as pauses have no samples.
    rate = 1.0 / max(float(np.median(np.diff(recording.t))), 1e-9)
    duration = len(recording.t) / rate
    cutoff = min(CUTOFF, 0.25 * rate) if cutoff is None else cutoff
    band = min(BAND * cutoff / CUTOFF, 0.5 * ROWS / (recording.n * duration), 0.5 * rate)
    return preprocess(without_spikes(recording), cutoff=cutoff, cutoff_decimation=band)


def _counting_rows(recording: Recording, filtered: FilteredSignals, noise_velocity: Array,
                   robot: Robot) -> tuple[np.ndarray, dict[int, str]]:
    """Which rows ``(M, n)`` count: away from ends, pauses, reversals and limits; and why a joint has none."""
    factor, (moving, undecided) = filtered.factor, _moving_samples(filtered, noise_velocity, robot)
    use = apart_from_reversals(filtered.q, filtered.qd, moving, MEMORY / filtered.cutoff,
                               filtered.dt)[::factor][filtered.keep]
    for j in range(recording.n):
        at_limit = clipped(recording.columns[f"tau_{j + 1}"], stands(recording.t, recording.columns[f"q_{j + 1}"]))
        if at_limit.any():
            near = np.interp(filtered.t, recording.t, at_limit.astype(float)) > 0.0
            use[:, j] &= ~ndimage.maximum_filter1d(near, 4 * factor + 1)[::factor][filtered.keep]
    return use, {**{int(j) + 1: "has no sample away from ends, pauses, reversals and limits: it has no part"
                    for j in np.flatnonzero(~use.any(axis=0))}, **undecided}


def _moving_samples(filtered: FilteredSignals, v_small: Array, robot: Robot) -> tuple[Array, dict[int, str]]:
    """Samples at which each joint moves ``(N, n)``, and joints that move little, with what that means.

    Below velocities of ``v_small (n,)`` the direction is lost in noise. Passages through low speed that are shorter
    than a period of the position filter's cut-off count as motion.
    """
    q, qd, dt = filtered.q, filtered.qd, filtered.dt
    moving = np.ones(q.shape, dtype=bool)
    undecided: dict[int, str] = {}
    for j in range(q.shape[1]):
        speed = np.abs(qd[:, j])
        slow = speed < np.maximum(2.0 * v_small[j], RESTING * np.percentile(speed, 99))
        edges = np.flatnonzero(np.diff(np.concatenate([[0], slow.astype(int), [0]])))
        for start, stop in zip(edges[::2], edges[1::2], strict=True):
            if (stop - start) * dt > 1.0 / filtered.cutoff:
                moving[start:stop, j] = False
        seconds = float(np.sum(moving[:, j]) * dt)
        travel = float(np.ptp(q[:, j]))
        turns = int(np.sum(np.diff(np.sign(qd[moving[:, j], j])) != 0))
        noise_travel = 20.0 * v_small[j] * dt
        if seconds < 2.0 or travel < max(noise_travel, 0.004 if robot.prismatic[j] else 0.02):
            undecided[j + 1] = (f"moves {seconds:.1f} s over {travel:.2g} {robot.units('rad')[j]}, in which "
                                "its causes are hardly distinguishable")
        elif turns < 2:
            undecided[j + 1] = (f"turns round {('never', 'once')[turns]}: friction, gravity and an offset are hardly "
                                "distinguishable there")
    return moving, undecided


def apart_from_reversals(q: Array, qd: Array, moving: np.ndarray, width: float, dt: float) -> np.ndarray:
    """Mask ``(N, n)`` of moving samples away from each reversal and each rest, in time and in distance.

    Friction near zero speed differs between drives, so no cause may depend on it. Filters keep its influence for a
    time, the presliding state for a distance, which takes long in slow motion.

    Args:
        q, qd: positions and velocities ``(N, n)`` [rad or m, and per second].
        moving: samples at which each joint moves ``(N, n)``.
        width, dt: time excluded on either side, and between samples [s].
    """
    near = ~moving
    change = np.diff(np.sign(qd), axis=0) != 0
    near[:-1] |= change
    near[1:] |= change
    half = max(1, round(width / dt))
    apart = ~ndimage.maximum_filter1d(near, 2 * half + 1, axis=0, mode="nearest")
    last = np.maximum.accumulate(np.where(near, np.arange(len(q))[:, None], 0), axis=0)
    travel = np.abs(q - np.take_along_axis(q, last, axis=0))
    return np.asarray(apart & (travel > _BRISTLES))


def _small_velocity(recording: Recording, filtered: FilteredSignals) -> Array:
    """Velocity below which its sign is not known ``(n,)``: twice the noise that the position filter lets through."""
    raw = interpolated(filtered.t, recording.t, recording.joints("q"))
    noise = np.std(np.diff(raw, 3, axis=0), axis=0) / np.sqrt(20.0)
    # White position noise through the low-pass, differentiated: integral of (2 pi f)^2 up to the cut-off.
    share = 2.0 * np.pi * filtered.cutoff * np.sqrt(2.0 * filtered.cutoff * filtered.dt / 3.0)
    top = np.percentile(np.abs(filtered.qd), 99, axis=0)
    return np.maximum(np.minimum(2.0 * noise * share, 0.02 * top), 1e-4 * top + 1e-9)


def without_dead_channels(made: Regression, dead: Sequence[int]) -> Regression:
    """The regression without some torque channels (from 0), which do not measure their joint."""
    use = made.use.copy()
    use[:, list(dead)] = False
    why = {j + 1: f"has a dead torque channel, tau_{j + 1}: it has no part" for j in dead}
    return replace(made, use=use, undecided={**made.undecided, **why})


def about_model(made: Regression, model: Model) -> Regression:
    """The same regression about a model of the same structure with other parameters."""
    s, n = made.signals, made.signals.n
    chain = chain_of(model._exact_model)
    load = inverse_dynamics(chain, s.q, s.qd, s.qdd)
    friction = model.friction.torque(s.qd, load, s.q, np.column_stack([direction_of(s, j) for j in range(n)]))
    torque = load + model._exact[model.base.layout.rotors] * s.qdd + model.offset + friction
    weight = inverse_dynamics(chain, s.q, np.zeros_like(s.q), np.zeros_like(s.q))
    signals = replace(s, load=load, torque=torque, friction=friction, weight=weight,
                      constant=constant_of_weight(model.offset, weight), sliding=model.friction.sliding(s.q, s.qd),
                      rigid=lambda a, b, c: inverse_dynamics(chain, a, b, c),
                      gravity_across=lambda at: gravity_across(chain, at), dry=model.friction.dry,
                      compliance=model.known_compliance)
    prediction = torque
    for effect in model.effects:
        if effect.domain == MOTOR_TORQUE:
            added = effect.contribution(signals)
            prediction = prediction + added
            change = effect.effect.loop_change(effect.coefficients, effect.theta)
            if change.body or change.gravity is not None or change.zero:
                # Additional gear torques deflect the gears as well.
                load = load + added
    signals = replace(signals, load=load)
    return replace(made, signals=signals,
                   y=made.measured - made.filtered.decimate(prediction + _bent_gears(signals)))


def _bent_gears(signals: Signals) -> Array:
    """Change of the torques by the twist and swing of gears whose stiffness the model has ``(N, n)`` [N m].

    The rigid body is asked at the motors' angles; the arm is where its gears leave it.
    """
    result = np.zeros_like(signals.load)
    if signals.compliance is None:
        return result
    swings, rigid = find("joint_elasticity", "tau_resonance"), replace(signals, compliance=None)
    for j, compliance in enumerate(signals.compliance.tolist()):
        if compliance > 0.0 and swings.usable(rigid, j + 1):
            result += swings.columns(signals, j + 1, (1.0 / compliance,))[:, :, 0]
    return result


def with_reversal_width(made: Regression, model: Model, reversal_width: Array) -> Regression:
    """The regression with dry friction that changes sign over another range of speeds, without samples in it.

    At creeping speed friction is anything between zero and sliding friction, by a law that differs between drives.

    Args:
        made, model: the regression, and whose friction it is.
        reversal_width: speeds ``(n,)`` [rad/s].
    """
    made = about_model(replace(made, signals=replace(made.signals, v_small=reversal_width)), model)
    s, W, places = made.signals, made.W.copy(), friction_places(model.base, model.friction)
    for j, (law, place) in enumerate(zip(model.friction.laws, places, strict=True)):
        if not law.presliding:
            columns = law.regressor(s.qd[:, [j]], s.load[:, [j]], s.q[:, [j]], direction_of(s, j))
            W[:, j, place] = made.filtered.decimate(columns[:, 0])
    sliding = np.abs(made.decimated_signals().qd) > CLEAR * reversal_width
    return replace(made, W=W, use=made.use & sliding)


def direction_of(signals: Signals, j: int) -> Array:
    """Direction of motion of joint ``j`` (from 0) for friction laws ``(N, 1)``."""
    return signals.direction(signals.qd[:, j], j + 1)[:, None]


def _differentiated(filtered: FilteredSignals) -> FilteredSignals:
    """The signals with velocities and accelerations of a quintic spline through the filtered positions.

    Central differences lose ``(2 pi f dt)^2 / 3`` of an acceleration, which a soft gear does as well.
    """
    spline = interpolate.make_interp_spline(filtered.t, filtered.q, k=5)
    return replace(filtered, qd=spline(filtered.t, 1), qdd=spline(filtered.t, 2))


def in_position_band(made: Regression, recording: Recording) -> Regression:
    """Sets times and filters of a torque regression for the position and force channels of the same recording."""
    rate = 1.0 / made.filtered.dt
    filtered = preprocess(recording, cutoff=made.filtered.cutoff, cutoff_decimation=min(POSITION_BAND, 0.5 * rate))
    if len(filtered.t) > len(made.filtered.t):
        filtered = _thinned(filtered)
    return replace(made, t=filtered.t_decimated - filtered.t[0], filtered=filtered)


def _thinned(filtered: FilteredSignals) -> FilteredSignals:
    """The signals thinned to five samples a period of the widest band, as effects are computed at every sample."""
    stride = int(1.0 / (filtered.dt * 5.0 * POSITION_BAND) + 1e-6)
    if stride < 2:
        return filtered
    columns = {name: np.ascontiguousarray(values[::stride]) for name, values in filtered.columns.items()}
    return replace(thinned(filtered, stride), columns=columns)


def without_spikes(recording: Recording) -> Recording:
    """The recording with single outliers of the torque replaced by values from their neighbours.

    This is done on the recorded samples, as resampling would multiply an outlier before a gap.
    """
    columns = dict(recording.columns)
    for name in (f"tau_{j + 1}" for j in range(recording.n) if f"tau_{j + 1}" in columns):
        tau = columns[name]
        if not np.all(np.isfinite(tau)):
            continue
        middle = ndimage.median_filter(tau, size=5, mode="nearest")
        off = tau - middle
        scale = 1.4826 * np.median(np.abs(off - np.median(off)))
        stands_out = np.abs(off) > max(6.0 * scale, 0.05 * np.std(tau))
        columns[name] = np.where(stands_out, middle, tau)
    return replace(recording, columns=columns)


def in_own_units(made: Regression) -> Regression:
    """Torque and load of the nominal model in the units of each joint's measurement, by one factor per joint."""
    s, nominal = made.signals, made.filtered.decimate(made.signals.torque)
    factor = (nominal * made.measured).sum(axis=0) / np.maximum((nominal**2).sum(axis=0), 1e-300)
    # A vertical axis has no gravity torque in any unit.
    signals = replace(s, torque=s.torque * factor, load=s.load * factor, friction=s.friction * factor,
                      weight=None if s.weight is None else s.weight * factor, rigid=None, gravity_across=None)
    return replace(made, signals=signals, y=made.measured, units=("A",) * len(made.units),
                   prismatic=(False,) * len(made.prismatic))


def _own_copies(W: Array) -> Array:
    """Columns ``(N, c, p)`` with a copy of its own for each channel of those that act on it."""
    return np.concatenate([np.where(np.arange(W.shape[1])[:, None] == j, W[:, :, np.any(W[:, j] != 0.0, axis=0)], 0.0)
                           for j in range(W.shape[1])], axis=2)
