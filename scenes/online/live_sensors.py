"""The camera of a live arm: pictures arrive at any time and are evaluated in another process."""

from __future__ import annotations

import dataclasses
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from statistics import median
from typing import Any, ClassVar, Protocol

import numpy as np
from scipy.special import chdtri

from ideal_robot.arrays import Array
from ideal_robot.execution.command_governor import CommandGovernor
from ideal_robot.robots.interface import RobotState
from ideal_robot.robots.robot import Robot
from ideal_robot.row_log import RowLog
from planning.line.measurement import Fused
from scenes.online.camera_process import CameraProcess, Header
from scenes.online.cycle import Cycled
from scenes.online.live_arm import LiveArm
from sensing import SensingError
from sensing.camera.camera_device import Field, WindowsAt
from sensing.camera.camera_model import CameraModel
from sensing.camera.hand_eye import HandEye
from sensing.camera.line_detection import LineField
from sensing.camera.line_search import DetectionSettings, PredictedLine
from sensing.force.sensors import WrenchSample, WrenchSource
from sensing.life_signs import LifeSigns

OLDEST = 0.4
"""Age from which on a picture is of no use: the arm's poses of that time are forgotten [s]."""
AHEAD = 0.04
"""How far ahead of this computer's clock a picture or a reading may be stamped [s]."""

LEAP = 0.004
"""By how much the line may be beside its prediction in addition to what the filter takes for possible [m]: errors of a
camera that is mounted by hand, and corners that no map expects. Pictures that are moved by eight pixels show 6 mm."""
BY_CHANCE = 1e-6
"""Probability of what the filter takes for possible to be exceeded in a field."""

_LATELY = 50
"""Readings of which it is known how far apart they come."""

_FAR = float(np.sqrt(chdtri(1, BY_CHANCE)))

Predict = Callable[[float], PredictedLine]
"""Where the line should be in a picture taken at a time of the run [s], in the tool frame."""


class SharedTime(Protocol):
    """Interface of the time that sensors share with the arm; ``at_begin`` is called where it restarts."""

    at_begin: list[Callable[[], None]]

    @property
    def t_ipo(self) -> float:
        """Interpolation cycle [s]."""

    def play_time(self, host: float) -> float:
        """The arm's time that corresponds to this computer's time ``host`` [s]; NaN where there is none."""


def belongs_until(arm: SharedTime, t: float) -> float:
    """Latest instant [s] of sensor data that belong to the cycle that ended at ``t`` [s]: half a cycle after ``t``."""
    return t + 0.5 * arm.t_ipo


def waits(arm: SharedTime, t: float, instant: float) -> bool:
    """Whether sensor data of ``instant`` belong to a later cycle than the one that has ended.

    Where this computer is behind the controller, it has not read yet how the arm moved until then. A forecast from the
    motion before would be wrong by as much as a force sensor resolves.

    Args:
        arm: the arm by whose time the cycle ended.
        t: end of the last cycle that was read [s].
        instant: time at which they were sensed [s].
    """
    return belongs_until(arm, t) < instant <= arm.play_time(time.perf_counter()) + AHEAD


@dataclass(frozen=True)
class EvaluatedField(Field):
    """A field whose line points are already known."""

    seen: LineField = None  # type: ignore[assignment]


class FoundBefore:
    """A ``LineDetector`` for fields that were evaluated in another process."""

    name: ClassVar[str] = "found_before"

    def detect(self, field: Field, camera: CameraModel, prediction: PredictedLine,
               settings: DetectionSettings) -> LineField:
        """Line points of an ``EvaluatedField``, which are already known; see ``LineDetector.detect``."""
        return self.points(field)

    @staticmethod
    def points(field: Field) -> LineField:
        """The line points of an ``EvaluatedField``."""
        if not isinstance(field, EvaluatedField):
            raise SensingError("expected a field that was evaluated before")
        return dataclasses.replace(field.seen, t=field.t_stamp)


class LiveCamera:
    """A ``sensing.camera.camera_device.Camera`` that exposes on its own schedule.

    Args:
        process: reads and evaluates.
        arm: whose time the fields are given.
        detection: how the line looks.

    Attributes:
        predict: see ``Predict``; nothing is evaluated before it is given.
        late, early: pictures that were not evaluated because of their stamps.
        ages: from mid-exposure until the field was used [s].
        hand_eye: the requested calibration, once it is done, or why it failed.
        signs: its signs of life; the arm is stopped where they fail.
        calibrated: whether its points have to agree with the map within their standard deviations.
        checked: result of the check from several poses before the task, as plain values; empty without one.
    """

    def __init__(self, process: CameraProcess, arm: LiveArm, detection: DetectionSettings) -> None:
        self._process, self._arm, self.detection = process, arm, detection
        self.signs, self.calibrated = LifeSigns(np.inf, ("the line's place [m]",)), False
        self.checked: dict[str, Any] = {}
        self.predict: Predict | None = None
        self.late = self.early = 0
        self.time_offset = 0.0
        self.ages: list[float] = []
        self.hand_eye: HandEye | Exception | None = None
        self._evaluated: list[Field] = []
        self._headers: list[Header] = []
        arm.between.append(self.serve)

    def request(self, t0: float, t1: float, windows: WindowsAt) -> None:
        """Does nothing, as whole pictures come without requests; see ``Camera.request``."""

    def arrived(self, t: float) -> list[Field]:
        """The fields that have arrived by ``t`` [s], see ``Camera.arrived``."""
        self._take()
        fields, self._evaluated = self._evaluated, []
        self.ages += [t - field.t_stamp for field in fields]
        return fields

    def calibrate(self, *given: Any) -> None:
        """Requests a calibration, see ``CameraProcess.calibrate``; its result is in ``hand_eye``."""
        self.predict = None
        self._process.calibrate(*given)

    def use(self, camera: CameraModel, time_offset: float) -> None:
        """Sets the calibrated camera and the correction of its stamps [s]."""
        self._process.use(camera)
        self.time_offset = time_offset

    def fused(self, fused: Fused | None) -> None:
        """Adds the fusion of a field (None: no line); stops the arm where the line jumps or moves implausibly."""
        if fused is None or not len(fused.innovation):
            return
        # The first field may differ far from its prediction, as the filter's variance is still large.
        self.signs.departs(float(fused.innovation[0]), LEAP + _FAR * fused.sigma)
        if self.calibrated:
            # The errors of a field's points are correlated, so they are used as one value. Sharp corners, which no map
            # of the line predicts, reach 2.8 (three seeds, with and without a check of the cell), pictures shifted by
            # two pixels 7; 4.0 are allowed.
            self.signs.fits(fused.nis / len(fused.innovation), 1)
        self._stop_at_fault()

    def _stop_at_fault(self) -> None:
        if self.signs.fault is not None:
            self._arm.stop(f"the camera: {self.signs.fault}")

    def serve(self) -> None:
        """Sends predictions for the pictures that have arrived; called while the controller is busy.

        Where answers are late, only the newest picture is kept.
        """
        self._take()
        if self._arm.behind:
            self._headers = self._headers[-1:]
            return
        headers, self._headers = self._headers, []
        for header in headers:
            t = self._arm.play_time(header.taken + self.time_offset)
            if waits(self._arm, self._arm.t, t):
                self._headers.append(header)
            else:
                self._ask(header, t)

    def _take(self) -> None:
        for message in self._process.poll():
            if isinstance(message, Header):
                self._headers.append(message)
            elif isinstance(message, LineField):
                self._evaluated.append(EvaluatedField(message.t, self._arm.t, (), (), message))
            else:
                self.hand_eye = message
        if self._process.ended is not None:
            self._arm.stop(self._process.ended)

    def _ask(self, header: Header, t: float) -> None:
        if self.predict is None or not np.isfinite(t) or self._arm.stood(header.taken + self.time_offset):
            return
        if t < max(self._arm.t - OLDEST, 0.0):
            self.late += 1
        elif t > belongs_until(self._arm, self._arm.t):
            self.early += 1
        else:
            # The camera's own stamp is checked, as a better estimate of its clock must not look like jitter.
            self.signs.stamped(header.stamp, header.read)
            self._stop_at_fault()
            self._process.ask(header.number, t, self.predict(t), self.detection)


# The force sensor in the loop of a live arm: a thread reads it, the cycle takes what is there.

CHANNELS = ("fx [N]", "fy [N]", "fz [N]", "mx [N m]", "my [N m]", "mz [N m]")
IMPOSSIBLE = 1e5
"""A reading beyond is none [N, N m]."""
SILENCE = 0.1
"""Time without a sound reading of the force sensor after which the arm is stopped [s]."""
_BEGINNING = 0.2
"""How much longer that may be while time has only begun: readings are late, and those from before do not count [s]."""
_OLDEST = 0.4  # largest age of a reading that is used [s]; the arm has long been stopped by then (``SILENCE``)
_WAITING = 4000  # readings: 0.6 s of the fastest sensor
_MOMENT = 0.002
"""Time in which a thread reads a packet that has come [s]; where none comes in it, none was there."""


class LiveForce:
    """A ``sensing.force.sensors.ForceSensor`` over a source; samples are given the arm's time.

    Attributes:
        samples: of all that were handed on the time [s] and the wrench [N, N m].
        signs: its health; readings that are treated as missing.
        untimely: such because of their stamps.
        reach: largest change of the force from one reading to the next [N]; inf where that is not known.
    """

    def __init__(self, source: WrenchSource, arm: SharedTime) -> None:
        self.source, self._arm = source, arm
        self.samples = RowLog(7)
        self.signs, self.untimely, self.reach = LifeSigns(IMPOSSIBLE, CHANNELS), 0, np.inf
        self._sound, self._read_so_far = 0.0, 0
        self._readings: deque[tuple[float, Array]] = deque(maxlen=_WAITING)
        self._taken: deque[WrenchSample] = deque(maxlen=_WAITING)
        self._closed = False
        arm.at_begin.append(self.begin)
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def arrived(self, t: float) -> list[WrenchSample]:
        """The samples that have arrived by ``t`` [s]; implausible readings are treated as missing."""
        self.take(t)
        samples = list(self._taken)
        self._taken.clear()
        return samples

    def take(self, t: float) -> list[WrenchSample]:
        """New samples of the cycles that ended by ``t`` [s]; the next ``arrived`` returns them as well."""
        samples = self._due(t)
        # Where this program was blocked, packets have arrived that the thread has not read yet.
        while self._quiet(t) and self._more_is_read():
            samples += self._due(t)
        return samples

    def _due(self, t: float) -> list[WrenchSample]:
        """Samples among what was read so far."""
        samples, latest = list[WrenchSample](), belongs_until(self._arm, t)
        while self._readings:
            stamp, wrench = self._readings[0]
            instant = self._arm.play_time(self.source.clock.host(stamp))
            if waits(self._arm, t, instant):
                break
            self._readings.popleft()
            if not max(t - _OLDEST, 0.0) <= instant <= latest:
                self.untimely += 1
            elif self.signs.check(wrench, np.repeat([self.reach, np.inf], 3)):
                samples.append(WrenchSample(instant, t, wrench))
        for sample in samples:
            self._sound = max(self._sound, sample.t)
            self.samples.append((sample.t, *sample.wrench))
        self._taken.extend(samples)
        return samples

    @property
    def pace(self) -> float:
        """Usual time from one reading to the next [s]; 0 while there are too few."""
        lately = [sample[0] for sample in self.samples[-_LATELY:]]
        return median(np.diff(lately).tolist()) if len(lately) > 1 else 0.0

    def silent(self, t: float) -> float:
        """Time since the last plausible reading at ``t`` [s]."""
        return t - self._sound

    def _quiet(self, t: float) -> bool:
        """Whether it has been silent for too long by ``t`` [s]."""
        return self.silent(t) > SILENCE + (_BEGINNING if t < 0.5 else 0.0)

    def _more_is_read(self) -> bool:
        """Waits for a moment until the thread has read something more; whether it has."""
        before, end = self._read_so_far, time.perf_counter() + _MOMENT
        while self._read_so_far == before and time.perf_counter() < end:
            time.sleep(_MOMENT / 10)
        return self._read_so_far > before

    def begin(self) -> None:
        """Restarts the run's time."""
        self._readings.clear()
        self._taken.clear()
        self._sound = 0.0
        self.signs.begin()
        self.samples = RowLog(7)

    def trouble(self, t: float) -> str | None:
        """Why the sensor is not reliable at ``t`` [s]; None where it is."""
        if self.signs.fault is not None:
            return f"the force sensor: {self.signs.fault}"
        if not self._quiet(t):
            return None
        return f"no sound reading of the force sensor for {1e3 * self.silent(t):.0f} ms: {self.why_silent()}"

    def why_silent(self) -> str:
        """What arrived instead of valid readings, in words."""
        counts = self.source.counts
        reasons = self.signs.missing + [f"{number} {what}" for number, what in (
            (self.untimely, "with an impossible time"),
            (counts.invalid, f"wrong by its own word ({counts.last_invalid})"), (counts.refused, "refused")) if number]
        return ", ".join(reasons) or "nothing came"

    def close(self) -> None:
        """Ends the thread; whoever opened the sensor closes it."""
        self._closed = True
        self._thread.join(1.0)

    def _read(self) -> None:
        while not self._closed:
            for reading in self.source.read(0.1):
                self._readings.append((reading.stamp, reading.wrench))
                self._read_so_far += 1


# A simulated run before the run on devices, so that code is compiled and loaded now.

class ImaginedCamera:
    """A camera that shows the line exactly where it is predicted; a ``sensing.camera.camera_device.Camera``.

    Attributes:
        predict: see ``scenes.online.live_sensors.Predict``.
    """

    def __init__(self) -> None:
        self.predict: Predict | None = None
        self._asked: list[float] = []

    def request(self, t0: float, t1: float, windows: WindowsAt) -> None:
        """Asks for the fields of a cycle before it begins; see ``Camera.request``."""
        self._asked.append(t0)

    def arrived(self, t: float) -> list[Field]:
        """The fields that have arrived by the controller time ``t`` [s]; see ``Camera.arrived``."""
        requests, self._asked = self._asked, []
        return [self._field(instant) for instant in requests[-1:]] if self.predict is not None else []

    def _field(self, t: float) -> EvaluatedField:
        if self.predict is None:
            raise ValueError("nothing to predict with")
        points = self.predict(t).points
        m = len(points)
        seen = LineField(t, points, np.zeros((m, 2)), np.zeros(m), np.full(m, 1e-4), np.ones(m), np.ones(m, dtype=bool),
                         True, "")
        return EvaluatedField(t, t, (), (), seen)


class ImaginedForce:
    """A sensor that shows given forces; a ``sensing.force.sensors.ForceSensor``.

    Attributes:
        wrench: the wrench that it shows ``(6,)`` [N, N m].
    """

    def __init__(self) -> None:
        self.wrench = np.zeros(6)

    def arrived(self, t: float) -> list[WrenchSample]:
        """The samples that have arrived by the controller time ``t`` [s]; see ``ForceSensor.arrived``."""
        return [WrenchSample(instant, t, self.wrench) for instant in (t - 0.008, t - 0.004, t) if instant >= 0.0]


def rehearse(task: Cycled, robot: Robot, cycles: int, first: int = 0) -> Iterator[float]:
    """Simulates cycles with an arm that follows at once; yields the time that each took to compute [s].

    Args:
        task: to be thrown away afterwards.
        robot: with the controller's cycle.
        cycles: number of cycles.
        first: number of the first one.
    """
    T, q = robot.t_ipo, task.q_start
    q_d = np.tile(q, (task.n_d, 1))
    governor = CommandGovernor(robot, q, t_ipo=T)
    for k in range(first, first + cycles):
        t, begun = k * T, time.perf_counter()
        task.observe(t, q, q_d)
        q_d = task.plan(t, q_d)
        governor.allowed(task.command(t, q_d))
        yield time.perf_counter() - begun
        task.request(t, t + T)
        task.collect(t, t + T, RobotState(t + T, q_d[0], np.zeros_like(q)))
        q = q_d[0]
