"""A force sensor: tools of unknown weight, bias, and a contact that gives way more than is assumed.

A recording either swings the tool through the air, or presses its tip on an unknown wavy surface with changing force
along a path. The tip is a spring with damping and friction; surface, direction and all sizes are drawn: biases of 3 to
10 times a quarter of the noise, elasticities assumed wrong by 1.25 to 2.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from studies.sensors.scene import Trial, chain, draw_tooled_arm, measured, poses, scene
from studies.strangers.arm import STEP, Arm, draw_motion

DETECTABLE = 0.25
"""Share of the sensor's noise that a bias has to reach to be seen at all."""
G = np.array([0.0, 0.0, -9.81])


def draw_force_trial(seed: int, kind: str | None = None) -> Trial:
    """Draws a trial; half of them without contact, half with.

    Args:
        seed: everything follows from it.
        kind: ``none`` or ``inside``; drawn if None.
    """
    rng = np.random.default_rng([seed, 40009])
    kind = str(rng.choice(("none", "inside"), p=(0.35, 0.65))) if kind is None else kind
    touches = rng.random() < 0.5
    for _ in range(200):
        trial = (_pressed if touches else _swung)(rng, kind, draw_tooled_arm(rng))
        if trial is not None:
            return trial
    raise RuntimeError(f"no trial of kind {kind} from seed {seed}")


class _Tool:
    """What hangs on the sensor, and what the sensor adds."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.mass, self.com = float(rng.uniform(0.3, 3.0)), rng.uniform(-0.1, 0.1, 3)
        self.noise = np.repeat([rng.uniform(0.1, 0.5), rng.uniform(0.005, 0.03)], 3)
        self.bias = np.zeros(6)
        self.inertia = rng.random() < 0.5
        self.moments = rng.random() < 0.7
        self.calibrated = rng.random() < 0.5

    def wrench(self, rng: np.random.Generator, t: Array, rotation: Array, place: Array, force: Array) -> Array:
        """``(N, 6)`` in the sensor frame for poses and a force on the tip in the base frame ``(N, 3)``."""
        field = np.tile(G, (len(t), 1))
        if self.inertia:
            dt = t[1] - t[0]
            field = field - np.gradient(np.gradient(place, dt, axis=0), dt, axis=0)
        own = self.mass * np.einsum("kij,ki->kj", rotation, field)
        clean = np.column_stack([own + np.einsum("kij,ki->kj", rotation, force), np.cross(self.com, own)])
        return np.asarray(clean + self.bias + self.noise * rng.normal(size=clean.shape))

    def known(self) -> dict[str, object]:
        """What calibration says of the tool, before the bias changed."""
        return {"mass": self.mass, "com": list(self.com), "bias": [0.0] * 6} if self.calibrated else {}


def _swung(rng: np.random.Generator, kind: str, arm: Arm) -> Trial | None:
    """The tool in the air."""
    tool = _Tool(rng)
    count = 6 if tool.moments else 3
    if kind == "inside":
        direction = rng.normal(size=count)
        direction /= np.sqrt(np.mean(direction**2))
        tool.bias[:count] = rng.uniform(3.0, 10.0) * DETECTABLE * tool.noise[:count] * direction
    every, motion = int(rng.choice([20, 8])), draw_motion(rng, arm, float(rng.uniform(12.0, 25.0)))
    t, q = every * STEP * np.arange(len(motion.t[::every]), dtype=float), motion.q[::every]
    rotation, place = poses(*chain(arm), q)
    pull = np.einsum("kij,i->kj", rotation, G / 9.81)
    if np.linalg.norm(np.std(pull, axis=0)) < 0.2 and not tool.calibrated:
        # Without turning the weight looks like a bias: nobody could say that there is none.
        return None
    wrench = tool.wrench(rng, t, rotation, place, np.zeros((len(t), 3)))
    return _trial(rng, arm, t, q, wrench[:, :count], ("force_bias", tool.bias) if kind == "inside" else None,
                  {"tool": tool.known()} if tool.calibrated else {})


def _pressed(rng: np.random.Generator, kind: str, arm: Arm) -> Trial | None:
    """Air, touch, a path there and back (or not) with changing force, lift."""
    tool = _Tool(rng)
    tool.moments, tool.calibrated = True, True
    rate, seconds = 200.0, float(rng.uniform(8.0, 14.0))
    t = np.arange(0.0, seconds, 1.0 / rate)
    normal, along = np.linalg.qr(rng.normal(size=(3, 2)))[0].T
    E, D = float(rng.uniform(2e3, 2e4)), float(rng.uniform(0.0, 10.0))
    length, passes = float(rng.uniform(0.15, 0.4)), int(rng.integers(1, 4))
    # Tangential motion between touch and lift; the tip is 4 mm above the surface before and after.
    touch, lift = 1.5, seconds - 1.5
    x = np.clip((t - touch - 0.5) / (lift - touch - 1.0), 0.0, 1.0)
    u = 0.5 * length * (1.0 - np.cos(np.pi * passes * x))
    down = _step((t - touch + 0.25) / 0.5) - _step((t - lift - 0.25) / 0.5)
    wish = rng.uniform(10.0, 30.0)
    wobble = sum(float(rng.uniform(0.05, 0.15)) * np.sin(2 * np.pi * f * t + rng.uniform(0, 6))
                 for f in rng.uniform(0.3, 3.0, 4))
    depth = (4e-3 + wish / E * (1.0 + wobble)) * down - 4e-3
    waves = [(rng.uniform(0.3e-3, 2e-3), rng.uniform(0.15, 0.4), rng.uniform(0, 6)) for _ in range(2)]
    height, slope = np.zeros_like(t), np.zeros_like(t)
    for a, w, p in waves:
        height += a * np.sin(2 * np.pi * u / w + p)
        slope += a * 2 * np.pi / w * np.cos(2 * np.pi * u / w + p)
    dt = t[1] - t[0]
    pressed = np.where(depth > 0, np.maximum(E * depth + D * np.gradient(depth, dt), 0.0), 0.0)
    square = normal - slope[:, None] * along
    square /= np.linalg.norm(square, axis=1, keepdims=True)
    slide = np.gradient(u, dt)
    force = pressed[:, None] * (square - 0.15 * (slide / np.sqrt(slide**2 + 1e-4))[:, None] * along)
    q = _followed(rng, arm, u[:, None] * along + (height - depth)[:, None] * normal)
    if q is None:
        return None
    ratio = 1.0
    if kind == "inside":
        ratio = float(rng.uniform(1.25, 2.0)) ** float(rng.choice([-1.0, 1.0]))
    rotation, place = poses(*chain(arm), q)
    give = np.array([1.0 / E - 1.0 / (E * ratio)])
    return _trial(rng, arm, t, q, tool.wrench(rng, t, rotation, place, force),
                  ("force_compliance", give) if kind == "inside" else None,
                  {"tool": tool.known(), "contact_stiffness": E * ratio})


def _followed(rng: np.random.Generator, arm: Arm, path: Array) -> Array | None:
    """Joint motion ``(N, n)`` that takes the tip along a path from where it starts; None out of reach."""
    model, tool = chain(arm)
    data = model.createData()
    q = 0.5 * (arm.low + arm.high) + 0.25 * (arm.high - arm.low) * rng.uniform(-1, 1, arm.n)
    pin.forwardKinematics(model, data, q)
    start = pin.updateFramePlacement(model, data, tool).translation.copy()
    result = np.empty((len(path), arm.n))
    for k, point in enumerate(path):
        for _ in range(6):
            J = pin.computeFrameJacobian(model, data, q, tool, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)[:3]
            error = start + point - pin.updateFramePlacement(model, data, tool).translation
            if np.linalg.norm(error) < 1e-9:
                break
            q = q + J.T @ np.linalg.solve(J @ J.T + 1e-8 * np.eye(3), error)
        else:
            return None
        if np.any(q < model.lowerPositionLimit) or np.any(q > model.upperPositionLimit):
            return None
        result[k] = q
    return result if np.max(np.abs(np.diff(result, axis=0))) < 0.02 and np.max(np.ptp(result, axis=0)) > 0.1 else None


def _step(x: Array) -> Array:
    """Smooth step from 0 to 1."""
    x = np.clip(x, 0.0, 1.0)
    return np.asarray(x**3 * (10.0 - 15.0 * x + 6.0 * x * x))


def _trial(rng: np.random.Generator, arm: Arm, t: Array, q: Array, wrench: Array, truth: tuple[str, Array] | None,
           meta: dict[str, object]) -> Trial:
    """The trial of a wrench ``(N, 3 or 6)`` along a motion; the size is a bias ``(6,)`` or a compliance ``(1,)``."""
    plain = measured(rng, scene(rng, arm, t, q))
    columns = dict(plain.columns)
    for i, name in enumerate(("fx", "fy", "fz", "mx", "my", "mz")[: wrench.shape[1]]):
        columns[name] = np.interp(plain.t, t, wrench[:, i])
    recording = dataclasses.replace(plain, columns=columns, meta=meta)
    return Trial(recording, arm.urdf, truth and (truth[0], 0), truth[1] if truth else np.zeros(0))
