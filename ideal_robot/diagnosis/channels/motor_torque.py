"""From a recording and a model to a regression: what was measured, what the model expects, what may be changed in it.

One row per joint and time step: the motor torque minus the model's, and the derivative of the model with respect to
all of its parameters (``ideal_robot.model.parametrisation``), both through the same decimation filter.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy import interpolate, signal

from ideal_robot.arrays import Array
from ideal_robot.dynamics import regressor
from ideal_robot.dynamics.newton_euler import chain_of, inverse_dynamics
from ideal_robot.effects import MOTOR_TORQUE, Domain, Signals
from ideal_robot.model.model import Model
from ideal_robot.model.parametrisation import sensitivity
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.preprocess import FilteredSignals, preprocess
from ideal_robot.signals.recording import Recording

HIGHEST_RATE = 100.0
"""Rate after decimation [Hz]: far above what a robot arm's torque follows, low enough for whole recordings at once."""
ROWS = 150_000
"""Rows of the regression (samples × joints) that are looked at, at most; longer recordings are decimated further."""
WIDTH = 2
"""Samples left out to either side of a reversal."""
_SLOW = 0.004
"""Share of its top speed below which a joint rests or touches zero. If that takes longer than a period of the position
filter's cut-off, friction hangs on a direction that the filter has blurred, and those samples do not count."""
_EDGE = 3.0
"""Memory of the position filter in periods of its cut-off; effects differentiate the load, which it made, once more."""


@dataclass(frozen=True)
class Experiment:
    """The regression of one recording.

    Attributes:
        t: decimated times from the start of the recording ``(N,)`` [s].
        channels, units: names and units of the ``c`` channels.
        y: measured minus predicted ``(N, c)``.
        measured: what was measured ``(N, c)``.
        W: derivative of the prediction by the model's parameters ``(N, c, p)``.
        use: samples that count ``(N, c)``.
        signals: undecimated signals for effects.
        filtered: the filter that made them; ``decimate`` brings columns of effects to the rows of ``y``.
        undecided: joints (from 1) that move too little, with the reason.
        domain: where its effects act.
        quiet: level of the measurement's own noise per channel ``(c,)``, in the band that is looked at.
    """

    t: Array
    channels: tuple[str, ...]
    units: tuple[str, ...]
    y: Array
    measured: Array
    W: Array
    use: np.ndarray
    signals: Signals
    filtered: FilteredSignals = field(repr=False)
    undecided: dict[int, str]
    quiet: Array
    domain: Domain = MOTOR_TORQUE

    def channel_of(self, joint: int) -> int | None:
        """Index of the channel of a joint; None where effects do not belong to one channel."""
        return joint - 1 if joint else None

    def decimate(self, columns: Array) -> Array:
        """Filters and decimates columns ``(N_raw, …)`` to the rows of ``y``; untouched zeros stay exactly zero."""
        return self.filtered.decimate(columns)

    def decimated_signals(self) -> Signals:
        """The signals at the rows of ``y``, sampled (not filtered): for plots and dependence measures."""
        s, step, keep = self.signals, self.filtered.factor, self.filtered.keep

        def at(values: Array) -> Array:
            return np.asarray(values[::step][keep])

        return replace(s, t=at(s.t), q=at(s.q), qd=at(s.qd), qdd=at(s.qdd), load=at(s.load), torque=at(s.torque),
                       friction=at(s.friction), payload=None, rigid=None, frames=None,
                       temperature=None if s.temperature is None else at(s.temperature),
                       sliding=None if s.sliding is None else at(s.sliding),
                       extra={name: at(values) for name, values in s.extra.items()})


def experiment(recording: Recording, robot: Robot, model: Model, *, cutoff: float | None = None,
               shared: bool = True, blur: Array | None = None, payload: bool = False) -> Experiment:
    """Builds the regression of the motor torques.

    Args:
        recording: with ``q_i`` and ``tau_i``.
        robot: whose URDF it is.
        model: what predicts, and whose parameters may change.
        cutoff: of the position filter [Hz], from the data if None.
        blur: speed over which dry friction changes sign ``(n,)`` [rad/s]; from the noise of the position if None.
        payload: whether effects need the regressor of a body on the last link.
        shared: whether the joints share inertias; False gives each joint its own copy of all parameters.

    Raises:
        InputError: see ``preprocess``.
    """
    n = robot.n
    rate = (len(recording.t) - 1) / max(float(recording.t[-1] - recording.t[0]), 1e-9)
    duration = len(recording.t) / rate
    wanted = min(HIGHEST_RATE, ROWS / (n * duration))
    filtered = preprocess(recording, cutoff=cutoff)
    # The torque is looked at up to far above what the motion contains: ripple and spikes are there.
    wanted = min(0.5 * wanted, 0.5 * rate)
    filtered = _differentiated(preprocess(recording, cutoff=filtered.cutoff, cutoff_decimation=wanted))
    q, qd, qdd = filtered.q, filtered.qd, filtered.qdd
    t = filtered.t - filtered.t[0]
    temperature = (np.column_stack([filtered.columns[f"temp_{i + 1}"] for i in range(n)])
                   if recording.has("temp") else None)

    noise_velocity = _small_velocity(recording, filtered)
    extra = {name: values for name, values in filtered.columns.items() if not _is_known_column(name)}
    body = regressor(robot.pinocchio, q, qd, qdd)[:, :, 10 * (n - 1) :] if payload else None
    still = np.zeros_like(q)
    signals = Signals(t, q, qd, qdd, still, still, still, temperature, extra=extra, payload=body,
                      v_small=noise_velocity, cutoff=filtered.cutoff)
    load = inverse_dynamics(chain_of(model._exact_model), q, qd, qdd)
    W = sensitivity(robot.pinocchio, model.base, model.friction, q, qd, qdd, load)
    W = filtered.decimate(W)
    moving, undecided = _moving(t, q, qd, noise_velocity, 1.0 / filtered.cutoff, robot)
    use = moving[:: filtered.factor][filtered.keep] & _apart_from_reversals(qd[:: filtered.factor][filtered.keep])
    use &= _apart_from_ends(filtered)[:, None]
    measured = filtered.decimate(filtered.tau)
    units = tuple("N" if robot.prismatic[j] else "N m" for j in range(n))
    made = Experiment(filtered.t_decimated - filtered.t[0], tuple(f"tau_{j + 1}" for j in range(n)), units,
                      measured, measured, W, use, signals, filtered, undecided, _noise(filtered))
    made = with_blur(made, model, noise_velocity if blur is None else blur)
    return made if shared else replace(made, W=_own_copies(made.W))


def about(made: Experiment, model: Model) -> Experiment:
    """The same regression about a model of the same structure with other parameters."""
    s, n = made.signals, made.signals.n
    chain = chain_of(model._exact_model)
    load = inverse_dynamics(chain, s.q, s.qd, s.qdd)
    friction = model.friction.torque(s.qd, load, s.q, np.column_stack([direction_of(s, j) for j in range(n)]))
    torque = load + model._exact[10 * n : 11 * n] * s.qdd + model.offset + friction
    signals = replace(s, load=load, torque=torque, friction=friction,
                      sliding=model.friction.sliding(s.q, s.qd),
                      rigid=lambda a, b, c: inverse_dynamics(chain, a, b, c))
    prediction = torque
    for effect in model.effects:
        if effect.domain == MOTOR_TORQUE:
            prediction = prediction + effect.contribution(signals)
    return replace(made, signals=signals, y=made.measured - made.filtered.decimate(prediction))


def with_blur(made: Experiment, model: Model, blur: Array) -> Experiment:
    """The same regression with dry friction that changes sign over other speeds ``(n,)`` [rad/s]."""
    made = about(replace(made, signals=replace(made.signals, v_small=blur)), model)
    s, W, at = made.signals, made.W.copy(), model.base.count
    for j, law in enumerate(model.friction.laws):
        first, at = at, at + len(law.coefficients)
        if not law.presliding:
            columns = law.regressor(s.qd[:, [j]], s.load[:, [j]], s.q[:, [j]], direction_of(s, j))
            W[:, j, first:at] = made.filtered.decimate(columns[:, 0])
    return replace(made, W=W)


def direction_of(signals: Signals, j: int) -> Array:
    """Direction of motion of joint ``j`` (from 0) as friction laws want it ``(N, 1)``."""
    return signals.direction(signals.qd[:, j], j + 1)[:, None]


def _differentiated(filtered: FilteredSignals) -> FilteredSignals:
    """With the derivatives of a quintic spline through the filtered positions.

    Central differences lose ``(2 pi f dt)^2 / 3`` of an acceleration, which a soft gear does as well.
    """
    spline = interpolate.make_interp_spline(filtered.t, filtered.q, k=5)
    return replace(filtered, qd=spline(filtered.t, 1), qdd=spline(filtered.t, 2))


def _apart_from_reversals(qd: Array, width: int = WIDTH) -> np.ndarray:
    """Mask ``(N, n)`` without the samples next to each change of direction, ``width`` to either side.

    When exactly friction changes sign between two samples nobody knows; each reversal would leave a spike of its own.
    """
    change = np.diff(np.sign(qd), axis=0) != 0
    mask = np.ones(qd.shape, dtype=bool)
    for shift in range(width):
        mask[: len(mask) - 1 - shift][change[shift:]] = False
        mask[1 + shift :][change[: len(change) - shift]] = False
    return mask


def _apart_from_ends(filtered: FilteredSignals) -> np.ndarray:
    """Mask ``(N,)`` without what the position filter does not know at both ends; at most a tenth is left out."""
    t = filtered.t_decimated
    first, last = float(filtered.t[0]), float(filtered.t[-1])
    edge = min(_EDGE / filtered.cutoff, 0.05 * (last - first))
    return np.asarray((t > first + edge) & (t < last - edge))


def _own_copies(W: Array) -> Array:
    N, c, _ = W.shape
    blocks = []
    for j in range(c):
        kept = np.flatnonzero(np.any(W[:, j] != 0.0, axis=0))
        block = np.zeros((N, c, len(kept)))
        block[:, j] = W[:, j][:, kept]
        blocks.append(block)
    return np.concatenate(blocks, axis=2)


def _is_known_column(name: str) -> bool:
    """Whether a column is one whose meaning is known and that causes nothing by itself."""
    head, _, tail = name.rpartition("_")
    known = {"q", "qd", "qdd", "tau", "current", "temp", "q_c", "q_d", "qa", "line_x", "line_y", "line_z"}
    return (tail.isdigit() and head in known) or name in {"x", "y", "z", "qx", "qy", "qz", "qw", "fx", "fy", "fz", "mx",
                                                          "my", "mz", "cam_t"}


def _small_velocity(recording: Recording, filtered: FilteredSignals) -> Array:
    """Velocity below which its sign is not known ``(n,)``: twice the noise that the position filter lets through."""
    raw = np.column_stack([np.interp(filtered.t, recording.t, recording.columns[f"q_{j + 1}"])
                           for j in range(recording.n)])
    noise = np.std(np.diff(raw, 3, axis=0), axis=0) / np.sqrt(20.0)
    # White position noise through the low-pass, differentiated: integral of (2 pi f)^2 up to the cut-off.
    share = 2.0 * np.pi * filtered.cutoff * np.sqrt(2.0 * filtered.cutoff * filtered.dt / 3.0)
    top = np.percentile(np.abs(filtered.qd), 99, axis=0)
    return np.maximum(np.minimum(2.0 * noise * share, 0.02 * top), 1e-4 * top + 1e-9)


def _moving(t: Array, q: Array, qd: Array, v_small: Array, rest: float, robot: Robot) -> tuple[Array, dict[int, str]]:
    """Samples at which each joint moves (passages shorter than ``rest`` [s] included), and joints that move too little.
    """
    dt = float(t[1] - t[0])
    moving = np.ones(q.shape, dtype=bool)
    undecided: dict[int, str] = {}
    for j in range(q.shape[1]):
        speed = np.abs(qd[:, j])
        slow = speed < np.maximum(2.0 * v_small[j], _SLOW * np.percentile(speed, 99))
        edges = np.flatnonzero(np.diff(np.concatenate([[0], slow.astype(int), [0]])))
        for start, stop in zip(edges[::2], edges[1::2], strict=True):
            if (stop - start) * dt > rest:
                moving[start:stop, j] = False
        seconds = float(np.sum(moving[:, j]) * dt)
        travel = float(np.ptp(q[:, j]))
        turns = int(np.sum(np.diff(np.sign(qd[moving[:, j], j])) != 0))
        noise_travel = 20.0 * v_small[j] * dt
        if seconds < 2.0 or travel < max(noise_travel, 0.004 if robot.prismatic[j] else 0.02):
            unit = "m" if robot.prismatic[j] else "rad"
            undecided[j + 1] = (f"moves only {seconds:.1f} s over {travel:.2g} {unit}; "
                                "at least 2 s and 0.02 rad (4 mm) are needed")
        elif turns < 2:
            undecided[j + 1] = f"reverses {turns} times; at least two reversals tell friction from gravity and offset"
    return moving, undecided


def _noise(filtered: FilteredSignals) -> Array:
    """Noise of the torque measurement in the band that is looked at: the floor of its spectrum above the band."""
    rate = 1.0 / filtered.dt
    band = min(filtered.cutoff_decimation, 0.5 * rate)
    f, power = signal.welch(filtered.tau, fs=rate, nperseg=min(len(filtered.tau), 1024), axis=0)
    above = f >= 0.8 * f[-1]
    return np.sqrt(np.median(power[above], axis=0) / np.log(2.0) * band)
