"""Where in an arm's reach a line scene fits: place of the surface, size of the line, speed that the joints allow."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.robots.collisions import Shapes
from ideal_robot.robots.robot import Robot
from ideal_robot.robots.size import reach, shoulder_height
from planning import OutOfReachError
from planning.path.kinematics import InverseKinematics
from planning.path.reference import ReferencePath
from planning.path.speed_profile import JointPath, Limits, SpeedProfile
from scenes.scene_files.drawn_line import reference_points
from scenes.scene_files.force_scene import ForceScene
from scenes.scene_files.line_scene import LineScene
from scenes.scene_files.scene import Scene, boxes_of, obstacles

AHEAD = (0.6, 0.5, 0.7, 0.4)
"""Distances of the line from the base that are tried, relative to the reach …"""
BELOW = (-0.2, -0.35, -0.05, 0.1, -0.5)
"""… heights of the surface from the second joint …"""
HEADINGS = (90.0, 0.0)
"""Of the line, across the arm or away from it; the second is tried where the first fits nowhere [deg] …"""
SIZES = (0.75, 0.6, 0.45, 0.3)
"""… and lengths of the line."""
FASTEST = 0.7
"""Speed that nobody needs to exceed in a first scene [m/s]."""
FAST_ENOUGH = 0.35
"""Speed for which no other place is tried [m/s]."""
SPARE = 0.7
"""Share of the speed that the joints allow along the reference which is used: corrections need the rest."""
CORRIDOR = (0.03, 0.006)
"""How far to the sides of the reference, and above and below it, the arm has to reach [m]."""
ATTEMPTS = 6
"""Postures from which one is looked for at a place before it counts as out of reach."""
BORDER = 0.05
"""How far a surface reaches beyond the reference [m]."""
LOWEST = 0.05
"""Of a surface above the base plane [m]: room for the tool's own width."""
TOOLS = (0.0, 0.1)
"""Lengths of tools that are tried, relative to the reach: a short wrist needs one to keep off the surface."""
FROM_LIMIT = 0.05
"""Distance from the joint limits on the whole corridor [rad or m]."""


@dataclass(frozen=True)
class Place:
    """Where a line fits.

    Attributes:
        origin, heading: of the surface [m], and about z [deg].
        length, speed: of the line [m], and that the joints allow with something to spare [m/s].
        tool_mm: length of a tool that keeps the wrist off the surface.
    """

    origin: tuple[float, float, float]
    heading: float
    length: float
    speed: float
    tool_mm: float


def place_line(scene: LineScene) -> Place:
    """A long line across the arm that it can follow fast, ahead of it and beside nothing that it would hit.

    Of the scene, shape of the line and run-up count. Raises InputError where it fits nowhere.
    """
    robot = scene.arm
    if shoulder_height(robot) < 0.0:
        raise InputError(f"{robot.name} hangs below z = 0, which is the floor; let the URDF begin with a link on the "
                         "floor and a fixed joint from there to the arm's base", file=robot.urdf, field="robot")
    best: Place | None = None
    for heading in HEADINGS:
        for candidate in (placed for share in SIZES for placed in _candidates(scene, robot, share, heading)):
            speed = fits(candidate, candidate.arm)
            if speed is not None and (best is None or speed > best.speed):
                best = Place(candidate.surface.origin, heading, float(candidate.line.length or 0.0), speed,
                             candidate.tool_mm)
                if speed >= FAST_ENOUGH:
                    return best
        if best is not None:
            return best
    raise InputError(f"no line fits in the reach of {robot.name} ({reach(robot):.2f} m) with the tool pointing down; "
                     "give the posture to work from as home in the robot's TOML, or place surface and line by hand",
                     file=robot.urdf, field="robot")


def where_it_fits(scene: LineScene) -> str:
    """A sentence about where in the reach of a scene's arm a line would fit."""
    try:
        place = place_line(scene)
    except InputError as error:
        return error.message
    x, y, z = place.origin
    tool = f" and tool_mm = {place.tool_mm:g}" if place.tool_mm else ""
    return (f"a line of {place.length:g} m fits with surface.origin = [{x:g}, {y:g}, {z:g}], "
            f"heading_deg = {place.heading:g}{tool}; ideal-robot new NAME --robot writes such a scene")


def _candidates(scene: LineScene, robot: Robot, share: float, heading: float) -> Iterator[LineScene]:
    """The scene with a line of a share of the reach, at the places that are tried, without a tool first."""
    size, shoulder = reach(robot), shoulder_height(robot)
    length = round(share * size, 2)
    turn = math.radians(heading)
    for tool, below, ahead in product(TOOLS, BELOW, AHEAD):
        height = round(max(shoulder + below * size, LOWEST), 2)
        begin = np.array([ahead * size, 0.0]) - 0.5 * length * np.array([math.cos(turn), math.sin(turn)])
        origin = (round(float(begin[0]), 2), round(float(begin[1]), 2), height)
        yield resized(scene, length, origin, heading).changed(tool_mm=round(100.0 * tool * size) * 10.0)


def resized(scene: LineScene, length: float, origin: tuple[float, float, float], heading: float = 90.0) -> LineScene:
    """The scene with its sine that long, its waves in proportion, at another place.

    Args:
        scene: to change.
        length: of the line [m].
        origin, heading: of the surface [m], and about z [deg].
    """
    return scene.changed(surface={"origin": list(origin), "heading_deg": heading, "tilt_deg": [0.0, 0.0]},
                         line={"formula": formula(length), "length": length, "points": None, "svg": None},
                         reference=run_ups(length))


def run_ups(length: float) -> dict[str, float]:
    """Straight pieces before and behind a line of a length [m]: the usual ones, shorter for short lines."""
    return {"run_up": round(min(0.15, max(0.06, 0.25 * length)), 2), "run_out": round(min(0.05, 0.1 * length), 2)}


def formula(length: float) -> str:
    """A sine of one and a half waves, its curvature the same whatever its length [m]."""
    wave = round(length / 1.5, 2)
    return f"{0.04 * (wave / 0.8) ** 2:.4g}*sin(2*pi*x/{wave:g})"


def scene_text(example: str, robot: str, place: Place) -> str:
    """A shipped line scene's text for another arm.

    Args:
        example, robot: the text, and the URDF as the scene is to name it.
        place: where the line fits.
    """
    values: dict[str, Any] = {"robot": robot, "speed": place.speed, "origin": list(place.origin),
                              "heading_deg": place.heading,
                              "formula": formula(place.length), "length": place.length,
                              "description": f"A sine-like line in the reach of {Path(robot).stem}."}
    rows = example.splitlines()
    for i, row in enumerate(rows):
        key = row.partition(" = ")[0]
        if key in values:
            rows[i] = f"{key} = {json.dumps(values[key], ensure_ascii=False)}"
    example = "\n".join(rows)
    tool = f"tool_mm = {place.tool_mm:g}\n" if place.tool_mm else ""
    example = example.replace("\n[surface]", f'model = "own"\n{tool}\n[surface]', 1)
    ends = "".join(f"{key} = {value:g}\n" for key, value in run_ups(place.length).items())
    return f"{example.rstrip()}\n\n[reference]\n{ends}"


def fits(scene: LineScene, robot: Robot) -> float | None:
    """The speed at which the arm can follow a scene's line [m/s]; None where it cannot."""
    try:
        reference = ReferencePath(reference_points(scene), up=scene.surface.pose().rotation[:, 2], turning=1.0)
        kinematics = InverseKinematics(robot)
        for share in (0.0, 0.5, 1.0):
            # Most places are refused here already, which is quicker than along the whole path.
            kinematics.search(reference.pose(share * reference.length), robot.home, ATTEMPTS)
        path = JointPath.of(robot, reference)
        beside = _corridor(robot, reference, path)
    except (InputError, OutOfReachError):
        return None
    near = np.vstack([path.q, *beside])
    if np.min(np.minimum(near - robot.q_min, robot.q_max - near)) < FROM_LIMIT:
        return None
    if shapes_about(scene, robot).first_touch(path.q[::5]) is not None:
        return None
    return _speed(robot, reference, path, scene)


def check_way(scene: LineScene, robot: Robot, reference: ReferencePath, path: JointPath) -> None:
    """Raises InputError for a reference on which the arm would hit something, or could not follow a line beside it.

    Args:
        scene, robot: how far the line may be from its reference, and the arm.
        reference, path: the path, and its joint angles.
    """
    check_clear(shapes_about(scene, robot), path)
    beside = scene.displacement
    half = 0.5 * reference.length
    sides = (1e-3 * beside.lateral_mm + half * math.sin(math.radians(beside.turn_deg)),
             1e-3 * beside.height_mm + half * math.sin(math.radians(beside.tilt_deg)))
    try:
        _corridor(robot, reference, path, sides)
    except OutOfReachError as error:
        raise InputError(f"the line may lie {1e3 * sides[0]:.0f} mm beside its reference and {1e3 * sides[1]:.0f} mm "
                         f"above or below it by the table displacement, and there {error}", field="path") from error


def check_clear(shapes: Shapes, path: JointPath) -> None:
    """Raises InputError for a path on which the arm would touch something, and says where, and what is in the way."""
    touch = shapes.first_touch(path.q[::5])
    if touch is not None:
        raise InputError(f"the arm would hit something: {touch} {path.s[5 * touch.row]:.2f} m from the path's begin",
                         field="path")


def shapes_about(scene: LineScene | ForceScene, robot: Robot) -> Shapes:
    """The arm above the surface that a scene's line is drawn on, which reaches ``BORDER`` beyond it, among boxes."""
    plane = scene.surface.pose()
    drawn = (reference_points(scene) - plane.translation) @ plane.rotation
    low, high = drawn.min(axis=0) - BORDER, drawn.max(axis=0) + BORDER
    middle = plane * pin.SE3(np.eye(3), np.array([*(0.5 * (low + high))[:2], 0.0]))
    return Shapes(robot, middle, (float(high[0] - low[0]), float(high[1] - low[1])), obstacles(scene.box))


def shapes_in(scene: Scene, robot: Robot) -> Shapes:
    """The arm among all that a scene names: boxes, and the surface where there is one."""
    if isinstance(scene, LineScene | ForceScene):
        return shapes_about(scene, robot)
    return Shapes(robot, boxes=obstacles(boxes_of(scene)))


def _speed(robot: Robot, reference: ReferencePath, path: JointPath, scene: LineScene) -> float | None:
    """What the joints allow on the slowest place, and what the reference's acceleration allows on its length."""
    with np.errstate(divide="ignore"):
        steady = float(np.min(robot.v_max / np.abs(path.dq)))
    run_up = math.sqrt(scene.reference.acceleration * max(reference.length - 0.1, 0.01) * 0.5)
    speed = math.floor(100.0 * min(FASTEST, SPARE * steady, run_up)) / 100.0
    if speed < 0.02:
        return None
    while speed >= 0.02:
        try:
            SpeedProfile.plan(robot, reference, Limits(speed, scene.reference.acceleration), path)
            return speed
        except InputError:
            speed = math.floor(80.0 * speed) / 100.0
    return None


def _corridor(robot: Robot, reference: ReferencePath, path: JointPath, half: tuple[float, float] = CORRIDOR
              ) -> list[Array]:
    """Joint angles along the four edges of a corridor about the reference, ``(K, n)`` each.

    Raises ``OutOfReachError`` where a part of it is out of reach, or beyond a joint limit.
    """
    kinematics, rows = InverseKinematics(robot), np.arange(0, len(path.s), 10)
    frames, rotations = reference.frames(path.s[rows]), reference.rotation(path.s[rows])
    edges = [frames.position + side * frames.normal + up * frames.up
             for side, up in product((-half[0], half[0]), (-half[1], half[1]))]
    return [kinematics.refine_rows(rotations, places, path.q[rows], wanted=path.q[rows]) for places in edges]
