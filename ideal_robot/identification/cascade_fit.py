"""Identifies the cascade of each joint's controller from recordings with commands.

[G] 5.2.2 identifies the controller at the interpolation cycle and has to live with inputs that are not constant in it.
A recording that resolves the loops' response allows more: the cascade

    r = low-pass(q_c(t - late)) ,  u = k_v (r - q) + k_ff ṙ + k_a r̈ - q̇_f
    τ = k_p u + k_i ∫u + τ_c tanh(ṙ / v_c) + c

is simulated with the *measured* angles, so neither rigid body nor friction enters, and its parameters are those whose
torque comes closest to the measured one over the whole recording (simulated, not predicted a step ahead, as [G] Fig. 17
teaches). A drive logs its present torque, or the mean since the last sample, which is a millisecond or two older. The
wrong assumption changes gains by a fifth; the one that fits better is used. Written out, τ is linear in k_p k_v, k_p
k_ff, k_p k_a and k_p; only the times and k_i / k_p need a search. What happens to commands before the cascade (a
delay, a low-pass) is the same for all joints, and sought where a short low-pass does not explain the torque. So is what
drives may do by themselves: the speed v_c over which they turn round what they compensate of friction, τ_c, and the
share g in which the gains of the velocity loop follow the inertia that a joint moves, ``k_p (1 + g (J(q) / J_0 - 1))``,
and other kinds of controllers: PID, impedance, inverse dynamics, whose torques are looked at where they were made,
before the data sheet's mass matrix.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares, minimize_scalar, nnls
from scipy.signal import butter, filtfilt, lfilter

from ideal_robot.arrays import Array, interpolated
from ideal_robot.command.fit import LATE
from ideal_robot.command.law import logged_finely
from ideal_robot.command.recorded import command_cycle, update_instants
from ideal_robot.dynamics.newton_euler import chain_of, inverse_dynamics
from ideal_robot.errors import InputError
from ideal_robot.identification.loop_recordings import require_changes, require_loop
from ideal_robot.loop.loop import mass_at
from ideal_robot.model.parametrisation import ControllerModel
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from ideal_robot.signals.sampling import gap_free

_ORDER = 2
"""Stages of the command low-pass that are fitted; a single short one comes out as two shorter ones just as well."""
_SEEN = 0.9
"""Share of the torque's squares that a low-pass leaves, which a channel of the command has to fall below to be sought:
for every delay there is a channel that differs from the low-pass by noise alone."""
_CUTOFF = 12.0
"""Torque and angles are compared below this frequency [Hz]: above, the encoder's increments make the velocity."""
_COARSEST = 0.25 / _CUTOFF
"""Longest cycle of a recording: four samples a period of that frequency, between which a spline is the motion [s]."""
_ROWS = 8
"""Rows that are kept of a period of that frequency."""
_SEARCHED = 3
"""Columns that are kept for the next step of a search: those of its point, and of a step aside."""
_INTEGRAL = 0.05
"""Usual integral time of a velocity loop [s]; the search begins with none and from an eighth to 16 times as quick."""
_EDGE = 50
"""Samples at either end that the filter spoils."""


@dataclass(frozen=True)
class ControllerFit:
    """Cascade gains of ``n`` joints in the form of [G] (16), (17) at the position loop's cycle, as identified.

    The error per joint ``(n,)`` is ``100 ‖τ - τ̂‖ / ‖τ - mean‖``.
    """

    controller: ControllerModel
    error_percent: Array


def fit_controller(recording: Recording, robot: Robot, rotors: Array | None = None) -> ControllerFit:
    """Cascade gains of every joint, from a recording in which all joints move.

    Args:
        recording: with ``q_c_i`` (the command before its low-pass), ``q_i`` and ``tau_i`` every 20 ms at least.
        robot: cycles, and the bodies of the data sheet.
        rotors: inertias of the rotors by the data sheet ``(n,)`` [kg m²], for gains scheduled by the joint's inertia;
            None if such gains are not searched.

    Raises:
        InputError: a missing column, too slow a sampling, a joint that does not move.
    """
    cycle = float(np.median(np.diff(recording.t)))
    if cycle > _COARSEST:
        raise InputError(f"the closed loop needs samples every {1e3 * _COARSEST:.3g} ms", file=recording.source,
                         field="t", value=cycle)
    for i in range(recording.n):
        if np.ptp(recording.columns[f"q_{i + 1}"]) < 0.02:
            raise InputError("the joint hardly moves", file=recording.source, field=f"q_{i + 1}")
    require_loop([recording])
    require_changes([recording.joints("tau")], "tau", recording.source)
    parts = gap_free(recording, ("q_c", "q", "tau"), 2 * _EDGE + 2)
    if not parts:
        raise InputError(f"too short: {2 * _EDGE + 2} samples without a gap are needed", file=recording.source,
                         field="t")
    # All joints of a drive log in the same way.
    sheets, moved = ([], None) if rotors is None else _sheets(parts, robot, rotors)
    joints = [_joints(parts, robot, averaged, sheets) for averaged in (False, True)]
    plain = _fitted(joints, _Channel())
    before = _sought(joints[0], robot.t_ipo)
    fits = [plain, *([] if before is None else [_fitted(joints, before)])]
    more = [channel for fit, each in fits if (channel := _helped(each, fit)) is not None]
    best = plain[0]
    # A more complex channel has to fit clearly better: a delay is tried before another kind of controller.
    for other in (*(fit for fit, _ in fits), *(_needed(joints, _fitted(joints, channel)[0]) for channel in more)):
        best = other if other.squares < _SEEN * best.squares else best
    k_v, k_ff, k_p, k_i, t_low, t_filter, compensation, bodies, acceleration, turns = best.values.T
    channel = best.channel
    controller = ControllerModel(
        t_cycle=robot.t_position, k_p=k_p * k_v, k_d=k_p * k_ff, k_1=k_p * (k_ff - 1.0), k_2=k_p * t_filter,
        k_i=k_i / k_p * robot.t_position, filter_time=t_low, filter_order=channel.order, delay=channel.late,
        integrated=channel.integrated, compensation=compensation if channel.turns else None,
        v_compensation=turns if channel.turns else None, bodies=bodies if channel.bodies else None,
        schedule=channel.schedule, coupled=channel.coupled,
        scheduled_at=moved if channel.schedule or channel.coupled else None, rate_filter=channel.rate,
        acceleration=acceleration if channel.accelerated else None)
    return ControllerFit(controller, best.error)


class _Channel(NamedTuple):
    """The way of all joints' commands: order of its low-pass, its stages' time constant at first, delay [s].

    And what drives do by themselves: the speed ``turns`` over which they turn round what they compensate of friction,
    any of ``_TURNS`` [rad/s], and the share ``schedule`` in which gains follow the inertia; 0 where they do not.
    ``integrated`` is the share of u without the position that the integrator gets: 0 of PID control;
    ``bodies`` whether torques of the data sheet's bodies are added, ``coupled`` whether its mass matrix makes torques
    of what loops ask for. ``rate`` is the time constant of the lag of the command's rates [s], ``ahead`` and
    ``accelerated`` whether the first and the second are fed forward.
    """

    order: int = _ORDER
    low: float = 0.0
    late: float = 0.0
    turns: float = 0.0
    schedule: float = 0.0
    integrated: float = 1.0
    bodies: bool = False
    coupled: bool = False
    rate: float = 0.0
    ahead: bool = True
    accelerated: bool = False


_SHORT = (0.001, 0.003, 0.006)
"""Times of low-passes of commands that every controller may have [s]."""
_LONG = (0.015, 0.04, 0.08)
"""Longer ones [s]; a single one is as good as two of half its time."""


class _Fitted(NamedTuple):
    """Cascades of all joints: ``values (n, 10)`` as of ``_fit_joint`` and v_c, errors ``(n,)`` [%], and channel."""

    values: Array
    error: Array
    channel: _Channel

    @property
    def squares(self) -> float:
        """Sum of the joints' squared errors."""
        return float(np.sum(self.error**2))


class _Sheet(NamedTuple):
    """What the data sheet says of the joints at the rows ``(N, n)`` of a stretch.

    Attributes:
        more: inertia that each joint moves, its rotor's included, over the mean J_0 of all stretches, less 1.
        torque: of gravity and velocities [N m].
        measured, added: torques, and those of gravity and velocities, before the mass matrix: J_0 M⁻¹ τ [N m].
    """

    more: Array
    torque: Array
    measured: Array
    added: Array


def _sheets(parts: Sequence[Recording], robot: Robot, rotors: Array) -> tuple[list[_Sheet], Array]:
    """What the data sheet says of each stretch, and the mean inertia that each joint moves ``(n,)`` [kg m²]."""
    chain, masses, torque = chain_of(robot.pinocchio), list[Array](), list[Array]()
    for part in parts:
        q = np.ascontiguousarray(part.joints("q"))
        torque.append(inverse_dynamics(chain, q, np.gradient(q, _step(part), axis=0), np.zeros_like(q)))
        masses.append(np.array([mass_at(chain, rotors, row) for row in q]))
    inertia = [np.diagonal(M, axis1=1, axis2=2) for M in masses]
    mean = np.concatenate(inertia).mean(axis=0)
    before = [mean * np.linalg.solve(M, np.stack([part.joints("tau"), added], axis=2)).transpose(2, 0, 1)
              for part, M, added in zip(parts, masses, torque, strict=True)]
    return [_Sheet(moved / mean - 1.0, added, *both)
            for moved, added, both in zip(inertia, torque, before, strict=True)], mean


def _step(part: Recording) -> float:
    return float(np.median(np.diff(part.t)))


def _joints(parts: Sequence[Recording], robot: Robot, averaged: bool, sheets: Sequence[_Sheet]) -> list[_Stretches]:
    """Every joint over stretches without a gap.

    Args:
        parts: stretches of the recording.
        robot: cycles.
        averaged: as of ``_JointCascade``.
        sheets: what the data sheet says of each stretch; empty where that is not looked at.
    """
    forced = [commands_in_force(part, robot) for part in parts]
    return [_Stretches([_JointCascade(forced[k][:, i], part.columns[f"q_{i + 1}"], part.columns[f"tau_{i + 1}"],
                                      _step(part), robot.t_velocity, averaged,
                                      _Sheet(*(rows[:, i] for rows in sheets[k])) if sheets else None)
                        for k, part in enumerate(parts)]) for i in range(parts[0].n)]


def commands_in_force(part: Recording, robot: Robot) -> Array:
    """Set points of the position loops ``(K (N - 1) + 1, n)`` [rad], K of their cycles in each of the recording's.

    A log finer than the interpolation cycle contains them. A log of the commands as sent is a cycle ahead: they are
    joined by lines, each reaching its command at the end of its cycle.

    Args:
        part: evenly sampled, with ``q_c_i`` ``(N,)``.
        robot: cycles.
    """
    q_c, t, cycle = part.joints("q_c"), part.t - part.t[0], _step(part)
    handed_over = command_cycle([part], "q_c")
    finer = max(round(cycle / robot.t_position), 1)
    at = cycle / finer * np.arange(finer * (len(t) - 1) + 1)
    if logged_finely(handed_over, robot.t_ipo):
        return interpolated(at, cycle * np.arange(float(len(t))), q_c)
    rows = update_instants(t, q_c)
    return interpolated(at - handed_over, cycle * rows, q_c[rows])


def _sought(joints: Sequence[_Stretches], t_ipo: float) -> _Channel | None:
    """The way of the commands before the cascades; None where short low-passes explain most.

    All joints tell, each by the logarithm of what is left of its torque.

    Args:
        joints: of the arm.
        t_ipo: from command to command [s]: what is late is so by whole cycles first of all.
    """
    channels = [_Channel(order, low, late) for order in (_ORDER, 1) for low in (*_SHORT, *_LONG)
                for late in (*LATE, t_ipo, 2.0 * t_ipo) if order == _ORDER or low in _LONG]
    channel = min(channels, key=lambda one: float(np.mean([np.log(joint.least(one)) for joint in joints])))
    if channel.low in _SHORT and not channel.late:
        return None
    return _agreed(joints, channel, "late")


def _agreed(joints: Sequence[_Stretches], channel: _Channel, free: str) -> _Channel:
    """The channel with a time, by its name, that is the same for all joints: the middle of what each says."""
    changed: dict[str, Any] = {free: float(np.median([_fit_joint(joint, channel, free)[2] for joint in joints]))}
    return channel._replace(**changed)


_TURNS = (0.003, 0.01, 0.03, 0.1)
"""Speeds over which compensated friction may turn round [rad/s]; beyond the last it is like a share of the velocity."""
_SCHEDULES = (0.25, 0.5, 0.75, 1.0)
"""Shares in which gains may follow the inertia: the search begins with them."""
_RATES = (0.003, 0.01, 0.03)
"""Lags of the command's rates [s]: the search begins with them."""


def _helped(joints: Sequence[_Stretches], plain: _Fitted) -> _Channel | None:
    """The channel of the kind of controller that explains most, with what drives do; None where none explains more.

    All joints tell, each by the logarithm of what is left of its torque. From each kind on, one thing after the other
    is taken where it leaves less by ``_SEEN``; another kind than a cascade has to leave less by as much.

    Args:
        joints: of the arm.
        plain: their cascades without.
    """
    known = dict[_Channel, float]()

    def left(channel: _Channel) -> float:
        if channel not in known:
            known[channel] = float(np.mean([np.log(min(joint.least(one, times) for one in _turning(channel)))
                                            for joint, times in zip(joints, plain.values[:, 4:6], strict=True)]))
        return known[channel]

    cascade, follows = plain.channel, joints[0].follows
    kinds = [cascade, cascade._replace(integrated=0.0),
             *([cascade._replace(bodies=True), cascade._replace(bodies=True, coupled=True, accelerated=True)]
               if follows else [])]
    found = [_refined(left, kind, follows) for kind in kinds]
    channel = min(found, key=lambda one: left(one) - np.log(_SEEN) * (found.index(one) > 0))
    if channel == cascade:
        return None
    # Lags of rates can only be seen with the right low-pass of the commands.
    lags = channel.rate or found.index(channel) > 0
    return _agreed(joints, channel._replace(rate=channel.rate or _RATES[1]), "rate") if lags else channel


def _refined(left: Callable[[_Channel], float], channel: _Channel, follows: bool) -> _Channel:
    """A kind of controller with what drives do beside, one thing after the other while it leaves less by ``_SEEN``.

    Args:
        left: logarithm of what a channel leaves.
        channel: of the kind.
        follows: whether the data sheet's inertias are looked at.
    """
    while True:
        more = [*(channel._replace(turns=turns) for turns in _TURNS[:1] if not channel.turns),
                *(channel._replace(rate=time) for time in _RATES if not channel.rate),
                *([] if channel.accelerated else [channel._replace(accelerated=True)]),
                *(channel._replace(schedule=share) for share in _SCHEDULES
                  if follows and not channel.schedule and not channel.coupled)]
        best = min(more, key=left, default=channel)
        if left(best) >= left(channel) + np.log(_SEEN):
            break
        channel = best
    if channel.schedule:
        near = _SCHEDULES[0]
        share = minimize_scalar(lambda g: left(channel._replace(schedule=float(g))), method="bounded",
                                bounds=(max(channel.schedule - near, 0.0), channel.schedule + near),
                                options={"xatol": 0.02}).x
        channel = channel._replace(schedule=float(share))
    return channel


def _needed(joints: Sequence[Sequence[_Stretches]], found: _Fitted) -> _Fitted:
    """The fit without what it does as well without: each thing that drives do has to lower what is left by ``_SEEN``.

    Args:
        joints: of the arm, for each way of logging.
        found: the fit with all that was found.
    """
    for less in ({"turns": 0.0}, {"rate": 0.0}, {"accelerated": False}, {"ahead": False}, {"schedule": 0.0}):
        if (simpler := found.channel._replace(**less)) != found.channel:
            fit = _fitted(joints, simpler)[0]
            found = fit if _SEEN * fit.squares < found.squares else found
    return found


def _turning(channel: _Channel) -> list[_Channel]:
    """The channel with each speed over which compensated friction may turn round; as it is where none is."""
    return [channel._replace(turns=turns) for turns in _TURNS] if channel.turns else [channel]


def _fitted(joints: Sequence[Sequence[_Stretches]], channel: _Channel) -> tuple[_Fitted, Sequence[_Stretches]]:
    """The cascades of the joints as they log, of ``joints`` for each way of logging, where commands pass a channel."""
    fits = [(_with_channel(each, channel), each) for each in joints]
    return min(fits, key=lambda fit: fit[0].squares)


def _with_channel(joints: Sequence[_Stretches], channel: _Channel) -> _Fitted:
    """The cascades of all joints where commands pass a channel; each compensates friction over a speed of its own."""
    own = [min(_turning(channel), key=joint.least) for joint in joints]
    fits = [_fit_joint(joint, one) for joint, one in zip(joints, own, strict=True)]
    return _Fitted(np.array([[*values, one.turns or 1.0] for (values, *_), one in zip(fits, own, strict=True)]),
                   np.array([error for _, error, _ in fits]), channel)


class _JointCascade:
    """The cascade of one joint over a stretch without a gap: its torque as a linear form of products of gains.

    Attributes:
        q_c, q: commands in force and motor angles at the position loop's cycle ``(K (N - 1) + 1,)`` [rad].
        tau, before: the torque below ``_CUTOFF`` about its mean, without the ends ``(M,)`` [N m], and that before the
            mass matrix; the same where no data sheet is looked at.
        angle: motor angles every ``t_velocity`` [rad].
        cycle, t_position, t_velocity: cycles of the recording, of position and velocity loop [s].
        every: steps of the velocity loop in a cycle of the recording.
        averaged: whether a torque is the mean since the last sample.
        sheet: what the data sheet says of the joint, ``(N,)`` each; None where that is not looked at.
    """

    def __init__(self, q_c: Array, q: Array, tau: Array, cycle: float, t_velocity: float,
                 averaged: bool = False, sheet: _Sheet | None = None) -> None:
        self.averaged, self.sheet = averaged, sheet
        # The logged cycle is measured and rarely a multiple of the controller's, whose steps are adapted to it.
        finer = (len(q_c) - 1) // (len(q) - 1)
        inner = max(round(cycle / finer / t_velocity), 1)
        self.every = finer * inner
        if abs(self.every * t_velocity - cycle) > 1e-9 * cycle:
            t_velocity = cycle / self.every
        self.q_c, self.cycle, self.t_position, self.t_velocity = q_c, cycle, cycle / finer, t_velocity
        self._low_pass = butter(4, min(0.9, 2 * _CUTOFF * cycle))
        # More rows would not add information.
        self._every = max(int(1.0 / (_ROWS * _CUTOFF * cycle)), 1)
        # Angles between samples: the encoder is read faster than it is logged, the motion is smooth at that scale.
        fine = t_velocity * np.arange(self.every * (len(q) - 1) + 1)
        self.angle = CubicSpline(np.arange(len(q)) * cycle, q)(fine)
        self.q = self.angle[::inner]
        # A search changes one time constant after the other, so the others' results are cached.
        self._commanded, self._moved, self._added = (
            lru_cache(_SEARCHED)(columns) for columns in (self._of_commands, self._of_velocity, self._of_bodies))
        self.tau, self.before = (rows - rows.mean() for rows in (
            self._smoothed(tau), self._smoothed(tau if sheet is None else sheet.measured)))

    def _smoothed(self, x: Array) -> Array:
        """Values of each cycle ``(..., N)`` below ``_CUTOFF``, without the ends ``(..., M)``."""
        return np.asarray(filtfilt(*self._low_pass, x)[..., _EDGE:-_EDGE:self._every])

    def columns(self, times: Array, channel: _Channel = _Channel()) -> Array:
        """What the products of gains multiply ``(M, 6)``; behind them accelerations and what drives compensate.

        Args:
            times: time constants of command and velocity ``(2,)`` [s].
            channel: what commands pass, and what drives do by themselves.
        """
        low, velocity = np.abs(times)
        schedule = channel.schedule if self.sheet is not None else 0.0
        # Settings of position and integrator are removed from the cache key, as they do not matter here.
        commanded = self._commanded(low, channel._replace(low=0.0, schedule=schedule, integrated=0.0, bodies=False))
        moved = self._moved(velocity, schedule)
        columns = [commanded[:2], moved[:1], commanded[2:4], moved[1:], commanded[4:]]
        if channel.bodies and self.sheet is not None:
            columns.append(self._added(channel.coupled))
        return np.ascontiguousarray(np.vstack(columns).T)

    # A row for each signal, a column for each instant, so that filters and sums run along contiguous memory.

    def _of_commands(self, low: float, channel: _Channel) -> Array:
        """Position error, rate, their integrals, acceleration and what turns with the rate ``(4..., M)``."""
        step = self.t_position
        at = step * np.arange(float(len(self.q_c)))
        command = np.interp(at - channel.late, at, self.q_c) if channel.late else self.q_c
        r = _low_passed(command, step, low, channel.order)
        rate = _differentiated(r, step, channel.rate)
        more = [*([_differentiated(rate, step, channel.rate)] if channel.accelerated else []),
                *([np.tanh(rate / channel.turns)] if channel.turns else [])]
        both = self._held(np.stack([r - self.q, rate]), channel.schedule)
        # Additional terms of the drives are not scheduled with the inertia; accelerations are, like the loops' gains.
        further = [self._held(value[None], channel.schedule * (channel.accelerated and k == 0))
                   for k, value in enumerate(more)]
        return self._logged(np.vstack([both, np.cumsum(both, axis=1) * self.t_velocity, *further]))

    def _of_velocity(self, time: float, schedule: float) -> Array:
        """The measured velocity behind its lag, and the integral ``(2, M)``."""
        speed = self._following(-_differentiated(self.angle, self.t_velocity, time)[None], schedule)
        return self._logged(np.vstack([speed, np.cumsum(speed, axis=1) * self.t_velocity]))

    def _of_bodies(self, coupled: bool) -> Array:
        """The torque that the data sheet's bodies take ``(1, M)``."""
        assert self.sheet is not None
        return self._logged(self._held((self.sheet.added if coupled else self.sheet.torque)[None], 0.0))

    def _held(self, values: Array, schedule: float) -> Array:
        """Values of each cycle ``(k, M)``, held over it: they act from its instant on."""
        each = -(-len(self.angle) // values.shape[1])
        return self._following(np.repeat(values, each, axis=1)[:, : len(self.angle)], schedule)

    def _following(self, values: Array, schedule: float) -> Array:
        """Values every ``t_velocity``, times the gains where they follow the inertia by a share."""
        if not schedule or self.sheet is None:
            return values
        return values * np.repeat(1.0 + schedule * self.sheet.more, self.every)[: len(self.angle)]

    def _logged(self, acting: Array) -> Array:
        """What a drive logs of torques every ``t_velocity``, without what is quicker than the fit looks at."""
        logged = acting[:, :: self.every]
        if self.averaged:
            logged = logged.copy()
            # Slice by slice: a mean over the few values of a cycle took a quarter of the search.
            logged[:, 1:] = sum(acting[:, k :: self.every] for k in range(1, self.every + 1)) / self.every
        return self._smoothed(logged)


class _Stretches:
    """All stretches of one joint together; the integrator's state at the start of each is a constant of its own.

    Their torques ``tau (M,)`` [N m] are one after the other, ``before`` those before the mass matrix.
    """

    def __init__(self, parts: Sequence[_JointCascade]) -> None:
        self._parts = parts
        self.tau = np.concatenate([part.tau for part in parts])
        self.before = np.concatenate([part.before for part in parts])
        self.cycle, self.t_velocity = parts[0].cycle, parts[0].t_velocity
        self.follows = parts[0].sheet is not None
        self._kept: tuple[float, ...] = ()
        self._columns, self._R = np.empty((0, 6)), np.empty((0, 8))

    def fitted(self, lags: Array, channel: _Channel, lagging: bool = False) -> tuple[Array, Array]:
        """Best ``k_p k_v, k_p k_ff, k_p, τ_c, b, k_p k_a`` ``(6,)``, and what they leave of the torque ``(M,)``.

        That is over the norm of the torque about its mean.

        Args:
            lags: time constants of command and velocity [s], and the integrator's k_i / k_p [1/s] ``(3,)``.
            channel: what commands pass.
            lagging: whether the lags are not known yet. One of δ moves the integral of the position's error by δ r,
                which is then free.
        """
        products, T, _ = self._solved(lags, channel, lagging)
        every = np.zeros(6)
        places = [0, 1, 2, *([5] if channel.accelerated else []), *([3] if channel.turns else []),
                  *([4] if channel.bodies else [])]
        every[places] = products[: len(places)]
        tau = self.before if channel.coupled else self.tau
        return every, (tau - self._columns @ (T @ products)) / np.linalg.norm(tau)

    def left(self, lags: Array, channel: _Channel, lagging: bool = True) -> float:
        """Share of the torque's squares that the best products leave [1]; see ``fitted``."""
        return self._solved(lags, channel, lagging)[2]

    def least(self, channel: _Channel, times: Array | None = None) -> float:
        """Share of the torque's squares that a channel leaves with the best of the first integrators [1].

        Args:
            channel: what commands pass.
            times: time constants of command and velocity that are tried beside the usual ones ``(2,)`` [s].
        """
        usual = np.array([channel.low, 2.0 * self.t_velocity])
        return min(self.left(np.array([*each, ratio / _INTEGRAL]), channel)
                   for each in ([usual] if times is None else [usual, times]) for ratio in _RATIOS)

    def _solved(self, lags: Array, channel: _Channel, lagging: bool) -> tuple[Array, Array, float]:
        """Products ``(k,)``, the matrix that makes their columns ``(c, k)``, and the share of the squares left [1]."""
        # Columns depend neither on ``low``, where a search starts, nor on ``integrated``: the key leaves them out.
        if (key := (*lags[:2], *channel._replace(low=0.0, integrated=0.0))) != self._kept:
            H = [part.columns(lags[:2], channel) for part in self._parts]
            self._kept = key
            self._columns = np.concatenate([part - part.mean(axis=0) for part in H])
            rows = np.column_stack([self._columns, self.before if channel.coupled else self.tau])
            self._R = np.asarray(np.linalg.qr(rows, mode="r"))
        count, w = self._columns.shape[1], channel.integrated
        free = 2 if lagging and w < 1.0 else 0
        T = np.zeros((count, count - 3 + free))
        fed = float(channel.ahead)
        T[[0, 1, 2], [0, 1, 2]] = 1.0, fed, 1.0
        T[[3, 4, 5], [0, 1, 2]] = abs(lags[2]) * np.array([1.0, w * fed, w])
        T[range(6, count), range(3, count - 3)] = 1.0
        if free:
            T[4, -2:] = 1.0, -1.0
        A, tau = self._R[:, :-1] @ T, self._R[:, -1]
        unit = np.maximum(np.linalg.norm(A, axis=0), 1e-12)
        # A loop has negative feedback: no gain is negative.
        products, rest = nnls(A / unit, tau)
        return products / unit, T, float(rest**2 / np.sum(tau**2))


_SLOWEST = 0.1
"""Integrator's k_i / k_p that recordings of some ten seconds tell from none [1/s]."""
_RATIOS = (0.0, *2.0 ** np.arange(-3, 5))
"""Integrators that are tried first, over ``_INTEGRAL``'s."""


def _fit_joint(joint: _Stretches, channel: _Channel, free: str = "") -> tuple[Array, float, float]:
    """Gains ``k_v, k_ff, k_p, k_i``, times, τ_c, b and k_p k_a of a joint ``(9,)``, the error [%], and a time [s].

    A lag of half a millisecond adds up to hundreds of newton metres in the integrator: lags and integrator must be
    about right together before a search can succeed.

    Args:
        joint: its torques.
        channel: what commands pass.
        free: the channel's time that is sought, too, and given back: ``late`` or ``rate``; none if empty.
    """
    unit = np.array([joint.cycle, joint.t_velocity, 1.0 / _INTEGRAL, joint.cycle])

    def asked(lags: Array) -> tuple[Array, _Channel]:
        lags = lags * unit[: len(lags)]
        return lags[:3], channel._replace(**{free: abs(lags[3])}) if free else channel

    def left(lags: Array, lagging: bool) -> Array:
        return joint.fitted(*asked(lags), lagging)[1]

    lows = [*np.arange(0.05, 4.06, 0.5), *([channel.low / joint.cycle] if channel.low else [])]
    starts = [np.array([low, 2.0, ratio, *([getattr(channel, free) / joint.cycle] if free else [])])
              for low in lows for ratio in _RATIOS]
    found = []
    # With PID control the lags have to be nearly right before the integral of the position error can be seen.
    for lagging in ((False, True) if channel.integrated < 1.0 else (False,)):
        start = starts[int(np.argmin([joint.left(*asked(lags), lagging) for lags in starts]))]
        for way in ((True, False) if lagging else (False,)):
            start = np.abs(least_squares(left, start, diff_step=1e-2, max_nfev=20, args=(way,)).x)
        found.append(start)
    best = min(found, key=lambda lags: joint.left(*asked(lags), False))
    (lags, channel), time = asked(best), float(best[3] * unit[3]) if free else 0.0
    (stiff, ahead, k_p, *added), rest = joint.fitted(lags, channel)
    k_p = max(k_p, 1e-9)
    error = 100.0 * float(np.linalg.norm(rest))
    # An integrator slower than the recording is treated as none.
    k_i = lags[2] * k_p if lags[2] > _SLOWEST else 0.0
    return np.array([stiff / k_p, ahead / k_p, k_p, k_i, *lags[:2], *added]), error, time


def _low_passed(x: Array, cycle: float, time: float, order: int) -> Array:
    a = np.exp(-cycle / time) if time > 0 else 0.0
    out = x - x[0]
    for _ in range(order):
        out = lfilter([1 - a], [1, -a], out)
    return np.asarray(out + x[0])


def _differentiated(x: Array, cycle: float, time: float) -> Array:
    a = np.exp(-cycle / time) if time > 0 else 0.0
    speed = np.concatenate([[0.0], np.diff(x)]) / cycle
    return np.asarray(lfilter([1 - a], [1, -a], speed))
