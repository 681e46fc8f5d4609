"""A cell with a force sensor in lockstep, without wires and clocks: what is done to it is the same every time."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.robots.interface import RobotState
from planning.path.kinematics import InverseKinematics
from scenes.force.cell import Cell, GlueWorld, set_up, true_tip
from scenes.force.play import force_figures
from scenes.methods import following_methods, method_of
from scenes.metrics import ControlError
from scenes.online.camera_process import CalibratedCamera
from scenes.online.job import Job
from scenes.online.journal import Journal
from scenes.online.live_sensors import LiveCamera, LiveForce
from scenes.scene_files.force_scene import ForceScene
from sensing.clock_relation import ClockRelation
from sensing.force.sensors import Reading, ReadingCounts
from sim.arm.arm import SimulatedArm
from sim.contact.contact import TipContact
from tests.scenes.follow.eye_on_bench import Bench as EyeBench
from tests.scenes.follow.eye_on_bench import Eye, WaitingArm, led

Spoil = Callable[[float, Array], Array]
"""What a sensor tells that has been faulty for a time [s], of a wrench ``(6,)``."""
Z = np.eye(6)[2]


def frozen(noise: float) -> Spoil:
    """Tells the wrench with which it began for ever, with this noise [N]."""
    rng, held = np.random.default_rng(5), []

    def spoil(since: float, wrench: Array) -> Array:
        held[:] = held or [wrench]
        return held[0] + noise * rng.standard_normal(6) * np.repeat([1.0, 0.07], 3)

    return spoil


def deaf(noise: float) -> Spoil:
    """Feels nothing but this noise [N]."""
    rng = np.random.default_rng(6)
    return lambda since, wrench: noise * rng.standard_normal(6) * np.repeat([1.0, 0.07], 3)


FAULTS: dict[str, Callable[[], Spoil]] = {
    "nothing but noise of 0.3 mN": lambda: deaf(3e-4),
    "nothing but noise of 0.3 N": lambda: deaf(0.3),
    "stuck at its last value": lambda: frozen(0.0),
    "stuck, with its usual noise": lambda: frozen(0.3),
    "at zero": lambda: deaf(0.0),
    "a leap of +30 N": lambda: lambda since, wrench: wrench + 30.0 * Z,
    "a leap of -30 N": lambda: lambda since, wrench: wrench - 30.0 * Z,
    "drift of +2 N/s": lambda: lambda since, wrench: wrench + 2.0 * since * Z,
    "drift of -2 N/s": lambda: lambda since, wrench: wrench - 2.0 * since * Z,
    "drift of +2 N/s in x": lambda: lambda since, wrench: wrench + 2.0 * since * np.eye(6)[0],
    "a gain of 0.7": lambda: lambda since, wrench: 0.7 * wrench,
    "a gain that fades by 15 %/s": lambda: lambda since, wrench: max(1.0 - 0.15 * since, 0.0) * wrench,
    "wrong sign": lambda: lambda since, wrench: -wrench,
    "wrong order of axes": lambda: lambda since, wrench: wrench[[2, 0, 1, 5, 3, 4]],
}
"""What is wrong with a force sensor from some instant on."""
STAGES = ("turning", "search", "press", "approach", "settle", "travel")
"""Of a job with a surface, in their order: what a fault may begin in."""


class BenchArm(WaitingArm):
    """Counts how often its time begins, and says when it last did by the simulated arm's time [s]."""

    begun, begun_at = 0, 0.0

    def begin(self) -> None:
        super().begin()
        self.begun += 1
        self.begun_at = self.link.arm.t  # type: ignore[attr-defined]


class Bench(EyeBench):
    """A simulated arm with a force sensor, and with a camera where the scene has one; a ``WrenchSource``, too.

    ``spoil``: what the sensor makes of a wrench ``(6,)`` that is faulty for so long [s]; ``stage``: when that begins.
    """

    def __init__(self, cell: Cell, arm: SimulatedArm, eye: Eye | None, spoil: Spoil | None = None,
                 stage: str | None = None, currents: bool = True) -> None:
        super().__init__(arm, cell.known.robot, eye)
        self.cell, self.spoil, self.stage, self.currents = cell, spoil, stage, currents
        self.counts, self.clock = ReadingCounts(), ClockRelation()
        self.contact = TipContact(self.arm, self.cell.surface, true_tip(self.cell.known.scene.tip))
        self._due: deque[tuple[float, float, Array]] = deque()
        self.live: BenchArm | None = None
        self.force: LiveForce | None = None
        self.since = np.inf

    pause: tuple[str, float, float] | None = None
    """In which stage, how long after its begin, and for how long the arm stands still though packets go on [s]."""

    def receive(self) -> RobotState:
        if self.pause is not None and self.at() == self.pause[0]:
            (_, after, lasts), self.pause = self.pause, None
            self.paused = self.arm.t + after, self.arm.t + after + lasts
        t0, state, t1 = self.arm.t, super().receive(), self.arm.t
        for sample in self.cell.sensor.due(t0, t1, self.arm.tcp_at, self.contact.force_at):
            if not np.isfinite(self.since) and self.stage is not None and self.at() == self.stage:
                self.since = sample.t
            wrench = sample.wrench
            if sample.t >= self.since and self.spoil is not None:
                wrench = self.spoil(sample.t - self.since, wrench)
            self._due.append((sample.t_arrival, sample.t, wrench))
        while self._due and self._due[0][0] <= t1:
            _, stamp, wrench = self._due.popleft()
            self.clock.add(stamp, stamp)
            if self.force is not None:
                self.force._readings.append((stamp, wrench))
        return state if self.currents else RobotState(state.t, state.q, np.full(self.robot.n, np.nan))

    def at(self) -> str:
        """The stage that is on."""
        begun = 0 if self.live is None else self.live.begun
        log = self.contact._log
        felt = float(log.row(log.rows - 1)[1]) if log.rows else 0.0
        first = self.turns
        if begun <= first:
            return "turning" if begun == first else ""
        if begun == first + 1:
            return "search" if felt == 0.0 else "press" if felt > 5.0 else ""
        phase = str(self.task.follower.phase.value)
        if phase != "travel":
            return phase
        self._travelling += self.t_ipo
        return "travel" if self._travelling > self.begins else ""

    begins = 1.0
    """Time of the travel after which a fault in it begins [s]."""
    turns = 1
    """How often time has begun when the tool is turned."""
    task: Any = None
    _travelling = 0.0

    def read(self, timeout: float) -> list[Reading]:
        """Readings are handed on in ``receive``, whatever the thread does."""
        time.sleep(timeout)
        return []

    def close(self) -> None:
        return


def followed(scene: ForceScene, folder: Path, before: dict[str, Any] | None = None, above: float = 0.0,
             tool_mass: float | None = None, pause: tuple[float, float] | None = None,
             pause_in: tuple[str, float, float] | None = None, **faults: Any) -> SimpleNamespace:
    """Follows a scene on the bench, with the arm held at first so far above the start of the path [m].

    Returns ``failure`` (None for the whole path), the largest true normal force ``force`` since the fault began [N] (of
    the whole run without one) and at its end ``left``, how far the tip moved from then on ``moved`` [m], how long after
    it the arm was stopped ``after`` [s], the ``job`` and the ``recording``; of the travel the RMS error of the true
    normal force ``rms`` [N], and where a camera looks for a line the tool's distance from it, ``beside``.
    """
    cell = set_up(scene)
    kinematics, q_start = InverseKinematics(cell.known.robot), cell.known.q_start()
    held = q_start + kinematics.away(q_start, above * cell.known.reference.frames(np.zeros(1)).up[0])
    with SimulatedArm(cell.known.robot, cell.world, cell.noise, held) as arm:
        known, eye = cell.known, Eye(cell) if scene.task == "glue" else None
        bench = Bench(cell, arm, eye, **faults)
        bench.pause = pause_in
        job = Job(scene, known.robot, known.model, method_of(scene.method, following_methods()), known.delay, 0.3,
                       CalibratedCamera(known.camera if eye is None else eye.true, folder / "camera.json"))
        job.before, job.tool_mass = before or {}, tool_mass
        journal = Journal(folder, known.robot, {})
        live = bench.live = BenchArm(bench, journal)
        force = bench.force = LiveForce(bench, live)
        camera = None if eye is None else LiveCamera(eye, live, job.detection)  # type: ignore[arg-type]

        def ready() -> Any:
            bench.task = job.configured.task
            task = job.ready(live, camera, force)
            if pause is not None:
                bench.paused = arm.t + pause[0], arm.t + sum(pause)
            return task

        failure = led(live, job, force, ready)
        force.close()
        history, begun = bench.contact.history(), bench.since if np.isfinite(bench.since) else 0.0
        since = history["t"] >= begun
        length = np.linalg.norm(np.diff(history["tip"][since], axis=0), axis=1).sum()
        largest = float(history["normal"][since].max(initial=0.0))
        moving = [live.begun_at + t for t in job.log.travel]
        rms = force_figures(scene, history, moving).rms
        beside = None if eye is None or failure is not None else _beside(cell, history, moving,
                                                                        live.begun_at + job.log.first_used)
        return SimpleNamespace(failure=failure, force=largest, left=float(history["normal"][-1]), moved=float(length),
                               after=arm.t - begun, job=job, recording=journal.recording(), bench=bench, rms=rms,
                               beside=beside)


def _beside(cell: Cell, history: dict[str, Array], moving: list[float], first_used: float) -> ControlError:
    """Distance of the true tip from the drawn line during the travel, as a simulated run has it."""
    travel = slice(*np.searchsorted(history["t"], [moving[0], moving[-1]]))
    with closing(GlueWorld(cell)) as world:
        return world.control_error(first_used, history["t"][travel], history["tip"][travel])
