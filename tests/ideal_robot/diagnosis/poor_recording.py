"""An arm of two joints whose friction is degressive in the second one, and recordings of it, poor and good.

The first recording is short, slow and of two frequencies a joint, as one of an arm at work is: it does not tell the
cause from a ripple.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pinocchio as pin
from scipy import interpolate

from ideal_robot.arrays import Array
from ideal_robot.dynamics import torques
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from studies.strangers.arm import robot_of

URDF = """<robot name="arm"><link name="l0"/>
<link name="l1"><inertial><origin xyz="0.0278 -0.0036 0.1025"/><mass value="21.118"/>
<inertia ixx="0.17679" iyy="0.19446" izz="0.10607" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="j1" type="revolute"><parent link="l0"/><child link="l1"/><origin xyz="0.0993 -0.0511 0.0" rpy="0 0 0"/>
<axis xyz="1 0 0"/><limit lower="-2.6" upper="2.6" effort="5000" velocity="10"/></joint>
<link name="l2"><inertial><origin xyz="0.0828 0.0637 0.0627"/><mass value="15.0992"/>
<inertia ixx="0.13126" iyy="0.14439" izz="0.07876" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="j2" type="revolute"><parent link="l1"/><child link="l2"/><origin xyz="0.0486 0.0603 0.323" rpy="0 0 0"/>
<axis xyz="1 0 0"/><limit lower="-2.6" upper="2.6" effort="5000" velocity="10"/></joint></robot>"""
FAST, QUICK = np.array([1.35, 1.37]), np.array([3.16, 5.24])
"""What the arm's motions stay within [rad/s, rad/s²]."""
TRUTH = ("degressive", 2)
SIZE, BEND = 0.128, 0.155
"""Of the cause [N m], and speed at which it has half of it [rad/s]."""
ROTOR, VISCOUS, COULOMB = np.array([0.48, 0.07]), np.array([5.0, 0.72]), np.array([5.6, 2.3])
NOISE = np.array([0.104, 0.044])
RATE = 200.0


@contextmanager
def poor_arm() -> Iterator[tuple[Robot, Robot]]:
    """The robot as it is, and with the limits that its recordings stay within."""
    with robot_of(URDF) as plain:
        yield plain, dataclasses.replace(plain, q_min=np.full(2, -1.2), q_max=np.full(2, 1.2), v_max=FAST, a_max=QUICK,
                                         tau_max=np.full(2, np.inf))


def poor_recording() -> Recording:
    """9.6 s of slow and narrow motion."""
    t, w = np.arange(0.0, 9.65, 1.0 / RATE), 2.0 * np.pi / 8.0
    rng = np.random.default_rng(1)
    q = np.zeros((len(t), 2))
    for j in range(2):
        for order in rng.choice([1.0, 2.0, 3.0, 5.0], 2, replace=False):
            q[:, j] += rng.uniform(0.4, 1.0) / (order * w) * np.sin(order * w * t + rng.uniform(0, 2 * np.pi))
        v = np.gradient(q[:, j], t)
        q[:, j] *= min(0.24 / np.max(np.abs(q[:, j])), 0.35 * FAST[j] / np.max(np.abs(v)),
                       0.5 * QUICK[j] / np.max(np.abs(np.gradient(v, t))))
    return recorded(t, q, rng)


def recording_of(commands: Array, t_ipo: float) -> Recording:
    """What the same arm records when it follows commands ``(N, 2)`` [rad] every ``t_ipo`` [s] exactly."""
    spline = interpolate.CubicSpline(t_ipo * np.arange(float(len(commands))), commands, axis=0)
    t = np.arange(0.0, t_ipo * (len(commands) - 1), 1.0 / RATE)
    return recorded(t, spline(t), np.random.default_rng(3))


def recorded(t: Array, q: Array, rng: np.random.Generator) -> Recording:
    """Encoders and torques of a motion ``(N, 2)`` [rad]."""
    qd = np.gradient(q, t, axis=0)
    qdd = np.gradient(qd, t, axis=0)
    tau = torques(pin.buildModelFromXML(URDF), q, qd, qdd) + ROTOR * qdd + np.array([-0.51, 0.28])
    tau += VISCOUS * qd + COULOMB * np.tanh(qd / (2e-3 * FAST))
    tau[:, 1] += SIZE * qd[:, 1] / (BEND + np.abs(qd[:, 1]))
    return Recording.from_arrays(t, q=np.round(q / 1e-6) * 1e-6, tau=tau + NOISE * rng.normal(size=q.shape))
