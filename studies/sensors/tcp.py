"""What lies behind the gear: effects on the TCP or the arm's angles as an external device sees them.

Truth is exact kinematics of an altered arm (joint placements, angles behind the gear, lengths that grow), not the
first-order columns that the library fits. The size of an effect is that of the part which no other place of the
measuring device could explain, 3 to 10 times a quarter of the device's noise.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pinocchio as pin
from scipy.interpolate import CubicSpline

from ideal_robot.arrays import Array
from studies.sensors.scene import Scene, Trial, chain, draw_tooled_arm, measured, poses, scene
from studies.strangers.arm import STEP, Arm, draw_motion, joint_axes, sliding

GEAR = ("joint_elasticity", "transmission_error", "backlash")
"""Effects between motor and arm."""
TCP = ("dead_time", *GEAR, "kinematic_error", "thermal_growth")
KINDS = ("none", "inside", "arm")
DETECTABLE = 0.25
"""Share of the device's noise that an effect has to reach to be seen at all."""

Move = Callable[[float], tuple[Array, Array]]
"""Arm angles ``(N, n)`` and TCP ``(N, 3)`` with an effect of some size."""
Bend = Callable[[float], Array]


def draw_tcp_trial(seed: int, kind: str | None = None) -> Trial:
    """Draws a trial.

    Args:
        seed: everything follows from it.
        kind: ``none``, ``inside`` (an effect in what only ``x y z`` show), ``arm`` (arm angles are measured, too);
            drawn if None.
    """
    rng = np.random.default_rng([seed, 30029])
    kind = str(rng.choice(KINDS, p=(0.25, 0.6, 0.15))) if kind is None else kind
    for _ in range(200):
        arm = draw_tooled_arm(rng)
        every, motion = int(rng.choice([20, 10, 8])), draw_motion(rng, arm, float(rng.uniform(25.0, 45.0)))
        q = motion.q[::every]
        trial = _with_effect(rng, kind, scene(rng, arm, every * STEP * np.arange(len(q), dtype=float), q))
        if trial is not None:
            return trial
    raise RuntimeError(f"no trial of kind {kind} from seed {seed}")


def _with_effect(rng: np.random.Generator, kind: str, s: Scene) -> Trial | None:
    noise = float(rng.uniform(1e-5, 5e-5))
    angle_noise = noise
    behind = kind == "arm" or (kind == "none" and rng.random() < 0.3)
    temperature = _temperature(rng, s) if rng.random() < 0.4 else None
    model, tool = chain(s.arm)
    truth, qa, exact = None, s.q, _positions(model, tool, s.q)
    xyz = exact
    if kind != "none":
        # Where arm angles are measured, gears show there.
        name = str(rng.choice(TCP if kind == "inside" else ("dead_time", "kinematic_error", "thermal_growth", *GEAR)))
        joint = int(rng.integers(s.arm.n))
        alteration = _altered(rng, s, name, joint, temperature)
        if alteration is None:
            return None
        move, unit, largest = alteration
        if behind and name in GEAR:
            spread = float(np.std(move(unit)[0][:, joint] - s.q[:, joint]))
            size = angle_noise * rng.uniform(3.0, 10.0) * unit / max(spread, 1e-300)
        else:
            visible = _beyond_the_device(move(unit)[1] - exact, exact)
            size = rng.uniform(3.0, 10.0) * DETECTABLE * noise / max(visible / unit, 1e-300)
        if size > largest:
            return None
        qa, xyz = move(size)
        truth = (name, 0 if name == "dead_time" else joint + 1)
    angles = qa + angle_noise * rng.normal(size=qa.shape) if behind else None
    recording = measured(rng, s, angles)
    # The device stands a little beside where it should.
    turn = pin.exp3(rng.normal(0.0, 1e-3, 3))
    tracked = CubicSpline(s.t, xyz, axis=0)(recording.t) @ turn.T + rng.normal(0.0, 2e-3, 3)
    tracked = tracked + noise * rng.normal(size=tracked.shape)
    columns = {**recording.columns, **{axis: np.ascontiguousarray(tracked[:, i]) for i, axis in enumerate("xyz")}}
    if temperature is not None:
        warm = np.round(CubicSpline(s.t, temperature, axis=0)(recording.t), 1)
        columns |= {f"temp_{j + 1}": np.ascontiguousarray(warm[:, j]) for j in range(s.arm.n)}
    return Trial(dataclasses.replace(recording, columns=columns), s.arm.urdf, truth, xyz - exact)


def _altered(rng: np.random.Generator, s: Scene, name: str, j: int,
             temperature: Array | None) -> tuple[Move, float, float] | None:
    """How arm angles and TCP are for a size of the effect, a small size, and the largest that makes sense."""
    model, tool = chain(s.arm)
    if name == "dead_time":
        exact = CubicSpline(s.t, _positions(model, tool, s.q), axis=0)
        return (lambda size: (s.q, exact(np.maximum(s.t - size, 0.0)))), 1e-4, 0.02
    if name in GEAR:
        bend, largest = _bend(rng, s, name, j)
        if bend is None:
            return None

        def behind_gear(size: float) -> tuple[Array, Array]:
            qa = s.q.copy()
            qa[:, j] += bend(size)
            return qa, _positions(model, tool, qa)

        return behind_gear, 1e-5 if name != "joint_elasticity" else 1e-5 / float(np.std(s.load[:, j])), largest
    if name == "kinematic_error":
        share = rng.normal(size=4) * rng.choice([0.0, 1.0], size=4, p=(0.4, 0.6))
        if not np.any(share):
            return None
        return (lambda size: (s.q, _positions(*_misbuilt(s.arm, j, size * share), s.q))), 1e-5, 0.01
    warm = _warming(rng, s, j, temperature)
    return (lambda size: (s.q, _grown(s, j, size * warm))), 1e-5, 3e-3


def _bend(rng: np.random.Generator, s: Scene, name: str, j: int) -> tuple[Bend | None, float]:
    """Arm minus motor angle ``(N,)`` of a size (None without a load), and the largest size that makes sense."""
    load, q = s.load[:, j], s.q[:, j]
    spread, span = float(np.std(load)), float(np.ptp(q))
    if spread < 1e-6:
        return None, 0.0
    if name == "joint_elasticity":
        return (lambda size: -size * load), 0.02 / float(np.max(np.abs(load)))
    if name == "transmission_error":
        k, phase = 2.0 * np.pi * rng.uniform(6.0, 40.0) / span, rng.uniform(0, 2 * np.pi)
        return (lambda size: size * (np.sin(k * q + phase) + 0.1 * np.sin(2.0 * k * q))), 2e-3
    crosses = 0.1 < float(np.mean(load > 0.0)) < 0.9
    if crosses and rng.random() < 0.5:
        return (lambda size: -size * load / np.sqrt(load**2 + (0.1 * spread) ** 2)), 5e-3

    def lagging(size: float) -> Array:
        arm = np.empty(len(q))
        arm[0] = q[0]
        for k in range(1, len(q)):
            gap = q[k] - arm[k - 1]
            arm[k] = arm[k - 1] + np.sign(gap) * max(abs(gap) - size, 0.0)
        return np.asarray(arm - q)

    return lagging, 5e-3


def _misbuilt(arm: Arm, j: int, wrong: Array) -> tuple[pin.Model, int]:
    """The arm with other Denavit–Hartenberg parameters of joint ``j``: ``Rot_z Trans_z Trans_x Rot_x`` behind it.

    ``wrong`` are errors of a, d [m], alpha, theta [rad] ``(4,)``.
    """
    model, tool = chain(arm)
    a, d, alpha, theta = wrong
    axes = [axis[:3] if slides else axis[3:] for axis, slides in zip(joint_axes(model), sliding(model), strict=True)]
    z, last = axes[j], j + 1 == arm.n
    following = model.frames[tool].placement if last else model.jointPlacements[j + 2]
    x = np.zeros(3) if last else np.cross(z, following.rotation @ axes[j + 1])
    if np.linalg.norm(x) < 1e-3:
        x = following.translation - (following.translation @ z) * z
    if np.linalg.norm(x) < 1e-3:
        x = np.eye(3)[int(np.argmin(np.abs(z)))]
        x = x - (x @ z) * z
    x = x / np.linalg.norm(x)
    error = pin.SE3(pin.exp3(theta * z), d * z) * pin.SE3(pin.exp3(alpha * x), a * x)
    if last:
        model.frames[tool].placement = error * following
    else:
        model.jointPlacements[j + 2] = error * following
    return model, tool


def _grown(s: Scene, j: int, strain: Array) -> Array:
    """TCP ``(N, 3)`` with the link behind joint ``j`` longer by a share ``(N,)``."""
    model, tool = chain(s.arm)
    data = model.createData()
    last = j + 1 == s.arm.n
    nominal = (model.frames[tool].placement if last else model.jointPlacements[j + 2]).copy()
    result = np.empty((len(s.t), 3))
    for k, row in enumerate(s.q):
        longer = pin.SE3(nominal.rotation, nominal.translation * (1.0 + strain[k]))
        if last:
            model.frames[tool].placement = longer
        else:
            model.jointPlacements[j + 2] = longer
        pin.forwardKinematics(model, data, row)
        result[k] = pin.updateFramePlacement(model, data, tool).translation
    return result


def _temperature(rng: np.random.Generator, s: Scene) -> Array:
    """Gears that warm up by a few kelvin, each at its own pace ``(N, n)`` [°C]."""
    span = s.t[-1]
    pace, rise = span * rng.uniform(0.4, 2.0, s.arm.n), rng.uniform(2.0, 12.0, s.arm.n)
    return np.asarray(rng.uniform(18, 30) + rise * (1.0 - 1.0 / (1.0 + (s.t[:, None] / pace) ** 1.2)))


def _warming(rng: np.random.Generator, s: Scene, j: int, temperature: Array | None) -> Array:
    """Warmth ``(N,)``, zero at the start and about one at the end."""
    if temperature is not None:
        warm = temperature[:, j] - temperature[0, j]
    else:
        pace = s.t[-1] * rng.uniform(0.3, 1.0)
        warm = 1.0 - 1.0 / (1.0 + s.t / pace)
    return np.asarray(warm / warm[-1])


def _beyond_the_device(change: Array, exact: Array) -> float:
    """Rms of what no shift and small turn of the measuring device explains [m]."""
    p = exact - exact.mean(axis=0)
    W = np.zeros((len(p), 3, 6))
    W[:, :, :3] = np.eye(3)
    for i, axis in enumerate(np.eye(3)):
        W[:, :, 3 + i] = np.cross(axis, p)
    flat = W.reshape(-1, 6)
    rest = change.reshape(-1) - flat @ np.linalg.lstsq(flat, change.reshape(-1), rcond=None)[0]
    return float(np.sqrt(np.mean(rest**2)))


def _positions(model: pin.Model, tool: int, q: Array) -> Array:
    """TCP ``(N, 3)`` [m]."""
    return poses(model, tool, q)[1]
