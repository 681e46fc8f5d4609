"""A cell with a camera in lockstep, without wires and processes: what is done to it is the same every time."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.errors import IdealRobotError
from ideal_robot.robots.interface import RobotState
from ideal_robot.robots.robot import Robot
from scenes.force.cell import Cell as ForceCell
from scenes.line.cell import Cell, Prepared, set_up
from scenes.methods import following_methods, method_of
from scenes.models import model_at
from scenes.online.camera_process import CalibratedCamera, Header
from scenes.online.camera_worker import _Worker
from scenes.online.cell_check import Seen, check_line
from scenes.online.cycle import CycleSettings, play_cycles
from scenes.online.job import Job
from scenes.online.journal import Journal
from scenes.online.live_arm import LiveArm, Worked
from scenes.online.live_sensors import LiveCamera
from scenes.online.log import SETTLING
from scenes.scene_files.line_scene import LineScene
from scenes.serve.cell import line_of
from sensing.camera.camera_device import Gray
from sensing.camera.camera_model import CameraModel
from sensing.camera.cameras import Frame
from sensing.clock_relation import ClockRelation
from sim.arm.arm import SimulatedArm
from sim.camera.image_chain import CameraSettings

BEGIN = 2.0
"""When faults of a camera begin, unless they are there from the beginning [s]."""
Stamp = Callable[[float], float]
Picture = Callable[[float, Gray], Gray]


def shifted(pixels: int) -> Picture:
    """Pictures moved sideways by so many pixels from ``BEGIN`` on."""
    return lambda t, gray: gray if t < BEGIN else np.ascontiguousarray(np.roll(gray, pixels, axis=1))


def shaken(width: float) -> Stamp:
    """Stamps anywhere within so long [s]."""
    rng = np.random.default_rng(3)
    return lambda t: t + width * float(rng.uniform(-0.5, 0.5))


def held(t: float) -> float:
    """Stamps that stand still from ``BEGIN`` on."""
    return min(t, BEGIN)


def black(t: float, gray: Gray) -> Gray:
    """Pictures that are black from ``BEGIN`` on."""
    return gray if t < BEGIN else np.zeros_like(gray)


def mirrored(t: float, gray: Gray) -> Gray:
    """Pictures whose sides are exchanged from ``BEGIN`` on."""
    return gray if t < BEGIN else np.ascontiguousarray(gray[:, ::-1])


def frozen() -> Picture:
    """The same picture for ever from ``BEGIN`` on."""
    last: list[Gray] = []

    def picture(t: float, gray: Gray) -> Gray:
        last[:] = [gray] if t < BEGIN or not last else last
        return last[0]

    return picture


class Eye:
    """A camera on a simulated arm whose pictures are evaluated when they have come; a ``CameraProcess``.

    ``stamp``: what it says of when it exposed [s]; ``picture``: what becomes of a picture taken at a time [s].
    """

    def __init__(self, cell: Cell | ForceCell, stamp: Stamp | None = None, picture: Picture | None = None) -> None:
        scene = cell.known.scene
        self._stamp, self._picture, self.ended = stamp, picture, None
        self.settings = CameraSettings.of(scene.camera)
        self._drawn = line_of(cell, scene)[1]
        self.worker = _Worker(cell.known.camera, scene.camera.detector, self)  # type: ignore[arg-type]
        self.clock, self.messages = ClockRelation(self.settings.latency), deque[Any]()
        self._due: deque[tuple[float, Frame]] = deque()
        self._number = 0

    @property
    def true(self) -> CameraModel:
        """As it is, not as it is believed to be."""
        return self._drawn.model  # type: ignore[union-attr]

    def see(self, arm: SimulatedArm) -> None:
        """Exposes and hands on what has come by the arm's time."""
        s = self.settings
        while (instant := self._number / s.rate) + 0.5 * s.exposure < arm.t:
            self._number += 1
            poses = [arm.tcp_at(max(instant + ((i + 0.5) / s.sub_exposures - 0.5) * s.exposure, 0.0))
                     for i in range(s.sub_exposures)]
            gray = self._drawn.picture(poses, instant)  # type: ignore[union-attr]
            gray = gray if self._picture is None else self._picture(instant, gray)
            stamp = instant if self._stamp is None else self._stamp(instant)
            self._due.append((instant + s.latency, Frame(self._number, stamp, instant + s.latency, gray)))
        while self._due and self._due[0][0] <= arm.t:
            arrived, frame = self._due.popleft()
            if self.clock.add(frame.stamp, arrived):
                self.worker._frames.append(frame)
                self.messages.append(Header(frame.number, self.clock.host(frame.stamp), arrived, frame.stamp))

    def send(self, told: tuple[str, Any]) -> None:
        """What the camera's process tells: kind and content."""
        self.messages.append(told[1])

    def poll(self) -> list[Any]:
        """See ``CameraProcess``."""
        messages = list(self.messages)
        self.messages.clear()
        return messages

    def ask(self, *asked: Any) -> None:
        """See ``CameraProcess``."""
        self.worker.answer("detect", asked)

    def use(self, camera: Any) -> None:
        """See ``CameraProcess``."""
        self.worker.answer("camera", camera)


class WaitingArm(LiveArm):
    """A bench waits while something is worked out: what it plays does not depend on how long that takes."""

    behind = False

    def meanwhile(self, work: Callable[[], Worked]) -> Worked:
        """See ``LiveArm``."""
        return work()


class Bench:
    """A simulated arm that is handed each command at once, and a camera on it; a ``Link``."""

    def __init__(self, arm: SimulatedArm, robot: Robot, eye: Eye | None) -> None:
        self.arm, self.robot, self.t_ipo, self.fault, self.eye = arm, robot, robot.t_ipo, None, eye
        self.commanded = self.arm.truth.q_m.copy()
        self.answer_times: list[float] = []
        self.in_force: list[Array] = []
        self.arrived, self.gone_on, self.missed, self.unanswered = 0.0, 0, False, ()
        self.counts: Any = SimpleNamespace()

    def send(self, q_c: Array) -> None:
        """A command ``(n,)`` [rad]."""
        self.commanded = np.array(q_c)

    paused: tuple[float, float] = (np.inf, np.inf)
    """From and to when the controller holds the arm where it is, though packets go on [s]."""
    _held: Array | None = None

    def receive(self) -> RobotState:
        self._held = (self.arm.truth.q_m if self._held is None else self._held) if (
            self.paused[0] <= self.arm.t < self.paused[1]) else None
        self.in_force.append(self.commanded if self._held is None else self._held)
        state = self.arm.cycle(self.in_force[-1])
        self.arrived = self.arm.t
        if self.eye is not None:
            self.eye.see(self.arm)
        return state


def led(live: LiveArm, job: Any, force: Any, ready: Callable[[], Any]) -> str | None:
    """Plays a job, ``ready`` giving its task once the arm is at its start; why it ended early, None for all of it."""
    try:
        job.approach(live, force)
        task = ready()
        live.begin()
        play_cycles(live, job.robot, task, job.log, CycleSettings(job.braking, 0.3, job.longest, job.expected, ""),
                    lambda *_: None)
    except IdealRobotError as error:
        return str(error)
    return job.log.failure  # type: ignore[no-any-return]


def _calibration(cell: Cell, file: Path, shared: Prepared | None) -> CalibratedCamera:
    if shared is None or shared.hand_eye is None:
        return CalibratedCamera(cell.true_camera, file)
    return CalibratedCamera(cell.known.camera, file, wanted=True).found(shared.hand_eye)


def followed(scene: LineScene, folder: Path, *, stamp: Stamp | None = None, picture: Picture | None = None,
             calibrated: bool = True, check: bool = False, shared: Prepared | None = None,
             pause: tuple[float, float] | None = None) -> SimpleNamespace:
    """Follows a line on the bench with a camera that is calibrated, or believed as it was mounted by hand.

    ``pause``: when after its begin, and for how long, the arm stands still though packets go on [s].

    A calibrated camera is the true one on a surface that nobody has seen; with ``shared``, of ``prepared``, camera and
    surface are those that moving over the line has shown, as ``follow --calibration`` has them.

    Returns ``failure`` (None for the whole path), the distance ``beside`` of the tool from the line on the whole way
    ``(N,)`` [m] with its times ``t``, of it what the figure of a simulated run counts ``settled``, how long the run
    went on ``after`` the instant ``BEGIN`` [s], how far the tool ``moved`` meanwhile [m], the ``job``, and what was
    ``seen`` before it.
    """
    cell = set_up(scene)
    known = cell.known
    with SimulatedArm(known.robot, cell.world, cell.noise, known.follower.q_start) as arm:
        eye = Eye(cell, stamp, picture)
        bench = Bench(arm, known.robot, eye)
        model = model_at(scene.model, known.robot, scene.source)
        job = Job(scene, known.robot, model, method_of(scene.method, following_methods()), known.delay, 0.3,
                  _calibration(cell, folder / "camera.json", shared) if calibrated else CalibratedCamera(known.camera))
        job.moved = () if shared is None else shared.moved
        live = WaitingArm(bench, Journal(folder, known.robot, {}))  # type: ignore[arg-type]
        camera = LiveCamera(eye, live, job.detection)  # type: ignore[arg-type]
        begun, seen = 0.0, list[Seen]()

        def ready() -> Any:
            nonlocal begun
            if (look := job.look) is not None and check:
                camera.use(job.calibration.camera, 0.0)
                seen.append(check_line(look, live, camera))
            task = job.ready(live, camera, None)
            begun = arm.t
            if pause is not None:
                bench.paused = begun + pause[0], begun + sum(pause)
            return task

        failure = led(live, job, None, ready)
        t, tcp = arm.tcp_path()
        s, lateral = cell.line.beside(tcp)
        inside = (s > 1e-6) & (s < cell.line.length - 1e-6) & (t > begun + 0.5)
        moved = float(np.linalg.norm(np.diff(tcp[t > BEGIN], axis=0), axis=1).sum())
        counts = job.log.first_used + SETTLING
        # The path's time stood with the arm.
        stood = arm.t - begun - job.log.t[-1] if pause is not None and pause[0] < counts else 0.0
        settled = inside & (t >= begun + counts + stood)
        return SimpleNamespace(failure=failure, after=arm.t - BEGIN, moved=moved, t=t[inside],
                               beside=np.abs(lateral[inside]), settled=np.abs(lateral[settled]), job=job,
                               camera=camera, bench=bench, seen=seen[0] if seen else None)
