"""What is known of a line scene before anything moves, by whoever follows the line: nothing of the world."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.robots.collisions import Shapes
from ideal_robot.robots.robot import Robot
from planning import OutOfReachError
from planning.line.line_follower import FollowerSettings, LineFollower
from planning.path.kinematics import InverseKinematics
from planning.path.pose_history import PoseHistory
from planning.path.reference import ReferencePath
from planning.path.speed_profile import Limits, SpeedProfile
from scenes.placing import check_way, where_it_fits
from scenes.scene_files.line_scene import LineScene
from scenes.scene_files.scene import SceneError
from sensing.camera.camera_device import Field
from sensing.camera.camera_model import CameraModel
from sensing.camera.detector import LineDetector
from sensing.camera.hand_eye import Observation, calibration_poses
from sensing.camera.line_detection import predicted_by_rows
from sensing.camera.line_search import DetectionSettings, PredictedLine

HORIZON = 0.3
"""Time for which desired positions are handed to the ideal robot, several of its main time constants ([L] 2.2) [s]."""
FOUND = (0.001, 0.0005)
"""What calibration by moving leaves open of the surface's height [m] and slope [rad], standard deviations."""
EDGE = 4
"""Pixels at the edge of a picture in which no line is looked for: half a window, and what the tool sways."""
START = 0.48
"""Time at rest before the path begins, in which the ideal robot takes up the gears' deflection under gravity [s]."""


@dataclass(kw_only=True)
class Known:
    """What a follower of the line is given.

    Attributes:
        scene: the file; of its tables those of the world are not looked at.
        robot: as its data sheet has it, with the controller's cycles.
        delay: cycles between the hand-over of a command and the begin of its interpolation.
        camera: as it is believed: by hand at first, then as calibrated.
        reference: the reference path.
        follower: plans along it.
        detector: finds the line's points in a field.
    """

    scene: LineScene
    robot: Robot
    delay: int
    camera: CameraModel
    reference: ReferencePath
    follower: LineFollower
    detector: LineDetector


def line_follower(scene: LineScene, robot: Robot, points: Array, camera: CameraModel, surface: pin.SE3 | None = None,
                  latency: float = FollowerSettings.latency) -> tuple[ReferencePath, LineFollower]:
    """Reference path and follower of a scene.

    Args:
        scene: speed, limits and what is measured.
        robot: the arm with the controller's cycle.
        points: of the reference ``(N, 3)`` [m].
        camera: as it is believed.
        surface: motion that takes the surface to where calibration saw it: the reference is laid on it. What it could
            not tell, or all of it where there was none, is left to the follower.
        latency: usual age of a field when it arrives [s].

    Raises:
        InputError: line out of reach, unreachable speed, a motion longer than the scene allows.
    """
    up = scene.surface.pose().rotation[:, 2]
    height, tilt = FollowerSettings.height, FollowerSettings.tilt
    if surface is not None:
        points, up = points @ surface.rotation.T + surface.translation, surface.rotation @ up
        height, tilt = FOUND
    reference = ReferencePath(points, up=up, turning=1.0)
    try:
        profile = SpeedProfile.plan(robot, reference, Limits(scene.speed, scene.reference.acceleration))
        if profile.joint_path is not None and surface is None:
            check_way(scene, robot, reference, profile.joint_path)
        scene.check_duration(profile.duration)
        follower = LineFollower(
            robot, reference, profile, round(HORIZON / robot.t_ipo), t_start=START, line_span=span_of(scene, reference),
            eye=camera.T_tool_camera.translation,
            settings=FollowerSettings(measurement=scene.measurement, height=height, tilt=tilt, view=view_of(camera),
                                      max_gap=scene.max_gap, max_search=scene.max_gap + 0.05, latency=latency,
                                      stamp=FollowerSettings.stamp if scene.stamp_estimate else 0.0))
    except OutOfReachError as error:
        raise InputError(f"the line is out of reach: {error}; {where_it_fits(scene)}", field="surface.origin",
                         value=list(scene.surface.origin)) from error
    except InputError as error:
        if error.field != "path":
            raise
        raise InputError(f"{error.message}; {where_it_fits(scene)}", field="surface.origin",
                         value=list(scene.surface.origin)) from error
    return reference, follower


def view_of(camera: CameraModel) -> tuple[float, float]:
    """Nearest and farthest distance ahead of the tool at which this camera shows a line [m], at most the usual ones."""
    ahead = np.linspace(*FollowerSettings.view, 151)
    pixels = camera.project_tool(np.column_stack([ahead, np.zeros((len(ahead), 2))]))
    size = np.array([camera.width, camera.height])
    shown = ahead[np.all((pixels >= EDGE) & (pixels <= size - 1 - EDGE), axis=1)]
    return (float(shown[0]), float(shown[-1])) if len(shown) > 1 else FollowerSettings.view


def span_of(scene: LineScene, reference: ReferencePath) -> tuple[float, float]:
    """Arc lengths of the reference between which the line ought to be [m]."""
    return scene.reference.run_up, reference.length - scene.reference.run_out


# Looking at one piece of the line while the camera moves over it: where to move, what to expect, what was seen.

SPREAD = np.linspace(-0.07, 0.07, 9)
"""Places on the line looked for in each field, around the middle of the view [m]."""
SIGMA, SIGMA_FOUND = 0.006, 0.002
"""How far the line may be from its reference before and after it is first seen, standard deviations [m]."""
PER_SPEED = 1e-3
"""Uncertainty of a moving tool's place: a millisecond's way, standard deviation [m per m/s]."""


class CalibrationView:
    """What is known of arm and line while the camera moves, and what was seen.

    Args:
        robot: the arm.
        reference: the reference path.
        believed: the camera as mounted by hand.
        detection: how the line looks.
        detector: what finds its points.
        q: where the arm rests at first ``(n,)`` [rad].

    Attributes:
        history: where the tool was.
        observations: what was seen.
    """

    def __init__(self, robot: Robot, reference: ReferencePath, believed: CameraModel, detection: DetectionSettings,
                 detector: LineDetector, q: Array) -> None:
        self.reference, self.believed, self.detection, self.detector = reference, believed, detection, detector
        self.history = PoseHistory(robot)
        self.history.add(0.0, q)
        self.observations: list[Observation] = []
        self._aside, self._sigma = 0.0, SIGMA
        self._table = np.arange(0.0, reference.length, 0.005)
        self._places = reference.position(self._table)

    def predicted(self, t: float) -> PredictedLine:
        """The line around the middle of the view at ``t`` [s], as far aside of the reference as it was first seen."""
        pose = self.history.pose(t)
        look = pose.act(_middle_of_view(self.believed))
        s = self._table[np.argmin(np.sum((self._places - look) ** 2, axis=1))]
        frames = self.reference.frames(s + SPREAD)
        points = frames.position + self._aside * frames.normal
        there = PredictedLine.from_base(points, frames.tangent, frames.up.mean(axis=0), pose, self._sigma)
        return predicted_by_rows(there, self.believed, t, self.history.row_pose)

    def look(self, field: Field, prediction: PredictedLine, ahead: float) -> None:
        """Notes the line points of a field.

        Args:
            field: as it arrived.
            prediction: where the line should be in it.
            ahead: by how much the stamps run ahead of the arm's time [s].
        """
        found = self.detector.detect(field, self.believed, prediction, self.detection)
        if not found.seen:
            return
        if self._sigma > SIGMA_FOUND:
            self._aside, self._sigma = self._aside + float(np.mean(found.lateral[found.used])), SIGMA_FOUND
        t = field.t_stamp - ahead
        velocity, angular = self.history.velocity(t)
        sigma = np.hypot(found.sigma[found.used], PER_SPEED * np.linalg.norm(velocity))
        self.observations.append(
            Observation(self.history.pose(t), found.pixels[found.used], sigma, velocity, angular))


def _middle_of_view(camera: CameraModel) -> Array:
    """Where the optical axis meets the plane through the TCP, in the tool frame ``(3,)`` [m]."""
    T = camera.T_tool_camera
    axis = T.rotation[:, 2]
    return np.asarray(T.translation - T.translation[2] / axis[2] * axis)


def calibration_postures(robot: Robot, reference: ReferencePath, camera: CameraModel, at: float, clear: float = 0.0,
                         shapes: Shapes | None = None) -> list[Array]:
    """Joint angles of the poses that the arm reaches, each near the one before and on a way that touches nothing.

    Args:
        robot: the arm.
        reference: the reference path.
        camera: as mounted by hand.
        at: arc length of the reference around which the piece lies [m].
        clear: how far the tip keeps away from the reference at least [m].
        shapes: the arm in its cell; None where nothing is known of it.

    Raises:
        SceneError: fewer than half of the poses can be reached.
    """
    frames = reference.frames(np.array([at]))
    kinematics = InverseKinematics(robot)
    q = kinematics.search(reference.pose(at), robot.home)
    centre = frames.position[0] + clear * frames.up[0]
    wanted = calibration_poses(centre, frames.tangent[0], frames.up[0], float(_middle_of_view(camera)[0]))
    postures: list[Array] = []
    for pose in wanted:
        try:
            found = kinematics.search(pose, q)
        except OutOfReachError:
            continue
        if shapes is None or shapes.touch_between(q, found) is None:
            postures.append(found)
            q = found
    if len(postures) < len(wanted) // 2:
        raise SceneError(f"the camera could not be calibrated: the arm reaches only {len(postures)} of {len(wanted)} "
                         "poses; move the surface nearer, or set calibration.by_moving = false")
    return postures
