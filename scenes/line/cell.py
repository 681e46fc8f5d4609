"""Sets up a line scene before the run: world, line, reference, camera and its calibration."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array, arc_lengths
from ideal_robot.elasticity.observer import GearDeflection
from ideal_robot.errors import InputError, found_in
from ideal_robot.robots.interface import RobotState
from ideal_robot.signals.recording import Recording
from scenes.camera_calibration import calibrate_by_moving, look_at_line
from scenes.models import model_for
from scenes.online.line_known import KnownLine, SeenBefore, line_follower, looked_again, span_of
from scenes.result import Progress, silent
from scenes.scene_files.drawn_line import Geometry, believed_camera, geometry, true_camera
from scenes.scene_files.line_scene import LineScene, Wear
from scenes.scene_files.scene import SceneError
from sensing import SensingError
from sensing.camera.camera_model import CameraModel
from sensing.camera.detector import DETECTORS
from sensing.camera.hand_eye import HandEye
from sensing.camera.line_detection import DetectionSettings
from sim.arm.arm import SimulatedArm
from sim.arm.world import World
from sim.camera.bullet_camera import BulletCamera
from sim.camera.camera import RenderedCamera
from sim.camera.image_chain import CameraSettings
from sim.camera.lamp import Lamp
from sim.camera.surface import DrawnLine
from sim.camera.surface import Feature as DrawnFeature
from sim.contact.contact import HeightSurface, Wave

WAVES = (0.37, 0.23, 0.11)
"""Wavelengths over which width and ink of a line drawn by hand change [m]."""


def _drawn_line(scene: LineScene, where: Geometry, rng: np.random.Generator) -> DrawnLine:
    """The line with the scene's features and what the seed draws of its wear."""
    look, wear = scene.line, scene.wear
    s = arc_lengths(where.drawn)
    wide, pale = _smooth(s, rng), 0.5 * (1.0 + _smooth(s, rng))
    widths = 1e-3 * look.width_mm * (1.0 + 0.01 * wear.width_percent * wide)
    grays = look.gray + 0.01 * wear.fade_percent * pale * (look.background - look.gray)
    worn = wear.width_percent > 0 or wear.fade_percent > 0
    return DrawnLine(where.drawn, where.plane, width=1e-3 * look.width_mm, gray=look.gray, background=look.background,
                     edge=1e-3 * look.edge_mm,
                     features=(*_features(scene, float(s[-1])), *_worn(wear, float(s[-1]), rng)),
                     widths=widths if worn else None, grays=grays if worn else None,
                     grain=None if wear.grain == "none" else wear.grain, grain_seed=scene.seed)


def _features(scene: LineScene, length: float) -> tuple[DrawnFeature, ...]:
    for i, f in enumerate(scene.feature):
        if f.at_mm > 1e3 * length:
            raise InputError(f"lies beyond the line; expected 0 to its length, {1e3 * length:.0f} mm",
                             file=scene.source, field=f"feature.{i}.at_mm", value=f.at_mm)
    return tuple(
        DrawnFeature(kind=f.kind, at=1e-3 * f.at_mm, length=1e-3 * f.length_mm, offset=1e-3 * f.offset_mm,
                     angle=float(np.radians(f.angle_deg)), width=1e-3 * f.width_mm, gray=f.gray)
        for f in scene.feature)


def _worn(wear: Wear, length: float, rng: np.random.Generator) -> list[DrawnFeature]:
    """Gaps, strokes and light, anywhere on the line; each kind has draws of its own."""
    gaps, scratches, crossings, glares, shades = rng.spawn(5)

    def place(draws: np.random.Generator) -> float:
        return float(length * draws.uniform(0.1, 0.95))

    features = [DrawnFeature("gap", place(gaps), length=1e-3 * wear.gap_mm * gaps.uniform(0.5, 1.0))
                for _ in range(wear.gaps)]
    features += [DrawnFeature("scratch", place(scratches), length=scratches.uniform(0.05, 0.15), width=0.0015,
                              angle=scratches.uniform(0.2, 1.2), offset=scratches.uniform(-0.005, 0.005))
                 for _ in range(wear.scratches)]
    features += [DrawnFeature("crossing", place(crossings), length=0.2, angle=crossings.uniform(0.8, 2.3))
                 for _ in range(wear.crossings)]
    features += [DrawnFeature("glare", place(glares), length=glares.uniform(0.08, 0.16),
                              offset=glares.uniform(-0.02, 0.02)) for _ in range(wear.glares)]
    return features + [DrawnFeature("shade", place(shades), length=shades.uniform(0.15, 0.25),
                                    offset=shades.uniform(-0.03, 0.03)) for _ in range(wear.shades)]


def _smooth(s: Array, rng: np.random.Generator) -> Array:
    """A smooth random course between -1 and 1 over arc lengths ``(N,)`` [m]."""
    phases = rng.uniform(0.0, 2.0 * np.pi, len(WAVES))
    return np.mean([np.sin(2.0 * np.pi * s / wave + phase) for wave, phase in zip(WAVES, phases, strict=True)], axis=0)


def bent_surface(scene: LineScene, where: Geometry, rng: np.random.Generator) -> HeightSurface | None:
    """A surface curved by half a sine over the line's longest extent, zero at its ends; None for a flat surface.

    Args:
        scene: its table ``displacement``.
        where: the line's place.
        rng: draws whether the middle is up or down.

    Raises:
        InputError: a curved surface with a camera that renders planes only.
    """
    bow = 1e-3 * scene.displacement.bow_mm
    up = rng.choice([-1.0, 1.0])
    if bow == 0.0:
        return None
    if scene.camera.renderer == "sampled":
        raise InputError("only camera.renderer = 'bullet' shows a bent surface", field="displacement.bow_mm",
                         value=scene.displacement.bow_mm)
    middle = where.drawn_xy.mean(axis=0)
    along = np.linalg.svd(where.drawn_xy - middle, full_matrices=False)[2][0]
    places = where.drawn_xy @ along
    start, span = float(places.min()), float(np.ptp(places))
    wave = Wave(float(up) * bow, 2.0 * span, float(np.arctan2(along[1], along[0])), -np.pi * start / span)
    return HeightSurface(where.plane, (wave,))


STRIPS = (0.05, 0.05)
"""Size of the pieces of a bent surface [m]: a bow of 1 mm over 1 m leaves them by 3 µm."""


@dataclass(kw_only=True)
class Cell:
    """All objects of one run, as set up before the motion.

    The follower is given ``known`` alone; the rest is the world.
    """

    known: KnownLine
    world: World
    geometry: Geometry
    line: DrawnLine
    true_camera: CameraModel
    noise: np.random.Generator
    camera_noise: np.random.Generator
    relief: HeightSurface | None = None
    """Heights over the surface's plane where it is bent."""


def set_up(scene: LineScene, hand_eye: HandEye | None = None, camera: CameraModel | None = None,
           shape: tuple[float, float] | None = None) -> Cell:
    """Builds world, camera, reference and follower of a scene.

    Args:
        scene: the scene.
        hand_eye: camera and surface from the calibration by moving, if there was one: the reference is moved onto that
            surface; the follower estimates the rest.
        camera: to be believed in place of the one that was mounted by hand.
        shape: deviation of the line's shape from its reference's, estimated from pictures.

    Raises:
        InputError: line out of reach, unreachable speed, a value of the world that makes no sense.
    """
    world = World.from_table(scene.robot, scene.arm_world, scene.source)
    robot = world.with_cycles(scene.arm)
    place, noise, camera_noise, calibration, _, wear, _, bend = streams(scene)
    where = geometry(scene, place)
    line, relief = _drawn_line(scene, where, wear), bent_surface(scene, where, bend)
    detector = DETECTORS.get(scene.camera.detector)()
    believed = believed_camera(scene.camera, scene.calibration)
    true = true_camera(believed, scene.calibration, calibration)
    if camera is not None:
        believed = camera
    elif hand_eye is not None:
        believed = hand_eye.camera
    with found_in(scene.source):
        reference, follower = line_follower(scene, robot, where.reference, believed,
                                            None if hand_eye is None else hand_eye.surface, shape=shape)
    known = KnownLine(scene=scene, robot=robot, delay=int(world.correction_delay), camera=believed, reference=reference,
                  follower=follower, detector=detector)
    return Cell(known=known, world=world, geometry=where, line=line, true_camera=true, noise=noise,
                camera_noise=camera_noise, relief=relief)


def streams(scene: LineScene) -> list[np.random.Generator]:
    """Independent random streams, so that changing one effect does not change the draws of another."""
    return [np.random.default_rng(child) for child in np.random.SeedSequence(scene.seed).spawn(8)]


@dataclass(frozen=True)
class Prepared:
    """Data that runs of the same scene share: rendered surface, line appearance, and camera calibration."""

    camera: RenderedCamera
    detection: DetectionSettings
    """How the line looks, as its first pictures tell."""
    hand_eye: HandEye | None
    shape: tuple[float, float] | None = None
    """How far the line's shape leaves its reference's, as these pictures tell."""
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
    scene, settings = cell.known.scene, CameraSettings.of(cell.known.scene.camera)
    lamp = lamp_over(scene, cell.geometry, streams(scene)[6])
    if scene.camera.renderer == "sampled":
        return RenderedCamera(cell.true_camera, cell.line, settings, cell.camera_noise, lamp=lamp)
    return BulletCamera(cell.true_camera, cell.line, settings, cell.camera_noise, tool=True, lamp=lamp,
                        arm=cell.known.robot if scene.tool_mm else None, relief=cell.relief, strips=STRIPS)


def lamp_over(scene: LineScene, where: Geometry, rng: np.random.Generator) -> Lamp | None:
    """The scene's lamp; None where light is uniform.

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
    """Paints the surface, finds the line's appearance and calibrates the camera, for runs of the scene.

    Raises:
        InputError: the scene cannot be run.
    """
    cell = set_up(scene)
    with camera_of(cell) as camera:
        shared = _looked_at(scene, cell, camera, progress)
        # The tables of a long path are freed before those of the run are made.
        del cell
        yield shared


def _looked_at(scene: LineScene, cell: Cell, camera: RenderedCamera, progress: Progress) -> Prepared:
    """What looking at the line and moving over it gives."""
    before, hand_eye, reasons = SeenBefore(), None, []
    moved: list[RobotState] = []
    recorded: Recording | None = None
    known = cell.known
    span = span_of(scene, known.reference)
    model = model_for(scene, known.robot, progress) if scene.calibration.by_moving else None
    with SimulatedArm(known.robot, cell.world, cell.noise, known.follower.q_start) as arm:
        try:
            before = look_at_line(known, arm, camera, span, streams(scene)[4])
        except SensingError as error:
            reasons.append(str(error))
        if model is not None:
            progress(0.0, "calibrating the camera")
            try:
                hand_eye = calibrate_by_moving(known, arm, camera, GearDeflection(model, cell.world.t_ipo),
                                               0.5 * sum(span), before, moved)
                recorded = arm.recording()
            except (SceneError, SensingError) as error:
                reasons.append(str(error))
    shape = before.shape if hand_eye is None else looked_again(known, hand_eye.camera, before, span)
    return Prepared(camera, before.detection, hand_eye, shape, moved=tuple(moved),
                    recorded=recorded, warning="; ".join([*reasons, *filter(None, [before.too_far()])]))


class LineWorld:
    """The true world of a run, for simulated sensors only."""

    def __init__(self, arm: SimulatedArm, line: DrawnLine) -> None:
        self._arm, self._line = arm, line

    def tool(self, t: float) -> pin.SE3:
        """True pose of the tool in the base frame at ``t`` [s], which has to lie in the past."""
        return self._arm.tcp_at(max(t, 0.0))

    def distance(self, t: float, at: Sequence[float] | Array = (0.0, 0.0, 0.0)) -> float:
        """How far the line is to the left of a point, in the surface [m]; NaN before its begin and behind its end.

        Args:
            t: time [s].
            at: the point in the tool frame ``(3,)`` [m].
        """
        pose = self.tool(t)
        place = pose.rotation @ np.asarray(at, dtype=float) + pose.translation
        plane = self._line.plane
        up = plane.rotation[:, 2]
        nearest = self._line.nearest((place - up * (up @ (place - plane.translation)))[None])
        beside = 1e-6 < nearest.s[0] < self._line.length - 1e-6
        return -float(nearest.lateral[0]) if beside else float("nan")
