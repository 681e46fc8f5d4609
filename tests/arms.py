"""Arms that tests try things on: URDFs that no maker has, plants of strangers, and a KR 15-like closed loop."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ideal_robot.arrays import Array
from ideal_robot.dynamics.newton_euler import chain_of
from ideal_robot.feedforward.base import Feedforward
from ideal_robot.friction.table import Friction, speed_grid
from ideal_robot.loop.loop import Cascade, CommandPath, Compensation, Drives, Loop, checked, low_pass_taps
from ideal_robot.loop.simulation import simulate
from ideal_robot.robots.robot import Robot
from studies.strangers import drive
from studies.strangers.arm import Arm, Motion, arm_of, draw_motion, random_urdf
from studies.strangers.logger import Logger, draw_logger
from studies.strangers.plant import CONSTRAINT, Plant, draw_plant, with_observer

LINK = '<link name="{name}">{inertial}</link>'
INERTIAL = ('<inertial><origin xyz="0 0 0.1"/><mass value="{mass}"/>'
            '<inertia ixx="{inertia}" iyy="{inertia}" izz="{inertia}" ixy="0" ixz="0" iyz="0"/></inertial>')
SIX = (("0 0 1", "0 0 0.2"), ("0 1 0", "0 0 0.2"), ("0 1 0", "0 0 0.45"), ("1 0 0", "0.2 0 0"), ("0 1 0", "0.25 0 0"),
       ("1 0 0", "0.1 0 0"))
"""Axis and place of each joint: a wrist of three axes that meet nearly, tool along x."""
SEVEN = (("0 0 1", "0 0 0.15"), ("0 1 0", "0 0 0.2"), ("0 0 1", "0 0 0.2"), ("0 -1 0", "0 0 0.2"), ("0 0 1", "0 0 0.2"),
         ("0 1 0", "0 0 0.2"), ("0 0 1", "0 0 0.1"))
FIVE = (("0 0 1", "0 0 0.1"), ("0 1 0", "0 0 0.1"), ("0 1 0", "0 0 0.3"), ("0 1 0", "0 0 0.3"), ("0 0 1", "0 0 0.1"))
TURNED = {6: "0 1.5707963 0", 7: "0 0 0", 5: "0 0 0"}
"""From the last link to the tool frame."""
GRIPPER = """<link name="hand"/><joint name="hand_joint" type="fixed"><parent link="tool0"/><child link="hand"/><axis xyz="0 0 0"/></joint>
<link name="left"><inertial><mass value="0.1"/><inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="left_finger" type="prismatic"><parent link="hand"/><child link="left"/><axis xyz="0 1 0"/>
<limit lower="0.01" upper="0.04" effort="20" velocity="0.2"/></joint>
<link name="right"/><joint name="right_finger" type="prismatic"><parent link="hand"/><child link="right"/><axis xyz="0 -1 0"/>
<limit lower="0" upper="0.04" effort="20" velocity="0.2"/><mimic joint="left_finger"/></joint>"""  # noqa: E501

SCARA = """<robot name="scara"><link name="base_link"/><link name="a"/><link name="b"/><link name="c"/><link name="d"/>
<joint name="j1" type="revolute"><parent link="base_link"/><child link="a"/><origin xyz="0 0 0.2"/><axis xyz="0 0 1"/>{limit}</joint>
<joint name="j2" type="revolute"><parent link="a"/><child link="b"/><origin xyz="{one} 0 0"/><axis xyz="0 0 {up}"/>{limit}</joint>
<joint name="j3" type="prismatic"><parent link="b"/><child link="c"/><origin xyz="{two} 0 0.05"/><axis xyz="0 0 {up}"/>
<limit lower="-0.2" upper="0" effort="300" velocity="1"/></joint>
<joint name="j4" type="revolute"><parent link="c"/><child link="d"/><origin xyz="0 0 0" rpy="{roll} 0 0"/><axis xyz="0 0 1"/>{limit}</joint>
</robot>"""  # noqa: E501
"""An arm of four joints, two of them upright, one that slides, one that turns the tool."""


def following(parts: Sequence[tuple[str, str, str, str, float, str]], tool: str = "0 0 0") -> str:
    """A chain of joints of which some follow others.

    Args:
        parts: of each joint name, type, axis, place, mass of its link [kg], and the attributes of its ``mimic``.
        tool: roll, pitch and yaw of the tool frame on the last link.
    """
    text = ['<robot name="following"><link name="base_link"/>']
    before = "base_link"
    for name, kind, axis, place, mass, mimic in parts:
        link = f"behind_{name}"
        low, high = (0.0, 0.3) if kind == "prismatic" else (-1.2, 1.2)
        text.append(LINK.format(name=link, inertial=INERTIAL.format(mass=mass, inertia=0.02 * mass)))
        text.append(f'<joint name="{name}" type="{kind}"><parent link="{before}"/><child link="{link}"/>'
                    f'<origin xyz="{place}"/><axis xyz="{axis}"/>'
                    f'<limit lower="{low}" upper="{high}" effort="600" velocity="2"/>'
                    f'{f"<mimic {mimic}/>" if mimic else ""}</joint>')
        before = link
    text.append(f'<link name="tool0"/><joint name="flange" type="fixed"><parent link="{before}"/><child link="tool0"/>'
                f'<origin xyz="0 0 0" rpy="{tool}"/></joint></robot>')
    return "".join(text)


PALLETIZER = following([
    ("j1", "revolute", "0 0 1", "0 0 0.3", 20.0, ""), ("j2", "revolute", "0 1 0", "0.1 0 0.1", 12.0, ""),
    ("rods", "revolute", "0 1 0", "0 0 0.5", 3.0, 'joint="j2" multiplier="-1"'),
    ("j3", "revolute", "0 1 0", "0 0 0", 8.0, ""),
    ("level", "revolute", "0 1 0", "0.5 0 0", 3.0, 'joint="j3" multiplier="-1"'),
    ("j4", "revolute", "0 0 -1", "0.05 0 -0.1", 2.0, "")], "3.14159265 0 0")
"""An arm of four joints whose rods keep the wrist level: two more joints follow."""
LIFTED = following([
    ("lift", "prismatic", "0 0 1", "0 0 0.2", 10.0, ""),
    ("stage", "prismatic", "0 0 1", "0 0 0.1", 8.0, 'joint="lift" multiplier="0.8" offset="0.02"'),
    *((f"joint_{i}", "revolute", axis, place, 4.0 / i, "") for i, (axis, place) in enumerate(SIX, 1))], TURNED[6])
"""An arm of six joints on a telescope, whose second stage a belt moves with the first."""


def urdf(joints: int = 6, *, mass: float | None = None, limit: str = 'lower="-2.9" upper="2.9" effort="0" velocity="0"',
         beyond: str = "", kind: str = "revolute") -> str:
    """A bare chain of 5, 6 or 7 joints, its first one of a kind, with links of a mass [kg] or none, then ``beyond``."""
    chain = {5: FIVE, 6: SIX, 7: SEVEN}[joints]
    parts = ['<robot name="bare"><link name="base_link"/>']
    for i, (axis, place) in enumerate(chain, 1):
        inertial = "" if mass is None else INERTIAL.format(mass=mass, inertia=0.01 * mass)
        parts.append(LINK.format(name=f"link_{i}", inertial=inertial))
        parts.append(f'<joint name="joint_{i}" type="{kind if i == 1 else "revolute"}">'
                     f'<parent link="{"base_link" if i == 1 else f"link_{i - 1}"}"/><child link="link_{i}"/>'
                     f'<origin xyz="{place}"/><axis xyz="{axis}"/><limit {limit}/></joint>')
    tip = "0.1 0 0" if joints == 6 else "0 0 0.1"
    parts.append(f'<link name="tool0"/><joint name="flange" type="fixed"><parent link="link_{joints}"/>'
                 f'<child link="tool0"/><origin xyz="{tip}" rpy="{TURNED[joints]}"/>'
                 '<axis xyz="0 0 0"/></joint>')
    # ROS-Industrial's second frame at the base, which stands behind the tool in the file.
    parts.append('<link name="base"/><joint name="base_fixed" type="fixed"><parent link="base_link"/>'
                 f'<child link="base"/></joint>{beyond}</robot>')
    return "\n".join(parts)


def written(folder: Path, text: str, name: str = "bare") -> Path:
    """The URDF as a file in a folder."""
    path = folder / f"{name}.urdf"
    path.write_text(text, encoding="utf-8")
    return path


# Strangers: one arm, bare or with some of what drives have.


def an_arm(seed: int = 3, n: int = 3) -> Arm:
    rng = np.random.default_rng(seed)
    return arm_of(rng, "chain", random_urdf(rng, n))


def a_motion(arm: Arm, seconds: float = 3.0, kind: str = "fourier") -> Motion:
    return draw_motion(np.random.default_rng(5), arm, seconds, kind)


def a_plant(arm: Arm, *, friction: bool = True, stiffness: float = np.inf, kind: int = CONSTRAINT,
            engine: str = "") -> Plant:
    """A plant under the cascade, or what DART has, which may not be here; gears rigid or as stiff as said."""
    if engine == "dart":
        pytest.importorskip("dartpy", exc_type=ImportError)
    rng = np.random.default_rng(1)
    plant = draw_plant(rng, arm)
    while plant.controller != "cascade":
        plant = draw_plant(rng, arm)
    n, block = arm.n, plant.block.copy()
    if not friction:
        block[[drive.COULOMB, drive.VISCOUS]] = 0.0
    plant = dataclasses.replace(plant, block=block, stiffness=np.full(n, stiffness), damping=np.full(n, 5.0),
                                regularisation=np.full(n, kind), presliding=np.full(n, 5e-4), v_smooth=np.full(n, 2e-3))
    return with_observer(rng, plant) if engine == "dart" else plant


def a_logger(rng: np.random.Generator, n: int, qa: tuple[int, ...] = (), **wanted: Any) -> Logger:
    """Sampled torques every 4 ms, or as wanted, without jitter, gaps, spikes, temperatures and places."""
    return dataclasses.replace(draw_logger(rng, n, qa), **dict(every=8, torque="sampled", encoder=1e-5, jitter=0.0,
                                                               dropped=0.0, spikes=0.0, temp=(), xy=False) | wanted)


# A KR 15-like closed loop with round numbers, and motions for it.

T = 0.012
ROBOT = Robot.load("kr15")


def plant(*, inertia: float = 1.0, friction: float = 1.0, stiffness: float = 1.0, delay: int = 1,
          elastic: bool = True) -> Loop:
    """The loop, or one whose inertias, friction and stiffness are wrong by factors."""
    chain = chain_of(ROBOT.pinocchio)
    n = ROBOT.n
    speeds = speed_grid(ROBOT.v_max)
    dry = np.array([90.0, 100.0, 55.0, 8.0, 8.0, 4.0])
    k = stiffness * np.array([4e5, 5e5, 2.5e5, 4e4, 4e4, 2e4])
    k_p = np.array([4500.0, 3500.0, 1400.0, 100.0, 95.0, 26.0])
    none = np.zeros((0, 3, n))
    return checked(Loop(
        chain._replace(mass=inertia * chain.mass, inertia=inertia * chain.inertia),
        Drives(ROBOT.rotor_inertia, np.zeros(n), np.ones(n), none, k if elastic else np.full(n, np.inf), 1.5e-3 * k,
               none, np.zeros(n), np.zeros(n)),
        a_friction(speeds, friction * np.tile(dry[:, None], speeds.shape[1]), 0.5 * friction * dry[:, None]
                   * np.sqrt(speeds), 3e-4),
        Cascade(np.full(n, 20.0), np.full(n, 0.93), np.zeros(n), 0.0, k_p, k_p / 0.05, np.full(n, 1e-3), ROBOT.tau_max,
                1.0),
        Compensation.none(chain, ROBOT.rotor_inertia),
        CommandPath(low_pass_taps(1.5e-3, 2, 0.002, n), delay, T, 0.002, 0.0005, ROBOT.q_min, ROBOT.q_max,
                    ROBOT.v_max)))


def a_friction(speeds: Array, dry: Array, fluid: Array, distance: float) -> Friction:
    """Friction that is alike in both directions, of sizes ``(n, m)`` at these speeds, turning over a distance [rad]."""
    n = len(speeds)
    sizes = np.ascontiguousarray(np.tile(np.stack([dry, fluid], axis=2)[:, None], (1, 2, 1, 1)))
    return Friction(speeds, sizes, np.zeros((n, 2)), np.full(n, distance))


def motion(amplitude: float = 0.2, duration: float = 1.6, lead: int = 45, tail: int = 25) -> Array:
    """Desired positions ``(N, n)``: rest, every joint once around a closed curve, rest."""
    t = np.arange(round(duration / T)) * T / duration
    phase = 2 * np.pi * t**4 * (35 - 84 * t + 70 * t**2 - 20 * t**3)
    shape = np.column_stack([np.sin(phase), 1 - np.cos(phase), np.sin(phase), 1 - np.cos(phase), np.sin(phase),
                             1.5 * np.sin(phase)])
    moved = ROBOT.home + amplitude * shape
    return np.concatenate([np.tile(moved[0], (lead, 1)), moved, np.tile(ROBOT.home, (tail, 1))])


def commands(feedforward: Feedforward, q_d: Array, n_d: int | None = None) -> Array:
    """What a feedforward commands along a path, with a horizon of ``n_d`` rows if not its own."""
    if n_d is None:
        return feedforward.along(q_d)
    state, q_c = feedforward.init(q_d[0]), np.empty_like(q_d)
    ahead = np.concatenate([q_d, np.tile(q_d[-1], (n_d, 1))])
    for k in range(len(q_d)):
        q_c[k], state = feedforward.step(state, ahead[k : k + n_d])
    return q_c


def rms(error: Array) -> float:
    """Root mean square over everything."""
    return float(np.sqrt(np.mean(error**2)))


def off(arm: Loop, feedforward: Feedforward, q_d: Array, lead: int = 40) -> float:
    """How far an arm is from where it should be, from cycle ``lead`` on, by the commands of a feedforward [rad]."""
    return rms(simulate(arm, commands(feedforward, q_d)).q_a[lead:-1] - q_d[lead:])
