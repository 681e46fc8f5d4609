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
from scenes.camera_world import camera_settings
from scenes.line.cell import Cell, set_up
from scenes.methods import following_methods, method_of
from scenes.models import model_at
from scenes.online.camera_process import CalibratedCamera, Header
from scenes.online.camera_worker import _Worker
from scenes.online.cell_check import check_line
from scenes.online.cycle import CycleSettings, play_cycles
from scenes.online.journal import Journal
from scenes.online.line_job import LineJob
from scenes.online.live_arm import LiveArm
from scenes.online.live_sensors import LiveCamera
from scenes.scene_files.line_scene import LineScene
from sensing.camera.camera_device import Gray
from sensing.camera.cameras import Frame
from sensing.clock_relation import ClockRelation
from sim.arm.arm import SimulatedArm
from sim.camera.live_camera import LiveCamera as TrueCamera

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


class Bench:
    """A simulated arm that is handed each command at once, and a camera on it; a ``Link`` and a ``CameraProcess``.

    Args:
        cell: the scene set up.
        arm: simulated.
        stamp: what the camera says of when it exposed [s].
        picture: what becomes of a picture taken at a time [s].
    """

    def __init__(self, cell: Cell, arm: SimulatedArm, stamp: Stamp | None, picture: Picture | None) -> None:
        self.cell, self.arm, self._stamp, self._picture = cell, arm, stamp, picture
        self.robot, self.t_ipo, self.fault = cell.known.robot, cell.known.robot.t_ipo, None
        self.commanded = arm.truth.q_m.copy()
        self.answer_times: list[float] = []
        self.arrived, self.gone_on, self.counts, self.ended = 0.0, 0, SimpleNamespace(), None
        self.settings = camera_settings(cell.known.scene.camera)
        self.eye = TrueCamera(cell.true_camera, cell.line, self.settings, cell.camera_noise, relief=cell.relief)
        self.worker = _Worker(cell.known.camera, cell.known.scene.camera.detector, self)  # type: ignore[arg-type]
        self.clock, self.messages = ClockRelation(self.settings.latency), deque[Any]()
        self._due: deque[tuple[float, Frame]] = deque()
        self._number = 0

    def send(self, q_c: Any) -> None:
        """A command ``(n,)`` [rad]; or what the camera's process tells, kind and content."""
        if isinstance(q_c, tuple):
            self.messages.append(q_c[1])
        else:
            self.commanded = np.array(q_c)

    def skip(self, q_c: Array) -> None:
        raise NotImplementedError

    def receive(self) -> RobotState:
        state = self.arm.cycle(self.commanded)
        self.arrived = self.arm.t
        s = self.settings
        while (at := self._number / s.rate) + 0.5 * s.exposure < self.arm.t:
            self._number += 1
            poses = [self.arm.tcp_at(max(at + ((i + 0.5) / s.sub_exposures - 0.5) * s.exposure, 0.0))
                     for i in range(s.sub_exposures)]
            gray = self.eye.picture(poses, at)
            gray = gray if self._picture is None else self._picture(at, gray)
            stamp = at if self._stamp is None else self._stamp(at)
            self._due.append((at + s.latency, Frame(self._number, stamp, at + s.latency, gray)))
        while self._due and self._due[0][0] <= self.arm.t:
            arrived, frame = self._due.popleft()
            if self.clock.add(frame.stamp, arrived):
                self.worker._frames.append(frame)
                self.messages.append(Header(frame.number, self.clock.host(frame.stamp), arrived))
        return state

    def poll(self) -> list[Any]:
        """See ``CameraProcess``."""
        found = list(self.messages)
        self.messages.clear()
        return found

    def ask(self, *asked: Any) -> None:
        """See ``CameraProcess``."""
        self.worker.answer("detect", asked)

    def use(self, camera: Any) -> None:
        """See ``CameraProcess``."""
        self.worker.answer("camera", camera)


def followed(scene: LineScene, folder: Path, *, stamp: Stamp | None = None, picture: Picture | None = None,
             calibrated: bool = True, check: bool = False) -> SimpleNamespace:
    """Follows a line on the bench with a camera that is calibrated, or believed as it was mounted by hand.

    Returns ``failure`` (None for the whole path), the distance ``beside`` of the tool from the line on the whole way
    ``(N,)`` [m] with its times ``t``, the ``job``.
    """
    cell = set_up(scene)
    known = cell.known
    with SimulatedArm(known.robot, cell.world, cell.noise, known.follower.q_start) as arm:
        bench = Bench(cell, arm, stamp, picture)
        model = model_at(scene.model, known.robot, scene.source)
        job = LineJob(scene, known.robot, model, method_of(scene.method, following_methods()), known.delay, 0.3,
                      CalibratedCamera(cell.true_camera, folder / "camera.json") if calibrated
                      else CalibratedCamera(known.camera))
        live = LiveArm(bench, Journal(folder, known.robot, {}))  # type: ignore[arg-type]
        camera = LiveCamera(bench, live, job.detection)  # type: ignore[arg-type]
        failure, begun = None, 0.0
        try:
            live.approach(job.q_start)
            if (look := job.look) is not None and check:
                camera.use(job.calibration.camera, 0.0)
                camera.apart = check_line(look, live, camera)
            task = job.ready(live, camera, None)
            live.begin()
            begun = arm.t
            play_cycles(live, job.robot, task, job.log, CycleSettings(job.braking, 0.3, job.longest, job.expected, ""),
                        lambda *_: None)
            failure = job.log.failure
        except IdealRobotError as error:
            failure = str(error)
        t, tcp = arm.tcp_path()
        s, lateral = cell.line.beside(tcp)
        inside = (s > 1e-6) & (s < cell.line.length - 1e-6) & (t > begun + 0.5)
        return SimpleNamespace(failure=failure, t=t[inside], beside=np.abs(lateral[inside]), job=job, camera=camera)
