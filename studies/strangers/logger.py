"""Loggers, what of a run reaches the file, and how large an effect is in what they recorded.

The size of an effect is how much of it nothing in the model class can take, against what that class leaves anyway.

The model class is what an identification fits: rigid body with free inertial parameters, rotor, dry and viscous
friction and an offset of every joint. On the *healthy twin* (the same plant, motion, logger and noise without the
effect) it leaves a residual h below ``BAND``; on the recording with the effect it leaves e. The effect's own share is
rms(e - h). One times *visible* is a quarter of rms(h): a sixteenth of the squares that are left anyway. Where
a model is known before, its parameters come from another healthy recording and are not fitted again: then nothing is
absorbed, and the whole difference of the two torques counts.

Encoder steps, noise, jitter and lost rows are the same in both recordings, so they raise rms(h) and leave e - h alone.
Spikes are left out of the comparison: they cost weight, and a few of them must not hide what is plain to see.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from scipy import signal

from ideal_robot.arrays import Array
from ideal_robot.signals.recording import Recording
from studies.strangers.arm import STEP
from studies.strangers.plant import Plant, Run

TORQUES = ("sampled", "averaged", "first_order", "second_order")


@dataclass(frozen=True)
class Logger:
    """How a run is recorded.

    Attributes:
        every: steps between two samples.
        torque: one of ``TORQUES``.
        corner: of the filters [Hz].
        encoder: step of the recorded positions [rad or m].
        noise: of the torque ``(n,)`` [N m].
        jitter: of the instants, relative to the interval.
        stamps: ``true`` stamps of samples taken at jittered instants, or ``nominal`` ones of the same.
        dropped, spikes: share of rows lost, and of torque values that are far off.
        qa, temp: joints from 0 whose arm angle, whose temperature is there.
        xy: whether the tool's place is there, without its height.
        seed: of noise, jitter and losses.
        delay: by which each torque is late ``(n,)`` [s].
        lag: time constant of one more filter of all torques [s].
        qa_delay: by which all arm angles are late [s].
        uneven: amplitude, periods per radian and phase by which each gear turns unevenly, ``(3, n)``.
    """

    every: int
    torque: str
    corner: float
    encoder: float
    noise: Array
    jitter: float
    stamps: str
    dropped: float
    spikes: float
    qa: tuple[int, ...]
    temp: tuple[int, ...]
    xy: bool
    seed: int
    delay: Array
    lag: float
    qa_delay: float
    uneven: Array

    @property
    def late(self) -> float:
        """By how much the torque is late through the logger alone, at low frequency [s]."""
        if self.torque == "averaged":
            return 0.5 * (self.every - 1) * STEP
        order = {"first_order": 1.0, "second_order": 2.0 * 0.7}.get(self.torque, 0.0)
        return order / (2.0 * np.pi * self.corner)


def draw_logger(rng: np.random.Generator, n: int, qa: tuple[int, ...] | None = None) -> Logger:
    """Draws a logger; noise is set later from the torques.

    Args:
        rng: source of the draw.
        n: joints.
        qa: joints whose arm angle is to be there; drawn if None.
    """
    if qa is None:
        qa = tuple(range(int(rng.integers(1, n + 1)))) if rng.random() < 0.2 else ()
    temp = tuple(int(j) for j in sorted(rng.choice(n, int(rng.integers(1, n + 1)), replace=False)))
    return Logger(
        every=int(rng.choice([2, 4, 5, 8, 10, 16, 20])), torque=str(rng.choice(TORQUES, p=(0.4, 0.25, 0.2, 0.15))),
        corner=float(rng.uniform(20.0, 80.0)), encoder=float(np.exp(rng.uniform(np.log(1e-6), np.log(1e-4)))),
        noise=rng.uniform(0.003, 0.015, n), jitter=float(rng.choice([0.0, 0.0, 0.05, 0.15])),
        stamps=str(rng.choice(["true", "nominal"])), dropped=float(rng.choice([0.0, 0.0, 0.002, 0.01])),
        spikes=float(rng.choice([0.0, 0.0, 0.0, 2e-4, 1e-3])), qa=qa, temp=temp if rng.random() < 0.2 else (),
        xy=bool(rng.random() < 0.15), seed=int(rng.integers(2**31)), delay=np.zeros(n), lag=0.0, qa_delay=0.0,
        uneven=np.zeros((3, n)))


def record(logger: Logger, plant: Plant, run: Run) -> Recording:
    """The recording of a run.

    Args:
        logger: what records.
        plant: gives kinematics.
        run: what happened.
    """
    rng = np.random.default_rng([logger.seed, 99])
    t, n = run.t, plant.n
    tau = _torque_read(logger, run.tau)
    rows = np.arange(logger.every, len(t) - logger.every, logger.every)
    nominal = t[rows]
    instants = nominal + rng.uniform(-1.0, 1.0, len(rows)) * logger.jitter * logger.every * STEP

    def sampled(values: Array, late: float = 0.0) -> Array:
        return np.interp(instants - late, t, values)

    def steps(values: Array) -> Array:
        return np.round(values / logger.encoder) * logger.encoder

    columns: dict[str, Array] = {"t": nominal.copy() if logger.stamps == "nominal" else instants.copy()}
    noise = rng.normal(size=(len(rows), n)) * logger.noise
    coloured = signal.lfilter([0.2], [1.0, -0.8], rng.normal(size=noise.shape), axis=0) * logger.noise
    for j in range(n):
        columns[f"q_{j + 1}"] = steps(sampled(run.q[:, j]))
        columns[f"q_d_{j + 1}"] = sampled(run.q_d[:, j])
        columns[f"tau_{j + 1}"] = sampled(tau[:, j], float(logger.delay[j])) + noise[:, j] + coloured[:, j]
    for j in range(n):
        hit = rng.random(len(rows)) < logger.spikes
        size = rng.normal(size=len(rows)) * 5.0 * np.std(columns[f"tau_{j + 1}"])
        columns[f"tau_{j + 1}"] = columns[f"tau_{j + 1}"] + np.where(hit, size, 0.0)
    for j in logger.qa:
        size, order, phase = logger.uneven[:, j]
        qa = run.qa[:, j] + size * np.cos(order * run.q[:, j] + phase)
        columns[f"qa_{j + 1}"] = steps(sampled(qa, logger.qa_delay) + rng.normal(size=len(rows)) * 1e-5)
    for j in logger.temp:
        drift = rng.uniform(0.5, 3.0) * (1.0 - np.exp(-nominal / (nominal[-1] * rng.uniform(0.5, 2.0))))
        columns[f"temp_{j + 1}"] = np.round(rng.uniform(25.0, 35.0) + drift, 1)
    if logger.xy:
        place = _places(plant, run, rows)
        for i, name in enumerate("xy"):
            columns[name] = np.interp(instants, nominal, place[:, i]) + rng.normal(size=len(rows)) * 3e-5
    keep = rng.random(len(rows)) >= logger.dropped
    return Recording({name: np.ascontiguousarray(values[keep]) for name, values in columns.items()}, {}, "stranger")


def _torque_read(logger: Logger, tau: Array) -> Array:
    """What the logger samples: filters start settled."""
    def filtered(b: Array, a: Array, values: Array) -> Array:
        zi = signal.lfilter_zi(b, a)
        return np.column_stack([signal.lfilter(b, a, column, zi=zi * column[0])[0] for column in values.T])

    if logger.torque == "averaged":
        tau = filtered(np.full(logger.every, 1.0 / logger.every), np.array([1.0]), tau)
    elif logger.torque in ("first_order", "second_order"):
        order = 1 if logger.torque == "first_order" else 2
        b, a = signal.butter(order, logger.corner * 2.0 * STEP)
        tau = filtered(b, a, tau)
    if logger.lag > 0.0:
        keep = np.exp(-STEP / logger.lag)
        tau = filtered(np.array([1.0 - keep]), np.array([1.0, -keep]), tau)
    return tau


def _places(plant: Plant, run: Run, rows: np.ndarray) -> Array:
    """Where the frame of the last joint is ``(rows, 3)`` [m]."""
    model, data = plant.arm.model, plant.arm.model.createData()
    places = np.empty((len(rows), 3))
    for i, k in enumerate(rows):
        pin.forwardKinematics(model, data, run.qa[k])
        places[i] = data.oMi[plant.n].translation
    return places


BAND = 12.0
"""[Hz] below which a model of an arm says anything; a third of the sampling rate where that is lower."""
SHARE = 0.25
"""Of the healthy residual's rms, one times visible."""
_ROWS = 1200


@dataclass(frozen=True)
class Reading:
    """A recording in the band: torque ``(M, n)``, and for every joint the columns ``(M, c)`` of the model class.

    Attributes:
        tau: ``(M, n)`` [N m].
        columns: of each joint.
        twist: arm angles less motor angles ``(M, n)``; NaN where they were not recorded.
    """

    tau: Array
    columns: tuple[Array, ...]
    twist: Array


def read(recording: Recording, model: pin.Model) -> Reading:
    """Filters a recording and computes the columns of the model class.

    Args:
        recording: as it was logged, spikes aside.
        model: kinematics.
    """
    n = recording.n
    rate = 1.0 / float(np.median(np.diff(recording.t)))
    t = np.arange(recording.t[0], recording.t[-1], 1.0 / rate)

    def uniform(name: str) -> Array:
        return np.column_stack([np.interp(t, recording.t, recording.columns[f"{name}_{j + 1}"]) for j in range(n)])

    q, tau = uniform("q"), uniform("tau")
    sos = signal.butter(4, min(BAND, rate / 3.0) * 2.0 / rate, output="sos")
    smooth = signal.sosfiltfilt(sos, q, axis=0)
    v = np.gradient(smooth, 1.0 / rate, axis=0)
    a = np.gradient(v, 1.0 / rate, axis=0)
    edge = int(0.5 * rate)
    rows = np.unique(np.linspace(edge, len(t) - edge - 1, _ROWS).astype(int))
    data = model.createData()
    body = np.array([pin.computeJointTorqueRegressor(model, data, smooth[k], v[k], a[k]) for k in rows])
    columns = []
    for j in range(n):
        dry = signal.sosfiltfilt(sos, np.tanh(v[:, j] / (0.005 * np.max(np.abs(v[:, j])) + 1e-9)))
        W = np.column_stack([body[:, j], a[rows, j], v[rows, j], dry[rows], np.ones(len(rows))])
        columns.append(W / (np.linalg.norm(W, axis=0) / np.sqrt(len(rows)) + 1e-9))
    twist = np.full((len(rows), n), np.nan)
    for j in range(n):
        if f"qa_{j + 1}" in recording.columns:
            bent = recording.columns[f"qa_{j + 1}"] - recording.columns[f"q_{j + 1}"]
            twist[:, j] = signal.sosfiltfilt(sos, np.interp(t, recording.t, bent))[rows]
    return Reading(signal.sosfiltfilt(sos, tau, axis=0)[rows], tuple(columns), twist)


def left(reading: Reading) -> Array:
    """Residual of the model class fitted to each joint by itself ``(M, n)`` [N m]."""
    return np.column_stack([y - W @ np.linalg.lstsq(W, y, rcond=1e-7)[0]
                            for y, W in zip(reading.tau.T, reading.columns, strict=True)])


def sizes(healthy: Reading, with_effect: Reading, absorbed: bool) -> Array:
    """Size of an effect in each joint's torque ``(n,)``, in multiples of what is visible.

    Args:
        healthy: of the twin.
        with_effect: of the recording.
        absorbed: whether the model class is fitted to the recording with the effect; else it is known before and
            the whole difference counts.
    """
    h, e = left(healthy), left(with_effect)
    level = np.sqrt(np.mean(h**2, axis=0))
    own = e - h if absorbed else with_effect.tau - healthy.tau
    return np.sqrt(np.mean(own**2, axis=0)) / (SHARE * level + 1e-12)


def twist_sizes(healthy: Reading, with_effect: Reading) -> Array:
    """The same for arm angles against motor angles ``(n,)``, 0 where they were not recorded.

    What bends on the healthy twin counts as what is left anyway, a constant aside.
    """
    result = np.zeros(healthy.twist.shape[1])
    for j in range(len(result)):
        h, e = healthy.twist[:, j], with_effect.twist[:, j]
        if np.isfinite(h).all() and np.isfinite(e).all():
            result[j] = float(np.std(e - h)) / (SHARE * float(np.std(h)) + 1e-9)
    return result
