"""An arm at work as formulas have it, without a controller, and what its encoders and drives record."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from scipy import signal

from ideal_robot.arrays import Array
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from studies.strangers.arm import SHIPPED, Arm, arm_of, random_urdf


@dataclass(frozen=True)
class Trial:
    """One trial.

    Attributes:
        kind: ``none``, or what was drawn.
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
        columns = {name: np.column_stack([np.interp(stamps, t, column) for column in values.T])
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
