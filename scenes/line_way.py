"""Checks whether an arm can follow a scene's line wherever it may lie, and how fast, for `new` and `run`."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.robots.collisions import Shapes
from ideal_robot.robots.robot import Robot
from planning import OutOfReachError
from planning.line.measurement import LineAhead
from planning.path.joint_demands import JointDemands
from planning.path.joint_path import JointPath
from planning.path.kinematics import TILTED, InverseKinematics
from planning.path.reference import ReferencePath
from planning.path.speed_profile import Limits, SpeedProfile
from scenes.scene_files.drawn_line import reference_points
from scenes.scene_files.force_scene import ForceScene
from scenes.scene_files.line_scene import LineScene
from scenes.scene_files.scene import Scene, SceneError, boxes_of, obstacles
from sensing.camera.camera_model import CameraModel
from sensing.camera.hand_eye import calibration_poses

ROWS = 60
"""Places along the reference at which the surfaces beside it are looked at."""
BORDER = 0.05
"""How far a surface reaches beyond the reference [m]."""
FOUND = (0.001, 0.0005)
"""What calibration by moving leaves open of the surface's height [m] and slope [rad], standard deviations."""
SIGMAS = 3.0
"""By how many of them a surface that calibration found may lie outside the scene's displacement."""


@dataclass(frozen=True)
class LineWay:
    """A reference that an arm can follow, and joint paths for all displacements that its line may have.

    Attributes:
        scene, robot: speed and acceleration, and the arm.
        reference: on the assumed or calibrated surface.
        path: of the reference in joint space.
        beside: of the lines on the outermost surfaces that the scene's displacement allows, at fewer places; none for a
            calibrated surface.
    """

    scene: LineScene
    robot: Robot
    reference: ReferencePath
    path: JointPath
    beside: tuple[JointPath, ...] = ()

    def travel(self) -> SpeedProfile:
        """The travel at the scene's speed on an assumed surface; on a calibrated one, at most as fast as it permits.

        Raises InputError for a speed that path or joints do not allow, or a motion longer than the scene allows.
        """
        limits = Limits(self.scene.speed, self.scene.reference.acceleration)
        travel = (SpeedProfile.plan(self.robot, self.reference, limits, self.path) if self.beside
                  else SpeedProfile.fastest(self.robot, limits, self.path))
        self.scene.check_duration(travel.duration)
        return travel

    def steady(self) -> float:
        """The steady speed that the joints allow everywhere, wherever the line lies [m/s]."""
        return min(float(JointDemands.of(self.robot, path, Limits.share).steady().min())
                   for path in (self.path, *self.beside))

    def margin(self) -> float:
        """Least distance of a joint from its limits, wherever the line lies [rad or m]."""
        q = np.vstack([path.q for path in (self.path, *self.beside)])
        return float(np.min(np.minimum(q - self.robot.q_min, self.robot.q_max - q)))


def line_way(scene: LineScene, robot: Robot, points: Array | None = None, surface: pin.SE3 | None = None) -> LineWay:
    """The joint paths of an arm along a scene's line.

    Args:
        scene: where the line is, and how far from there it may lie.
        robot: the arm, with the scene's tool.
        points: of the reference ``(N, 3)`` [m]; the scene's if None.
        surface: motion that takes the assumed surface to where calibration found it; None before calibration.

    Raises:
        InputError: the arm cannot reach the line, or one that the table displacement allows, or would hit something.
    """
    points = reference_points(scene) if points is None else points
    up = scene.surface.pose().rotation[:, 2]
    if surface is not None:
        found = ReferencePath(points @ surface.rotation.T + surface.translation, up=surface.rotation @ up, turning=1.0)
        # With fewer than seven joints a place has one posture near home, wherever the place is.
        if robot.n <= 6:
            return LineWay(scene, robot, found, JointPath.of(robot, found))
        assumed = JointPath.of(robot, ReferencePath(points, up=up, turning=1.0))
        return LineWay(scene, robot, found, _moved(robot, found, assumed))
    reference = ReferencePath(points, up=up, turning=1.0)
    path = JointPath.of(robot, reference)
    check_clear(shapes_about(scene, robot), path)
    return LineWay(scene, robot, reference, path, tuple(_beside(scene, robot, reference, path)))


def _moved(robot: Robot, reference: ReferencePath, path: JointPath) -> JointPath:
    """The joint path of a reference that was moved a little, as near as it can be to the one before.

    More than six joints may take a place in many postures: searched for anew it could be one that leaves the limits
    where this one, which was judged before the run, does not. Raises InputError where it is out of reach.
    """
    s = np.linspace(0.0, reference.length, len(path.s))
    try:
        q = InverseKinematics(robot).refine_rows(reference.rotation(s), reference.frames(s).position, path.q,
                                                 wanted=path.q)
    except OutOfReachError as error:
        raise InputError(f"the path cannot be reached by {robot.name}: {error}", field="path") from error
    return JointPath.through(s, q)


def _beside(scene: LineScene, robot: Robot, reference: ReferencePath, path: JointPath) -> Iterator[JointPath]:
    """Joint paths along the outermost lines that the displacement allows; InputError for one out of reach."""
    away = scene.displacement
    height, tilt = (1e-3 * away.height_mm + SIGMAS * FOUND[0], math.radians(away.tilt_deg) + SIGMAS * FOUND[1])
    side = 1e-3 * away.lateral_mm + 0.5 * reference.length * math.sin(math.radians(away.turn_deg))
    rows = np.unique(np.linspace(0, len(path.s) - 1, min(ROWS, len(path.s))).round().astype(int))
    s, frames, rotations = path.s[rows], reference.frames(path.s[rows]), reference.rotation(path.s[rows])
    plane = scene.surface.pose()
    middle = pin.SE3(plane.rotation, frames.position.mean(axis=0))
    kinematics = InverseKinematics(robot)
    for about_x, about_y, up, across in product((-1.0, 1.0), repeat=4):
        moved = middle * pin.SE3(pin.rpy.rpyToMatrix(about_x * tilt, about_y * tilt, 0.0),
                                 np.array([0.0, 0.0, up * height])) * middle.inverse()
        turned = moved.rotation @ rotations
        places = (frames.position + across * side * frames.normal) @ moved.rotation.T + moved.translation
        try:
            q = kinematics.refine_rows(turned, places, path.q[rows], wanted=path.q[rows])
            _check_axis(kinematics, turned, places, q)
        except OutOfReachError as error:
            raise InputError(f"by the table displacement the line may lie {1e3 * side:.0f} mm beside its reference, "
                             f"its surface {1e3 * height:.0f} mm above or below and tilted by "
                             f"{math.degrees(tilt):.1f}°, and there {error}", field="path") from error
        yield JointPath.through(s, q)


def _check_axis(kinematics: InverseKinematics, rotations: Array, places: Array, q: Array) -> None:
    """Raises ``OutOfReachError`` where fewer than six joints cannot turn the tool axis as far as is wanted."""
    if kinematics.robot.n >= 6:
        return
    for rotation, place, row in zip(rotations, places, q, strict=True):
        pose = kinematics.fk(row)
        aside = float(np.linalg.norm(np.cross(pose.rotation[:, 2], rotation[:, 2])))
        if aside > math.sin(TILTED):
            raise OutOfReachError(place, float(np.linalg.norm(pose.translation - place)))


def check_clear(shapes: Shapes, path: JointPath) -> None:
    """Raises InputError for a path on which the arm would collide; names the place and the obstacle."""
    touch = shapes.first_touch(path.q[::5])
    if touch is not None:
        raise InputError(f"the arm would hit something: {touch} {path.s[5 * touch.row]:.2f} m from the path's begin",
                         field="path")


def shapes_about(scene: LineScene | ForceScene, robot: Robot) -> Shapes:
    """The arm with its obstacles: the surface of a scene's line, ``BORDER`` beyond the line, and boxes."""
    plane = scene.surface.pose()
    drawn = (reference_points(scene) - plane.translation) @ plane.rotation
    low, high = drawn.min(axis=0) - BORDER, drawn.max(axis=0) + BORDER
    middle = plane * pin.SE3(np.eye(3), np.array([*(0.5 * (low + high))[:2], 0.0]))
    return Shapes(robot, middle, (float(high[0] - low[0]), float(high[1] - low[1])), obstacles(scene.box))


def shapes_in(scene: Scene, robot: Robot) -> Shapes:
    """The arm with all obstacles of a scene: boxes, and the surface where there is one."""
    if isinstance(scene, LineScene | ForceScene):
        return shapes_about(scene, robot)
    return Shapes(robot, boxes=obstacles(boxes_of(scene)))


def middle_of_view(camera: CameraModel) -> Array:
    """Where the optical axis meets the plane through the TCP, in the tool frame ``(3,)`` [m]."""
    T, axis = camera.T_tool_camera, camera.T_tool_camera.rotation[:, 2]
    return np.asarray(T.translation - T.translation[2] / axis[2] * axis)


def calibration_postures(robot: Robot, reference: ReferencePath, path: JointPath, camera: CameraModel, at: float,
                         clear: float = 0.0, shapes: Shapes | None = None, line: LineAhead | None = None
                         ) -> list[Array]:
    """Joint angles of the calibration poses that the arm reaches, on a path without collisions.

    Errors of the joints' places displace the tool, by another amount in each configuration, and the calibration takes
    such differences for errors of the camera. So each pose is reached from the posture in which the line is followed,
    without another wrist, elbow or shoulder, and the last joint turns the tool; only an arm that reaches fewer than
    half of them so uses other configurations.

    Args:
        robot: the arm.
        reference, path: the reference path, and the joint path by which it is followed.
        camera: as mounted by hand.
        at: arc length of the reference around which the piece lies [m].
        clear: how far the tip keeps away from the reference at least [m].
        shapes: the arm in its cell; None where it is unknown.
        line: the line's known place there; on the reference if None.

    Raises:
        SceneError: fewer than half of the poses can be reached.
    """
    frames, kinematics = reference.frames(np.array([at])), InverseKinematics(robot)
    followed, up = path.q[np.argmin(np.abs(path.s - at))], frames.up[0]
    place, direction = ((frames.position[0], frames.tangent[0]) if line is None
                        else (line.points[0], line.tangents[0]))
    poses = calibration_poses(place + clear * up, direction, up, float(middle_of_view(camera)[0]))
    ways: tuple[Callable[[pin.SE3, Array], Array], ...] = (
        lambda pose, _: _carried(kinematics, followed, pose), kinematics.search)
    for way in ways:
        postures, q = list[Array](), followed
        for pose in poses:
            try:
                posture = way(pose, q)
            except OutOfReachError:
                continue
            if shapes is None or shapes.touch_between(q, posture) is None:
                postures.append(posture)
                q = posture
        if len(postures) >= len(poses) // 2:
            return postures
    raise SceneError(f"the camera could not be calibrated: the arm reaches only {len(postures)} of {len(poses)} poses; "
                     "move the surface nearer, or set calibration.by_moving = false")


CARRIED = 0.1
"""Between two poses on the way from one posture to another [rad, and as many metres]: Newton's method keeps to one
arrangement of the joints there."""
DRAWN_ALONG = 0.3
"""Share of the way to the posture wanted that more than six joints are drawn with each of them."""


def _carried(kinematics: InverseKinematics, q: Array, pose: pin.SE3) -> Array:
    """Joint angles ``(n,)`` [rad] of a pose in the arrangement of ``q (n,)`` [rad], the last joint turning the tool.

    Raises ``OutOfReachError`` where the way there leaves the reach or the joint limits.
    """
    begin = kinematics.fk(q)
    whole = pin.log6(begin.inverse() * pose)
    wanted, robot = q.copy(), kinematics.robot
    wanted[-1] = np.clip(q[-1] + kinematics.last_axis() @ whole.angular, robot.q_min[-1], robot.q_max[-1])
    steps = max(int(np.ceil(np.linalg.norm(whole.vector) / CARRIED)), 1)
    angles = q
    for share in np.arange(1, steps + 1) / steps:
        # The angles approach the target step by step, as along a path: in one step Newton's method overshoots.
        angles = kinematics.solve(begin * pin.exp6(share * whole), angles,
                                  wanted=angles + DRAWN_ALONG * (q + share * (wanted - q) - angles))
    return angles
