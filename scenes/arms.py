"""The arm of a scene, as its URDF describes it, and the files of its identified models."""

from __future__ import annotations

import os
from dataclasses import replace
from functools import lru_cache
from importlib import resources
from pathlib import Path

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.model.model import Model
from ideal_robot.robots import SHIPPED as SHIPPED_ARMS
from ideal_robot.robots.collisions import Shapes
from ideal_robot.robots.robot import Robot, spread_postures
from ideal_robot.robots.size import FEWEST, of_its_size, reach, shoulder_height
from planning import OutOfReachError
from planning.path.kinematics import InverseKinematics
from scenes.scene_files.scene import SHIPPED

AHEAD = (0.6, 0.5, 0.7)
"""Where a tool works, in front of the base, relative to the arm's reach …"""
BELOW = (-0.15, -0.35, 0.1)
"""… and how high, from the second joint."""
STARTS = 24
"""Postures from which a ready one is looked for, for each place."""
ENOUGH = 0.5
"""Share of the most room at any height with which the first height of ``BELOW`` is taken: an arm that hangs from the
ceiling reaches the upper ones over its head only."""
ROOM = 0.3
"""Distance to the joint limits that is enough [rad]."""
DOWN = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
"""A tool that points down."""


def arm_of(name_or_urdf: str) -> Robot:
    """The arm that a scene names, with defaults for what its URDF lacks; raises the errors of ``Robot.load``."""
    if name_or_urdf in SHIPPED_ARMS or not os.path.isfile(name_or_urdf):
        return Robot.load(name_or_urdf)
    beside = os.path.splitext(name_or_urdf)[0] + ".toml"
    stamps = tuple(os.stat(path).st_mtime_ns if os.path.isfile(path) else 0 for path in (name_or_urdf, beside))
    return _loaded(os.path.abspath(name_or_urdf), name_or_urdf, stamps)


@lru_cache(maxsize=8)
def _loaded(place: str, name: str, changed: tuple[int, ...]) -> Robot:
    """Loads once as long as the files do not change."""
    robot = of_its_size(Robot.load(name))
    if robot.n < FEWEST or "home" in robot.data.get("joints", {}):
        return robot
    home = _ready(robot)
    return robot if home is None else replace(robot, home=home)


def _ready(robot: Robot) -> Array | None:
    """The posture ``(n,)`` with the tool down over a place ahead that leaves much room to move; None without one."""
    kinematics, shapes, size = InverseKinematics(robot), Shapes(robot), reach(robot)
    shoulder, starts = shoulder_height(robot), spread_postures(robot.q_min, robot.q_max, STARTS)
    candidates = [max(postures, key=lambda candidate: candidate[0]) for postures in
                  (_over(kinematics, shapes, size, shoulder + below * size, starts) for below in BELOW) if postures]
    if not candidates:
        return None
    most = max(room for room, _ in candidates)
    home = np.array(next(q for room, q in candidates if room >= ENOUGH * most))
    home.setflags(write=False)
    return home


def _over(kinematics: InverseKinematics, shapes: Shapes, size: float, height: float, starts: Array
          ) -> list[tuple[float, Array]]:
    """Room, and postures ``(n,)`` with the tool down at a height over places ahead, looked for from each start."""
    postures = []
    for ahead in AHEAD:
        target = pin.SE3(DOWN, np.array([ahead * size, 0.0, height]))
        for start in starts:
            try:
                q = _turned_back(kinematics.robot, kinematics.solve(target, start))
            except OutOfReachError:
                continue
            if shapes.first_touch(q[None]) is None:
                postures.append((_room(kinematics, size, q), q))
    return postures


def _turned_back(robot: Robot, q: Array) -> Array:
    """The same posture with whole turns taken away."""
    less = q - 2.0 * np.pi * np.round(q / (2.0 * np.pi))
    return np.where(~robot.prismatic & (less >= robot.q_min) & (less <= robot.q_max), less, q)


def _room(kinematics: InverseKinematics, size: float, q: Array) -> float:
    """How well an arm can move from a posture: least singular value of its Jacobian, less near a limit or wound up."""
    robot, model = kinematics.robot, kinematics.robot.pinocchio
    jacobian = pin.computeFrameJacobian(model, model.createData(), q, robot.tool_id, pin.LOCAL_WORLD_ALIGNED)
    scaled = np.vstack([jacobian[:3] / size, jacobian[3:]])
    smallest = np.linalg.svd(scaled, compute_uv=False)[min(robot.n, 6) - 1]
    margin = float(np.min(np.minimum(q - robot.q_min, robot.q_max - q)))
    height = kinematics.elbow(q) / size
    wound = float(np.mean(np.abs(q))) / np.pi
    return float(smallest * min(1.0, margin / ROOM) * (1.0 + max(height, 0.0)) * (1.0 - 0.3 * wound))


# Identified models: the shipped ones, and those of the user's.

def shipped_model(robot_name: str) -> Path:
    """File of the shipped model of a robot, identified on recordings of its default world (``make models``)."""
    return Path(str(resources.files("scenes"))) / "models" / f"{robot_name}.json"


def model_at(wanted: str, robot: Robot, source: str | None = None) -> Model:
    """The model that a scene names by ``shipped`` or by its path.

    Raises InputError for no shipped model for that robot, no such file, or a model of another robot.

    Args:
        wanted, robot: the name or path, and the arm.
        source: the scene, for messages.
    """
    path = shipped_model(robot.name) if wanted == SHIPPED else Path(wanted)
    if not os.path.isfile(path):
        raise InputError("no such model file; give the path of one that identify or prepare wrote, or shipped"
                         if wanted != SHIPPED else
                         f'no model is shipped for {robot.name}; model = "own" has it identified by '
                         "motions of the scene's arm, or identify one and give its path", file=source,
                         field="model", value=wanted)
    model = _load(path, path.stat().st_mtime_ns)
    model.require_arm(robot, file=path)
    return model


@lru_cache(maxsize=8)
def _load(path: Path, changed: int) -> Model:
    """Loads once as long as the file does not change."""
    return Model.load(path)
