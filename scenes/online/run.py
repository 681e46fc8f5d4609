"""Follows on devices: opens and calibrates them, follows, stops on the path where necessary, writes the results."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.bounded_values import parsed_json
from ideal_robot.errors import IdealRobotError, InputError
from ideal_robot.feedforward.registry import feedforward
from ideal_robot.robots.interface import RobotState
from ideal_robot.signals.recording import Recording
from scenes.arms import arm_of, model_at
from scenes.methods import following_methods, method_of
from scenes.metrics import spread_ms
from scenes.online.camera_process import CameraProcess, calibrated_camera
from scenes.online.cell_check import CalibrationMotion, calibrated_by_moving, check_line
from scenes.online.cycle import CycleSettings, holding_share, play_cycles
from scenes.online.devices import Devices, opened_arm
from scenes.online.job import Job
from scenes.online.journal import Journal, Later, owned, remove, rescued, written
from scenes.online.live_arm import LiveArm, answers_within, at_cycle, response_of
from scenes.online.live_sensors import LiveCamera, LiveForce
from scenes.online.processes import (
    give_back,
    memory_together,
    peak_memory,
    processor_seconds,
    stopping_on_signals,
    undisturbed,
)
from scenes.online.result import FollowResult
from scenes.online.self_test import self_test
from scenes.result import Progress, silent
from scenes.scene_file import scene_values
from scenes.scene_files.drawn_line import believed_camera
from scenes.scene_files.force_scene import ForceScene
from scenes.scene_files.line_scene import LineScene
from scenes.scene_files.scene import OWN, Scene, scene_in_file
from sensing.force.sensors import open_force

REST = 0.3
"""Rest behind a stop [s]."""


def follow(scene: Scene, devices: Devices, *, method: str | None = None, calibration: Path | None = None,
           out: Path | None = None, progress: Progress = silent) -> FollowResult:
    """Follows the scene's line or surface once on devices.

    Args:
        scene: from ``load_cell``; its tables of the simulated world are not used.
        devices: addresses of the devices.
        method: method that turns sensor data into commands; the scene's own if None.
        calibration: file of the camera's calibration; where it is not there yet the camera is calibrated by moving.
            None: the camera is taken as the scene has it.
        out: folder of recording, page and figures; ``out/follow/NAME`` if None.
        progress: called with the fraction done.

    Raises:
        InputError: anything of this cannot be used. Nothing has moved then.
        IdealRobotError: the arm does not connect, or does not rest at the start.
    """
    folder = out or Path("out") / "follow" / scene.name
    job = _job(scene, devices, method, calibration)
    _check_devices(job, devices)
    with owned(folder):
        return _followed(scene, devices, job, method, calibration, folder, progress)


def _followed(scene: Scene, devices: Devices, job: Job, method: str | None, calibration: Path | None, folder: Path,
              progress: Progress) -> FollowResult:
    """``follow`` with a job that is set up, and a folder that is this run's."""
    name = method or str(getattr(scene, "method", "ideal"))
    before = rescued(folder)
    at_start = give_back()
    if job.calibration.wanted:
        progress(0.0, "planning the calibration")
        motion = job.calibration_motion()
        moved = list[RobotState]()
        calibrated = _played(scene, job, devices, folder, "calibration", progress,
                             partial(_calibrate, job=job, motion=motion, moved=moved))
        if calibrated.failure is not None:
            return _kept(replace(calibrated, left_behind=before), folder)
        remove(folder)
        # Planned on the calibrated surface; the controller has to restart RSI.
        job = _job(scene, devices, method, calibration)
        job.moved = moved
    if devices.check:
        job.before = _before(folder, scene)
    job.tool_mass = devices.tool_mass
    progress(0.0, "rehearsing")
    job.rehearse()
    at_start = max(at_start, give_back())
    # Loads what a cycle needs before the first packet.
    job.rehearse()
    cycles = job.imagined_cycles()
    next(cycles)
    result = _played(scene, job, devices, folder, name, progress,
                     partial(_follow, job=job, method=name, progress=progress, check=devices.check, cycles=cycles))
    timing = {**result.timing, "memory_at_start_MB": at_start}
    return _kept(replace(result, left_behind=before, timing=timing), folder)


def _before(folder: Path, scene: Scene) -> dict[str, Any]:
    """Figures of the last run of a scene in its folder; none where there are none that can be read."""
    with suppress(OSError, ValueError, IdealRobotError):
        figures = parsed_json((folder / "report.json").read_text(encoding="utf-8"), None, "figures")
        return dict(figures) if isinstance(figures, dict) and figures.get("scene") == scene.name else {}
    return {}


def _kept(result: FollowResult, folder: Path) -> FollowResult:
    """Recording and page written; only then the journal goes."""
    result = written(result, folder)
    remove(folder)
    return result


def _job(scene: Scene, devices: Devices, method: str | None, calibration: Path | None) -> Job:
    """What is followed, set up as far as it goes without devices."""
    robot = scene.arm if isinstance(scene, LineScene) else arm_of(scene.robot)
    if devices.cycle is not None:
        robot = at_cycle(robot, devices.cycle)
    model = model_at(scene.model, robot, scene.source)
    within = answers_within(response_of(model, robot, int(devices.delay)), robot.t_ipo)
    if not isinstance(scene, LineScene | ForceScene):
        raise InputError("expected a scene of kind line or force: devices follow no other", field="kind",
                         value=scene.kind)
    chosen = method_of(method or scene.method, following_methods())
    feedforward("ideal", model, robot, delay=int(devices.delay))
    camera = calibrated_camera(believed_camera(scene.camera, scene.calibration), calibration)
    return Job(scene, robot, model, chosen, int(devices.delay), within, camera)


def _check_devices(job: Job, devices: Devices) -> None:
    for name in job.needs:
        if getattr(devices, name) is None:
            raise InputError(f"this scene needs a {'force sensor' if name == 'force' else name}: give its address",
                             field=f"--{name}")


@dataclass(frozen=True)
class _Opened:
    """Devices of a run."""

    arm: LiveArm
    journal: Journal
    process: CameraProcess | None
    camera: LiveCamera | None
    force: LiveForce | None
    granted: list[str]
    """For even timing, by the system."""


@contextmanager
def _opened(scene: Scene, job: Job, devices: Devices, folder: Path, method: str, progress: Progress
            ) -> Iterator[_Opened]:
    """The devices that the job needs; signals stop the arm."""
    with ExitStack() as stack:
        process = None
        if job.camera is not None and devices.camera is not None:
            progress(0.0, "opening the camera")
            process = CameraProcess(devices.camera, devices.camera_delay, job.camera, scene.camera.detector,  # type: ignore[attr-defined]
                                    devices.patience)
            stack.callback(process.close)
        source = None
        if "force" in job.needs and devices.force is not None:
            source = open_force(devices.force, devices.force_delay)
            stack.callback(source.close)
        journal = Journal(folder, job.robot, {"scene": scene.name, "method": method, "model": scene.model})
        stack.callback(journal.close)
        progress(0.0, "waiting for the arm")
        granted = stack.enter_context(undisturbed(devices.core))
        link = stack.enter_context(opened_arm(devices, job.robot, job.answers_within))
        arm = LiveArm(link, journal)
        force = None if source is None else LiveForce(source, arm)
        if force is not None:
            stack.callback(force.close)
        camera = None if process is None else LiveCamera(process, arm, job.detection)
        stack.enter_context(stopping_on_signals(arm.stop))
        yield _Opened(arm, journal, process, camera, force, granted)


def _calibrate(opened: _Opened, job: Job, motion: CalibrationMotion, moved: list[RobotState]) -> None:
    if opened.camera is None:
        raise InputError("calibrating by moving needs a camera", field="--camera")
    job.approach(opened.arm, opened.force)
    job.calibration.found(calibrated_by_moving(motion, opened.arm, opened.camera))
    moved += opened.arm.reported


def _follow(opened: _Opened, job: Job, method: str, progress: Progress, check: bool, cycles: Iterator[float]) -> None:
    if check:
        job.tested = self_test(opened.arm, cycles, job.ahead)
    job.approach(opened.arm, opened.force)
    look, camera = job.look, opened.camera
    if check and look is not None and camera is not None:
        camera.use(job.calibration.camera, job.calibration.time_offset)
        camera.checked = check_line(look, opened.arm, camera).json()
    task = job.ready(opened.arm, opened.camera, opened.force)
    shown = Later(progress)
    opened.arm.between.append(shown.catch_up)
    opened.arm.begin()
    play_cycles(opened.arm, job.robot, task, job.log,
                CycleSettings(job.braking, REST, job.longest, job.expected, method), shown)


def _played(scene: Scene, job: Job, devices: Devices, folder: Path, method: str, progress: Progress,
            work: Callable[[_Opened], None]) -> FollowResult:
    """Opens the devices, does the work and returns its result, however it ended."""
    with _opened(scene, job, devices, folder, method, progress) as opened:
        arm = opened.arm
        pids = [os.getpid()] + ([opened.process.pid] if opened.process is not None and opened.process.pid else [])
        begun, used = time.perf_counter(), [processor_seconds(pid) for pid in pids]
        try:
            work(opened)
            failure = job.log.failure
        except IdealRobotError as error:
            if not arm.cycles:
                raise
            failure = str(error)
        wall = max(time.perf_counter() - begun, 1e-9)
        shares = [(processor_seconds(pid) - before) / wall for pid, before in zip(pids, used, strict=True)]
        timing = {"answer_ms": spread_ms(np.array(arm.link.answer_times)),
                  "computing_ms": spread_ms(np.array(job.log.cycles)),
                  "processor_share": dict(zip(("follower", "camera"), shares, strict=False)),
                  "peak_memory_MB": dict(zip(("follower", "camera"), map(peak_memory, pids), strict=False)),
                  "memory_together_MB": memory_together(pids), "seconds": wall, "granted": opened.granted}
        if job.tested is not None:
            timing["self_test"] = job.tested.json()
        recording = _recorded(opened.journal, job)
        recording = replace(recording, meta={**recording.meta, "stopped_because": failure})
        return FollowResult(scene, method, failure, recording, job.figures(), _told(opened, devices), timing,
                            job.planned())


def _recorded(journal: Journal, job: Job) -> Recording:
    """The recording of a run, all of it by the controller's time, which goes on through approach, calibration and run.

    The job's own time begins with the run, and waits where cycles are lost.
    """
    recording, (run, clock) = journal.recording(), journal.times()
    if not (job.log.t and len(run)):
        return recording
    columns = job.columns(_by_clock(recording.t, clock, run))
    if "cam_t" in columns:
        columns["cam_t"] = _by_clock(columns["cam_t"], run, clock)
    return replace(recording, columns={**recording.columns, **columns},
                   meta={**recording.meta, "run_begins_at": float(_by_clock(np.zeros(1), run, clock)[0])})


def _by_clock(t: Array, clock: Array, other: Array) -> Array:
    """Times ``t`` of one clock by the other [s], both read at once ``(N,)``; beyond the readings both go alike."""
    return np.interp(t, clock, other) + t - np.clip(t, clock[0], clock[-1])


def _told(opened: _Opened, devices: Devices) -> dict[str, Any]:
    """What each device did."""
    arm, process, camera, force = opened.arm, opened.process, opened.camera, opened.force
    stamps = getattr(arm.link, "stamps", None)
    report: dict[str, Any] = {"arm": {"address": devices.arm, "link": asdict(arm.link.counts),
                                      "time_stamps": None if stamps is None else stamps.described(),
                                      "cycles_not_recorded": opened.journal.unwritten,
                                      "clock": arm.clock.report().to_dict()}}
    if not getattr(arm.link, "relative", True):
        report["arm"]["holding_share"] = holding_share(opened.journal.recording().joints("q_c"), arm.robot)
    if process is not None and camera is not None:
        report["camera"] = {"address": devices.camera, "stamps": process.stamps, "clock": process.clock,
                            "age_when_used_ms": spread_ms(np.array(camera.ages)), "left_out": process.left_out,
                            "too_old": camera.late, "from_the_future": camera.early, "ended": process.ended,
                            "check": camera.checked}
    if force is not None:
        report["force"] = {"address": devices.force, "counts": asdict(force.source.counts),
                           "clock": force.source.clock.report().to_dict(), "stuck": force.signs.stuck,
                           "impossible": force.signs.impossible, "leapt": force.signs.leapt,
                           "without_noise": force.signs.quiet, "untimely": force.untimely}
    return report


# Scene files as a follower reads them: without the simulated world, which a real cell's file need not have.

FOLLOWED: dict[str, type[Scene]] = {"line": LineScene, "force": ForceScene}


def load_cell(name_or_path: str | Path) -> Scene:
    """Loads and checks a scene that can be followed on devices.

    Raises:
        InputError: no such scene, another kind, an unknown key, a value out of range, the model of a simulated arm.
    """
    path, values = scene_values(name_or_path)
    kind = values.get("kind")
    if not isinstance(kind, str) or kind not in FOLLOWED:
        raise InputError(f"only scenes of kind {', '.join(FOLLOWED)} are followed on devices", file=path, field="kind",
                         value=kind)
    scene = scene_in_file(FOLLOWED[kind], values, path)
    if scene.model == OWN:
        raise InputError("the model of a simulated arm; identify the real one and give the path of its model",
                         file=path, field="model", value=OWN)
    return scene
