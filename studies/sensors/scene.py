"""An arm at work as formulas have it, without a controller, and what its encoders and drives record."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from scipy import signal

from ideal_robot.arrays import Array, interpolated
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from studies.strangers.arm import SHIPPED, Arm, arm_of, random_urdf


@dataclass(frozen=True)
class Trial:
    """One trial.

    Attributes:
        recording: for the diagnosis.
        urdf: text of the URDF for the diagnosis.
        truth: the effect drawn, name and joint from 1 (0 for the whole arm); None for none.
        size: of the effect, in its parameters' units.
    """

    recording: Recording
    urdf: str
    truth: tuple[str, int] | None
    size: Array


@dataclass(frozen=True)
class Scene:
    """One motion of an arm.

    Attributes:
        arm: that moves.
        t: times ``(N,)`` [s].
        q: joint angles ``(N, n)`` [rad].
        load: torque at the gear output ``(N, n)`` [N m].
        torque: of the motors ``(N, n)`` [N m].
    """

    arm: Arm
    t: Array
    q: Array
    load: Array
    torque: Array


def draw_tooled_arm(rng: np.random.Generator) -> Arm:
    """A shipped arm or a chain of three to seven joints, with a tool: without it the last joint moves no TCP."""
    name, urdf = "chain", random_urdf(rng, int(rng.choice([3, 4, 5, 6, 6, 7])))
    if rng.random() < 0.4:
        name = str(rng.choice(SHIPPED))
        urdf = Robot.load(name).urdf.read_text(encoding="utf-8")
    arm = arm_of(rng, name, urdf)
    if "tool0" in arm.urdf:
        return arm
    x, y, z = rng.uniform(0.05, 0.2, 3)
    tool = (f'<link name="tool0"/><joint name="tool" type="fixed"><parent link="l{arm.n}"/><child link="tool0"/>'
            f'<origin xyz="{x:.4f} {y:.4f} {z:.4f}" rpy="0 0 0"/></joint>')
    return dataclasses.replace(arm, urdf=arm.urdf.replace("</robot>", tool + "\n</robot>"))


def scene(rng: np.random.Generator, arm: Arm, t: Array, q: Array) -> Scene:
    """Draws drives and computes the torques of a motion.

    Args:
        rng: draws friction, rotors and offsets.
        arm: that moves.
        t: times ``(N,)`` [s].
        q: joint angles ``(N, n)`` [rad].
    """
    dt, n, data = t[1] - t[0], arm.n, arm.model.createData()
    qd = np.gradient(q, dt, axis=0)
    qdd = np.gradient(qd, dt, axis=0)
    load = np.array([pin.rnea(arm.model, data, *row) for row in zip(q, qd, qdd, strict=True)]).reshape(q.shape)
    friction = (arm.need * rng.uniform(0.05, 0.25, n) / arm.fast * qd
                + arm.need * rng.uniform(0.08, 0.3, n) * np.tanh(qd / (2e-3 * arm.fast)))
    rotor, offset = arm.mass * rng.uniform(0.1, 0.8, n), arm.need * rng.normal(0, 0.02, n)
    return Scene(arm, t, q, load, load + friction + rotor * qdd + offset)


def measured(rng: np.random.Generator, s: Scene, qa: Array | None = None) -> Recording:
    """Noise, white and coloured, quantisation, at times a jittering clock.

    Args:
        rng: draws them.
        s: what happened.
        qa: arm angles ``(N, n)`` [rad]; None if they are not measured.
    """
    t, q = s.t, s.q
    noise = (np.std(s.torque, axis=0) + 1e-3) * rng.uniform(0.005, 0.02, s.arm.n)
    colour = signal.lfilter([0.1], [1.0, -0.9], rng.normal(size=q.shape), axis=0)
    tau = s.torque + noise * rng.normal(size=q.shape) + 0.4 * noise * colour
    if rng.random() < 0.4:
        tau = np.round(tau / noise) * noise
    encoder = float(rng.choice([1e-7, 1e-6, 5e-6]))
    columns = {"q": np.round((q + rng.normal(size=q.shape) * 0.3 * encoder) / encoder) * encoder, "tau": tau}
    if qa is not None:
        columns["qa"] = qa
    if rng.random() < 0.25:
        stamps = t + rng.uniform(-0.15, 0.15, len(t)) * (t[1] - t[0])
        columns = {name: interpolated(stamps, t, values)
                   for name, values in columns.items()}
        t = stamps
    return Recording.from_arrays(np.array(t), **columns)


def chain(arm: Arm) -> tuple[pin.Model, int]:
    """The arm as its drawings say, and the frame of its TCP."""
    model = pin.buildModelFromXML(arm.urdf)
    return model, int(model.getFrameId([f.name for f in model.frames if f.type == pin.FrameType.BODY][-1]))


def poses(model: pin.Model, tool: int, q: Array) -> tuple[Array, Array]:
    """Orientation ``(N, 3, 3)`` and place ``(N, 3)`` [m] of the TCP.

    Args:
        model: kinematics.
        tool: index of the tool frame.
        q: joint angles ``(N, n)`` [rad].
    """
    data = model.createData()
    rotation, place = np.empty((len(q), 3, 3)), np.empty((len(q), 3))
    for k, row in enumerate(q):
        pin.forwardKinematics(model, data, row)
        pose = pin.updateFramePlacement(model, data, tool)
        rotation[k], place[k] = pose.rotation, pose.translation
    return rotation, place


# A camera that sees a line: a line, a moving camera, one effect of it or none, and noise.
#
# The camera hangs on a gantry with a wrist, whose joints are the tool's pose, so nothing has to be rendered or solved.
# Its truth is geometry: points of the true line as they lie in the true pose of their exposure.

SIZES = {"camera_latency": (0.001, 0.006), "camera_scale": (0.01, 0.04), "camera_offset": (0.002, 0.008),
         "lens_distortion": (4.0, 16.0), "clock_drift": (0.0006, 0.003)}
"""Smallest and largest size of each effect [s, 1, m or rad, 1/m², s/s]."""
KINDS = (*SIZES, "none")
AHEAD = np.linspace(0.02, 0.11, 5)
AXIS = np.array([0.065, 0.0, 0.0])
RATE, FIELDS = 250.0, 50.0
NOISE = 2e-5


def gantry() -> str:
    """URDF of three slides and three revolute joints whose axes meet in the tool, which looks down."""
    axes = ("1 0 0", "0 1 0", "0 0 1", "0 0 1", "0 1 0", "1 0 0")
    parts = ['<robot name="gantry"><link name="base"/>']
    parent = "base"
    for i, axis in enumerate(axes, start=1):
        kind = "prismatic" if i <= 3 else "revolute"
        parts.append(
            f'<joint name="joint_{i}" type="{kind}"><parent link="{parent}"/><child link="link_{i}"/>'
            f'<axis xyz="{axis}"/><limit lower="-4" upper="4" effort="500" velocity="5"/></joint>'
            f'<link name="link_{i}"><inertial><origin xyz="0.01 0.02 0.05"/><mass value="{8.0 / i:.3f}"/>'
            '<inertia ixx="0.02" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>')
        parent = f"link_{i}"
    parts.append('<joint name="tool" type="fixed"><parent link="link_6"/><child link="tool0"/>'
                 f'<origin rpy="{math.pi!r} 0 0"/></joint><link name="tool0"/></robot>')
    return "".join(parts)


def draw_line_trial(seed: int, kind: str | None = None, share: float = 1.0) -> tuple[str, float, Recording]:
    """Kind, size (times ``share``) and recording of a trial; the recording bears no trace of either.

    Args:
        seed: of everything that is drawn.
        kind: name of the effect; drawn if None.
        share: factor on the size of the effect, 1.
    """
    rng = np.random.default_rng(seed)
    kind = kind or str(rng.choice(KINDS))
    size = 0.0 if kind == "none" else float(share * rng.uniform(*SIZES[kind]) * rng.choice([-1.0, 1.0]))
    speed, length = rng.uniform(0.2, 0.5), 1.3
    wave = [(rng.uniform(0.01, 0.03) / k, rng.uniform(0.5, 0.9) / k, rng.uniform(0.0, 6.28)) for k in (1, 2)]
    x_line = np.arange(-0.3, length + 0.4, 0.0005)
    line = np.column_stack([x_line, sum(a * np.sin(6.2832 * x_line / w + f) for a, w, f in wave),
                            np.zeros(len(x_line))])
    heading = np.gradient(line[:, 1], x_line)
    wander = [[(rng.uniform(0.3, 1.0) * top, rng.uniform(0.4, 1.6), rng.uniform(0.0, 6.28)) for _ in range(2)]
              for top in (0.008, 0.003, 0.12, 0.02, 0.02)]

    def joints(t: Array) -> Array:
        moves = [sum(a * np.sin(6.2832 * f * t + p) for a, f, p in part) for part in wander]
        x = speed * t + 0.02 * np.sin(3.0 * t)
        yaw = np.arctan(np.interp(x, x_line, heading)) + moves[2]
        return np.column_stack([x, np.interp(x, x_line, line[:, 1]) + moves[0], 0.003 + moves[1], yaw, *moves[3:]])

    t = np.arange(0.0, length / speed, 1.0 / RATE)
    q = joints(t)
    model = pin.buildModelFromXML(gantry())
    data, tau = model.createData(), _torques(rng, model, t, q)
    columns: dict[str, Array] = {"t": t}
    columns |= {f"q_{i + 1}": q[:, i] + rng.normal(0.0, 2e-6, len(t)) for i in range(6)}
    columns |= {f"tau_{i + 1}": tau[:, i] for i in range(6)}
    stamps, points = np.full(len(t), np.nan), np.full((len(t), len(AHEAD), 3), np.nan)
    tool = model.getFrameId("tool0")
    for stamp in np.arange(0.1, t[-1] - 0.1, 1.0 / FIELDS):
        row = int(np.searchsorted(t, stamp))
        late = size if kind == "camera_latency" else size * stamp if kind == "clock_drift" else 0.0
        pin.forwardKinematics(model, data, joints(np.array([stamp + late]))[0])
        pose = pin.updateFramePlacement(model, data, tool)
        in_tool = (line - pose.translation) @ pose.rotation
        order = np.argsort(in_tool[:, 0])
        u = np.column_stack([AHEAD, *(np.interp(AHEAD, in_tool[order, 0], in_tool[order, i]) for i in (1, 2))])
        u[:, 1] += rng.normal(0.0, NOISE, len(u)) + rng.normal(0.0, 0.5 * NOISE)
        stamps[row], points[row] = stamp, _displaced(u, kind, size)
    columns["cam_t"] = stamps
    columns |= {f"line_{axis}_{i + 1}": points[:, i, k] for i in range(len(AHEAD)) for k, axis in enumerate("xyz")}
    meta = {"camera": {"axis": [float(v) for v in AXIS], "distance": 0.25}}
    return kind, size, Recording(columns, meta)


def _torques(rng: np.random.Generator, model: pin.Model, t: Array, q: Array) -> Array:
    """Torques ``(N, n)`` [N m] of the gantry with dry friction and noise."""
    qd, qdd = np.gradient(q, t, axis=0), np.gradient(np.gradient(q, t, axis=0), t, axis=0)
    data = model.createData()
    tau = np.array([pin.rnea(model, data, *row) for row in zip(q, qd, qdd, strict=True)])
    return np.asarray(tau + (5.0 * np.tanh(qd / 0.01) + rng.normal(0.0, 0.3, tau.shape)))


def _displaced(u: Array, kind: str, size: float) -> Array:
    """Points ``(m, 3)`` as a camera reports them whose error is a function of what it reports."""
    reported = u
    for _ in range(8):
        out = (reported - AXIS) * np.array([1.0, 1.0, 0.0])
        if kind == "camera_scale":
            reported = u + size * out
        elif kind == "lens_distortion":
            reported = u + size * np.sum(out**2, axis=1)[:, None] * out
        elif kind == "camera_offset":
            reported = u + size * np.column_stack([np.full(len(u), 0.5) - out[:, 1], out[:, 0], 0.0 * u[:, 0]])
    return np.asarray(reported)
