"""What keeping a force along a path does in each interpolation cycle: [L] Fig. 1 with a force sensor."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects.force import ForceErrors
from ideal_robot.elasticity.observer import ArmObserver
from ideal_robot.errors import RaisedBy
from ideal_robot.feedforward.corrected_arm import CorrectedArm
from ideal_robot.feedforward.friction_at_work import FrictionAtWork
from ideal_robot.feedforward.method import Setting
from ideal_robot.robots.interface import RobotState
from ideal_robot.row_log import RowLog
from planning.force.contact import CLEAR, Phase, StopConditions, Tare, most_force
from planning.force.contour import SPARE, ContourFollower
from planning.force.force_follower import DirectForceFeedback, Errors, SurfaceFollower
from planning.force.line_on_surface import LineOnSurface, SightSettings
from planning.force.surface_forecast import FeltArm, surfaces
from planning.line.deviation_model import Expected, PathDeviation
from planning.line.filter_bank import FilterBank
from planning.line.fusion import DeviationFilter
from planning.line.measurement import Fused
from planning.path.desired_path import planned_cycles
from planning.path.kinematics import InverseKinematics
from scenes.methods import DIRECT, SceneMethod
from scenes.online.cycle import CycleLog
from scenes.online.force_known import Known
from sensing.camera.camera_device import Camera, Field, Window
from sensing.camera.line_detection import LineField, at_middle_row
from sensing.camera.line_search import PredictedLine, search_windows
from sensing.force.force_calibration import ContactElasticity, ToolLoad
from sensing.force.sensors import ForceSensor, WrenchSample

# The camera of a ``glue`` scene: fields of the drawn line on the curved surface, and what can go wrong with them.

KNOWN = 1e-6
"""Standard deviation of a relative error that is not estimated."""


def glue_fusion(cell: Known) -> Callable[[Errors], FilterBank]:
    """One filter for both sensors: a map across the path, the height along it, and the sensors' own errors."""
    sight = SightSettings()
    camera = (sight.yaw, sight.stamp, sight.scale if cell.scene.assumed.distance_estimated else KNOWN)
    ahead = planned_cycles(cell.n_d, cell.robot.t_ipo, SPARE) * cell.robot.t_ipo * cell.profile.top_speed + 0.2

    def across() -> PathDeviation:
        return PathDeviation(cell.reference, across=Expected(shape=0.01), ahead=ahead, behind=0.04, knot=0.02)

    def made(errors: Errors) -> FilterBank:
        biases = {"camera": camera, "force": errors}
        return FilterBank([DeviationFilter(model, biases=biases) for model in surfaces(across)])

    return made


class GlueCamera:
    """The camera in the loop of a ``glue`` scene.

    Args:
        cell: what is known of the scene.
        follower: whose map the fields go into.
        rng: of the pictures; from it comes what garbage shows, where the scene has such trouble.

    Attributes:
        detect: finds the line's points in a field, in the tool frame.
    """

    def __init__(self, cell: Known, follower: SurfaceFollower, rng: np.random.Generator) -> None:
        scene = cell.scene
        # A stream of its own: garbage leaves the noise of the pictures as it is.
        self._rng, self.follower, self._trouble = rng.spawn(1)[0], follower, scene.trouble
        self.camera, self.detection = cell.camera, cell.detection
        reference = cell.reference
        span = (scene.reference.run_up, reference.length - scene.reference.run_out)
        sight = SightSettings(distance_ratio=scene.assumed.distance_ratio)
        self.sight = LineOnSurface(follower, self.camera.T_tool_camera, sight, span)
        self._detector = cell.detector
        self.detect: Callable[[Field], LineField] = self._detected
        self.fields: list[tuple[float, int, str]] = []
        self.first_used = float("nan")

    def windows(self, exposure: float) -> Sequence[Window] | None:
        """The windows to read out of the field exposed at ``exposure`` [s]; None while nothing arrives."""
        if self._during(self._trouble.loss, exposure):
            return None
        return search_windows(self.camera, self.predicted(exposure), self.detection)

    def predicted(self, t: float) -> PredictedLine:
        """Where the line should be in a picture taken at ``t`` [s], in the tool frame."""
        return self.sight.predict(t).seen_by(self.camera, t, self.follower.history.row_pose)

    def sense(self, t: float, arrived: Sequence[Field]) -> None:
        """Evaluates the fields that have arrived by ``t`` [s] and fuses them."""
        for item in arrived:
            detected = at_middle_row(self.detect(item), self.camera, self.follower.history.row_pose)
            if self._during(self._trouble.garbage, item.t_stamp):
                detected = self._garbage(detected)
            fused = self.sight.update(detected)
            dof = 0 if fused is None else fused.dof
            if dof and not np.isfinite(self.first_used):
                self.first_used = t
            self.fields.append((item.t_stamp, dof, detected.reason if fused is None else fused.reason))

    def _detected(self, item: Field) -> LineField:
        """Line points of a field, in the tool frame."""
        return self._detector.detect(item, self.camera, self.predicted(item.t_stamp), self.detection)

    def _during(self, span: tuple[float, ...], t: float) -> bool:
        """Whether ``t`` lies in a span that counts from the beginning of the travel."""
        start = self.follower.t_travel
        return bool(span) and start + span[0] <= t < start + span[1]

    def _garbage(self, seen: LineField) -> LineField:
        """Another field than the camera took: points anywhere beside the line, each claiming to be good."""
        size = 1e-3 * self._trouble.garbage_mm
        beside = size * self._rng.uniform(-1, 1) + 0.2 * size * self._rng.standard_normal(len(seen.points_tcp))
        points = seen.points_tcp.copy()
        points[:, 1] += beside
        return replace(seen, points_tcp=points)


# What is written down while a contact is followed.

@dataclass
class ForceLog(CycleLog):
    """What is written down while a scene is played.

    Attributes:
        phase, s, planned: of the follower in each cycle: phase, arc length [m], planned deviation [m].
        samples: of each cycle with samples: time of the newest [s], normal force [N], innovation squared for each, how
            many they were.
        wrenches: of all samples of the force sensor the time [s] and the wrench [N, N m].
        fields: for ``glue``: time stamp [s], values used, why not all.
    """

    phase: list[str] = field(default_factory=list)
    s: RowLog = field(default_factory=RowLog)
    planned: RowLog = field(default_factory=RowLog)
    samples: RowLog = field(default_factory=RowLog)
    wrenches: RowLog = field(default_factory=RowLog)
    fields: list[tuple[float, int, str]] = field(default_factory=list)

    @property
    def travel(self) -> list[float]:
        """When the cycles of the travel began [s]."""
        return [t for t, phase in zip(self.t, self.phase, strict=False) if phase == Phase.TRAVEL.value]

    def add(self, t: float, follower: SurfaceFollower | ContourFollower) -> None:
        """One cycle that begins at ``t`` [s]."""
        self.phase.append(follower.phase.value)
        self.s.append(follower.s_at(t))
        self.planned.append(follower.planned())


BRAKING = 2.0
"""Deceleration of a stop on the path [m/s²]."""
LONGEST = 60.0
"""A run that has not ended so long after its travel is stuck [s]."""
GATHERED = 0.01
"""Time for which samples are gathered before they are fused [s]: three samples at 250 Hz take no longer than one."""


class ForceTask:
    """Pressing and moving with one method; a ``scenes.online.cycle.Task``.

    Args:
        cell: what is known of the scene.
        method: how ``q_d`` becomes ``q_c``.
        gains: K_p [m/N per cycle], K_d [m/N] of direct feedback.
        tool: bias and weight, from calibration.
        elasticity: of tip and surface, from calibration.
        rng: draws what a camera in trouble shows.
        friction: as the dry run has shown it; the model's if None.
    """

    def __init__(self, cell: Known, method: SceneMethod, gains: tuple[float, float] | None, tool: ToolLoad,
                 elasticity: ContactElasticity, rng: np.random.Generator,
                 friction: FrictionAtWork | None = None) -> None:
        known = ForceErrors.of(cell.model.effects if method.knows_model else ())
        tool = replace(tool, bias=tool.bias + known.wrench)
        self.cell, self.method, self.tool, self.elasticity, self.n_d = cell, method, tool, elasticity, cell.n_d
        self.assumed_stiffness = assumed = known.stiffness(cell.scene.assumed.elasticity_ratio * elasticity.stiffness)
        self.vision: GlueCamera | None = None
        self._direct: DirectForceFeedback | None = None
        self.follower: SurfaceFollower | ContourFollower
        if cell.scene.task == "contour":
            self.follower = cell.contour_follower(assumed)
        else:
            glue = cell.scene.task == "glue"
            self.follower = self._surface = cell.follower(assumed, glue_fusion(cell) if glue else None)
            self.vision = GlueCamera(cell, self._surface, rng) if glue else None
            if method.key == DIRECT and gains is not None:
                self._direct = DirectForceFeedback(self._surface, *gains)
        self._stop = StopConditions(cell.robot, cell.scene.emergency.limits())
        self._tare = Tare()
        model = cell.model if method.knows_model else None
        self.feedforward = method.following(Setting(cell.robot, model, self.n_d, cell.delay, friction=friction))
        # Where the gears are not known, commands and motor angles share the same error: q_a ≈ q.
        self._geometry = CorrectedArm(cell.robot, () if model is None else model.effects)
        self._kinematics = InverseKinematics(cell.robot)
        self._arm = None if model is None else FeltArm(ArmObserver(model, cell.robot.t_ipo), self.q_start,
                                                       self._kinematics.torque)
        self._state = self.feedforward.init(self.q_start)
        self._lets_go = False
        self.log = ForceLog()
        self._torque = np.zeros((self.n_d, cell.robot.n))
        self._sensor: ForceSensor
        self._felt: list[tuple[Array, Array]] = []
        self._fused_at = -np.inf
        self._camera: Camera | None = None

    @property
    def steps(self) -> int:
        """Cycles of the controller from the last motor angles but one to the last."""
        return 1

    def connect(self, sensor: ForceSensor, camera: Camera | None) -> None:
        """Connects the devices: the force sensor, and the camera of a scene that has one."""
        self._sensor, self._camera = sensor, camera

    def calibrated(self, tool: ToolLoad, elasticity: ContactElasticity) -> None:
        """Takes what a calibration has found meanwhile.

        The model's ``ForceErrors`` are not added: turning the tool shows the sensor's bias as it is, and pressing all
        that gives under the force. They would count twice.
        """
        self.tool, self.elasticity = tool, elasticity
        self.assumed_stiffness = self.cell.scene.assumed.elasticity_ratio * elasticity.stiffness
        self.follower.press_as(self.assumed_stiffness)

    @property
    def q_start(self) -> Array:
        """Where the arm rests at first ``(n,)`` [rad]."""
        return self.follower.q_start

    def observe(self, t: float, q: Array, q_d: Array) -> None:
        """See ``Task.observe``."""
        arm = q if self._arm is None else self._geometry.as_drawn(self._arm.step(t, q, self._torque[0], self.steps))
        self.follower.observe(t, arm)

    def away(self, q_d: Array) -> Array | None:
        """See ``Task.away``: whatever it is stopped for the tip lets go of the surface; at a contour's end, too."""
        if self._lifted:
            return None
        self._lets_go = True
        distance = CLEAR + most_force(self.cell.scene.force) / self.assumed_stiffness
        return self._kinematics.away(q_d[0], distance * self.follower.normal)

    @property
    def _lifted(self) -> bool:
        """Whether the tip is off the surface at the end of its path; none is at that of a contour."""
        if self._direct is not None:
            return self._direct.lifted >= self._surface.settings.lift
        return isinstance(self.follower, SurfaceFollower) and self.follower.phase is Phase.DONE

    def plan(self, t: float, q_d: Array) -> Array:
        """Desired joint positions over the horizon ``(n_d, n)``."""
        self._sense(t)
        self.fuse(t)
        self._check(t)
        # Direct feedback goes its own way between touch-down and lift: no need to plan.
        if self._direct is not None and self.follower.phase is not Phase.APPROACH:
            self._surface.advance(t)
            return q_d
        q_d = self._horizon(t)
        self._stop.command(t, q_d)
        return q_d

    def _horizon(self, t: float) -> Array:
        """The horizon ``(n_d, n)`` [rad] from ``t`` [s] on."""
        return self.follower.horizon(t)

    def fuse(self, t: float) -> None:
        """Fuses the forces and the fields that have arrived by ``t`` [s]."""
        self.fuse_forces(t)
        self.fuse_fields(t)

    def fuse_fields(self, t: float) -> bool:
        """Fuses the fields that have arrived by ``t`` [s]; whether there was anything to fuse."""
        fields = self._fields(t)
        if self.vision is not None:
            self.vision.sense(t, fields)
        return bool(fields)

    def _fields(self, t: float) -> Sequence[Field]:
        """What the camera has delivered by ``t`` [s]."""
        return [] if self.vision is None or self._camera is None else self._camera.arrived(t)

    def command(self, t: float, q_d: Array) -> Array:
        """Commanded joint positions ``(n,)``."""
        self._torque = np.zeros_like(q_d) if self._lets_go else self.follower.contact_torque(q_d)
        if self._direct is not None:
            return self._direct.command(t, q_d)
        n_d = self.feedforward.n_d
        with RaisedBy(f"method {self.method.key}: step"):
            q_c, self._state = self.feedforward.step(self._state, q_d[:n_d], self._torque[:n_d])
        return q_c

    def request(self, t0: float, t1: float) -> None:
        """Asks the camera for windows where the line should be."""
        self.log.add(t0, self.follower)
        if self.vision is not None and self._camera is not None:
            self._camera.request(t0, t1, self.vision.windows)

    def collect(self, t0: float, t1: float, measured: RobotState) -> None:
        """See ``Task.collect``: a feedforward that adapts learns from the cycle."""
        with RaisedBy(f"method {self.method.key}: observe"):
            self._state = self.feedforward.observe(self._state, measured)

    def speed(self, t: float) -> float:
        """Path speed [m/s]; at least a tenth, so that a stop at rest takes some time, too."""
        return max(self.follower.speed_at(t), 0.1)

    def done(self, t: float) -> bool:
        """Whether the path has ended."""
        return self.follower.phase is Phase.DONE or self._lifted

    def _sense(self, t: float) -> None:
        if arrived := self._sensor.arrived(t):
            self._felt.append(self._contact(t, arrived))

    def fuse_forces(self, t: float) -> bool:
        """Fuses the forces that were gathered by ``t`` [s]; whether there was anything to fuse."""
        if not self._felt or (self._direct is None and t - self._fused_at < GATHERED):
            return False
        self._fused_at = t
        t_felt, contact = (np.concatenate(part) for part in zip(*self._felt, strict=True))
        self._felt = []
        history = self.follower.history
        if self._arm is not None:
            force = np.array([history.pose(max(at, history.first)).rotation @ f
                              for at, f in zip(t_felt, contact, strict=True)])
            for at, q_a in self._arm.feel(t_felt, force):
                history.revise(at, self._geometry.as_drawn(q_a))
        self._fuse_felt(t_felt, contact)
        return True

    def _fuse_felt(self, t_felt: Array, contact: Array) -> None:
        """Fuses contact forces ``(m, 3)`` [N, tool frame] of instants ``(m,)`` [s]."""
        self._fused(t_felt, self.follower.update_force(t_felt, contact))

    def _fused(self, t_felt: Array, fused: Fused | None) -> None:
        """Writes down what became of the forces of instants ``(m,)`` [s]."""
        nis = float("nan") if fused is None or not fused.dof else fused.nis / fused.dof
        self.log.samples.append((float(t_felt[-1]), self.follower.force, nis, len(t_felt)))
        if self._direct is not None:
            self._direct.update(self.follower.force)

    def _contact(self, t: float, arrived: Sequence[WrenchSample]) -> tuple[Array, Array]:
        """Instants ``(m,)`` [s] and contact forces ``(m, 3)`` [N, tool frame] of samples; ends on a force too large."""
        history = self.follower.history
        contact = np.array([self.tool.contact(s.wrench, history.pose(max(s.t, history.first)).rotation)[:3]
                            for s in arrived])
        t_felt = np.array([s.t for s in arrived])
        if self.follower.phase is Phase.APPROACH:
            self._tare.add(t_felt, contact)
        contact = contact - self._tare.force
        self._stop.force(t, float(np.median(np.linalg.norm(contact, axis=1))))
        return t_felt, contact

    def _check(self, t: float) -> None:
        follower = self.follower
        if follower.phase is Phase.TRAVEL:
            # Samples are late: contact is judged at the time of the newest one.
            newest = self.log.samples[-1][0] if self.log.samples else t
            self._stop.contact(newest, follower.last_touch)
            if self.vision is not None:
                self.vision.sight.check(t)
        elif follower.phase is Phase.APPROACH:
            self._stop.approach(t, follower.descended, follower.settings.reach)
