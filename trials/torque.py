"""Blind trials: robot, motion, effect, joint and size drawn at random; the recording carries no trace of the draw.

The size of an effect is given in multiples of what can be seen at all: the part of its torque that no change of
inertias, Coulomb and viscous friction, rotors and offsets could produce has to reach a quarter of the noise and a
three-hundredth of the joint's torque.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from scipy import signal

from ideal_robot.arrays import Array
from ideal_robot.signals.recording import Recording
from trials.arms import Arm, draw_arm, draw_motion
from trials.torque_truth import INSIDE, OUTSIDE, Scene, scene

STRUCTURAL = ("dead_time", "joint_elasticity", "backlash")
"""Effects that change what is recorded of the motion, not only the torque."""
ARM_SIDE = ("dead_time", "joint_elasticity", "transmission_error", "backlash")
"""Effects between motor and arm, seen where the arm's angle is measured."""
AGAINST_MODEL = ("viscous", "coulomb", "current_offset", "drive_gain", "rotor_inertia", "payload")
"""Changes of a model's own parameters, seen only against a model identified before."""
KINDS = ("none", "inside", "outside", "two", "arm", "model")


@dataclass(frozen=True)
class Trial:
    """One trial.

    Attributes:
        seed: it was drawn from.
        kind: one of ``KINDS``.
        recording: for the diagnosis.
        urdf: text of the URDF for the diagnosis.
        truth: the effects drawn: name, joint from 1 (0 for the whole arm).
        outside: whether the effect is outside the library.
        oracle: torque or angle ``(N, n)`` that the effects added, for an oracle that knows their form.
        reference: a recording of the same arm without the effect, for kinds that need a model; None for others.
    """

    seed: int
    kind: str
    recording: Recording
    urdf: str
    truth: tuple[tuple[str, int], ...]
    outside: bool
    oracle: Array
    reference: Recording | None


def draw_trial(seed: int, kind: str | None = None) -> Trial:
    """Draws a trial.

    Args:
        seed: everything follows from it.
        kind: one of ``KINDS``; drawn if None, effects of the library most often.
    """
    rng = np.random.default_rng([seed, 20011])
    kind = str(rng.choice(KINDS, p=(0.2, 0.34, 0.16, 0.1, 0.1, 0.1))) if kind is None else kind
    for _ in range(40):
        arm = draw_arm(rng)
        if kind == "two" and arm.n < 2:
            continue
        rate = float(rng.choice([100.0, 200.0, 250.0, 500.0]))
        seconds = float(rng.uniform(25.0, 45.0))
        t = np.arange(0.0, seconds, 1.0 / rate)
        s = scene(arm, t, *draw_motion(rng, arm, t))
        trial = _with_effects(rng, seed, kind, s)
        if trial is not None:
            return trial
    raise RuntimeError(f"no trial of kind {kind} from seed {seed}")


def _with_effects(rng: np.random.Generator, seed: int, kind: str, s: Scene) -> Trial | None:
    noise = np.std(s.torque, axis=0) * rng.uniform(0.005, 0.02, s.arm.n)
    truth: list[tuple[str, int]] = []
    added = np.zeros_like(s.q)
    q, tau = s.q.copy(), s.torque.copy()
    qa: Array | None = None
    reference = None
    if kind in ("inside", "outside", "two"):
        taken: set[int] = set()
        for _ in range(2 if kind == "two" else 1):
            joint = int(rng.choice([j for j in range(s.arm.n) if j not in taken]))
            pool = list(OUTSIDE) if kind == "outside" else [*INSIDE, *(STRUCTURAL if kind == "inside" else ())]
            if s.arm.n == 1:
                pool = [name for name in pool if "coupling" not in name]
            name = str(rng.choice(pool))
            if name == "axis_coupling" and joint == 0:
                joint = 1
            drawn = _torque_effect(rng, s, name, joint, noise)
            if drawn is None:
                return None
            q, change = drawn
            tau, added = tau + change, added + change
            taken.add(joint)
            truth.append((name, joint + 1))
    elif kind == "arm":
        name, joint = str(rng.choice(ARM_SIDE)), int(rng.integers(s.arm.n))
        change, qa_noise = _arm_effect(rng, s, name, joint)
        qa = s.q + change + rng.normal(size=s.q.shape) * qa_noise
        added = change
        truth.append((name, joint + 1))
    elif kind == "model":
        name = str(rng.choice(AGAINST_MODEL))
        joint = int(rng.integers(s.arm.n))
        change = _parameter_effect(rng, s, name, joint)
        tau, added = tau + change, change
        truth.append((name, 0 if name == "payload" else joint + 1))
        again = scene(s.arm, s.t, *draw_motion(rng, s.arm, s.t))
        reference = measured(rng, s.arm, again.t, again.q, again.torque, noise, None)
    recording = measured(rng, s.arm, s.t, q, tau, noise, qa)
    return Trial(seed, kind, recording, s.arm.urdf, tuple(truth), kind == "outside", added, reference)


def _torque_effect(rng: np.random.Generator, s: Scene, name: str, joint: int,
                   noise: Array) -> tuple[Array, Array] | None:
    """Recorded positions and added torque of an effect at three to ten times the size that can be seen."""
    times = rng.uniform(3.0, 10.0)
    if name in STRUCTURAL:
        return _structural(rng, s, name, joint, noise, times)
    column = (INSIDE | OUTSIDE)[name](rng, s, joint)
    size = visible(s, column, joint, noise)
    if size <= 0.0:
        return None
    column = column * times / size
    # A cause as large as the arm's own torques would be no blind spot but another arm.
    if np.std(column[:, joint]) > 0.5 * np.std(s.torque[:, joint]):
        return None
    return s.q, column


def visible(s: Scene, column: Array, joint: int, noise: Array) -> float:
    """Size of an effect at a joint in multiples of the smallest that can be seen.

    Args:
        s: the motion.
        column: its torque ``(N, n)`` [N m].
        joint: from 0.
        noise: standard deviation of the torque ``(n,)`` [N m].
    """
    rows = slice(None, None, max(1, len(s.t) // 600))
    data = s.arm.model.createData()
    base = []
    for q, qd, qdd in zip(s.q[rows], s.qd[rows], s.qdd[rows], strict=True):
        full = np.atleast_2d(pin.computeJointTorqueRegressor(s.arm.model, data, q, qd, qdd))[joint]
        base.append([*full, qdd[joint], qd[joint], np.tanh(qd[joint] / (2e-3 * s.arm.fast[joint])), 1.0])
    W = np.array(base)
    # Only what an arm's torque measurement resolves counts.
    lowpass = signal.butter(2, min(15.0 * 2.0 * (s.t[1] - s.t[0]), 0.9), output="sos")
    smooth = signal.sosfiltfilt(lowpass, column[:, joint])
    y = smooth[rows]
    own = float(np.std(y - W @ np.linalg.lstsq(W, y, rcond=1e-9)[0]))
    return own / max(0.25 * noise[joint], 0.003 * float(np.std(s.torque[:, joint])))


def _structural(rng: np.random.Generator, s: Scene, name: str, joint: int, noise: Array,
                times: float) -> tuple[Array, Array] | None:
    def recorded(size: float) -> tuple[Array, Array]:
        if name == "dead_time":
            late = np.interp(s.t - size, s.t, s.torque[:, joint])
            change = np.zeros_like(s.q)
            change[:, joint] = late - s.torque[:, joint]
            return s.q, change
        bend = s.load[:, joint]
        if name == "backlash":
            bend = np.tanh(bend / (0.3 * np.std(bend)))
        dt = s.t[1] - s.t[0]
        q = s.q.copy()
        q[:, joint] += size * bend
        qd = s.qd[:, joint] + size * np.gradient(bend, dt)
        qdd = s.qdd[:, joint] + size * np.gradient(np.gradient(bend, dt), dt)
        change = np.zeros_like(s.q)
        # The motor's friction and rotor move with the motor.
        change[:, joint] = (s.arm.rotor[joint] * (qdd - s.qdd[:, joint])
                            + s.arm.viscous[joint] * (qd - s.qd[:, joint])
                            + s.arm.coulomb[joint] * (np.tanh(qd / (2e-3 * s.arm.fast[joint]))
                                                      - np.tanh(s.qd[:, joint] / (2e-3 * s.arm.fast[joint]))))
        return q, change

    small = {"dead_time": 1e-3, "joint_elasticity": 1e-4 / float(np.std(s.load[:, joint]) + 1e-9),
             "backlash": 1e-5}[name]
    q, change = recorded(small)
    if name == "dead_time":
        seen = change
    else:
        # What the torque computed from the recorded angle is wrong by.
        again = scene(s.arm, s.t, q, np.gradient(q, s.t, axis=0), np.gradient(np.gradient(q, s.t, axis=0), s.t, axis=0))
        exact = scene(s.arm, s.t, s.q, np.gradient(s.q, s.t, axis=0),
                      np.gradient(np.gradient(s.q, s.t, axis=0), s.t, axis=0))
        seen = exact.load - again.load
    times_visible = visible(s, seen, joint, noise)
    if times_visible <= 0.0:
        return None
    size = small * times / times_visible
    largest = {"dead_time": 0.03, "joint_elasticity": 0.02 / float(np.max(np.abs(s.load[:, joint])) + 1e-9),
               "backlash": 0.005}[name]
    return recorded(size) if size < largest else None


def _arm_effect(rng: np.random.Generator, s: Scene, name: str, joint: int) -> tuple[Array, float]:
    noise = 1e-5
    size = noise * rng.uniform(3.0, 10.0)
    q, load = s.q[:, joint], s.load[:, joint]
    if name == "dead_time":
        column = -s.qd[:, joint]
    elif name == "joint_elasticity":
        column = -load
    elif name == "transmission_error":
        column = np.cos(2.0 * np.pi * rng.uniform(6.0, 60.0) / float(np.ptp(q)) * q + rng.uniform(0, 6))
    else:
        column = -np.tanh(load / (0.1 * np.std(load) + 1e-9))
    change = np.zeros_like(s.q)
    change[:, joint] = column / (np.std(column) + 1e-12) * size
    return change, noise


def _parameter_effect(rng: np.random.Generator, s: Scene, name: str, joint: int) -> Array:
    change = np.zeros_like(s.q)
    arm, v = s.arm, s.qd[:, joint]
    if name == "viscous":
        change[:, joint] = arm.viscous[joint] * v * rng.uniform(0.4, 1.2)
    elif name == "coulomb":
        change[:, joint] = arm.coulomb[joint] * np.tanh(v / (2e-3 * arm.fast[joint])) * rng.uniform(0.4, 1.2)
    elif name == "current_offset":
        change[:, joint] = np.std(s.torque[:, joint]) * rng.uniform(0.1, 0.3) * rng.choice([-1.0, 1.0])
    elif name == "drive_gain":
        change[:, joint] = s.torque[:, joint] * rng.uniform(0.08, 0.25) * rng.choice([-1.0, 1.0])
    elif name == "rotor_inertia":
        change[:, joint] = arm.rotor[joint] * s.qdd[:, joint] * rng.uniform(0.5, 1.5)
    else:
        loaded = arm.model.copy()
        last = loaded.inertias[loaded.njoints - 1]
        mass = last.mass * rng.uniform(0.4, 1.2)
        body = pin.Inertia(mass, last.lever + rng.uniform(-0.05, 0.1, 3), np.eye(3) * mass * 0.05**2)
        loaded.inertias[loaded.njoints - 1] = last + body
        data = loaded.createData()
        torque = np.array([pin.rnea(loaded, data, *row) for row in zip(s.q, s.qd, s.qdd, strict=True)])
        change = torque.reshape(s.q.shape) - s.load
    return change


def measured(rng: np.random.Generator, arm: Arm, t: Array, q: Array, tau: Array, noise: Array,
              qa: Array | None) -> Recording:
    """Noise, white and coloured, quantisation, at times a jittering clock or CSV-like rounding.

    Args:
        rng: draws noise, quantisation and clock.
        arm: that moved.
        t: times ``(N,)`` [s].
        q: joint angles ``(N, n)`` [rad].
        tau: torques ``(N, n)`` [N m].
        noise: standard deviation of the torque ``(n,)`` [N m].
        qa: arm angles ``(N, n)`` [rad]; None if they are not measured.
    """
    colour = signal.lfilter([0.1], [1.0, -0.9], rng.normal(size=tau.shape), axis=0)
    tau = tau + noise * rng.normal(size=tau.shape) + 0.4 * noise * colour
    if rng.random() < 0.4:
        step = noise * 1.0
        tau = np.round(tau / step) * step
    encoder = float(rng.choice([1e-7, 1e-6, 5e-6]))
    q = np.round((q + rng.normal(size=q.shape) * 0.3 * encoder) / encoder) * encoder
    columns = {"q": q, "tau": tau}
    if qa is not None:
        columns["qa"] = qa
    if rng.random() < 0.25:
        dt = t[1] - t[0]
        stamps = t + rng.uniform(-0.15, 0.15, len(t)) * dt
        columns = {name: np.column_stack([np.interp(stamps, t, column) for column in values.T])
                   for name, values in columns.items()}
        t = stamps
    named = {f"{name}_{i + 1}": np.ascontiguousarray(values[:, i]) for name, values in columns.items()
             for i in range(arm.n)}
    return Recording({"t": np.array(t), **named}, {}, "blind")
