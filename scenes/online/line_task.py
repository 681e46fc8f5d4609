"""What following a line does in each interpolation cycle: the two loops of [L] Fig. 1."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects.camera import CameraErrors
from ideal_robot.elasticity.observer import GearDeflection
from ideal_robot.errors import IdealRobotError, InputError, RaisedBy
from ideal_robot.feedforward.corrected_arm import CorrectedArm
from ideal_robot.feedforward.method import Setting
from ideal_robot.model.model import Model
from ideal_robot.robots.interface import RobotState
from ideal_robot.signals.recording import expect
from planning.line.deviation_sensor import DeviationSensor, fuse_reading
from planning.line.direct_feedback import DirectFeedback
from planning.line.measurement import Fused
from scenes.methods import DIRECT, SceneMethod
from scenes.online.line_known import START, Known
from scenes.online.line_log import FieldShown, LineLog
from scenes.online.live_arm import LiveArm
from sensing.camera.camera_device import Camera, Field, Window
from sensing.camera.line_detection import LineField, at_middle_row, search_windows
from sensing.camera.line_polynomial import fit_of_lowest_order

REST = 0.2
"""Time the recording goes on after the path has come to rest [s]."""
SHOWN = 4
"""Camera fields kept as pictures."""
RECENT = 32
"""Fields among which one that comes twice is recognised by its time stamp."""


def assumed_latency(model: Model) -> float:
    """By how much the model says that the camera's time stamps are wrong [s]; 0 where it says nothing."""
    return CameraErrors.of(model.effects).late_by(0.0)


class LineTask:
    """Following a line with one method; a ``scenes.online.cycle.Task``.

    Args:
        cell: what is known of the scene.
        method: how ``q_d`` becomes ``q_c``.
        camera: what sees the line.
        model: of the arm; None for a method that knows of none.
        gains: K_p, K_d of direct sensor feedback [1 per cycle].
        log: is written to.
        sensors: besides the camera.
    """

    def __init__(self, cell: Known, method: SceneMethod, camera: Camera, model: Model | None,
                 gains: tuple[float, float] | None, log: LineLog,
                 sensors: Sequence[DeviationSensor] = ()) -> None:
        self.cell, self.method, self.camera, self.log, self.sensors = cell, method, camera, log, tuple(sensors)
        self.follower = follower = cell.follower
        self.n_d = follower.n_d
        horizon = min(self.n_d, cell.scene.n_d or self.n_d)
        self._T = cell.robot.t_ipo
        self._count = int(np.ceil((START + follower.duration + REST) / self._T))
        self._picture_at = set(np.linspace(0.35 * self._count, 0.9 * self._count, SHOWN).astype(int))
        self._new: list[Field] = []
        self._sensed: tuple[Field, LineField] | None = None
        self._stamps: deque[float] = deque(maxlen=RECENT)
        self.feedforward = method.following(Setting(cell.robot, model, horizon, cell.delay))
        self._deflection = GearDeflection(model, self._T) if model is not None else None
        effects = () if model is None else model.effects
        self._known, self._arm = CameraErrors.of(effects), CorrectedArm(cell.robot, effects)
        self._direct = DirectFeedback(follower, *gains) if method.key == DIRECT and gains else None
        self._state = self.feedforward.init(follower.q_start)
        # Once for nothing, so that compiling does not fall into the first cycles.
        follower.reference.project(follower.reference.position(np.array([0.1])), 0.1)
        for sensor in self.sensors:
            if sensor.name in log.sensor_values:
                raise InputError("two sensors have that name; give each its own", field="sensors", value=sensor.name)
            log.sensor_values[sensor.name] = log.sensor_used[sensor.name] = 0

    def learn(self, moved: Iterable[RobotState]) -> None:
        """A feedforward that adapts learns from what the controller reported when the arm moved last."""
        with RaisedBy(f"method {self.method.key}: observe"):
            for measured in moved:
                self._state = self.feedforward.observe(self._state, measured)

    @property
    def q_start(self) -> Array:
        """Where the arm rests at first ``(n,)`` [rad]."""
        return self.follower.q_start

    @property
    def longest(self) -> float:
        """Length of the play [s]."""
        return (self._count + 0.5) * self._T

    def observe(self, t: float, q: Array, q_d: Array) -> None:
        """See ``Task.observe``; the arm's angles are those less the gears' deflection, where a model knows it."""
        self.take_fields(t)
        self.take_angles(t, q, q_d)

    def take_fields(self, t: float) -> None:
        """Takes the fields that have arrived by ``t`` [s]; the next ``plan`` uses them."""
        self._new, self._sensed = [], None
        for field in self.camera.arrived(t):
            # A field that a network delivers twice is one measurement.
            if field.t_stamp not in self._stamps:
                self._new.append(field)
                self._stamps.append(field.t_stamp)

    def take_angles(self, t: float, q: Array, q_d: Array) -> None:
        """See ``Task.observe``."""
        self.follower.observe(t, self._arm.as_drawn(q if self._deflection is None else q - self._deflection.at(q_d)))

    def plan(self, t: float, q_d: Array) -> Array:
        """Desired joint positions over the horizon ``(n_d, n)``: of the sensed path, or of the reference."""
        return self.sensed_plan(t)

    def sensed_plan(self, t: float) -> Array:
        """The horizon ``(n_d, n)`` [rad] from ``t`` [s] on, with the fields taken last; see ``plan``."""
        for arrived in self._new:
            seen = self._sense(arrived)
            self._sensed = arrived, seen
            self.log.add_field(seen, self.cell.scene.points)
            if seen.seen and not np.isfinite(self.log.first_used):
                self.log.first_used = t
        for sensor in self.sensors:
            with RaisedBy(f"sensor {sensor.name}: arrived"):
                readings = sensor.arrived(t)
            expect(readings, Sequence, f"{sensor.name}: arrived", "return a list of Readings, empty where none is new")
            for reading in (candidate for candidate in readings if np.isfinite(candidate.value)):
                self.log.sensor_values[sensor.name] += 1
                self.log.sensor_used[sensor.name] += fuse_reading(self.follower, reading, sensor.name).dof
        if self.method.senses:
            return self.follower.horizon(t)
        self.follower.fusion.travel(float(self.follower.profile.s(t - START)))
        k = min(max(round((t - START) / self._T), 0), len(self.follower.q_reference) - self.n_d)
        return self.follower.q_reference[k : k + self.n_d]

    def _sense(self, arrived: Field) -> LineField:
        """Line points of a field and what follows from them for the path."""
        follower = self.follower
        arrived = replace(arrived, t_stamp=arrived.t_stamp + self._known.late_by(arrived.t_stamp))
        pose = follower.history.row_pose(arrived.t_stamp)
        ahead = self.cell.predicted(arrived.t_stamp)
        detector = self.cell.detector
        with RaisedBy(f"detector {detector.name}: detect"):
            seen = detector.detect(arrived, self.cell.camera, ahead, self.cell.detection)
        expect(seen, LineField, f"detector {detector.name}", "return one from detect, also where no line is seen")
        seen = replace(seen, points_tcp=self._known.points(seen.points_tcp, self.cell.camera.axis_on_surface))
        seen = at_middle_row(seen, self.cell.camera, follower.history.row_pose)
        if self._direct is not None:
            self._direct.update(seen, pose)
        self.fused(follower.update(seen, pose))
        return seen

    def fused(self, fused: Fused | None) -> None:
        """What became of a field in the map; whoever follows on devices looks at it."""

    def command(self, t: float, q_d: Array) -> Array:
        """Commanded joint positions ``(n,)``."""
        if self._direct is not None:
            return self._direct.command(t)
        with RaisedBy(f"method {self.method.key}: step"):
            q_c, self._state = self.feedforward.step(self._state, q_d[: self.feedforward.n_d])
        return q_c

    def request(self, t0: float, t1: float) -> None:
        """Asks the camera for windows where the line should be."""
        self.log.with_field.append(bool(self._new))
        self.log.s.append(float(self.follower.profile.s(t0 - START)))
        self.log.believed.append(self.follower.planned(t0)[0] if self.method.senses else 0.0)
        self.camera.request(t0, t1, self._windows)

    def _windows(self, exposure: float) -> Sequence[Window]:
        ahead = self.cell.predicted(exposure + self._known.late_by(exposure))
        return search_windows(self.cell.camera, ahead, self.cell.detection)

    def collect(self, t0: float, t1: float, measured: RobotState) -> None:
        """See ``Task.collect``: a feedforward that adapts learns, and a field now and then is kept for the report."""
        self.learn([measured])
        k = round(t0 / self._T)
        if k not in self._picture_at:
            return
        self._picture_at.discard(k)
        if self._sensed is not None and self._sensed[1].seen:
            raw, seen = self._sensed
            self.log.shown.append(self._picture(seen, raw))
        else:
            self._picture_at.add(k + 1)

    def away(self, q_d: Array) -> Array | None:
        """See ``Task.away``: a tool that follows by eye presses on nothing."""
        return None

    def speed(self, t: float) -> float:
        """Path speed [m/s]."""
        return float(self.follower.profile.speed(t - START))

    def done(self, t: float) -> bool:
        """Whether the path is done and the arm at rest."""
        return round(t / self._T) + 1 >= self._count

    def _picture(self, seen: LineField, raw: Field) -> FieldShown:
        """The points found in a field and the polynomial through them ([L] 5); the whole image is drawn later."""
        follower, reference = self.follower, self.cell.reference
        pose = follower.history.row_pose(seen.t)
        points = seen.points_tcp[seen.used] @ pose.rotation.T + pose.translation
        s, deviation, _ = reference.project(points, float(follower.profile.s(seen.t - START)) + 0.06)
        polynomial = fit_of_lowest_order(s, deviation, seen.sigma[seen.used])
        places = np.linspace(polynomial.span[0] - 0.01, polynomial.span[1] + 0.01, 60)
        frames = reference.frames(places)
        curve = frames.position + polynomial.deviation(places)[0][:, None] * frames.normal
        return FieldShown(seen.t, raw, np.empty((0, 0), dtype=np.uint8), seen.pixels, seen.used,
                          self.cell.camera.project_tool((curve - pose.translation) @ pose.rotation))


# What following a line on devices does in each cycle: where the cycle is short, planned in the one before.

AT_ONCE = 0.008
"""Cycle from which on there is time to plan with a field between packet and answer [s]."""


class LiveLineTask(LineTask):
    """``LineTask`` with an arm that may have to be stopped.

    Behind short cycles an answer waits for no field: as soon as the command of a cycle has gone, the plan of the next
    one is made with the fields that are there by then. What is left between packet and answer is one step of the
    feedforward along that plan. A field takes effect a cycle later for it; the map it goes into is one over places
    ([L] 4.3), to which its age makes no difference.
    """

    arm: LiveArm | None = None
    ahead = False
    """Whether each cycle is planned in the one before."""
    heard: Callable[[Fused | None], None] | None = None
    """Looks at what became of each field."""
    _prepared: tuple[int, Array | IdealRobotError] | None = None

    def lead(self, arm: LiveArm) -> None:
        """From now on with this arm, which is at rest at the start."""
        self.arm, self.ahead = arm, self._T < AT_ONCE
        if self.ahead:
            arm.between.append(lambda: self.prepare(arm.t + self._T))

    def away(self, q_d: Array) -> Array | None:
        """See ``Task.away``: the commands of an arm that has not followed them come back to it."""
        return None if self.arm is None else self.arm.guard.back_to_arm(q_d[0])

    def fused(self, fused: Fused | None) -> None:
        """See ``LineTask.fused``."""
        if self.heard is not None:
            self.heard(fused)

    def prepare(self, t: float) -> None:
        """Plans the cycle that begins at ``t`` [s], with what has come by now; nobody waits for it yet."""
        self.take_fields(t)
        try:
            outcome: Array | IdealRobotError = self.sensed_plan(t)
        except IdealRobotError as error:
            outcome = error
        self._new = []
        self._prepared = round(t / self._T), outcome

    def observe(self, t: float, q: Array, q_d: Array) -> None:
        """See ``Task.observe``."""
        if not self.ahead:
            self.take_fields(t)
        self.take_angles(t, q, q_d)

    def plan(self, t: float, q_d: Array) -> Array:
        """See ``scenes.online.cycle.Task``."""
        if self.arm is not None:
            self.arm.check(t)
        number, prepared = self._prepared or (-1, None)
        self._prepared = None
        if self._new or prepared is None or number != round(t / self._T):
            # There is time for a field, or this is one of several lost cycles that are made good at once.
            return self.sensed_plan(t)
        if isinstance(prepared, IdealRobotError):
            raise prepared
        return prepared

    def command(self, t: float, q_d: Array) -> Array:
        """See ``scenes.online.cycle.Task``."""
        if self.arm is not None:
            self.arm.q_d = q_d[0]
        return super().command(t, q_d)

    def collect(self, t0: float, t1: float, measured: RobotState) -> None:
        """See ``Task.collect``; the pictures are in another process, none is kept."""
        self.learn([measured])
