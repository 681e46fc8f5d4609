"""Sets up a force scene before the run: arm, surface, reference, and the calibrations by moving."""

from __future__ import annotations

import math
from contextlib import closing
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.elasticity.observer import GearDeflection
from ideal_robot.errors import found_in
from ideal_robot.feedforward.friction_at_work import FrictionAtWork, friction_at_work
from ideal_robot.loop.from_model import loop_model
from ideal_robot.row_log import let_go, new_array
from planning import OutOfReachError
from planning.force.contact import dry_run
from planning.path.reference import ReferencePath
from scenes.arms import arm_of
from scenes.camera_calibration import calibrate_by_moving, look_at_line
from scenes.metrics import ControlError
from scenes.models import model_for
from scenes.online.force_calibration import Pressed
from scenes.online.force_known import START_HEIGHT, KnownSurface, force_reference
from scenes.online.log import SETTLING
from scenes.scene_files.drawn_line import Geometry, believed_camera, geometry, true_camera
from scenes.scene_files.force_scene import ForceScene, TipTable, UnknownSurface
from sensing.camera.camera_model import CameraModel
from sensing.camera.detector import DETECTORS
from sensing.camera.hand_eye import HandEye
from sensing.camera.line_search import DetectionSettings
from sensing.force.force_calibration import ContactElasticity, ToolLoad, identify_tool
from sim.arm.arm import SimulatedArm
from sim.arm.world import World
from sim.camera.bullet_camera import BulletCamera
from sim.camera.image_chain import CameraSettings
from sim.camera.surface import AT_A_TIME, DrawnLine
from sim.contact.contact import ForceSensor, ForceSensorSettings, HeightSurface, Tip, TipContact, Wave


def true_surface(table: UnknownSurface) -> HeightSurface:
    """The surface that the follower does not know."""
    waves = tuple(Wave(1e-3 * w.amplitude_mm, 1e-3 * w.wavelength_mm, math.radians(w.heading_deg),
                       math.radians(w.phase_deg)) for w in table.wave)
    return HeightSurface(table.pose(), waves, table.curvature, 1e-3 * table.crest_mm, 1e-3 * table.offset_mm,
                         table.slope)


def true_tip(table: TipTable) -> Tip:
    """The tool's elastic tip."""
    return Tip(table.stiffness, table.damping, table.friction)


@dataclass(kw_only=True)
class Cell:
    """All objects of one run, as set up before the motion.

    The follower is given ``known`` alone; the rest is the world.
    """

    known: KnownSurface
    world: World
    surface: HeightSurface
    geometry: Geometry
    sensor: ForceSensor
    noise: np.random.Generator
    camera_streams: tuple[np.random.Generator, np.random.Generator]


def scene_curves(scene: ForceScene) -> dict[str, Array]:
    """Reference path and the true surface above the line ``(N, 3)`` [m], for the viewer."""
    where = geometry(scene, _streams(scene)[0])
    surface = true_surface(scene.surface)
    on_plane = (where.drawn - where.plane.translation) @ where.plane.rotation
    return {"line": surface.points(on_plane[:, :2]), "reference": where.reference}


def _streams(scene: ForceScene) -> list[np.random.Generator]:
    """Independent random streams: place, arm, force sensor, camera, calibration, pictures before the run."""
    return [np.random.default_rng(child) for child in np.random.SeedSequence(scene.seed).spawn(6)]


def set_up(scene: ForceScene, seen: tuple[HandEye, DetectionSettings] | None = None) -> Cell:
    """Builds world, surface and follower of a force scene.

    Args:
        scene: the scene.
        seen: camera and line appearance from the calibration by moving; those of the scene if None.

    Raises:
        InputError: path out of reach, unreachable speed, a value that makes no sense.
    """
    world = World.from_table(scene.robot, scene.arm_world, scene.source)
    robot = world.with_cycles(arm_of(scene.robot))
    place, noise, sensor_noise, camera_noise, calibration, _ = _streams(scene)
    camera, detection = (
        (believed_camera(scene.camera, scene.calibration), scene.line.detection) if seen is None
        else (seen[0].camera, seen[1]))
    where = geometry(scene, place)
    with found_in(scene.source):
        reference, profile = force_reference(scene, robot, where.reference)
    surface = true_surface(scene.surface)
    known = KnownSurface(scene=scene, robot=robot, delay=int(world.correction_delay), model=model_for(scene, robot),
                  reference=reference, profile=profile, camera=camera, detection=detection,
                  detector=DETECTORS.get(scene.camera.detector)(), start_height=_placed(surface, reference))
    return Cell(known=known, world=world, surface=surface, geometry=where,
                sensor=ForceSensor(ForceSensorSettings(**scene.sensor.model_dump()), sensor_noise), noise=noise,
                camera_streams=(camera_noise, calibration))


def _placed(surface: HeightSurface, reference: ReferencePath) -> float:
    """Height of the tip above the reference at which a person places the arm [m].

    It is the told one, unless the surface lies so high that less than half of it is left: that is seen.
    """
    frames = reference.frames(np.zeros(1))
    start, out = (surface.plane.rotation.T @ v for v in (frames.position[0] - surface.plane.translation, frames.up[0]))
    higher = float(surface.height(start[0], start[1]) - start[2]) / float(out[2])
    return max(START_HEIGHT, higher + 0.5 * START_HEIGHT)


def calibrate_tool(cell: Cell) -> ToolLoad:
    """Bias and weight of the tool from the sensor in seven orientations, the arm resting in the air."""
    wrenches, rotations = [], []
    fk = cell.known.robot.fk()
    for turn, bend in ((0.0, 0.0), (0.0, 0.6), (0.0, -0.6), (0.8, 0.3), (1.6, 0.6), (-0.8, 0.4), (-1.6, -0.4)):
        q = cell.known.robot.home.copy()
        q[-3] += turn
        q[-2] += bend
        with SimulatedArm(cell.known.robot, cell.world, cell.noise, q) as arm:
            pose = arm.truth.tcp
        samples = [cell.sensor.sample(0.0, pose, np.zeros(3)).wrench for _ in range(100)]
        wrenches.append(np.mean(samples, axis=0))
        rotations.append(fk(q).rotation)
    return identify_tool(np.array(wrenches), rotations)


def calibrate_elasticity(cell: Cell, tool: ToolLoad) -> ContactElasticity:
    """The elasticity E: the tip is pressed slowly into the surface at the path's start and retracted ([L] 4.4)."""
    follower = cell.known.follower(elasticity=1e6)
    pressed = Pressed(cell.known, tool, follower.q_start)
    T, speed = cell.world.t_ipo, -0.03
    with SimulatedArm(cell.known.robot, cell.world, cell.noise, follower.q_start) as arm:
        contact = TipContact(arm, cell.surface, true_tip(cell.known.scene.tip))
        for k in range(int(6.0 / T)):
            state = arm.cycle(pressed.go(speed * T))
            pressed.hear(state, cell.sensor.due(k * T, (k + 1) * T, arm.tcp_at, contact.force_at))
            recent = float(pressed.recent() @ pressed.up)
            if speed < 0 and recent > 3.0:
                speed = -0.01
            if speed < 0 and recent > 1.6 * cell.known.scene.force:
                speed = 0.01
            if speed > 0 and recent < 1.0:
                break
    return pressed.elasticity()


class Prepared:
    """Calibration results that all runs of a scene share: tool, contact, camera and friction.

    Each is computed when it is first used. Later disturbances of the sensor are not part of it.

    Args:
        scene: the scene.
    """

    def __init__(self, scene: ForceScene) -> None:
        self._scene = scene.model_copy(update={"sensor": scene.sensor.model_copy(update={"drift": ()})})

    @cached_property
    def contact(self) -> tuple[ToolLoad, ContactElasticity]:
        """Tool and contact from the calibration, see ``calibrated``."""
        return calibrated(self._scene)

    @cached_property
    def camera(self) -> tuple[HandEye, DetectionSettings] | None:
        """Camera and line appearance from the calibration, see ``camera_shown``."""
        return camera_shown(self._scene)

    @cached_property
    def friction(self) -> FrictionAtWork | None:
        """Friction from the dry run, see ``friction_shown``."""
        return friction_shown(self._scene)


def calibrated(scene: ForceScene) -> tuple[ToolLoad, ContactElasticity]:
    """Tool and contact from calibrations by moving in this scene."""
    cell = set_up(scene)
    tool = calibrate_tool(cell)
    return tool, calibrate_elasticity(cell, tool)


def friction_shown(scene: ForceScene) -> FrictionAtWork | None:
    """Friction as estimated from a dry run above the path.

    None where the path is not known beforehand or cannot be reached above the surface, and where a camera looks at a
    line as well: there the dry run did not improve the force.
    """
    if scene.task != "surface":
        return None
    cell = set_up(scene)
    try:
        q_d = dry_run(cell.known.robot, cell.known.reference, cell.known.profile.top_speed, cell.known.q_start())
    except OutOfReachError:
        return None
    with SimulatedArm(cell.known.robot, cell.world, cell.noise, q_d[0]) as arm:
        for q in q_d:
            arm.cycle(q)
        recording = arm.recording()
    return friction_at_work(recording, loop_model(cell.known.model, cell.known.robot, delay=cell.known.delay))


def camera_shown(scene: ForceScene) -> tuple[HandEye, DetectionSettings] | None:
    """Camera calibration and line appearance from moving over the line.

    None where there is no camera, or its nominal mounting is used.

    Raises:
        SceneError: the arm reaches too few of the poses, or too few of them show the line.
        SensingError: no picture shows it.
    """
    if scene.task != "glue" or not scene.calibration.by_moving:
        return None
    cell = set_up(scene)
    known = cell.known
    span = (scene.reference.run_up, known.reference.length - scene.reference.run_out)
    with (closing(GlueWorld(cell)) as world,
          SimulatedArm(known.robot, cell.world, cell.noise, known.q_start()) as arm):
        before = look_at_line(known, arm, world.rendered, span, _streams(scene)[5])
        hand_eye = calibrate_by_moving(known, arm, world.rendered, GearDeflection(known.model, cell.world.t_ipo),
                                       0.5 * sum(span), before)
    return hand_eye, before.detection


def glue_line(cell: Cell) -> tuple[DrawnLine, CameraModel]:
    """The line that is drawn on the curved surface, and the true camera."""
    scene, where = cell.known.scene, cell.geometry
    line = DrawnLine(where.drawn, where.plane, width=1e-3 * scene.line.width_mm, gray=scene.line.gray,
                     background=scene.line.background, edge=1e-3 * scene.line.edge_mm)
    return line, true_camera(believed_camera(scene.camera), scene.calibration, cell.camera_streams[1])


class GlueWorld:
    """Renders the line on the curved surface of a scene, and measures true errors against it."""

    def __init__(self, cell: Cell) -> None:
        self.line, true = glue_line(cell)
        self._surface = cell.surface
        self.rendered = BulletCamera(true, self.line, CameraSettings.of(cell.known.scene.camera),
                                     cell.camera_streams[0], relief=cell.surface)

    def close(self) -> None:
        """Frees the renderer."""
        self.rendered.close()

    def control_error(self, first_used: float, t: Array, tip: Array) -> ControlError:
        """Distance of the true tip from the drawn line, seen along the plane's normal, while it is followed.

        Args:
            first_used: when a field of the camera was used first [s]; NaN if never.
            t: instants during the travel ``(N,)`` [s].
            tip: true positions of the tip at them, in the surface's coordinates ``(N, 3)`` [m].
        """
        surface, positions = self._surface.plane, new_array(len(tip), 3)
        for first in range(0, len(tip), AT_A_TIME):
            part = slice(first, first + AT_A_TIME)
            positions[part] = tip[part] @ surface.rotation.T + surface.translation
            let_go(tip, positions)
        s, beside = self.line.beside(positions)
        return ControlError.of(t, s, beside, (s > 1e-6) & (s < self.line.length - 1e-6) & (t >= first_used + SETTLING))
