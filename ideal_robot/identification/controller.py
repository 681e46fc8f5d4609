"""Joint controllers from logged command, position and torque, [G] 5.2.2, equations (15) to (17).

With the integrator the torque is the PI-filtered output of the PD part; filtered that way, each column of (16) gives a
column of the simulated torque, which is linear in the gains. So for a given k_I the whole controller is *simulated* by
one small least-squares fit, and k_I is the value whose simulation comes closest to the measured torque. A direct
estimate of k_I, from one step to the next, accumulates errors in the integrator: [G] Fig. 17, implemented for the
comparison.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import optimize

from ideal_robot.arrays import Array, interpolated
from ideal_robot.errors import InputError
from ideal_robot.identification.loop_recordings import commanded, in_cycle, require_changes, require_loop
from ideal_robot.model.parametrisation import ControllerModel
from ideal_robot.results import Summarised, listed
from ideal_robot.signals.recording import Recording
from ideal_robot.signals.sampling import gap_free

_K_I_RANGE = (1e-4, 2.0)
"""Cycle over reset time: those tried reach from half a cycle to ten thousand."""


@dataclass(frozen=True, repr=False)
class ControllerIdentification(Summarised):
    """Result of ``identify_controller``.

    Attributes:
        model: the controllers.
        error_percent: ``100 ‖τ - τ̂‖ / ‖τ - mean‖`` of the simulated controller per joint ``(n,)``.
        k_i_direct: integral gain of the one-step estimate ``(n,)``, for the comparison only.
        t: sampling instants of the first recording's longest stretch without a gap ``(N,)`` [s].
        measured, simulated, drifting: measured torque then, the simulation with the model's k_I, and that with
            ``k_i_direct`` ``(N, n)`` [N m].
    """

    model: ControllerModel
    error_percent: Array
    k_i_direct: Array
    t: Array
    measured: Array
    simulated: Array
    drifting: Array

    def summary(self) -> list[tuple[str, str]]:
        """Fit of the simulated controllers to the torque as rows of label and value."""
        return [("controllers", f"of {len(self.error_percent)} joints"),
                ("error of the torque", listed(self.error_percent, "%"))]


def identify_controller(recordings: Sequence[Recording], t_cycle: float,
                        without_integrator: Sequence[Recording] = ()) -> ControllerIdentification:
    """Identifies the joint controllers at the interpolation cycle.

    Args:
        recordings: with ``q_c_i`` (or ``q_d_i``), ``q_i`` and ``tau_i``, the integrator on.
        t_cycle: the cycle the gains shall belong to [s]; recordings may be sampled faster.
        without_integrator: recordings made with the integral gain set to zero, where the controller allows it. k_P,
            k_D, k_1 and k_2 then come from these alone, as in [G]; otherwise they come along with k_I.

    Raises:
        InputError: no command columns, a sampling time that does not divide the cycle, a joint that does not move, a
            command or a torque without information.
    """
    _require_signals(recordings, without_integrator)
    n = recordings[0].n
    by_recording = [parts for recording in recordings if (parts := _stretches(recording, t_cycle))]
    if not by_recording:
        raise InputError(f"too short: three cycles of {1e3 * t_cycle:g} ms without a gap are needed",
                         file=recordings[0].source, field="t")
    stretches = [stretch for parts in by_recording for stretch in parts]
    pd_stretches = [stretch for recording in without_integrator for stretch in _stretches(recording, t_cycle)]
    delay, delay_std = _command_delay(stretches, t_cycle)
    best, less, more = (_gains(stretches, pd_stretches, t_cycle, d)
                        for d in (delay, delay - delay_std, delay + delay_std))
    gains, k_i = best.gains[:4], best.gains[4]
    # The gains depend on the delay, which is estimated from the same noise.
    std = np.hypot(best.std, 0.5 * (more.gains - less.gains))
    spread = {name: std[i].tolist() for i, name in enumerate(("k_p", "k_d", "k_1", "k_2", "k_i"))}
    model = ControllerModel(t_cycle, k_p=gains[0], k_d=gains[1], k_1=gains[2], k_2=gains[3], k_i=k_i,
                            filter_time=np.zeros(n), delay=delay, std=spread)
    longest = max(by_recording[0], key=lambda stretch: len(stretch.recording.t))
    shown = _series(longest, t_cycle, delay)[0]
    direct, drifting = _direct(longest, t_cycle, gains)
    count = min(len(shown.t), len(drifting))
    return ControllerIdentification(model, best.error_percent, direct, shown.t[:count], shown.tau[:count],
                                    _simulated(shown, gains, k_i)[:count], drifting[:count])


@dataclass(frozen=True)
class _Gains:
    """Gains of all joints at a delay of the command, k_p, k_d, k_1, k_2, k_i, and their deviations ``(5, n)`` each."""

    gains: Array
    std: Array
    error_percent: Array


class _Stretch(NamedTuple):
    """A part of a recording without a gap, and whether the recording begins with it, at rest."""

    recording: Recording
    first: bool


def _gains(stretches: Sequence[_Stretch], without_integrator: Sequence[_Stretch],
           t_cycle: float, delay: float) -> _Gains:
    series, pd_series = ([part for stretch in some for part in _series(stretch, t_cycle, delay)]
                         for some in (stretches, without_integrator))
    n = stretches[0].recording.n
    gains, std, error = np.empty((5, n)), np.empty((5, n)), np.empty(n)
    for j in range(n):
        joint = _Joint(series, j)
        fixed = None
        if pd_series:
            # Plain least squares, as there is no integrator; an offset is estimated, too.
            pd = _simulation(_Joint(pd_series, j), 0.0, None)
            fixed, std[:4, j] = pd.gains, pd.std
        gains[4, j], std[4, j] = _integral_gain(joint, fixed)
        fit = _simulation(joint, gains[4, j], fixed)
        gains[:4, j], error[j] = fit.gains, fit.error_percent
        if fixed is None:
            std[:4, j] = np.hypot(fit.std, _slope(joint, gains[4, j]) * std[4, j])
    return _Gains(gains, std, error)


def _require_signals(recordings: Sequence[Recording], without_integrator: Sequence[Recording]) -> None:
    if not recordings:
        raise InputError("no recording was given", field="recordings")
    for j in range(recordings[0].n):
        if max(np.ptp(recording.joints("q")[:, j]) for recording in recordings) < 1e-2:
            raise InputError("the joint hardly moves; its controller cannot be identified", file=recordings[0].source,
                             field=f"q_{j + 1}")
    for those in filter(None, (recordings, without_integrator)):
        require_loop(those)
        require_changes([recording.joints("tau") for recording in those], "tau", those[0].source)


def _command_delay(stretches: Sequence[_Stretch], t_cycle: float) -> tuple[float, float]:
    """The delay of the command with which the simulated controllers come closest to the torque, and its σ [s]."""
    def squares(delay: float) -> tuple[Array, Array]:
        """Squared errors over the torque's squares, and the number of independent samples ``(n,)`` each."""
        series = [_series(stretch, t_cycle, delay, offsets=False)[0] for stretch in stretches]
        joints = [_Joint(series, j) for j in range(stretches[0].recording.n)]
        errors = np.array([min(_simulation(joint, k, None).error_percent ** 2 for k in np.geomspace(0.02, 0.8, 8))
                           for joint in joints])
        return errors, np.array([joint.news for joint in joints])

    def cost(delay: float) -> float:
        return float(np.sum(squares(delay)[0]))

    grid = np.linspace(0.0, 0.75 * t_cycle, 7)
    i = int(np.argmin([cost(d) for d in grid]))
    optimum = optimize.minimize_scalar(cost, bounds=(grid[max(i - 1, 0)], grid[min(i + 1, len(grid) - 1)]),
                                       method="bounded", options={"xatol": 0.01 * t_cycle})
    delay, h = float(optimum.x), 0.1 * t_cycle
    (least, news), (more, _), (less, _) = (squares(d) for d in (delay, delay + h, delay - h))
    curvature = np.maximum((more - 2.0 * least + less) / h**2, 0.0)
    # The slope of a sum of squares has the variance 2 σ² times its curvature.
    spread = np.sqrt(np.sum(2.0 * least / news * curvature)) / max(float(np.sum(curvature)), 1e-300)
    return delay, min(float(spread), t_cycle)


def _simulated(series: _Series, gains: Array, k_i: Array) -> Array:
    """Torque ``(N, n)`` of the controllers for a measured motion, [G] (16), (17), from the first measured torque on."""
    tau = np.einsum("knc,cn->kn", series.columns + k_i[:, None] * series.integrals, gains)
    return tau - tau[0] + series.tau[0]


@dataclass(frozen=True)
class _Series:
    """Signals of one recording, or of a stretch of it without a gap, as means over the cycles.

    Attributes:
        t: times ``(N,)`` [s].
        offsets: how many series of the same recording there are.
        columns: of (16) ``(N, n, 4)``.
        integrals: of the columns over the time in cycles ``(N, n, 4)``.
        tau: torque ``(N, n)`` [N m].
    """

    t: Array
    offsets: int
    columns: Array
    integrals: Array
    tau: Array


def _series(stretch: _Stretch, t_cycle: float, delay: float, offsets: bool = True) -> list[_Series]:
    """Means over cycles of ``t_cycle``; one series for each offset of the faster samples, or the first of them alone.

    Inputs change within a cycle. Averaged over it, the difference quotient of (16) *is* the derivative, and torque and
    columns belong to the same instant; sampled, they would lie half a cycle apart. The controller sees the command
    later by ``delay`` [s], that of its low-pass. Where a stretch does not begin at rest, the delayed command of the
    first cycle is not known, and that cycle is left out.
    """
    recording, first = stretch.recording, stretch.first
    step, every = in_cycle(recording, t_cycle)
    begin = slice(0 if first else every, None)
    t, q, tau = recording.t[begin], recording.joints("q", begin), recording.joints("tau", begin)
    q_d = interpolated(t - delay, recording.t, recording.joints(commanded(recording)))
    e, qd = q_d - q, np.gradient(q, step, axis=0)

    def mean(x: Array) -> Array:
        total = np.concatenate([np.zeros_like(x[:1]), np.cumsum(0.5 * (x[1:] + x[:-1]), axis=0)])
        return (total[every:] - total[:-every]) / every

    def rate(x: Array) -> Array:
        return (x[every:] - x[:-every]) / t_cycle

    columns = np.stack([mean(e), rate(e), rate(q), rate(qd)], axis=2)
    area = np.concatenate([np.zeros_like(e[:1]), np.cumsum(0.5 * (e[1:] + e[:-1]), axis=0)]) * step
    integrals = np.stack([mean(area), mean(e), mean(q), mean(qd)], axis=2) / t_cycle
    torque = mean(tau)
    count = every if offsets else 1
    return [_Series(t[every:][i::every], count, columns[i::every], integrals[i::every], torque[i::every])
            for i in range(count)]


def _stretches(recording: Recording, t_cycle: float) -> list[_Stretch]:
    """Stretches without a gap, of three cycles at least."""
    return [_Stretch(part, part.t[0] < recording.t[0] + t_cycle)
            for part in gap_free(recording, (commanded(recording), "q", "tau"), 3 * in_cycle(recording, t_cycle)[1])]


class _Joint:
    """One joint's series of all recordings: columns of (16), their integrals, torque, and the normal equations.

    The simulated torque of a series is ``(C + k_I S) g`` plus a constant, the integrator's unknown state at the start.
    So the sums of products of ``C``, ``S`` and the torque about their means are all that fits for many k_I need.
    """

    def __init__(self, series: Sequence[_Series], joint: int) -> None:
        self.columns = [part.columns[:, joint] for part in series]
        self.integrals = [part.integrals[:, joint] for part in series]
        self.tau = [part.tau[:, joint] for part in series]
        C, S, y = (np.concatenate([x - x.mean(axis=0) for x in parts])
                   for parts in (self.columns, self.integrals, self.tau))
        self.products = C.T @ C, C.T @ S + S.T @ C, S.T @ S, C.T @ y, S.T @ y, float(y @ y)
        # Neighbouring samples of the offset series are not independent; the information is that of one of them.
        self.news = sum(len(part.t) / part.offsets for part in series)


@dataclass(frozen=True)
class _Fit:
    gains: Array
    std: Array
    error_percent: float
    cost: float


def _simulation(joint: _Joint, k_i: float, fixed: Array | None) -> _Fit:
    """The controller simulated with ``k_i``: gains by least squares, or ``fixed`` ones."""
    CC, CS, SS, Cy, Sy, yy = joint.products
    G, r = CC + k_i * CS + k_i**2 * SS, Cy + k_i * Sy
    scale = np.sqrt(np.diag(G))
    inverse = np.linalg.inv(G / np.outer(scale, scale)) / np.outer(scale, scale)
    gains = inverse @ r if fixed is None else fixed
    cost = max(float(yy - 2.0 * gains @ r + gains @ G @ gains), 0.0)
    std = np.sqrt(np.maximum(np.diag(inverse), 0.0) * cost / joint.news)
    return _Fit(gains, std, 100.0 * float(np.sqrt(cost / yy)), cost)


def _integral_gain(joint: _Joint, fixed: Array | None) -> tuple[float, float]:
    """The k_I whose simulation comes closest, and its standard deviation from the curvature of the cost."""
    grid = np.geomspace(*_K_I_RANGE, 40)
    costs = [_simulation(joint, k, fixed).cost for k in grid]
    i = int(np.argmin(costs))
    low, high = grid[max(i - 1, 0)], grid[min(i + 1, len(grid) - 1)]
    best = optimize.minimize_scalar(lambda k: _simulation(joint, k, fixed).cost, bounds=(low, high), method="bounded",
                                    options={"xatol": 1e-5 * high})
    k = float(best.x)
    h = 0.05 * k
    up, down = (_simulation(joint, k + s * h, fixed).cost for s in (1.0, -1.0))
    curvature = max((up - 2.0 * best.fun + down) / h**2, 1e-300)
    return k, float(np.sqrt(2.0 * best.fun / joint.news / curvature))


def _slope(joint: _Joint, k_i: float) -> Array:
    """How the gains ``(4,)`` follow k_I: one that is a little wrong makes them wrong by more than the noise does."""
    h = 0.02 * k_i
    return np.asarray((_simulation(joint, k_i + h, None).gains - _simulation(joint, k_i - h, None).gains) / (2.0 * h))


def _direct(stretch: _Stretch, t_cycle: float, gains: Array) -> tuple[Array, Array]:
    """k_I by least squares from one step of (17) to the next, and the torque it leads to: what [G] warns of.

    Signals are sampled once a cycle and differentiated backwards, as the interpolation cycle sees them:
    ``τ(k) - τ(k-1) - u(k) + u(k-1) = k_I u(k)``. Returns ``k_I (n,)`` and the torque ``(N, n)`` at the cycles' ends.
    """
    recording, first = stretch.recording, stretch.first
    _, every = in_cycle(recording, t_cycle)
    rows = slice(every if first else 2 * every, None, every)
    q_d, q, tau = (recording.joints(name, rows) for name in (commanded(recording), "q", "tau"))

    def rate(x: Array) -> Array:
        return np.concatenate([np.zeros_like(x[:1]), np.diff(x, axis=0)]) / t_cycle

    u = (q_d - q) * gains[0] + rate(q_d - q) * gains[1] + rate(q) * gains[2] + rate(rate(q)) * gains[3]
    step = np.diff(tau, axis=0) - np.diff(u, axis=0)
    k_i = np.sum(step * u[1:], axis=0) / np.sum(u[1:] ** 2, axis=0)
    increments = (1.0 + k_i) * u[1:] - u[:-1]
    return k_i, np.concatenate([tau[:1], tau[0] + np.cumsum(increments, axis=0)])
