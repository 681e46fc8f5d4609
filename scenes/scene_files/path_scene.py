"""Scenes of kind ``path``: a tool path known beforehand, run with every way of correcting commands."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
import pinocchio as pin
import pydantic

from ideal_robot.arrays import Array, held
from ideal_robot.errors import InputError, LimitError
from ideal_robot.robots.collisions import Shapes
from ideal_robot.robots.robot import Robot
from planning import OutOfReachError
from planning.path.kinematics import InverseKinematics
from scenes.scene_files.scene import BENCH, CELL, Box, Scene, Table, obstacles
from scenes.scene_files.tool_path import lasting, shape_of, tool_path

REST_BEFORE, REST_AFTER = 0.9, 0.6
"""How long the arm rests at the start and at the end of the path [s]; it does not count for the errors."""


class Figure(Table):
    """The figure of the path and its place."""

    shape: Literal["iso9283", "triangle", "circle", "edge"]
    size_mm: float = pydantic.Field(gt=1.0, le=3000.0)
    """Edge, edge, diameter or side length."""
    centre: tuple[float, float, float]
    """In the base frame [m]."""
    tilt_deg: float = 0.0
    """Inclination of its plane: 0 lies flat, 90 stands upright facing the robot."""
    heading_deg: float = 0.0
    """Turns the inclined plane about the vertical."""
    tool_tilt_deg: float = 0.0
    """How far the tool is turned up from its direction in the home posture."""
    turn_deg: float = pydantic.Field(default=0.0, ge=-360.0, le=360.0)
    """Change of orientation along the way, about the vertical."""
    acceleration: float = pydantic.Field(default=3.0, gt=0.0)
    """Largest along the path [m/s²]; assumed, the papers give none."""


class Paper(Table):
    """Error reductions that a paper publishes for this path, by method; reports show them beside the measured ones."""

    E_car_reduction_percent: dict[str, float] = pydantic.Field(default_factory=dict)
    E_max_reduction_percent: dict[str, float] = pydantic.Field(default_factory=dict)
    source: str = "[G]"


class PathScene(Scene):
    """A tool path on one robot in one world."""

    worlds: ClassVar[tuple[str, ...]] = (BENCH, CELL)
    speed: float = pydantic.Field(gt=0.0)
    path: Figure
    box: tuple[Box, ...] = ()
    """Boxes in the cell, each a table ``[[box]]``."""
    method: str = "ideal"
    learn_from: Literal["arm", "motor", "tcp", "two_dof"] = "tcp"
    """What learning measures: arm angles, motor angles, TCP poses (an external device), or two of their six degrees of
    freedom."""
    paper: Paper = Paper()


@dataclass(frozen=True)
class JointPath:
    """The path as the input of the ideal robot.

    Attributes:
        q_d: desired joint positions at the cycles ``(N, n)`` [rad], rest before and behind included.
        x_d: desired TCP positions ``(N, 3)`` [m].
        t: ``(N,)`` [s].
        counts: where errors are evaluated ``(N,)``: during the motion along the path.
    """

    q_d: Array
    x_d: Array
    t: Array
    counts: np.ndarray


def joint_path(scene: PathScene, robot: Robot, t_ipo: float) -> JointPath:
    """Plans the scene's path in joint space; InputError for one out of reach, too fast, or that touches something.

    Args:
        scene, robot: figure and speed; posture, kinematics and limits.
        t_ipo: cycle [s].
    """
    kinematics = InverseKinematics(robot)
    home = kinematics.fk(robot.home)
    figure = scene.path
    tilt = _about([0.0, 1.0, 0.0], -figure.tilt_deg)
    # Seen from the robot: x of the figure to the right, y up (or ahead where it lies flat).
    plane = pin.SE3(_about([0.0, 0.0, 1.0], figure.heading_deg) @ tilt @ np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]]),
                    np.array(figure.centre))
    rotation = _about([0.0, 1.0, 0.0], -figure.tool_tilt_deg) @ home.rotation
    turn = ((0.0, 0.0, 1.0), float(np.radians(figure.turn_deg))) if figure.turn_deg else None
    shape = shape_of(figure.shape, 1e-3 * figure.size_mm)
    scene.check_duration(lasting(shape, scene.speed, figure.acceleration))
    tool = tool_path(shape, plane, scene.speed, figure.acceleration, t_ipo, rotation=rotation, turn=turn)
    try:
        q = robot.home
        # From home in small steps, so that the arm keeps its posture (elbow, wrist).
        for share in np.linspace(0.05, 1.0, 20):
            q = kinematics.solve(pin.SE3.Interpolate(home, tool.poses[0], float(share)), q)
        moved = kinematics.path(tool.poses, q)
    except OutOfReachError as error:
        raise InputError(f"the path is out of reach: {error}", file=scene.source, field="path.centre",
                         value=list(figure.centre)) from error
    _check_speed(moved, robot, t_ipo)
    touch = Shapes(robot, boxes=obstacles(scene.box)).first_touch(moved[::5])
    if touch is not None:
        raise InputError(f"the arm would hit something: {touch} {5 * touch.row * t_ipo:.2f} s from the path's begin",
                         file=scene.source, field="path.centre", value=list(figure.centre))
    before, after = round(REST_BEFORE / t_ipo), round(REST_AFTER / t_ipo)
    q_d, x_d = (held(rows, before=before, after=after) for rows in (moved, tool.positions))
    counts = np.zeros(len(q_d), dtype=bool)
    counts[before : before + len(moved)] = True
    return JointPath(q_d, x_d, np.asarray(t_ipo * np.arange(float(len(q_d)))), counts)


def _check_speed(q: Array, robot: Robot, t_ipo: float) -> None:
    speed = np.max(np.abs(np.diff(q, axis=0)), axis=0) / t_ipo
    for i in np.flatnonzero(speed > robot.v_max):
        error = LimitError(int(i) + 1, f"velocity [{robot.units('rad/s')[i]}]", float(speed[i]), float(robot.v_max[i]),
                           "move slower")
        raise InputError(str(error), field="speed")


def _about(axis: list[float], degrees: float) -> Array:
    return np.asarray(pin.exp3(np.radians(degrees) * np.array(axis)))
