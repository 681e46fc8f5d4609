"""What a force scene needs before anything moves: arm, surface, reference, and the two calibrations by moving."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.elasticity.deflection import GearDeflection
from ideal_robot.errors import InputError
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from planning.force.contact import FORCE_ERRORS, ContactSettings
from planning.force.contour import ContourFollower, ContourSettings
from planning.force.force_follower import SurfaceFollower
from planning.line.fusion import DeviationFilter
from planning.path.kinematics import InverseKinematics
from planning.path.reference import ReferencePath
from planning.path.speed_profile import Limits, SpeedProfile
from planning.planning_error import OutOfReachError
from scenes.drawn_line import Geometry, geometry
from scenes.force.scene import ForceScene
from scenes.models import model_for
from sensing.force.force_calibration import ContactElasticity, ToolLoad, identify_elasticity, identify_tool
from sim.arm.arm import SimulatedArm
from sim.arm.world import World
from sim.contact.contact import HeightSurface, TipContact
from sim.contact.force_sensor import ForceSensor

N_D = 20
"""Desired positions handed to the ideal robot [cycles]."""
POSITION_NOISE = 3e-5
"""Standard deviation of the estimated tip position [m]."""
DOWN = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])
"""Orientation of a tool that points down."""
START_HEIGHT = 0.01
"""Of the tip above the reference when the approach begins [m]."""


@dataclass
class Cell:
    """Everything of one run that is set up before anything moves."""

    scene: ForceScene
    robot: Robot
    world: World
    model: Model
    surface: HeightSurface
    geometry: Geometry
    reference: ReferencePath
    profile: SpeedProfile
    sensor: ForceSensor
    noise: np.random.Generator
    camera_streams: tuple[np.random.Generator, np.random.Generator]

    def follower(self, elasticity: float, fusion: DeviationFilter | None = None) -> SurfaceFollower:
        """A fresh follower that assumes this elasticity [N/m]; with ``fusion``, a camera shows the line, too."""
        settings = ContactSettings(force=self.scene.force, elasticity=elasticity, position_noise=POSITION_NOISE)
        estimated = self.scene.assumed.elasticity_estimated
        return SurfaceFollower(self.robot, self.reference, self.profile, N_D, settings, fusion=fusion,
                               lateral=fusion is not None, start_height=START_HEIGHT,
                               force_errors=FORCE_ERRORS if estimated else (1e-6, FORCE_ERRORS[1]))

    def contour_follower(self, elasticity: float) -> ContourFollower:
        """A fresh follower of a contour: of the reference it knows the starting point alone."""
        scene, frames = self.scene, self.reference.frames(np.zeros(1))
        out, up = frames.up[0], np.array([0.0, 0.0, 1.0])
        start = pin.SE3(self.reference.rotation(0.0), frames.position[0] + START_HEIGHT * out)
        side = 1 if float(np.cross(up, -out) @ frames.tangent[0]) > 0 else -1
        q_start = InverseKinematics(self.robot).search(start, self.robot.home)
        settings = ContourSettings(force=scene.force, elasticity=elasticity, speed=scene.speed,
                                   length=float(scene.line.length or 0.5))
        return ContourFollower(self.robot, start, -out, up, side, q_start, N_D, settings)


def scene_curves(scene: ForceScene) -> dict[str, Array]:
    """Reference path and the true surface above the line ``(N, 3)`` [m], for the viewer."""
    where = geometry(scene, _streams(scene)[0])
    surface = scene.surface.truth()
    on_plane = (where.drawn - where.plane.translation) @ where.plane.rotation
    return {"line": surface.points(on_plane[:, :2]), "reference": where.reference}


def _streams(scene: ForceScene) -> list[np.random.Generator]:
    """Independent random streams: place, arm, force sensor, camera, calibration."""
    return [np.random.default_rng(child) for child in np.random.SeedSequence(scene.seed).spawn(5)]


def set_up(scene: ForceScene) -> Cell:
    """Builds a scene.

    Raises:
        InputError: path out of reach, unreachable speed, a value that makes no sense.
    """
    robot = Robot.load(scene.robot)
    world = World.from_table(scene.robot, scene.world)
    place, noise, sensor_noise, camera_noise, calibration = _streams(scene)
    where = geometry(scene, place)
    out = where.plane.rotation[:, 2]
    if scene.task == "contour":
        # Pressed sideways, the tool keeps its orientation: straight down.
        reference = ReferencePath(where.reference, up=out, rotation=DOWN)
    else:
        reference = ReferencePath(where.reference, up=out, turning=1.0)
    try:
        profile = SpeedProfile.plan(robot, reference, Limits(scene.speed, scene.reference.acceleration, jerk=40.0))
    except OutOfReachError as error:
        raise InputError(f"the path is out of reach: {error}", field="surface.origin",
                         value=list(scene.surface.origin)) from error
    return Cell(scene, robot, world, model_for(scene, robot), scene.surface.truth(), where, reference, profile,
                ForceSensor(scene.sensor.truth(), sensor_noise), noise, (camera_noise, calibration))


def calibrate_tool(cell: Cell) -> ToolLoad:
    """Bias and weight of the tool from the sensor in seven orientations, the arm resting in the air."""
    home = cell.robot.home
    wrenches, rotations = [], []
    fk = cell.robot.fk()
    for turn, bend in ((0.0, 0.0), (0.0, 0.6), (0.0, -0.6), (0.8, 0.3), (1.6, 0.6), (-0.8, 0.4), (-1.6, -0.4)):
        q = home.copy()
        q[-3] += turn
        q[-2] += bend
        with SimulatedArm(cell.robot, cell.world, cell.noise, q) as arm:
            pose = arm.truth.tcp
        samples = [cell.sensor.sample(0.0, pose, np.zeros(3)).wrench for _ in range(100)]
        wrenches.append(np.mean(samples, axis=0))
        rotations.append(fk(q).rotation)
    return identify_tool(np.array(wrenches), rotations)


def calibrate_elasticity(cell: Cell, tool: ToolLoad) -> ContactElasticity:
    """E by moving: the tip is pressed slowly into the surface at the start of the path and drawn back ([L] 4.4)."""
    follower = cell.follower(elasticity=1e6)
    kinematics = InverseKinematics(cell.robot)
    deflection = GearDeflection(cell.model, cell.world.t_ipo)
    frames = cell.reference.frames(np.zeros(1))
    up, start, rotation = frames.up[0], frames.position[0], cell.reference.rotation(0.0)
    T, q = cell.world.t_ipo, follower.q_start
    height, speed = START_HEIGHT, -0.03
    stamps, forces, times, places = [], [], [], []
    with SimulatedArm(cell.robot, cell.world, cell.noise, q) as arm:
        contact = TipContact(arm, cell.surface, cell.scene.tip.truth())
        state = None
        for k in range(int(6.0 / T)):
            height += speed * T
            q = kinematics.refine([pin.SE3(rotation, start + height * up)], q[None])[0]
            state = arm.cycle(q)
            q_a = state.q - deflection.at(np.tile(q, (3, 1)))
            times.append(state.t)
            places.append(kinematics.fk(q_a).translation - start)
            for sample in cell.sensor.due(k * T, (k + 1) * T, arm.tcp_at, contact.force_at):
                stamps.append(sample.t)
                forces.append(rotation @ tool.contact(sample.wrench, rotation)[:3])
            recent = float(np.mean(forces[-5:], axis=0) @ up) if forces else 0.0
            if speed < 0 and recent > 3.0:
                speed = -0.01
            if speed < 0 and recent > 1.6 * cell.scene.force:
                speed = 0.01
            if speed > 0 and recent < 1.0:
                break
    felt, way = np.array(forces), np.array(places)
    # The surface need not be square to the nominal normal: its own is where the force points.
    normal = felt[felt @ up > 0.5 * cell.scene.force].mean(axis=0)
    normal = normal / np.linalg.norm(normal)
    return identify_elasticity(np.interp(stamps, times, way @ normal), felt @ normal)


@lru_cache(maxsize=64)
def calibrations(key: str) -> tuple[ToolLoad, ContactElasticity]:
    """Both calibrations of a scene, once for all methods; ``key`` is the scene as JSON."""
    scene = ForceScene.model_validate_json(key)
    cell = set_up(scene)
    tool = calibrate_tool(cell)
    return tool, calibrate_elasticity(cell, tool)
