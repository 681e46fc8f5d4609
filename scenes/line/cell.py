"""What a line-following run needs before anything moves: world, line, reference, camera and its calibration."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np

from ideal_robot.elasticity.deflection import GearDeflection
from ideal_robot.errors import InputError
from ideal_robot.robots.robot import Robot
from planning.line.line_follower import FollowerSettings, LineFollower
from planning.path.reference import ReferencePath
from planning.path.speed_profile import Limits, SpeedProfile
from planning.planning_error import OutOfReachError
from scenes.camera_table import believed_camera, camera_settings, true_camera
from scenes.drawn_line import Geometry, geometry
from scenes.line.appearance import look_at_line
from scenes.line.calibration import calibrate_by_moving
from scenes.line.scene import LineScene
from scenes.models import model_for
from scenes.result import Progress, silent
from scenes.scene_error import SceneError
from sensing.camera.camera_model import CameraModel
from sensing.camera.detector import DETECTORS, LineDetector
from sensing.camera.hand_eye import HandEye
from sensing.camera.line_detection import DetectionSettings
from sensing.sensing_error import SensingError
from sim.arm.arm import SimulatedArm
from sim.arm.world import World
from sim.camera.camera import RenderedCamera
from sim.camera.surface import DrawnLine
from sim.camera.surface import Feature as DrawnFeature

HORIZON = 0.3
"""Time for which desired positions are handed to the ideal robot, several of its main time constants ([L] 2.2) [s]."""
START = 0.48
"""Time at rest before the path begins, in which the ideal robot takes up the gears' deflection under gravity [s]."""


@dataclass
class Cell:
    """Everything of one run that is set up before anything moves."""

    scene: LineScene
    robot: Robot
    world: World
    geometry: Geometry
    line: DrawnLine
    true_camera: CameraModel
    camera: CameraModel
    """As it is believed: by hand at first, then as calibrated."""
    reference: ReferencePath
    follower: LineFollower
    detector: LineDetector
    noise: np.random.Generator
    camera_noise: np.random.Generator


def set_up(scene: LineScene) -> Cell:
    """Builds world, camera, reference and follower of a scene.

    Raises:
        InputError: line out of reach, unreachable speed, a value of the world that makes no sense.
    """
    world = World.from_table(scene.robot, scene.world)
    # A controller's cycle times are no secret: they stand in its manual.
    robot = replace(Robot.load(scene.robot), t_ipo=world.t_ipo, t_position=world.t_position,
                    t_velocity=world.t_velocity)
    place, noise, camera_noise, calibration, _ = streams(scene)
    where = geometry(scene, place)
    line = DrawnLine(where.drawn, where.plane, width=1e-3 * scene.line.width_mm, gray=scene.line.gray,
                     background=scene.line.background, edge=1e-3 * scene.line.edge_mm, features=_features(scene))
    detector = DETECTORS.get(scene.camera.detector)()
    believed = believed_camera(scene.camera)
    true = true_camera(believed, scene.calibration, calibration)
    reference = ReferencePath(where.reference, up=scene.surface.pose().rotation[:, 2], turning=1.0)
    try:
        profile = SpeedProfile.plan(robot, reference, Limits(scene.speed, scene.reference.acceleration))
        begin = scene.reference.run_up
        follower = LineFollower(
            robot, reference, profile, round(HORIZON / robot.t_ipo), t_start=START,
            line_span=(begin, reference.length - scene.reference.run_out),
            settings=FollowerSettings(measurement=scene.measurement, max_blind=scene.max_gap,
                                      max_search=scene.max_gap + 0.05,
                                      stamp=FollowerSettings.stamp if scene.stamp_estimate else 0.0))
    except OutOfReachError as error:
        raise InputError(f"the line is out of reach: {error}", field="surface.origin",
                         value=list(scene.surface.origin)) from error
    return Cell(scene, robot, world, where, line, true, believed, reference, follower, detector, noise,
                camera_noise)


def streams(scene: LineScene) -> list[np.random.Generator]:
    """Independent random streams, so that changing one effect does not change the draws of another."""
    return [np.random.default_rng(child) for child in np.random.SeedSequence(scene.seed).spawn(5)]


def _features(scene: LineScene) -> tuple[DrawnFeature, ...]:
    return tuple(
        DrawnFeature(kind=f.kind, at=1e-3 * f.at_mm, length=1e-3 * f.length_mm, offset=1e-3 * f.offset_mm,
                     angle=float(np.radians(f.angle_deg)), width=1e-3 * f.width_mm, gray=f.gray)
        for f in scene.feature)


@dataclass(frozen=True)
class Prepared:
    """What runs of the same scene share: rendered surface, the line's looks, and the camera as calibrated by moving."""

    camera: RenderedCamera
    detection: DetectionSettings
    """How the line looks, as its first pictures tell."""
    hand_eye: HandEye | None
    warning: str = ""
    """Why there are no looks or no calibration although one was wanted; the run then goes on with the usual line, the
    camera as mounted by hand."""


@contextmanager
def prepared(scene: LineScene, progress: Progress = silent) -> Iterator[Prepared]:
    """Paints the surface, looks at the line and calibrates the camera, for one or many runs of the scene.

    Raises:
        InputError: the scene cannot be played.
    """
    cell = set_up(scene)
    with RenderedCamera(cell.true_camera, cell.line, camera_settings(scene.camera), cell.camera_noise) as camera:
        detection, hand_eye, reasons = DetectionSettings(), None, []
        span = (scene.reference.run_up, cell.reference.length - scene.reference.run_out)
        model = model_for(scene, cell.robot, progress) if scene.calibration.by_moving else None
        with SimulatedArm(cell.robot, cell.world, cell.noise, cell.follower.q_start) as arm:
            try:
                detection = look_at_line(cell.robot, cell.reference, cell.camera, arm, camera, span, streams(scene)[4])
            except SensingError as error:
                reasons.append(str(error))
            if model is not None:
                progress(0.0, "calibrating the camera")
                try:
                    hand_eye = calibrate_by_moving(cell.robot, cell.reference, cell.camera, arm, camera,
                                                   GearDeflection(model, cell.world.t_ipo), 0.5 * sum(span), detection,
                                                   cell.detector)
                except (SceneError, SensingError) as error:
                    reasons.append(str(error))
        yield Prepared(camera, detection, hand_eye, "; ".join(reasons))
