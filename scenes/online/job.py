"""A task on devices: motions before it, its calibration data, and its results."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from statistics import median
from types import MappingProxyType
from typing import Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.execution.following import Following
from ideal_robot.execution.guard import Guard
from ideal_robot.friction.presliding import slid
from ideal_robot.model.model import Model
from ideal_robot.robots.interface import TOLERANCE, RobotState
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import WRENCH
from planning import PlanningError
from planning.force.bearable_speed import TIMES, bearable_speed, forecast_error, left_beside, worst_force
from planning.force.contact import ASKED, ASKING, NOTICED, most_force
from planning.force.force_follower import SurfaceFollower
from planning.force.sensor_gain import NOT_MEASURED, SensorGain, best_known, gain_by_weight, wrong_gain
from planning.line.line_follower import FollowerSettings, LineFollower
from scenes.line_way import shapes_about
from scenes.methods import SceneMethod
from scenes.online.camera_process import CalibratedCamera
from scenes.online.cell_check import CalibrationMotion, Look, Piece
from scenes.online.configured import Configured, force_task, line_task
from scenes.online.contact import ContactSensor
from scenes.online.contact_witness import ContactWitness
from scenes.online.felt_force import WITHIN, FeltForce, Surface, stiffness_of
from scenes.online.force_calibration import elasticity_by_pressing, tool_by_turning
from scenes.online.force_known import BRAKING, LONGEST, KnownSurface, force_reference
from scenes.online.line_camera import AT_ONCE
from scenes.online.line_known import START, KnownLine, line_follower
from scenes.online.live_arm import START_TOLERANCE, LiveArm, moves, near_start, response_of
from scenes.online.live_sensors import FoundBefore, ImaginedCamera, ImaginedForce, LiveCamera, LiveForce, rehearse
from scenes.online.log import TaskLog, plan_error
from scenes.online.self_test import LASTS, SelfTest
from scenes.online.task import Task
from scenes.scene_files.drawn_line import reference_points
from scenes.scene_files.force_scene import CameraTrouble, ForceScene
from scenes.scene_files.line_scene import LineScene
from scenes.scene_files.scene import SceneError
from sensing.camera.camera_model import CameraModel
from sensing.force.force_calibration import ContactElasticity, ToolLoad

_UNDER_WAY = 2
"""Cycles from a picture's arrival until a plan is made with its line points; one more where plans are made ahead."""
_OTHER_TOOL, _OTHER_SURFACE = 0.05, 1.5
"""Difference of the tool's mass from the last run's that is no scatter [kg], and ratio of elasticities. On the
simulated cell three scenes differ by 0.006 kg and 1 %."""
# Assumed until pressing and turning have measured them.
_GUESS = ContactElasticity(4000.0, 1000.0, 0.0)  # [N/m]
_NO_LOAD = ToolLoad(np.zeros(6), 0.0, np.zeros(3), np.zeros(2))  # [N], [kg]
_AHEAD = 3
"""Cycles by which forces are answered later where they are fused ahead: at 100 N/mm and 0.2 m/s the error is then 5.7 N
in place of 3.1, which is that of a forecast over so much more."""
_TOUCHED, _TRAVELLED = 0.2, 1.5
"""Times of a rehearsal until the surface is felt, and from then on [s]."""


class Job:
    """A task on devices with all of its preparation and results.

    Args:
        scene: the scene; its tables of the simulated world are not used.
        robot: with the controller's cycle.
        model: of the arm.
        method: method that turns sensor data into commands.
        delay: cycles of the controller's own delay.
        answers_within: time in which the arm's loop answers a command [s].
        calibration: of the camera, and whether it is to be made by moving.

    Attributes:
        configured: the task and its sensors.
        needs: devices beside the arm: ``camera``, ``force``.
        braking: deceleration of a stop on the path [m/s²].
        expected: usual length of a run [s].
        longest: time after which a run is stuck [s].
        detection: how the line looks.
        moved: what the controller reported in a session before this one, cycle by cycle.
        tool_mass: stated, of all that hangs on the force sensor [kg]; None where nobody says.
        tested: whether this computer keeps up with the cycle; None where that was not tested.
        gains: of the force sensor, as each witness measured it.
        before: figures of the last run of this scene, with which the calibrations are compared.
    """

    def __init__(self, scene: LineScene | ForceScene, robot: Robot, model: Model, method: SceneMethod, delay: int,
                 answers_within: float, calibration: CalibratedCamera) -> None:
        if isinstance(scene, ForceScene):
            # Faults of the simulated camera belong to the world and are not used here.
            most = min(scene.emergency.force, most_force(scene.force))
            emergency = scene.emergency.model_copy(update={"force": most})
            scene = scene.model_copy(update={"trouble": CameraTrouble(), "emergency": emergency})
        self.scene, self.robot, self.model, self.method, self.delay = scene, robot, model, method, delay
        self.answers_within, self.calibration, self.detection = answers_within, calibration, scene.line.detection
        self.moved: Sequence[RobotState] = ()
        self.tool_mass: float | None = None
        self.gains = list[SensorGain]()
        self.tested: SelfTest | None = None
        self.before: Mapping[str, Any] = MappingProxyType({})
        self.known, self.configured = self._new_task()
        camera, contact = self.configured.camera, self.configured.contact
        self.needs = (*(("force",) if contact is not None else ()), *(("camera",) if camera is not None else ()))
        if isinstance(self.known, KnownSurface):
            self.braking, self.expected = BRAKING, self.known.profile.duration + 4.0
            self.longest = self.expected + LONGEST
        else:
            self.braking = scene.reference.acceleration
            self.longest = self.expected = (self.known.follower.lasts + 0.5) * robot.t_ipo
        self._force: LiveForce | None = None
        self._felt: FeltForce | None = None

    def _new_task(self) -> tuple[KnownLine | KnownSurface, Configured]:
        scene, robot, camera, points = self.scene, self.robot, self.calibration.camera, reference_points(self.scene)
        known: KnownLine | KnownSurface
        if isinstance(scene, ForceScene):
            reference, profile = force_reference(scene, robot, points)
            known = KnownSurface(scene=scene, robot=robot, delay=self.delay, model=self.model, reference=reference,
                                 profile=profile, camera=camera, asking=ASKING, detection=self.detection,
                                 detector=FoundBefore())
            return known, force_task(known, self.method, _NO_LOAD, _GUESS, newest=True)
        under_way = (_UNDER_WAY + (robot.t_ipo < AT_ONCE)) * robot.t_ipo
        reference, follower = line_follower(scene, robot, points, camera, self.calibration.surface,
                                            latency=FollowerSettings.latency + under_way)
        known = KnownLine(scene=scene, robot=robot, delay=self.delay, camera=camera, reference=reference,
                          follower=follower, detector=FoundBefore())
        return known, line_task(known, self.method, self.model if self.method.knows_model else None)

    @property
    def log(self) -> TaskLog:
        """The log of the task."""
        return self.configured.task.log

    @property
    def contact(self) -> ContactSensor:
        """The force sensor of a task with contact."""
        assert self.configured.contact is not None
        return self.configured.contact

    @property
    def camera(self) -> CameraModel | None:
        """The camera with its present calibration; None where none is needed."""
        return self.calibration.camera if self.configured.camera is not None else None

    @property
    def look(self) -> Look | None:
        """The view that is checked before the task; None where no camera is calibrated."""
        if self.camera is None or not self.calibration.known:
            return None
        return Look(self.known.reference, self.scene.reference.run_up, self.q_start, self.camera, self.model,
                    self.calibration.residual, shapes_about(self.scene, self.robot))

    @property
    def q_start(self) -> Array:
        """Joint angles at which the arm rests before the start ``(n,)`` [rad]."""
        return self.configured.task.q_start

    def calibration_motion(self) -> CalibrationMotion:
        """The motion from ``q_start`` and back to calibrate the camera; raises ``SceneError`` where there is none."""
        known, ends = self.known, self.scene.reference
        piece = Piece(known.reference, 0.5 * (ends.run_up + (known.reference.length - ends.run_out)), self.q_start,
                      known.clear, shapes_about(self.scene, self.robot), known.prior)
        return CalibrationMotion.planned(piece, self.calibration.camera, self.model, self.robot, self.detection)

    def rehearse(self) -> None:
        """Loads compiled code, so that it delays no cycle, and measures how long this computer takes for a cycle."""
        configured, camera, force = self._imagined()
        T, rest = self.robot.t_ipo, np.zeros(self.robot.n)
        # Also computes the external force by the motors and the guard, which the simulated task does not use.
        self.model.inverse_dynamics(self.q_start, rest, rest)
        Guard(self.robot, self.q_start)
        Following(lambda: self.q_start, self.robot, response_of(self.model, self.robot, self.delay))
        if configured.contact is None:
            deque(rehearse(configured.task, self.robot, math.ceil((START + 0.6) / T)), maxlen=0)
            return
        slid(rest, rest, rest)
        if isinstance(self.known, KnownSurface):
            follower = self.known.follower(_GUESS.stiffness)
            forecast_error(follower.settings, follower.errors, configured.contact.scene.speed, T, 0.0)
        first, took = math.ceil(_TOUCHED / T), list[float]()
        # The simulated forces need not fit a surface; this call only loads the code.
        with suppress(PlanningError):
            took.extend(rehearse(configured.task, self.robot, first))
            reference = self.known.reference
            pushed = configured.contact.scene.force * reference.frames(np.zeros(1)).up[0]
            force.wrench = np.concatenate([reference.rotation(0.0).T @ pushed, np.zeros(3)])
            cycles = math.ceil(_TRAVELLED / T)
            for number, seconds in enumerate(rehearse(configured.task, self.robot, cycles, first=first)):
                if number == cycles // 2:
                    # Fields can wait: only the time for forces matters.
                    camera.predict = None
                    took.clear()
                took.append(seconds)
        if took:
            self.contact.takes(median(took))

    def _imagined(self) -> tuple[Configured, ImaginedCamera, ImaginedForce]:
        """The task with sensors that show what is expected."""
        _, configured = self._new_task()
        camera, force = ImaginedCamera(), ImaginedForce()
        configured.connect(force, camera)
        if configured.camera is not None:
            camera.predict = configured.camera.predicted
        return configured, camera, force

    def imagined_cycles(self) -> Iterator[float]:
        """Computes one cycle of the task per iteration and yields the time that it took [s], for the self-test.

        Slow preparations are done before the first.
        """
        configured, _, force = self._imagined()
        force.wrench = np.zeros(6)
        cycles = rehearse(configured.task, self.robot, math.ceil((START + LASTS) / self.robot.t_ipo))
        # The simulated surface need not be reached here.
        with suppress(PlanningError):
            for _ in range(math.ceil(START / self.robot.t_ipo) - 1):
                next(cycles)
            yield 0.0
            yield from cycles

    @property
    def ahead(self) -> bool:
        """Whether each cycle is computed ahead, after the command of the one before."""
        return all(sensor.at_once > self.robot.t_ipo for sensor in self.configured.task.sensors)

    # Preparation before the task.

    def approach(self, arm: LiveArm, force: LiveForce | None) -> None:
        """Moves the arm from near ``q_start``, where it rests, to it; feedforward and sensors learn from the motion.

        A tool for contact is weighed first, high above the path; it then descends at a speed that is safe for a touch.

        Args:
            arm: connected.
            force: None where none is needed.

        Raises:
            SceneError: it is not near, or a force on the way is implausible.
            FollowStoppedError: it could not go on.
        """
        if self.configured.contact is None:
            self._watch_following(arm)
            arm.approach(self.q_start)
            return
        if force is None:
            raise SceneError("following a surface needs a force sensor")
        near_start(arm.link.commanded, self.q_start, START_TOLERANCE)
        self._watch_following(arm)
        self._felt = felt = arm.meanwhile(lambda: self._watch(force))
        arm.at_begin.append(felt.begin)
        arm.guard.watches.append(felt)
        felt.tool, above = tool_by_turning(self._surface, self.q_start, arm, force)
        if self.tool_mass is not None:
            self.gains.append(gain := gain_by_weight(felt.tool, self.tool_mass))
            if gain.wrong:
                raise SceneError(wrong_gain(gain))
            felt.ratio = best_known(self.gains).at_most
        self._as_before("tool_mass_kg", mass := felt.tool.mass, "kg", lambda last: abs(mass - last) > _OTHER_TOOL)
        arm.lead(moves(self.robot, [above, self.q_start], 2 * self.robot.t_ipo))

    def _watch_following(self, arm: LiveArm) -> None:
        """Has the guard check from now on whether the arm follows its commands."""
        def loaded() -> Following:
            response = response_of(self.model, self.robot, self.delay)
            return Following(lambda: arm.link.commanded, self.robot, response,
                             tolerance=getattr(arm.link, "tolerance", None) or TOLERANCE,
                             cause=getattr(arm.link, "cause", None))

        arm.guard.watches.append(arm.meanwhile(loaded))

    @property
    def _surface(self) -> KnownSurface:
        assert isinstance(self.known, KnownSurface)
        return self.known

    def _watch(self, force: LiveForce) -> FeltForce:
        """The force sensor as a watch over every motion."""
        return FeltForce(force, self.robot, self._begin, self.contact.scene.emergency.force)

    @property
    def _begin(self) -> Surface:
        """What is known beforehand of the surface where the path begins."""
        frames = self.known.reference.frames(np.zeros(1))
        up = frames.up[0]
        return Surface(frames.position[0], up, WITHIN, stiffness_of(self.model, self.robot, self.q_start, up))

    def ready(self, arm: LiveArm, camera: LiveCamera | None, force: LiveForce | None) -> Task:
        """The task after its preparing motions: calibration, weighing the tool, touching the surface.

        The arm is at ``q_start`` before and after.

        Args:
            arm: connected, at the start.
            camera: None where none is needed.
            force: None where none is needed.
        """
        task, eye = self.configured.task, self.configured.camera
        if eye is not None and camera is None:
            raise SceneError("following a line needs a camera")
        if self.configured.contact is not None:
            self._pressed(arm, force)
        else:
            # Reports during contact do not show friction: only those of free motion are learned from.
            moved = [*self.moved, *arm.reported]
            arm.meanwhile(lambda: task.learn(moved))
        self.configured.connect(force, camera)
        if camera is not None and eye is not None:
            camera.use(self.calibration.camera, self.calibration.time_offset)
            if self.configured.contact is None:
                # On a surface the sight itself rejects points that do not fit.
                camera.calibrated, eye.heard = self.calibration.known, camera.fused
        task.lead(arm)
        if camera is not None and eye is not None:
            camera.predict = eye.predicted
        return task

    def _pressed(self, arm: LiveArm, force: LiveForce | None) -> None:
        """The elasticity by pressing; from then on what is felt is looked at."""
        felt, contact, wanted = self._felt, self.contact, self.contact.scene.force
        if force is None or felt is None or felt.tool is None:
            raise SceneError("following a surface needs a force sensor, and its tool weighed")
        tool = felt.tool
        if not any(np.isfinite(state.tau).all() for state in arm.reported):
            self._check_gain()
        elasticity, by_motors = elasticity_by_pressing(self._surface, self.q_start, arm, force, felt, self.gains)
        if by_motors is not None:
            self.gains.append(by_motors)
        felt.ratio = best_known(self.gains).at_most
        self._as_before("elasticity_N_m", E := elasticity.stiffness, "N/m",
                        lambda last: max(E, last) > _OTHER_SURFACE * min(E, last))
        arm.meanwhile(lambda: contact.calibrated(tool, elasticity, felt.ratio))
        self._check_gain()
        if isinstance(follower := contact.follower, SurfaceFollower):
            self._check_bearable(follower, arm, force)
            if (noise := force.signs.noise) is not None:
                usual = float(np.sqrt(np.mean(noise[:3] ** 2)))
                follower.ask(max(ASKING, force.signs.loudness(usual, ASKED, force.pace)))
        witness = ContactWitness(contact.scene, contact.follower, force, elasticity, self.model, self._begin,
                                 lambda: arm.guard.unsure)
        contact.witnessed(witness, arm.t_ipo < contact.in_one)
        self._force, felt.wanted = force, wanted

    def _check_gain(self) -> None:
        """Raises ``SceneError`` where the surface may bear too much by what is known of the sensor's gain."""
        wanted, gain = self.contact.scene.force, best_known(self.gains)
        if gain.wrong:
            raise SceneError(wrong_gain(gain))
        bears, allowed = worst_force(wanted, gain.ratio, 0.0), most_force(wanted)
        if bears <= allowed:
            return
        less = max(most_force(0.0) / worst_force(1.0, gain.ratio, 0.0), 0.0)
        said = gain.shown if self.gains else "not measured"
        raise SceneError(f"the force sensor's gain is {said}: where it shows the desired {wanted:.0f} N, the surface "
                         f"may bear {bears:.0f} N, and {allowed:.0f} N are allowed; give the mass on the sensor "
                         "(--tool-mass), let the controller report its torques, or press "
                         f"with less (force = {math.floor(less):d})")

    def _check_bearable(self, follower: SurfaceFollower, arm: LiveArm, force: LiveForce) -> None:
        """Raises ``SceneError`` where the surface is too stiff for the speed: it would bear more than it may."""
        T, wanted, noise = self.robot.t_ipo, self.contact.scene.speed, force.signs.noise
        settings = follower.settings if noise is None else replace(follower.settings, noise=float(np.max(noise[:3])))
        answered, ratio = NOTICED + (_AHEAD * T if self.contact.at_once > T else 0.0), best_known(self.gains).ratio
        left = left_beside(self.model, self.robot, self.q_start, self._begin.up)
        speed = arm.meanwhile(lambda: bearable_speed(settings, follower.errors, wanted, T, left, answered, ratio))
        if speed < wanted:
            E, allowed = 1e-3 * settings.elasticity, most_force(settings.force)
            # The measured elasticity scatters by some per cent, so the speed is reduced by five.
            slower = math.floor(950.0 * speed) / 1e3
            error = arm.meanwhile(lambda: forecast_error(settings, follower.errors, wanted, T, left, answered))
            raise SceneError(f"a contact of {E:.0f} N/mm is too stiff for {wanted:g} m/s: a surface of unknown shape "
                             f"is forecast over {1e3 * answered:.0f} ms, by which the force may go wrong by "
                             f"{TIMES * error:.0f} N, and with a force sensor whose gain is known within "
                             f"{1e2 * ratio[1]:.0f} % the surface may bear "
                             f"{worst_force(settings.force, ratio, error):.0f} N, where {allowed:.0f} N are allowed; "
                             + (f"speed = {slower:g} would do" if slower else "no speed would do")
                             + ", or a softer tip")

    def _as_before(self, figure: str, value: float, unit: str, other: Callable[[float], bool]) -> None:
        """Raises ``SceneError`` where ``other`` says that a calibration differs from the figure of the last run."""
        last = self.before.get(figure)
        if isinstance(last, float) and last > 0.0 and other(last):
            raise SceneError(f"{figure} is {value:.3g} {unit} and was {last:.3g} {unit} at the last calibration; look "
                             "whether the tool is the same and firmly mounted, and if it is to be another one, follow "
                             "once with --no-check")

    # Results after the task.

    def columns(self, t: Array) -> dict[str, Array]:
        """Columns of the recording besides the arm's own, at times of the run ``t (N,)`` [s].

        ``cam_t`` and the line points of each field, as in recordings of line scenes; the wrench as sensed and the felt
        normal force, NaN before the first and behind the last.
        """
        columns: dict[str, Array] = {}
        if isinstance(self.scene, LineScene):
            columns |= self.log.point_columns(t, self.scene.points)
        sensed: Any = [] if self._force is None else self._force.samples
        for names, samples in ((("f_normal",), self.log.samples), (WRENCH, sensed)):
            if samples:
                rows = np.array(samples)
                order = np.argsort(rows[:, 0])
                columns |= {name: np.interp(t, rows[order, 0], rows[order, i], left=np.nan, right=np.nan)
                            for i, name in enumerate(names, start=1)}
        return columns

    def figures(self) -> dict[str, Any]:
        """Key figures for ``--json``."""
        figures: dict[str, Any] = {}
        if self.configured.contact is not None:
            figures |= {"force_N": self._kept(), **self._calibrated(), "force_gain": self._gain()}
        if self.configured.camera is not None:
            figures["fields"] = self.log.counts()
        if isinstance(follower := self.configured.task.follower, LineFollower):
            figures |= {"first_used_s": self.log.first_used, "calibration": self.calibration.json(),
                        "plan_error_mm": plan_error(self.log, follower.fusion),
                        "stamp_error_ms": 1e3 * float(follower.fusion.bias("camera")[0][1])}
        return figures

    def _gain(self) -> dict[str, Any]:
        """The force sensor's gain by the witness that knows it best, and what would pass."""
        if not self.gains:
            return {"text": NOT_MEASURED}
        return dict(min(self.gains, key=lambda gain: gain.sigma).json())

    def _kept(self) -> dict[str, float]:
        """How the force was kept, as it was felt [N]."""
        log, wanted, moving = self.log, self.contact.scene.force, self.log.travel
        felt = np.array([force for t, force, *_ in log.samples if moving and moving[0] <= t <= moving[-1]])
        return {"wanted": wanted,
                "rms_error": float(np.sqrt(np.mean((felt - wanted) ** 2))) if len(felt) else float("nan"),
                "largest": float(max((force for _, force, *_ in log.samples), default=float("nan")))}

    def _calibrated(self) -> dict[str, float]:
        """Results of the calibrations; those of the last run where this one has not made them."""
        keys = "elasticity_N_m", "tool_mass_kg"
        if self._force is None:
            return {key: float(self.before.get(key) or math.nan) for key in keys}
        return dict(zip(keys, (self.contact.elasticity.stiffness, self.contact.tool.mass), strict=True))

    def planned(self) -> Array:
        """Time [s] and planned deviation from the reference [m] of each cycle ``(N, 2)``."""
        return self.log.desired
