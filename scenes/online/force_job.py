"""Following a surface by force on devices: the planning of ``scenes.force`` with sensors that are elsewhere."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.elasticity.observer import GearDeflection
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from planning.force.contact import EmergencyStopError, Phase
from planning.path.kinematics import InverseKinematics
from planning.planning_error import OutOfReachError, PlanningError
from scenes.methods import SceneMethod
from scenes.online.camera_process import CalibratedCamera
from scenes.online.cycle import Task
from scenes.online.force_task import START_HEIGHT, ForceLog, ForceTask, GlueCamera, Known, force_reference
from scenes.online.line_job import Piece, calibrated_by_moving
from scenes.online.live_arm import LiveArm, moves
from scenes.online.live_sensors import FoundBefore, ImaginedCamera, ImaginedForce, LiveCamera, LiveForce, rehearse
from scenes.scene_files.drawn_line import reference_points
from scenes.scene_files.force_scene import CameraTrouble, ForceScene
from scenes.scene_files.scene import SceneError
from sensing.camera.camera_model import CameraModel
from sensing.camera.line_search import DetectionSettings, PredictedLine
from sensing.force.force_calibration import ContactElasticity, ToolLoad, identify_elasticity, identify_tool

# The force sensor's tool and the contact are calibrated by moving the real arm ([L] 4.4).

LIFT = 0.15
"""How far away from the surface the tool is turned [m]."""
TURNS = ((0.0, 0.0), (0.0, 0.4), (0.0, -0.4), (0.5, 0.3), (1.0, 0.5), (-0.5, 0.4), (-1.0, -0.3))
"""Turns of the joints before the last two [rad]."""
REST, USED = 0.6, 0.35
"""Rest in each posture, and the end of it that counts [s]."""
_FAST, _SLOW, _JERKY = 0.03, 0.01, 0.5
"""Speeds of the approach and of pressing [m/s], and their change [m/s²]."""
_FELT = 3.0
"""Force from which on it is pressed slowly [N]."""
_LONGEST = 12.0
_MARGIN = 0.05
"""Distance from the joints' limits that turned postures keep [rad]."""


def tool_by_turning(known: Known, start: Array, arm: LiveArm, force: LiveForce) -> ToolLoad:
    """Bias and weight of the tool, turned in the air.

    Args:
        known: what is known of the scene.
        start: where the arm is, and is again afterwards ``(n,)`` [rad].
        arm: connected.
        force: what it feels.

    Raises:
        SceneError: no readings, or the arm cannot be turned there.
    """
    robot, T = known.robot, known.robot.t_ipo
    up = known.reference.frames(np.zeros(1)).up[0]
    fk = robot.fk()
    here = fk(start)
    try:
        lifted = InverseKinematics(robot).search(pin.SE3(here.rotation, here.translation + LIFT * up), start)
    except OutOfReachError as error:
        raise SceneError(f"the tool cannot be lifted to be turned: {error}") from error
    postures = []
    for turn, bend in TURNS:
        q = lifted.copy()
        q[-3] += turn
        q[-2] += bend
        if ((q > robot.q_min + _MARGIN) & (q < robot.q_max - _MARGIN)).all():
            postures.append(q)
    wrenches, rotations = [], []
    arm.begin()
    force.begin()
    last = start
    for q in postures:
        arm.lead(moves(robot, [last, q], REST))
        felt = [sample.wrench for sample in force.arrived(arm.t) if sample.t > arm.t - USED]
        if len(felt) < 5:
            raise SceneError(f"the force sensor is silent: {force.why_silent()}")
        wrenches.append(np.mean(felt, axis=0))
        rotations.append(fk(q).rotation)
        last = q
    arm.lead(moves(robot, [last, lifted, start], 2 * T))
    return identify_tool(np.array(wrenches), rotations)


def elasticity_by_pressing(known: Known, start: Array, arm: LiveArm, force: LiveForce, tool: ToolLoad
                           ) -> ContactElasticity:
    """E by moving: the tip is pressed slowly into the surface at the start of the path and drawn back.

    Args:
        known: what is known of the scene.
        start: where the arm is, and is again afterwards ``(n,)`` [rad].
        arm: connected.
        force: what it feels.
        tool: bias and weight.

    Raises:
        SceneError: nothing is felt, or too much.
    """
    robot, T = known.robot, known.robot.t_ipo
    kinematics, deflection = InverseKinematics(robot), GearDeflection(known.model, T)
    frames = known.reference.frames(np.zeros(1))
    up, origin, rotation = frames.up[0], frames.position[0], known.reference.rotation(0.0)
    limit, wanted = known.scene.emergency.force, known.scene.force
    q, height, speed, target = start.copy(), START_HEIGHT, 0.0, -_FAST
    times, places, stamps, forces = [], [], [], []
    arm.begin()
    force.begin()
    for _ in range(int(_LONGEST / T)):
        arm.check(arm.t)
        speed += float(np.clip(target - speed, -_JERKY * T, _JERKY * T))
        height += speed * T
        if height >= START_HEIGHT and target > 0:
            break
        q = kinematics.refine([pin.SE3(rotation, origin + height * up)], q[None])[0]
        arm.q_d = q
        state = arm.cycle(q)
        times.append(arm.t)
        places.append(kinematics.fk(state.q - deflection.at(np.tile(q, (3, 1)))).translation - origin)
        for sample in force.arrived(arm.t):
            stamps.append(sample.t)
            forces.append(rotation @ tool.contact(sample.wrench, rotation)[:3])
        recent = float(np.mean(forces[-5:], axis=0) @ up) if forces else 0.0
        if force.silent(arm.t) > 0.3 or not abs(recent) < limit:
            raise SceneError(f"pressing was stopped: {recent:.1f} N felt of {limit:.0f} N allowed; sensor: "
                             f"{force.why_silent()}")
        if target < 0 and recent > _FELT:
            target = -_SLOW
        if target < 0 and recent > 1.6 * wanted:
            target = _SLOW
        if target > 0 and recent < 1.0:
            target = _FAST
    arm.lead(moves(robot, [q, start], 2 * T))
    felt, way = np.array(forces), np.array(places)
    pressed = felt @ up > 0.5 * wanted if len(felt) else np.zeros(0, dtype=bool)
    if not pressed.any():
        raise SceneError(f"pressed {1e3 * (START_HEIGHT - float((way @ up).min())):.0f} mm down and "
                         "felt no surface; look whether it is where it should be")
    # The surface need not be square to the nominal normal: its own is where the force points.
    normal = felt[pressed].mean(axis=0)
    normal = normal / np.linalg.norm(normal)
    return identify_elasticity(np.interp(stamps, times, way @ normal), felt @ normal)


BRAKING = 2.0
"""Deceleration of a stop on the path [m/s²]."""
CLEAR = 0.03
"""Distance from the surface's nominal place that the tip keeps while the camera is calibrated [m]."""
LONGEST = 60.0
"""A run that has not ended so long after its travel is stuck [s]."""
SILENCE = 0.1
"""Time without a sound reading of the force sensor after which the arm is stopped [s]."""
_GUESS = ContactElasticity(4000.0, 1000.0, 0.0, 0.0)
_NO_LOAD = ToolLoad(np.zeros(6), 0.0, np.zeros(3), np.zeros(2))


class LiveForceTask(ForceTask):
    """``ForceTask`` with devices that may fall silent and an arm that may have to be stopped."""

    arm: LiveArm | None = None
    force: LiveForce | None = None

    def plan(self, t: float, q_d: Array) -> Array:
        """See ``scenes.online.cycle.Task``."""
        if self.arm is not None:
            self.arm.check(t)
        q_d = super().plan(t, q_d)
        if self.force is not None and self.force.silent(t) > SILENCE + (0.2 if t < 0.5 else 0.0):
            raise EmergencyStopError("force", t, f"no sound reading of the force sensor for "
                                     f"{1e3 * self.force.silent(t):.0f} ms: {self.force.why_silent()}")
        return q_d

    def command(self, t: float, q_d: Array) -> Array:
        """See ``scenes.online.cycle.Task``."""
        if self.arm is not None:
            self.arm.q_d = q_d[0]
        return super().command(t, q_d)


class ForceJob:
    """A surface, a contour, or a line on a surface; a ``scenes.online.devices.Job``.

    Args:
        scene: what is followed; of its tables those of the world are not looked at.
        robot: with the controller's cycle.
        model: of the arm.
        method: how what is sensed becomes commands.
        delay: cycles of the controller's own delay.
        answers_within: time in which the arm's loop answers a command [s].
        calibration: of the camera of a ``glue`` scene.
    """

    braking = BRAKING

    def __init__(self, scene: ForceScene, robot: Robot, model: Model, method: SceneMethod, delay: int,
                 answers_within: float, calibration: CalibratedCamera) -> None:
        # What happens to the simulated camera is the world's.
        self.scene = scene.model_copy(update={"trouble": CameraTrouble()})
        self.robot, self.model, self.method, self.answers_within = robot, model, method, answers_within
        self.calibration = calibration
        reference, profile = force_reference(scene, robot, reference_points(scene))
        self._known = Known(scene=self.scene, robot=robot, delay=delay, model=model, reference=reference,
                            profile=profile, camera=calibration.camera)
        self.expected = profile.duration + 4.0
        self.longest = self.expected + LONGEST
        self._task = self._new_task()
        self.log: ForceLog = self._task.log
        self.detection = (self._task.vision.detection if self._task.vision is not None else DetectionSettings())
        self._force: LiveForce | None = None

    @property
    def camera(self) -> CameraModel | None:
        """See ``Job``."""
        return self.calibration.camera if self.scene.task == "glue" else None

    @property
    def q_start(self) -> Array:
        """See ``Job``."""
        return self._task.q_start

    def needs(self) -> tuple[str, ...]:
        """See ``Job``."""
        return ("force", "camera") if self.scene.task == "glue" else ("force",)

    def rehearse(self) -> None:
        """See ``Job``: the touch-down and a piece of the travel, felt at once."""
        task, camera, force = self._new_task(), ImaginedCamera(), ImaginedForce()
        task.connect(force, camera if task.vision is not None else None)
        vision = task.vision
        if vision is not None:
            camera.predict = lambda t: _predicted(vision, t)
        T = self.robot.t_ipo
        try:
            rehearse(task, self.robot, math.ceil(0.2 / T))
            force.wrench = np.array([0.0, 0.0, -self.scene.force, 0.0, 0.0, 0.0])
            rehearse(task, self.robot, math.ceil(1.5 / T), first=math.ceil(0.2 / T))
        except PlanningError:
            # What is felt fits no surface: that is no matter here, the code is loaded.
            return

    def calibrate(self, arm: LiveArm, camera: LiveCamera) -> CalibratedCamera:
        """See ``Job``; the tip keeps away from the surface. Where that lies the force tells later.

        Args:
            arm: connected, at the start.
            camera: on the arm.
        """
        reference = self._known.reference
        piece = Piece(reference, 0.5 * (self.scene.reference.run_up + reference.length - self.scene.reference.run_out),
                      self.q_start, CLEAR)
        return self.calibration.found(
            calibrated_by_moving(piece, self.calibration.camera, self.model, arm, camera))

    def ready(self, arm: LiveArm, camera: LiveCamera | None, force: LiveForce | None) -> Task:
        """See ``Job``: bias and weight of the tool by turning it, the elasticity by pressing.

        Args:
            arm: connected, at the start.
            camera: on the arm.
            force: on the arm.
        """
        if force is None:
            raise SceneError("following a surface needs a force sensor")
        tool = tool_by_turning(self._known, self.q_start, arm, force)
        elasticity = elasticity_by_pressing(self._known, self.q_start, arm, force, tool)
        task = self._task
        task.calibrated(tool, elasticity)
        task.connect(force, camera)
        task.arm, task.force, self._force = arm, force, force
        if camera is not None and task.vision is not None:
            vision = task.vision
            camera.use(self.calibration.camera, self.calibration.time_offset)
            camera.predict = lambda t: _predicted(vision, t)
        force.begin()
        return task

    def columns(self, t: Array) -> dict[str, Array]:
        """See ``Job``: the wrench as sensed and the felt normal force."""
        columns: dict[str, Array] = {}
        if self.log.samples:
            felt = np.array(self.log.samples)
            order = np.argsort(felt[:, 0])
            columns["f_normal"] = np.interp(t, felt[order, 0], felt[order, 1])
        if self._force is not None and self._force.samples:
            sensed = np.array(self._force.samples)
            times, sensed = sensed[:, 0], sensed[:, 1:]
            order = np.argsort(times)
            for i, name in enumerate(("fx", "fy", "fz", "mx", "my", "mz")):
                columns[name] = np.interp(t, times[order], sensed[order, i])
        return columns

    def planned(self) -> Array:
        """See ``Job``."""
        first = [float(np.atleast_1d(row)[0]) for row in self.log.planned]
        count = min(len(self.log.t), len(first))
        return np.column_stack([self.log.t[:count], first[:count]])

    def figures(self) -> dict[str, Any]:
        """See ``Job``."""
        log, wanted = self.log, self.scene.force
        moving = [t for t, phase in zip(log.t, log.phase, strict=False) if phase == Phase.TRAVEL.value]
        felt = np.array([force for t, force, _ in log.samples if moving and moving[0] <= t <= moving[-1]])
        figures: dict[str, Any] = {"force_N": {
            "wanted": wanted, "rms_error": float(np.sqrt(np.mean((felt - wanted) ** 2))) if len(felt) else float("nan"),
            "largest": float(max((force for _, force, _ in log.samples), default=float("nan")))},
            "elasticity_N_m": self._task.elasticity.stiffness, "tool_mass_kg": self._task.tool.mass}
        if self._task.vision is not None:
            fields = self._task.vision.fields
            figures["fields"] = {"seen": len(fields), "used": sum(1 for one in fields if one[1] > 0)}
        return figures

    def _new_task(self) -> LiveForceTask:
        task = LiveForceTask(self._known, self.method, None, _NO_LOAD, _GUESS, np.random.default_rng(0))
        if task.vision is not None:
            task.vision.detector = FoundBefore()
        return task


def _predicted(vision: GlueCamera, t: float) -> PredictedLine:
    """Where the line should be in a picture taken at ``t`` [s], in the tool frame."""
    return vision.sight.predict(t).seen_by(vision.camera, t, vision.follower.history.row_pose)
