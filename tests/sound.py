"""Sound files that tests break or work on: a small arm, its model, recordings, paths and scenes, all quick."""

from __future__ import annotations

import json
import math
import tempfile
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ideal_robot.dynamics import torques
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.export import write_mcap, write_rosbag2
from ideal_robot.signals.recording import Recording
from scenes.online.camera_process import CalibratedCamera
from scenes.report.replay import write_replay
from scenes.view.viewer import replay_of_columns
from sensing.camera.camera_model import CameraModel

URDF = b"""<?xml version="1.0"?>
<robot name="arm">
<link name="base"/>
<link name="upper"><visual><geometry><box size="0.1 0.1 0.5"/></geometry></visual>
<inertial><origin xyz="0 0 0.2" rpy="0 0 0"/><mass value="6.0"/>
<inertia ixx="0.2" iyy="0.2" izz="0.05" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="lower"><inertial><origin xyz="0 0.05 0.2" rpy="0 0 0"/><mass value="3.0"/>
<inertia ixx="0.1" iyy="0.1" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="first" type="revolute"><parent link="base"/><child link="upper"/><origin xyz="0 0 0.3" rpy="0 0 0"/>
<axis xyz="0 1 0"/><limit lower="-2.5" upper="2.5" effort="300" velocity="3"/></joint>
<joint name="second" type="revolute"><parent link="upper"/><child link="lower"/><origin xyz="0 0 0.5" rpy="0 0 0.1"/>
<axis xyz="0 1 0"/><limit lower="-2.5" upper="2.5" effort="200" velocity="4"/></joint>
</robot>
"""
DATA = b"""name = "arm"
[joints]
gear_ratio = [100.0, 80.0]
rotor_inertia = [1e-4, 1e-4]
torque_constant = [0.8, 0.6]
a_max = [20.0, 30.0]
home = [0.0, 0.5]
[controller]
t_ipo = 0.012
t_position = 0.002
t_velocity = 0.0005
[rsi]
axis_sign = [1.0, -1.0]
axis_zero = [0.0, 5.0]
"""
LINE = b"""kind = "line"
title = "short"
speed = 0.7
method = "none"
seed = 1
[calibration]
by_moving = false
[surface]
origin = [0.98, -0.6, 0.35]
heading_deg = 90.0
[line]
formula = "0.4 + 0.02*sin(2*pi*x/0.5)"
length = 0.2
[displacement]
lateral_mm = 4.0
"""
PATH = b"""kind = "path"
title = "circle"
robot = "kr15"
speed = 0.3
seed = 1
method = "none"
[path]
shape = "circle"
size_mm = 60.0
centre = [1.0, 0.0, 0.9]
tilt_deg = 20.0
"""
FORCE = b"""kind = "force"
title = "short wave"
speed = 0.2
force = 20.0
seed = 1
gains = [5e-5, 6e-5]
[surface]
origin = [0.98, -0.4, 0.35]
heading_deg = 90.0
slope = [0.01, 0.02]
wave = [{amplitude_mm = 4.0, wavelength_mm = 260.0}]
[line]
formula = "0*x"
length = 0.12
[world]
base = "bench"
"""
CLAMPED = b"""kind = "clamped"
title = "one joint"
robot = "kr500"
seed = 1
[clamp]
configurations = [[1.62, -0.89, 1.84, 1.62, -1.57, 0.46]]
push = "tool_z"
forces = [1000.0, 3000.0, 5000.0]
components = ["fz"]
"""
CLOSE_CLAMPED = b"""kind = "close_clamped"
title = "clamped a few times"
robot = "kr15"
speed = 0.5
seed = 1
[path]
shape = "circle"
size_mm = 60.0
centre = [1.05, 0.0, 0.95]
tilt_deg = 45.0
[clamp]
most = 4
push = "joints"
[world]
stiffness = [4.5e5, 2.2e5, 2.6e5, 4.5e4, 4.5e4, 2.0e4]
"""
SCENES = {"line": LINE, "path": PATH, "force": FORCE, "clamped": CLAMPED}
SVG = b'<svg xmlns="http://www.w3.org/2000/svg"><g><path d="M 0 0 C 50 10 80 -20 100 0 L 200 10"/></g></svg>'
@cache
def arm(folder: Path) -> Robot:
    """The small arm, its files written into ``folder``."""
    (folder / "arm.urdf").write_bytes(URDF)
    (folder / "arm.toml").write_bytes(DATA)
    return Robot.load(folder / "arm.urdf")


@cache
def motion(folder: Path) -> dict[str, Any]:
    """Five seconds of the small arm moving: ``t``, ``q_c_i``, ``q_i``, ``tau_i``."""
    robot, rng = arm(folder), np.random.default_rng(1)
    t = 0.01 * np.arange(500)
    w = np.array([[2.1, 3.7], [4.3, 1.9]])
    q = 0.5 * np.sin(w[0] * t[:, None]) + 0.2 * np.sin(w[1] * t[:, None] + 1.0)
    qd = 0.5 * w[0] * np.cos(w[0] * t[:, None]) + 0.2 * w[1] * np.cos(w[1] * t[:, None] + 1.0)
    qdd = -0.5 * w[0] ** 2 * np.sin(w[0] * t[:, None]) - 0.2 * w[1] ** 2 * np.sin(w[1] * t[:, None] + 1.0)
    tau = torques(robot.pinocchio, q, qd, qdd) + robot.rotor_inertia * qdd + 4.0 * np.sign(qd) + 3.0 * qd
    tau = tau + 0.1 * rng.normal(size=tau.shape)
    return {"t": t, **{f"{key}_{i + 1}": values[:, i] for key, values in (("q_c", q), ("q", q), ("tau", tau))
                       for i in range(2)}}


@cache
def pushes(folder: Path) -> dict[str, Any]:
    """Twelve seconds of the small arm clamped and pushed: ``t``, ``q_i``, ``current_i``, ``fx fy fz mx my mz``."""
    robot, rng = arm(folder), np.random.default_rng(2)
    t = 0.02 * np.arange(600)
    levels = np.column_stack([np.sin(2 * math.pi * t / 6.0), np.sin(2 * math.pi * t / 4.0)]) * (t > 1.0)[:, None]
    tau = 80.0 * levels + 0.1 * rng.normal(size=levels.shape)
    q = np.array([0.3, 0.6]) + tau / 1e5
    wrench = np.column_stack([100 * levels[:, 0], 0 * t, 120 * levels[:, 1], 0 * t, 30 * levels[:, 0], 0 * t])
    wrench = wrench + 0.5 * rng.normal(size=wrench.shape)
    return {"t": t, **{f"q_{i + 1}": q[:, i] for i in range(2)},
            **{f"current_{i + 1}": tau[:, i] / robot.drive_gain[i] for i in range(2)},
            **dict(zip(("fx", "fy", "fz", "mx", "my", "mz"), wrench.T, strict=True))}


@cache
def joint_path() -> dict[str, Any]:
    """A second of a path of the shipped six-joint arm: ``t``, ``q_d_i``."""
    t = 0.012 * np.arange(80)
    s = np.clip(t / t[-1], 0, 1)[:, None]
    home = np.array([0.0, -1.2217304764, 1.8325957146, 0.0, 0.9599310886, 0.0])
    q = home + 0.05 * (10 * s**3 - 15 * s**4 + 6 * s**5) * np.ones(6)
    return {"t": t, **{f"q_d_{i + 1}": q[:, i] for i in range(6)}}


@cache
def model(folder: Path) -> bytes:
    """A model of the small arm: what its data sheet says."""
    return Model.nominal(arm(folder)).save(folder / "nominal.json").read_bytes()


@cache
def calibration() -> bytes:
    """A camera's calibration as it is kept."""
    return json.dumps(CalibratedCamera(CameraModel.default(320, 240), time_offset=0.003).json(), indent=2).encode()


@cache
def bag(folder: Path, *, mcap: bool) -> bytes:
    """The small arm's recording as an MCAP file, or the database of a ROS 2 bag.

    Args:
        folder: for the sound files; any that lasts.
        mcap: the one or the other.
    """
    recording = Recording(dict(motion(folder)), {}, "small arm")
    with tempfile.TemporaryDirectory() as scratch:
        if mcap:
            return write_mcap(recording, Path(scratch) / "r.mcap").read_bytes()
        return next(write_rosbag2(recording, Path(scratch) / "bag").glob("*.db3")).read_bytes()


@cache
def replay(folder: Path) -> bytes:
    """The replay of the small arm's motion."""
    with tempfile.TemporaryDirectory() as scratch:
        (Path(scratch) / "r.csv").write_bytes(csv_bytes(motion(folder)))
        recording = Recording.read(Path(scratch) / "r.csv")
        replay = replace(replay_of_columns(arm(folder), recording),
                         surface=np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]))
        return write_replay(replay, Path(scratch) / "r.replay.npz", recording).read_bytes()


def csv_bytes(columns: dict[str, Any]) -> bytes:
    """A table as CSV."""
    return pd.DataFrame(columns).to_csv(index=False).encode()
