"""Arms for the trials (shipped ones, measured ones from public URDFs, chains drawn at random) and how they move."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.robots.robot import Robot

SHIPPED = ("kr6", "kr15", "manutec_r15")
MEASURED = ("panda", "ur5", "ur10", "tiago")
DATA = Path(__file__).resolve().parents[3] / "shared" / "data"
"""Where the URDFs of measured arms are, if they are there; a chain is drawn instead otherwise."""


@dataclass(frozen=True)
class Arm:
    """An arm as drawn.

    Attributes:
        name: of the shipped or measured arm, or ``chain``.
        urdf: text that the diagnosis is given.
        model: the true rigid body; its masses, centres and inertias differ from those of the URDF.
        need: torque a moderate motion asks for ``(n,)`` [N m], what drives are sized by.
        mass: mean diagonal of the mass matrix ``(n,)`` [kg m²].
        low, high: range of the motion ``(n,)`` [rad or m].
        fast, quick: velocity and acceleration the motion stays within ``(n,)``.
    """

    name: str
    urdf: str
    model: pin.Model
    need: Array
    mass: Array
    low: Array
    high: Array
    fast: Array
    quick: Array

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.model.nv)


def draw_arm(rng: np.random.Generator, fewest: int = 2) -> Arm:
    """A shipped arm, a measured one, or a chain of 2 to 7 joints, about a third each.

    Args:
        rng: source of the draw.
        fewest: joints at least.
    """
    kind = str(rng.choice(["shipped", "measured", "chain"], p=(0.35, 0.25, 0.4)))
    chain = random_urdf(rng, int(rng.choice([n for n in (2, 3, 4, 5, 6, 6, 7) if n >= fewest])))
    name, urdf = "chain", chain
    if kind == "shipped":
        name = str(rng.choice(SHIPPED))
        urdf = Robot.load(name).urdf.read_text(encoding="utf-8")
    elif kind == "measured":
        drawn = str(rng.choice(MEASURED))
        path = DATA / drawn / f"{drawn}.urdf"
        if path.is_file():
            name, urdf = drawn, path.read_text(encoding="utf-8")
    return arm_of(rng, name, urdf)


def arm_of(rng: np.random.Generator, name: str, urdf: str) -> Arm:
    """An individual of the type that a URDF describes, with the motion its drives allow.

    Args:
        rng: source of the differences to the URDF.
        name: what it is called.
        urdf: text of the URDF.
    """
    model = pin.buildModelFromXML(urdf)
    n = model.nv
    for i in range(1, model.njoints):
        body = model.inertias[i]
        factor = rng.uniform(0.85, 1.2)
        mass = max(body.mass * factor, 0.05)
        # A body always has some extension: bare points of a URDF would make no inertia about the last axes.
        inertia = body.inertia * factor * rng.uniform(0.95, 1.1) + np.eye(3) * mass * 0.02**2
        model.inertias[i] = pin.Inertia(mass, body.lever * rng.uniform(0.9, 1.1, 3), inertia)
    middle = 0.5 * (model.lowerPositionLimit + model.upperPositionLimit)
    half = np.minimum(0.35 * (model.upperPositionLimit - model.lowerPositionLimit), 1.2)
    slides = sliding(model)
    fast = np.where(slides, rng.uniform(0.15, 0.5, n), rng.uniform(0.6, 1.8, n))
    quick = fast * rng.uniform(2.0, 5.0, n)
    data = model.createData()
    needs, masses = [], []
    for _ in range(20):
        q = middle + half * rng.uniform(-1, 1, n)
        needs.append(np.abs(pin.rnea(model, data, q, fast * rng.uniform(-1, 1, n), quick * rng.uniform(-1, 1, n))))
        masses.append(np.diag(pin.crba(model, data, q)).copy())
    return Arm(name, urdf, model, np.mean(needs, axis=0) + 1e-2, np.mean(masses, axis=0), middle - half, middle + half,
               fast, quick)


@contextmanager
def robot_of(urdf: str) -> Iterator[Robot]:
    """The arm of a trial from the text of its URDF, whose file is there as long as the context."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "arm.urdf"
        yield written(urdf, path)


def written(urdf: str, path: Path) -> Robot:
    """The robot of a URDF's text, whose tool is its last link as it is.

    Args:
        urdf: text of the URDF.
        path: where it is written; which link carries the tool is said beside it.
    """
    frames = pin.buildModelFromXML(urdf).frames
    last = [frame.name for frame in frames if frame.type == pin.FrameType.BODY][-1]
    path.write_text(urdf, encoding="utf-8")
    path.with_suffix(".toml").write_text(f'tool_frame = "{last}"\n', encoding="utf-8")
    return Robot.load(path)


def sliding(model: pin.Model) -> np.ndarray:
    """Which joints slide ``(n,)``."""
    return np.array([np.linalg.norm(axis[:3]) > 0.5 for axis in joint_axes(model)])


def joint_axes(model: pin.Model) -> Array:
    """Motion subspace of every joint in its own frame ``(n, 6)``: linear, then angular."""
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    return np.array([pin.getJointJacobian(model, data, j, pin.ReferenceFrame.LOCAL)[:, j - 1].copy()
                     for j in range(1, model.njoints)])


def random_urdf(rng: np.random.Generator, n: int) -> str:
    """Text of a URDF of a serial chain of ``n`` joints; in one of three chains one of the first three slides."""
    slider = int(rng.integers(min(n, 3))) if rng.random() < 0.33 else -1
    parts, scale, last = ['<robot name="chain">', '<link name="l0"/>'], 1.0, "0 0 0"
    for i in range(n):
        mass, length = scale * rng.uniform(6.0, 22.0), rng.uniform(0.15, 0.45) * scale**0.3
        wide = mass * length**2 / 12.0
        com = rng.uniform(-0.25, 0.25, 3) * length + np.array([0.0, 0.0, 0.4 * length])
        axis = str(rng.choice([a for a in ("1 0 0", "0 1 0", "0 0 1") if a != last]))
        last = axis
        limit = "0.5" if i == slider else "2.6"
        x, y = rng.uniform(-0.08, 0.08, 2)
        yaw = rng.uniform(-0.5, 0.5)
        parts.append(
            f'<link name="l{i + 1}"><inertial><origin xyz="{com[0]:.4f} {com[1]:.4f} {com[2]:.4f}"/>'
            f'<mass value="{mass:.4f}"/><inertia ixx="{wide:.5f}" iyy="{1.1 * wide:.5f}" izz="{0.6 * wide:.5f}" '
            f'ixy="0" ixz="0" iyz="0"/></inertial></link>'
            f'<joint name="j{i + 1}" type="{"prismatic" if i == slider else "revolute"}"><parent link="l{i}"/>'
            f'<child link="l{i + 1}"/><origin xyz="{x:.4f} {y:.4f} {0.0 if i == 0 else length:.4f}" '
            f'rpy="0 0 {yaw:.4f}"/><axis xyz="{axis}"/><limit lower="-{limit}" upper="{limit}" effort="5000" '
            f'velocity="10"/></joint>')
        scale *= 0.65
    return "\n".join([*parts, "</robot>"])


STEP = 0.0005
"""Time step of all engines [s]."""
KINDS = ("fourier", "strokes", "cycles")


@dataclass(frozen=True)
class Motion:
    """Desired motion of the arm, every ``STEP``.

    Attributes:
        kind: one of ``KINDS``.
        t: time ``(N,)`` [s].
        q, qd, qdd: desired position, velocity and acceleration ``(N, n)``.
    """

    kind: str
    t: Array
    q: Array
    qd: Array
    qdd: Array


def draw_motion(rng: np.random.Generator, arm: Arm, seconds: float, kind: str | None = None) -> Motion:
    """Draws a motion that starts at rest.

    Args:
        rng: source of the draw.
        arm: gives range, velocities and accelerations.
        seconds: how long.
        kind: one of ``KINDS``; drawn if None.
    """
    kind = str(rng.choice(KINDS)) if kind is None else kind
    t = np.arange(round(seconds / STEP), dtype=float) * STEP
    make = {"fourier": _fourier, "strokes": _strokes, "cycles": _cycles}[kind]
    q = make(rng, arm, t)
    qd = np.gradient(q, STEP, axis=0)
    return Motion(kind, t, q, qd, np.gradient(qd, STEP, axis=0))


def _fourier(rng: np.random.Generator, arm: Arm, t: Array) -> Array:
    base = 2.0 * np.pi / float(rng.choice([8.0, 10.0, 15.0]))
    x = np.zeros((len(t), arm.n))
    for j in range(arm.n):
        for k in range(1, int(rng.integers(4, 9)) + 1):
            a, b = rng.normal(size=2) / k**0.7
            x[:, j] += a * np.cos(k * base * t) + b * np.sin(k * base * t)
    v, a = np.gradient(x, STEP, axis=0), np.gradient(np.gradient(x, STEP, axis=0), STEP, axis=0)
    size = np.minimum.reduce([0.5 * (arm.high - arm.low) / np.max(np.abs(x), axis=0),
                              arm.fast / np.max(np.abs(v), axis=0), arm.quick / np.max(np.abs(a), axis=0)])
    s = np.clip(t / 1.5, 0.0, 1.0)[:, None]
    return 0.5 * (arm.high + arm.low) + x * size * (10 * s**3 - 15 * s**4 + 6 * s**5)


def _strokes(rng: np.random.Generator, arm: Arm, t: Array) -> Array:
    """Septic polynomials between random points, each joint at its own pace."""
    q = np.zeros((len(t), arm.n))
    for j in range(arm.n):
        begin, here = 0.0, 0.5 * (arm.low[j] + arm.high[j])
        while begin < t[-1]:
            goal = float(rng.uniform(arm.low[j], arm.high[j]))
            # Peak velocity of the septic is 2.19 d/T, peak acceleration 7.52 d/T².
            T = max(2.19 * abs(goal - here) / (arm.fast[j] * rng.uniform(0.3, 1.0)),
                    float(np.sqrt(7.52 * abs(goal - here) / arm.quick[j])), 0.3)
            s = np.clip((t - begin) / T, 0.0, 1.0)
            rows = t >= begin
            q[rows, j] = (here + (goal - here) * (35 * s**4 - 84 * s**5 + 70 * s**6 - 20 * s**7))[rows]
            begin, here = begin + T, goal
    return q


def _cycles(rng: np.random.Generator, arm: Arm, t: Array) -> Array:
    """A job of a few points, repeated: all joints together, at times slower, with rests; some points lie close by."""
    count = int(rng.integers(5, 9))
    points = [0.5 * (arm.low + arm.high)]
    for _ in range(count):
        if rng.random() < 0.35:
            near = points[-1] + 0.1 * (arm.high - arm.low) * rng.uniform(-1, 1, arm.n)
            points.append(np.clip(near, arm.low, arm.high))
        else:
            points.append(rng.uniform(arm.low, arm.high))
    points.append(points[0])
    override = rng.choice([1.0, 1.0, 0.6, 0.3], size=count + 1)
    rests = rng.choice([0.0, 0.1, 0.3, 1.0], size=count + 1)
    q = np.tile(points[0], (len(t), 1))
    begin = 0.3
    while begin < t[-1]:
        for start, end, share, rest in zip(points[:-1], points[1:], override, rests, strict=True):
            step = np.abs(end - start)
            T = max(float(np.max(1.5 * step / (arm.fast * share))), float(np.max(np.sqrt(9.0 * step / arm.quick))),
                    0.25)
            first = int(np.searchsorted(t, begin))
            s = np.clip((t[first:] - begin) / T, 0.0, 1.0)[:, None]
            # Acceleration rises and falls like sin², over the first and last third, between them constant speed.
            q[first:] = start + (end - start) * _blended(s)
            begin += T + rest
            if begin >= t[-1]:
                break
    return q


def _blended(s: Array) -> Array:
    """Way ``0 … 1`` over time ``0 … 1``: thirds of speeding up, of steady speed (1.5), of slowing down."""
    third, peak = 1.0 / 3.0, 1.5

    def rise(u: Array) -> Array:
        x = u / third
        return peak * third * (0.5 * x**2 + (np.cos(2 * np.pi * x) - 1.0) / (4.0 * np.pi**2))

    return np.where(s < third, rise(np.minimum(s, third)),
                    np.where(s < 2 * third, 0.25 + peak * (s - third), 1.0 - rise(np.minimum(1.0 - s, third))))
