"""Places a line scene in an arm's reach: surface, size of the line, speed that the joints allow."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from ideal_robot.errors import InputError
from ideal_robot.robots.robot import Robot, spread_postures
from ideal_robot.robots.size import mean_height, reach, shoulder_height
from planning import OutOfReachError
from planning.path.joint_path import JointPath
from planning.path.kinematics import InverseKinematics
from planning.path.reference import ReferencePath
from scenes.line_way import calibration_postures, line_way, shapes_about
from scenes.scene_files.drawn_line import believed_camera, reference_points
from scenes.scene_files.line_scene import LineScene
from scenes.scene_files.scene import SceneError

AHEAD = (0.6, 0.5, 0.7, 0.4)
"""Distances of the line from the base that are tried, relative to the reach …"""
NEAR = (0.3, 0.2)
"""… and, where the tool points down at none of them, nearer ones: of arms whose wrist is as long as their forearm …"""
BELOW = (-0.2, -0.35, -0.05, 0.1, -0.5)
"""… heights of the surface from the second joint, and that at which the tool is on average …"""
HEADINGS = (90.0, 0.0)
"""Of the line, across the arm or away from it; the second is tried where the first fits nowhere [deg] …"""
SIZES = (0.75, 0.6, 0.45, 0.3)
"""… and lengths of the line."""
FASTEST = 0.7
"""Speed that nobody needs to exceed in a first scene [m/s]."""
SPARE = 0.8
"""Share of the speed that path and joints allow which is used: corrections need the rest."""
PERIOD = 0.5
"""Time that a wave of the line takes at least [s]: what gears and friction leave of an arm's model grows with the
frequency that is asked of it."""
WORTH = 0.5
"""Share of the speed of a line's own ``PERIOD`` from which on no shorter line is tried."""
SLOWEST = 0.02
"""Speed below which nobody would follow a line [m/s]."""
ATTEMPTS = 6
"""Postures from which one is looked for at a place before it counts as out of reach."""
LOWEST = 0.05
"""Of a surface above the base plane [m]: room for the tool's own width."""
TOOLS = (0.0, 0.1)
"""Lengths of tools that are tried, relative to the reach: a short wrist needs one to keep off the surface …"""
LONG_TOOLS = (0.25,)
"""… and a longer one where none of them does, of an arm whose flange lies above the end of its forearm."""
TURNS = (0.0, 180.0, 90.0, -90.0, 45.0, -45.0, 135.0, -135.0)
"""How tool and camera are mounted on the flange, about the approach axis: a wrist of less than a turn cannot point a
flange's own x axis along every travel [deg]; in steps of an eighth a wrist of a quarter turn can."""
FROM_LIMIT = 0.05
"""Distance from the joint limits on the whole corridor [rad or m]."""


@dataclass(frozen=True)
class Place:
    """A place, size and speed of a line that the arm can follow.

    Attributes:
        origin, heading: of the surface [m], and about z [deg].
        length, speed: of the line [m], and along it [m/s], below what the joints allow.
        tool_mm: length of a tool that keeps the wrist off the surface.
        tool_turn_deg: of tool and camera about the approach axis.
    """

    origin: tuple[float, float, float]
    heading: float
    length: float
    speed: float
    tool_mm: float
    tool_turn_deg: float

    @property
    def tool(self) -> dict[str, float]:
        """The scene's keys of the tool; empty for the default tool."""
        keys = {"tool_mm": self.tool_mm, "tool_turn_deg": self.tool_turn_deg}
        return {key: value for key, value in keys.items() if value}


def place_line(scene: LineScene) -> Place:
    """Finds a place for a long line across the arm that it can follow fast and without collisions.

    Only the line's shape and run-up are taken from the scene. Raises InputError where it fits nowhere.
    """
    robot = scene.arm
    highest = _highest(robot)
    if shoulder_height(robot) < 0.0 or highest < LOWEST:
        where = "hangs" if shoulder_height(robot) < 0.0 else f"has its tool no higher than {highest:.2f} m, thus"
        raise InputError(f"{robot.name} {where} below z = 0, which is the floor; let the URDF begin with a link on the "
                         "floor and a fixed joint from there to the arm's base", file=robot.urdf, field="robot")
    # Where the arm cannot calibrate the camera at any line, the line is placed without that condition.
    for seeing, tools, ahead, turn in product((True, False) if scene.calibration.by_moving else (False,),
                                              (TOOLS, LONG_TOOLS), (AHEAD, NEAR), TURNS):
        if (place := _placed(scene.changed(tool_turn_deg=turn), robot, (tools, ahead), seeing)) is not None:
            return place
    raise InputError(f"no line fits in the reach of {robot.name} ({reach(robot):.2f} m) with the tool pointing down; "
                     "give the posture to work from as home in the robot's TOML, or place surface and line by hand",
                     file=robot.urdf, field="robot")


def _highest(robot: Robot) -> float:
    """Height of the tool where the arm holds it as high as hardly ever [m]."""
    fk = robot.fk()
    return float(np.quantile([fk(q).translation[2] for q in spread_postures(robot.q_min, robot.q_max)], 0.95))


def _placed(scene: LineScene, robot: Robot, tried: tuple[tuple[float, ...], tuple[float, ...]], seeing: bool
            ) -> Place | None:
    """Where a line fits with some tools and at some distances, the tool mounted as it is; None for nowhere.

    On request it is one over which the camera is calibrated.
    """
    slow: Place | None = None
    for heading, share in product(HEADINGS, SIZES):
        best: Place | None = None
        wanted = min(FASTEST, wave(round(share * reach(robot), 2)) / PERIOD)
        for candidate in _candidates(scene, robot, share, heading, tried):
            speed = fits(candidate, candidate.arm, wanted)
            if (speed is not None and (best is None or speed > best.speed)
                    and (not seeing or calibrates(candidate, candidate.arm))):
                best = Place(candidate.surface.origin, heading, float(candidate.line.length or 0.0), speed,
                             candidate.tool_mm, candidate.tool_turn_deg)
            if best is not None and best.speed >= math.floor(100.0 * wanted) / 100.0:
                return best
        if best is not None and best.speed >= WORTH * wanted:
            return best
        if best is not None and (slow is None or best.speed > slow.speed):
            slow = best
        if slow is not None and share == SIZES[-1]:
            return slow
    return None


def calibrates(scene: LineScene, robot: Robot) -> bool:
    """Whether the arm reaches the poses that calibrate the camera over the middle of the line."""
    reference = ReferencePath(reference_points(scene), up=scene.surface.pose().rotation[:, 2], turning=1.0)
    try:
        calibration_postures(robot, reference, JointPath.of(robot, reference),
                             believed_camera(scene.camera, scene.calibration), 0.5 * reference.length,
                             shapes=shapes_about(scene, robot))
    except (SceneError, OutOfReachError):
        return False
    return True


def where_it_fits(scene: LineScene) -> str:
    """A sentence that proposes a place for the line in the reach of a scene's arm."""
    try:
        place = place_line(scene)
    except InputError as error:
        return error.message
    x, y, z = place.origin
    tool = "".join(f" and {key} = {value:g}" for key, value in place.tool.items())
    return (f"a line of {place.length:g} m fits with surface.origin = [{x:g}, {y:g}, {z:g}], "
            f"heading_deg = {place.heading:g}{tool}; ideal-robot new NAME --robot writes such a scene")


def _candidates(scene: LineScene, robot: Robot, share: float, heading: float,
                tried: tuple[tuple[float, ...], tuple[float, ...]]) -> Iterator[LineScene]:
    """The scene with a line of a share of the reach, with the tools in turn, at the distances that are tried."""
    size, shoulder = reach(robot), shoulder_height(robot)
    length = round(share * size, 2)
    turn = math.radians(heading)
    heights = dict.fromkeys(round(max(height, LOWEST), 2)
                            for height in (*(shoulder + below * size for below in BELOW), mean_height(robot)))
    tools, distances = tried
    for tool, height, ahead in product(tools, heights, distances):
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
    """Lengths of the straight segments before and behind a line [m]: the default ones, shorter for short lines."""
    return {"run_up": round(min(0.15, max(0.06, 0.25 * length)), 2), "run_out": round(min(0.05, 0.1 * length), 2)}


def wave(length: float) -> float:
    """Wavelength of a line of one and a half waves [m]."""
    return round(length / 1.5, 2)


def formula(length: float) -> str:
    """Formula of a sine of one and a half waves over a length [m]; its curvature does not depend on the length."""
    return f"{0.04 * (wave(length) / 0.8) ** 2:.4g}*sin(2*pi*x/{wave(length):g})"


def scene_text(example: str, robot: str, place: Place) -> str:
    """A shipped line scene's text for another arm.

    Args:
        example, robot: the text, and the URDF as the scene is to name it.
        place: a place where the line fits.
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
    tool = "".join(f"{key} = {value:g}\n" for key, value in place.tool.items())
    example = example.replace("\n[surface]", f'model = "own"\n{tool}\n[surface]', 1)
    ends = "".join(f"{key} = {value:g}\n" for key, value in run_ups(place.length).items())
    return f"{example.rstrip()}\n\n[reference]\n{ends}"


def fits(scene: LineScene, robot: Robot, wanted: float = FASTEST) -> float | None:
    """The speed up to ``wanted`` at which the arm follows the line with a margin [m/s]; None where it cannot.

    ``scenes.line_way.line_way`` checks, as it does before every run; a margin is required in addition.

    Args:
        scene, robot: the line, and the arm with the scene's tool.
        wanted: speed that need not be exceeded [m/s].
    """
    try:
        reference = ReferencePath(reference_points(scene), up=scene.surface.pose().rotation[:, 2], turning=1.0)
        kinematics = InverseKinematics(robot)
        for share in (0.0, 0.5, 1.0):
            # Most places are rejected here already, which is faster than along the whole path.
            kinematics.search(reference.pose(share * reference.length), robot.home, ATTEMPTS)
        way = line_way(scene, robot)
        if way.margin() < FROM_LIMIT:
            return None
        speed = math.floor(100.0 * min(wanted, SPARE * way.steady())) / 100.0
        while speed >= SLOWEST:
            try:
                replace(way, scene=scene.changed(speed=speed)).travel()
                return speed
            except InputError:
                # On a short path the arm only accelerates and brakes, so that no joint's speed is the limit.
                speed = math.floor(80.0 * speed) / 100.0
    except (InputError, OutOfReachError):
        pass
    return None
