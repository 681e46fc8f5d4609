"""Following a surface by force on devices: the planning of ``scenes.force`` with sensors that are elsewhere."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.errors import IdealRobotError
from ideal_robot.robots.interface import RobotState
from planning import PlanningError
from planning.force.contact import ASKED, ASKING, EmergencyStopError, Phase, most_force
from planning.force.contour import LATELY, ContourFollower
from planning.force.felt_by_motors import BeyondSensor
from planning.line.measurement import Fused, Measurement
from scenes.methods import SceneMethod
from scenes.online.cycle import Task
from scenes.online.devices import Job
from scenes.online.felt_force import WITHIN, FeltForce, Surface, stiffness_of
from scenes.online.force_calibration import elasticity_by_pressing, tool_by_turning
from scenes.online.force_known import START_HEIGHT, Known, force_reference
from scenes.online.force_task import BRAKING, LONGEST, ForceLog, ForceTask
from scenes.online.line_task import AT_ONCE
from scenes.online.live_arm import START_TOLERANCE, LiveArm, moves, near_start
from scenes.online.live_sensors import FoundBefore, ImaginedCamera, ImaginedForce, LiveCamera, LiveForce, rehearse
from scenes.scene_files.drawn_line import reference_points
from scenes.scene_files.force_scene import CameraTrouble, ForceScene
from scenes.scene_files.scene import SceneError
from sensing.camera.camera_device import Field
from sensing.force.force_calibration import ContactElasticity, ToolLoad

_BELOW = 1.25
"""Depth below where the surface was touched, as a share of what the wanted force takes, at which the tip is stopped."""
_OTHER_TOOL, _OTHER_SURFACE = 0.05, 1.5
"""Difference of the tool's mass from the last run's that is no scatter [kg], and ratio of elasticities. On the
simulated cell three scenes differ by 0.006 kg and 1 %."""
_IN_AIR = 0.003
"""Height above where the calibration touched the surface at which nothing can be felt [m]."""
_RECEDES = 0.3
"""Share of the wanted force by which a contour may lie deeper than forecast: 0.1 with a sound sensor, over 0.3 within
0.1 s with one that is stuck (``python -m studies faults``)."""
_TOUCHES, _SLIDES = 3.0, 0.5
"""Force that need not be a push [N], and the largest coefficient of friction that a tip has."""
_BY_MOTORS = 0.65
"""Share of the force that the surface bears beyond the wanted one of which the motors' word is enough."""
_PULLS = -3.0
"""Force that no surface exerts [N]."""
_UNSEEN = 5
"""Fusions of forces, 0.06 s of them, after which no field is fused before the sensor's signs of life are looked at."""
# Until pressing and turning have told them.
_GUESS = ContactElasticity(4000.0, 1000.0, 0.0)  # [N/m]
_NO_LOAD = ToolLoad(np.zeros(6), 0.0, np.zeros(3), np.zeros(2))  # [N], [kg]


class LiveForceTask(ForceTask):
    """``ForceTask`` with devices that may fall silent and an arm that may have to be stopped.

    No answer waits for a field: it is fused as soon as the command of a cycle has gone. Behind short cycles no answer
    waits for forces either, and one thing is done between two: what forces tell is worked out, or fused behind the
    next, or a field is. Where answers are behind, only forces are. Whether a force is too large is looked at before.
    """

    arm: LiveArm | None = None
    force: LiveForce | None = None
    ahead = False
    """Whether what is sensed is fused, and the next cycle planned, between two cycles."""
    _unfit: IdealRobotError | None = None
    _prepared: tuple[int, Array] | None = None
    _measured: tuple[Array, Measurement | None] | None = None
    """Instants of forces ``(m,)`` [s] that are fused between the next two cycles, and what they tell."""
    floor, ceiling = -np.inf, np.inf
    """Heights at the start of the path below which the tip does not go, and above which it feels nothing [m]."""

    def __init__(self, cell: Known, method: SceneMethod) -> None:
        super().__init__(cell, method, None, _NO_LOAD, _GUESS, np.random.default_rng(0))
        # What is felt goes into a map of the surface, which tells how well it fits.
        self.maps = cell.scene.task != "contour"
        # What was felt of the tip's swing and not looked at, see ``SurfaceFollower.felt``.
        self._swung = list[Array]()
        # What the motors feel beyond what the sensor feels.
        self.motors = BeyondSensor(cell.model, cell.robot.t_ipo)
        # How near what was felt came to each limit, as a share of it.
        self.nearest = dict[str, float]()
        if self.vision is not None:
            self.vision.detect = FoundBefore.points

    @property
    def steps(self) -> int:
        """See ``ForceTask``."""
        return 1 if self.arm is None else self.arm.steps

    def lead(self, arm: LiveArm) -> None:
        """From now on with this arm, which is at rest at the start."""
        self.arm, self.ahead = arm, self.vision is not None and arm.t_ipo < AT_ONCE
        arm.between.append(lambda: self.answered(arm))

    def witness(self) -> None:
        """Looks whether what is felt answers the tip's swing, and at what the motors feel, for the next cycle."""
        self.motors.weigh()
        if self.force is not None and self._swung:
            self.force.signs.answers(np.concatenate(self._swung), self.elasticity.stiffness, ASKED)
            self._swung.clear()

    def _fused(self, t_felt: Array, fused: Fused | None) -> None:
        super()._fused(t_felt, fused)
        if self.force is not None and self.maps and self.follower.phase is Phase.TRAVEL:
            _, _, innovation, values = self.log.samples[-1]
            self.force.signs.fits(innovation, int(values))
            self._swung.append(self._surface.felt)

    def answered(self, arm: LiveArm) -> None:
        """What is done once a command has gone; the next cycle is told if something goes wrong."""
        try:
            if self.ahead:
                self.prepare(arm.t)
            else:
                self.witness()
                # Forces come first.
                if not arm.behind:
                    self.fuse_fields(arm.t)
        except IdealRobotError as error:
            self._unfit = error

    def prepare(self, t: float) -> None:
        """Fuses what has arrived by ``t`` [s], forces alone where answers are behind, and plans the next cycle."""
        measured, self._measured = self._measured, None
        if fused := measured is not None:
            self._fused(measured[0], None if measured[1] is None else self._surface.fuse(measured[0], measured[1]))
        elif not self.fuse_forces(t) and not (self.arm is not None and self.arm.behind):
            fused = len(self._swung) < _UNSEEN and self.fuse_fields(t)
            if not fused:
                self.witness()
        t += self.cell.robot.t_ipo
        self._prepared = round(t / self.cell.robot.t_ipo), self._surface.horizon(t, anew=not fused)

    def _fuse_felt(self, t_felt: Array, contact: Array) -> None:
        if self.ahead:
            self._measured = t_felt, self._surface.measured(t_felt, contact)
        else:
            super()._fuse_felt(t_felt, contact)

    def _fields(self, t: float) -> Sequence[Field]:
        """See ``ForceTask``: the newest alone, which shows of the line what those before it have shown."""
        return super()._fields(t)[-1:]

    def _horizon(self, t: float) -> Array:
        """See ``ForceTask``: what was prepared, but for one of several lost cycles that are made good at once."""
        number, q_d = self._prepared or (-1, None)
        return q_d if q_d is not None and number == round(t / self.cell.robot.t_ipo) else super()._horizon(t)

    def fuse(self, t: float) -> None:
        """See ``ForceTask``."""
        if self._unfit is not None:
            raise self._unfit
        if not self.ahead:
            self.fuse_forces(t)
        if self.arm is None:
            self.fuse_fields(t)

    def plan(self, t: float, q_d: Array) -> Array:
        """See ``Task.plan``."""
        if self.arm is not None:
            self.arm.check(t)
        q_d = super().plan(t, q_d)
        if self.force is not None:
            self._check_felt(t)
            self._check_height(t)
        return q_d

    def away(self, q_d: Array) -> Array | None:
        """See ``Task.away``: from where the arm stands, where it has not followed its commands."""
        away = super().away(q_d)
        back = None if self.arm is None else self.arm.guard.back_to_arm(q_d[0])
        return away if back is None else back if away is None else away + back

    def _check_felt(self, t: float) -> None:
        """Raises ``EmergencyStopError`` where what is felt is no push, fits no contour, or not what the motors feel."""
        follower, scene = self.follower, self.cell.scene
        if follower.force < _PULLS:
            raise EmergencyStopError("force", t, f"the force sensor feels the surface pull with {-follower.force:.1f} "
                                     "N; check its sign, its axes, and whether its bias has moved")
        if follower.phase in (Phase.SETTLE, Phase.TRAVEL) and self._beyond(
                "sideways", follower.sideways, max(_TOUCHES, _SLIDES * follower.force)):
            raise EmergencyStopError("force", t, f"{follower.force:.1f} N felt out of the surface and "
                                     f"{follower.sideways:.1f} N along it, which is no push; look whether the force "
                                     "sensor is alive, and check its axes")
        if isinstance(follower, ContourFollower) and follower.phase is Phase.TRAVEL and self._beyond(
                "forecast", follower.recedes, _RECEDES * scene.force):
            raise EmergencyStopError("force", t, f"the contour lies deeper by {follower.recedes:.1f} N than it was "
                                     f"felt to go on {LATELY:.2f} s ago; look whether the force sensor is alive")
        if self._beyond("motors", self.motors.excess, _BY_MOTORS * (most_force(scene.force) - scene.force)):
            raise EmergencyStopError("force", t, f"the motors feel {self.motors.excess:.0f} N more than the "
                                     f"{follower.force:.0f} N of the force sensor; look whether it is alive, and "
                                     "whether its bias has moved")

    def _beyond(self, sign: str, value: float, limit: float) -> bool:
        """Whether a value is beyond its limit; keeps how near it came."""
        self.nearest[sign] = max(self.nearest.get(sign, 0.0), value / limit)
        return value > limit

    def _check_height(self, t: float) -> None:
        """Raises ``EmergencyStopError`` where the tip is higher or deeper than it can be with what is felt."""
        follower = self.follower
        height = START_HEIGHT - follower.descended
        if follower.phase is Phase.SETTLE and height > self.ceiling:
            raise EmergencyStopError("force", t, f"{follower.force:.1f} N felt in the air, {1e3 * height:.1f} mm above "
                                     "the path's start; look whether the force sensor's bias has leapt")
        if follower.phase in (Phase.APPROACH, Phase.SETTLE) and height < self.floor:
            raise EmergencyStopError("force", t, f"the tip is {-1e3 * height:.1f} mm below the path's start, where "
                                     f"the calibration felt more than is wanted, and {follower.force:.1f} N are felt; "
                                     "look whether the force sensor is alive")

    def command(self, t: float, q_d: Array) -> Array:
        """See ``scenes.online.cycle.Task``."""
        if self.arm is not None:
            self.arm.q_d = q_d[0]
        return super().command(t, q_d)

    def collect(self, t0: float, t1: float, measured: RobotState) -> None:
        """See ``Task.collect``."""
        super().collect(t0, t1, measured)
        if self.follower.phase is Phase.TRAVEL:
            self.motors.hear(measured, self._torque[0] / self.cell.scene.force, self.follower.force,
                             self.follower.speed_at(t0))


class ForceJob(Job):
    """A surface, a contour, or a line on a surface."""

    braking = BRAKING
    before: Mapping[str, Any] = MappingProxyType({})
    """Figures of the last run of this scene, with which the calibrations are compared."""
    scene: ForceScene
    log: ForceLog
    _known: Known
    _task: LiveForceTask

    def _set_up(self) -> None:
        scene, robot = self.scene, self.robot
        self.needs = ("force", "camera") if scene.task == "glue" else ("force",)
        # What happens to the simulated camera is the world's.
        emergency = scene.emergency.model_copy(update={"force": min(scene.emergency.force, most_force(scene.force))})
        self.scene = scene.model_copy(update={"trouble": CameraTrouble(), "emergency": emergency})
        reference, profile = force_reference(scene, robot, reference_points(scene))
        self._known = Known(scene=self.scene, robot=robot, delay=self.delay, model=self.model, reference=reference,
                            profile=profile, camera=self.calibration.camera, asking=ASKING, detection=self.detection)
        self.expected = profile.duration + 4.0
        self.longest = self.expected + LONGEST
        self._task = LiveForceTask(self._known, self.method)
        self.log = self._task.log
        self._force: LiveForce | None = None
        self._felt: FeltForce | None = None

    def rehearse(self) -> None:
        """See ``Job``: the touch-down and a piece of the travel, felt at once."""
        task, camera, force = LiveForceTask(self._known, self.method), ImaginedCamera(), ImaginedForce()
        task.connect(force, camera if task.vision is not None else None)
        if task.vision is not None:
            camera.predict = task.vision.predicted
        T = self.robot.t_ipo
        try:
            rehearse(task, self.robot, math.ceil(0.2 / T))
            force.wrench = np.array([0.0, 0.0, -self.scene.force, 0.0, 0.0, 0.0])
            rehearse(task, self.robot, math.ceil(1.5 / T), first=math.ceil(0.2 / T))
        except PlanningError:
            # What is felt fits no surface: that is no matter here, the code is loaded.
            return

    def approach(self, arm: LiveArm, force: LiveForce | None) -> None:
        """See ``Job.approach``: up, where the tool is weighed, and down to the start as slowly as a touch asks for."""
        if force is None:
            raise SceneError("following a surface needs a force sensor")
        near_start(arm.link.commanded, self.q_start, START_TOLERANCE)
        self.watch_following(arm)
        self._felt = felt = arm.meanwhile(lambda: self._watch(force))
        arm.at_begin.append(felt.begin)
        arm.guard.watches.append(felt)
        felt.tool, above = tool_by_turning(self._known, self.q_start, arm, force)
        self._as_before("tool_mass_kg", mass := felt.tool.mass, "kg", lambda last: abs(mass - last) > _OTHER_TOOL)
        arm.lead(moves(self.robot, [above, self.q_start], 2 * self.robot.t_ipo))

    def _watch(self, force: LiveForce) -> FeltForce:
        """The force sensor as a watch over every motion."""
        known, frames = self._known, self._known.reference.frames(np.zeros(1))
        up = frames.up[0]
        surface = Surface(frames.position[0], up, WITHIN, stiffness_of(known.model, self.robot, self.q_start, up))
        return FeltForce(force, self.robot, surface, self.scene.emergency.force)

    def ready(self, arm: LiveArm, camera: LiveCamera | None, force: LiveForce | None) -> Task:
        """See ``Job.ready``: the elasticity by pressing."""
        felt = self._felt
        if force is None or felt is None or felt.tool is None:
            raise SceneError("following a surface needs a force sensor, and its tool weighed")
        tool = felt.tool
        elasticity = elasticity_by_pressing(self._known, self.q_start, arm, force, felt)
        self._as_before("elasticity_N_m", E := elasticity.stiffness, "N/m",
                        lambda last: max(E, last) > _OTHER_SURFACE * min(E, last))
        task = self._task
        arm.meanwhile(lambda: task.calibrated(tool, elasticity))
        task.floor = elasticity.touch - _BELOW * self.scene.force / elasticity.stiffness
        task.ceiling = elasticity.touch + _IN_AIR
        task.connect(force, camera)
        task.force = self._force = force
        felt.wanted = self.scene.force
        task.lead(arm)
        if camera is not None and task.vision is not None:
            camera.use(self.calibration.camera, self.calibration.time_offset)
            camera.predict = task.vision.predicted
        return task

    def _as_before(self, figure: str, value: float, unit: str, other: Callable[[float], bool]) -> None:
        """Raises ``SceneError`` where ``other`` says that a calibration differs from the figure of the last run."""
        last = self.before.get(figure)
        if isinstance(last, float) and last > 0.0 and other(last):
            raise SceneError(f"{figure} is {value:.3g} {unit} and was {last:.3g} {unit} at the last calibration; look "
                             "whether the tool is the same and firmly mounted, and if it is to be another one, follow "
                             "once with --no-check")

    def columns(self, t: Array) -> dict[str, Array]:
        """See ``Job``: the wrench as sensed and the felt normal force; NaN before the first and behind the last."""
        columns: dict[str, Array] = {}
        sensed: Any = [] if self._force is None else self._force.samples
        for names, samples in ((("f_normal",), self.log.samples), (("fx", "fy", "fz", "mx", "my", "mz"), sensed)):
            if samples:
                rows = np.array(samples)
                order = np.argsort(rows[:, 0])
                columns |= {name: np.interp(t, rows[order, 0], rows[order, i], left=np.nan, right=np.nan)
                            for i, name in enumerate(names, start=1)}
        return columns

    def planned(self) -> Array:
        """See ``Job``."""
        first = [float(np.atleast_1d(row)[0]) for row in self.log.planned]
        count = min(len(self.log.t), len(first))
        return np.column_stack([self.log.t[:count], first[:count]])

    def figures(self) -> dict[str, Any]:
        """See ``Job``."""
        log, wanted = self.log, self.scene.force
        moving = log.travel
        felt = np.array([force for t, force, *_ in log.samples if moving and moving[0] <= t <= moving[-1]])
        figures: dict[str, Any] = {"force_N": {
            "wanted": wanted, "rms_error": float(np.sqrt(np.mean((felt - wanted) ** 2))) if len(felt) else float("nan"),
            "largest": float(max((force for _, force, *_ in log.samples), default=float("nan")))},
            **self._calibrated()}
        if self._task.vision is not None:
            fields = self._task.vision.fields
            figures["fields"] = {"seen": len(fields), "used": sum(1 for field in fields if field[1] > 0)}
        return figures

    def _calibrated(self) -> dict[str, float]:
        """What calibrations have found, the last run's where this one has not come so far."""
        keys = "elasticity_N_m", "tool_mass_kg"
        if self._force is None:
            return {key: float(self.before.get(key) or math.nan) for key in keys}
        return dict(zip(keys, (self._task.elasticity.stiffness, self._task.tool.mass), strict=True))
