"""What a line-following run needs before anything moves: world, line, reference, camera and its calibration."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np

from ideal_robot.elasticity.deflection import GearDeflection
from ideal_robot.robots.interface import RobotState
from ideal_robot.signals.recording import Recording
from scenes.camera_table import believed_camera, true_camera
from scenes.camera_world import camera_settings
from scenes.drawn_line import Geometry, geometry
from scenes.line.appearance import look_at_line
from scenes.line.bent_surface import bent_surface
from scenes.line.calibration import calibrate_by_moving
from scenes.line.known import Known, line_follower, span_of
from scenes.line.scene import LineScene
from scenes.line.worn_line import drawn_line
from scenes.models import model_for
from scenes.result import Progress, silent
from scenes.scene_error import SceneError
from sensing.camera.camera_model import CameraModel
from sensing.camera.detector import DETECTORS
from sensing.camera.hand_eye import HandEye
from sensing.camera.line_detection import DetectionSettings
from sensing.sensing_error import SensingError
from sim.arm.arm import SimulatedArm
from sim.arm.world import World
from sim.camera.bullet_camera import BulletCamera
from sim.camera.camera import RenderedCamera
from sim.camera.lamp import Lamp
from sim.camera.surface import DrawnLine
from sim.contact.contact import HeightSurface

STRIPS = (0.05, 0.05)
"""Size of the pieces of a bent surface [m]: a bow of 1 mm over 1 m leaves them by 3 µm."""


@dataclass(kw_only=True)
class Cell(Known):
    """Everything of one run that is set up before anything moves: what the follower knows, and the world."""

    world: World
    geometry: Geometry
    line: DrawnLine
    true_camera: CameraModel
    noise: np.random.Generator
    camera_noise: np.random.Generator
    relief: HeightSurface | None = None
    """Heights over the surface's plane where it is bent."""


def set_up(scene: LineScene, hand_eye: HandEye | None = None, camera: CameraModel | None = None) -> Cell:
    """Builds world, camera, reference and follower of a scene.

    Args:
        scene: what to play.
        hand_eye: camera and surface as moving over the line has shown them, if it has: the reference is laid on that
            surface. What it could not tell is left to the follower.
        camera: to be believed in place of the one that was mounted by hand.

    Raises:
        InputError: line out of reach, unreachable speed, a value of the world that makes no sense.
    """
    world = World.from_table(scene.robot, scene.arm_world, scene.source)
    # A controller's cycle times are no secret: they stand in its manual.
    robot = replace(scene.arm, t_ipo=world.t_ipo, t_position=world.t_position,
                    t_velocity=world.t_velocity)
    place, noise, camera_noise, calibration, _, wear, _, bend = streams(scene)
    where = geometry(scene, place)
    line, relief = drawn_line(scene, where, wear), bent_surface(scene, where, bend)
    detector = DETECTORS.get(scene.camera.detector)()
    believed = believed_camera(scene.camera, scene.calibration)
    true = true_camera(believed, scene.calibration, calibration)
    if camera is not None:
        believed = camera
    elif hand_eye is not None:
        believed = hand_eye.camera
    reference, follower = line_follower(scene, robot, where.reference, believed,
                                        None if hand_eye is None else hand_eye.surface)
    return Cell(scene=scene, robot=robot, delay=int(world.correction_delay), world=world, geometry=where, line=line,
                true_camera=true, camera=believed, reference=reference, follower=follower, detector=detector,
                noise=noise, camera_noise=camera_noise, relief=relief)


def streams(scene: LineScene) -> list[np.random.Generator]:
    """Independent random streams, so that changing one effect does not change the draws of another."""
    return [np.random.default_rng(child) for child in np.random.SeedSequence(scene.seed).spawn(8)]


@dataclass(frozen=True)
class Prepared:
    """What runs of the same scene share: rendered surface, the line's looks, and the camera as calibrated by moving."""

    camera: RenderedCamera
    detection: DetectionSettings
    """How the line looks, as its first pictures tell."""
    hand_eye: HandEye | None
    believed: CameraModel | None = None
    """A camera to be believed in place of the one that was mounted by hand."""
    moved: tuple[RobotState, ...] = ()
    """What the controller reported while the camera was calibrated, cycle by cycle."""
    recorded: Recording | None = None
    """What it logged meanwhile, several times a cycle."""
    warning: str = ""
    """Why there are no looks or no calibration although one was wanted; the run then goes on with the usual line, the
    camera as mounted by hand."""


def camera_of(cell: Cell) -> RenderedCamera:
    """The simulated camera of a scene, over its drawn surface and under its lamp."""
    scene, settings = cell.scene, camera_settings(cell.scene.camera)
    lamp = lamp_over(scene, cell.geometry, streams(scene)[6])
    if scene.camera.renderer == "sampled":
        return RenderedCamera(cell.true_camera, cell.line, settings, cell.camera_noise, lamp=lamp)
    return BulletCamera(cell.true_camera, cell.line, settings, cell.camera_noise, tool=True, lamp=lamp,
                        arm=cell.robot if scene.tool_mm else None, relief=cell.relief, strips=STRIPS)


def lamp_over(scene: LineScene, where: Geometry, rng: np.random.Generator) -> Lamp | None:
    """The scene's lamp; None where there is light from everywhere.

    Args:
        scene: its table ``light``.
        where: the line's place.
        rng: draws on which side of the line the lamp stands.
    """
    light = scene.light
    side = rng.uniform(0.0, 2.0 * np.pi)
    if light.falloff == light.shadow == light.glare == 0.0:
        return None
    across = light.aside_m * np.array([np.cos(side), np.sin(side), 0.0])
    place = where.drawn.mean(axis=0) + where.plane.rotation @ (across + np.array([0.0, 0.0, light.height_m]))
    return Lamp(place, 1e-3 * light.radius_mm, light.falloff, light.shadow, light.glare)


@contextmanager
def prepared(scene: LineScene, progress: Progress = silent) -> Iterator[Prepared]:
    """Paints the surface, looks at the line and calibrates the camera, for one or many runs of the scene.

    Raises:
        InputError: the scene cannot be played.
    """
    cell = set_up(scene)
    with camera_of(cell) as camera:
        found = _looked_at(scene, cell, camera, progress)
        # The tables of a long path are not held while those of the play are made.
        del cell
        yield found


def _looked_at(scene: LineScene, cell: Cell, camera: RenderedCamera, progress: Progress) -> Prepared:
    """What looking at the line and moving over it gives."""
    detection, hand_eye, reasons = DetectionSettings(), None, []
    moved: list[RobotState] = []
    recorded: Recording | None = None
    span = span_of(scene, cell.reference)
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
                                               cell.detector, moved)
                recorded = arm.recording()
            except (SceneError, SensingError) as error:
                reasons.append(str(error))
    return Prepared(camera, detection, hand_eye, moved=tuple(moved), recorded=recorded,
                    warning="; ".join(reasons))
