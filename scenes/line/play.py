"""Plays a line-following scene: camera, sensing, planning and ideal robot around the simulated arm ([L] Fig. 1)."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.elasticity.deflection import GearDeflection
from ideal_robot.errors import InputError
from ideal_robot.feedforward.base import Feedforward
from ideal_robot.feedforward.passthrough import PassThrough
from ideal_robot.model.model import Model
from planning.line.direct_feedback import DirectFeedback
from planning.path.stopping import stopping_rows
from planning.planning_error import LineLostError, OutOfReachError
from scenes.line.cell import START, Cell, Prepared, detection, prepared, set_up, streams
from scenes.line.compare import LineComparison, compare_lines
from scenes.line.recording import line_recording
from scenes.line.result import SETTLING, ControlError, FieldShown, LineResult, Timing
from scenes.line.scene import LineScene, geometry
from scenes.metrics import PathErrors, path_errors
from scenes.models import model_for
from scenes.result import Progress, silent
from sensing.camera.field import Field
from sensing.camera.line_detection import LineField, detect_line, search_windows
from sensing.camera.line_polynomial import fit_line_polynomial
from sim.arm.arm import SimulatedArm
from sim.camera.camera import RenderedCamera

SceneModel = LineScene
METHODS = ("none", "direct_feedback", "sensor_path", "ideal")
REST = 0.2
"""Time the recording goes on after the path has come to rest [s]."""
SHOWN = 4
"""Camera fields kept as pictures."""


def curves(scene: LineScene) -> dict[str, Array]:
    """Drawn line and reference path ``(N, 3)`` [m], for the viewer."""
    where = geometry(scene, streams(scene)[0])
    return {"line": where.drawn, "reference": where.reference}


def run(scene: LineScene, *, method: str | None = None, out: Path | None = None, progress: Progress = silent,
        gains: tuple[float, float] | None = None, shared: Prepared | None = None) -> LineResult:
    """Follows the line once.

    Args:
        scene: what to play.
        method: one of ``METHODS``; the scene's own if None.
        out: folder for recording and report; nothing is written without.
        progress: told how far it is.
        gains: K_p, K_d of direct sensor feedback; found by search if None.
        shared: from ``prepared`` of the same scene, to save its time.

    Raises:
        InputError: the scene cannot be played: unknown method, line out of reach, unreachable speed.
    """
    method = method or scene.method
    if method not in METHODS:
        raise InputError(f"expected one of {', '.join(METHODS)}", field="method", value=method)
    if method == "direct_feedback" and gains is None:
        from scenes.line.compare import best_gains

        with prepared(scene) as own:
            gains = best_gains(scene, own, progress=lambda fraction, text: progress(0.8 * fraction, text))[0]
    if shared is None:
        with prepared(scene, progress) as own:
            result = _play(set_up(scene), method, gains, own, progress, pictures=out is not None)
    else:
        result = _play(set_up(scene), method, gains, shared, progress, pictures=out is not None)
    if out is None:
        return result
    from scenes.line.page import write_run

    return write_run(result, out)


def compare(scene: LineScene, *, out: Path | None = None, progress: Progress = silent) -> LineComparison:
    """Plays the scene with every method and with direct sensor feedback at its best gain."""
    return compare_lines(scene, run, out=out, progress=progress)


def assumed_latency(model: Model) -> float:
    """By how much the model says that the camera's time stamps are wrong [s]; 0 where it says nothing."""
    return sum(effect.coefficients[0] for effect in model.effects if effect.name == "camera_latency")


@dataclass
class _Log:
    """What is written down while the scene is played."""

    t: list[float] = field(default_factory=list)
    q_d: list[Array] = field(default_factory=list)
    fields: list[LineField] = field(default_factory=list)
    shown: list[tuple[pin.SE3, FieldShown]] = field(default_factory=list)
    cycles: list[float] = field(default_factory=list)
    with_field: list[bool] = field(default_factory=list)
    s: list[float] = field(default_factory=list)
    believed: list[float] = field(default_factory=list)
    used: int = 0
    first_used: float = np.nan
    failure: str | None = None


class _Loop:
    """The two loops of [L] Fig. 1 around one arm, one method of turning ``q_d`` into ``q_c``."""

    def __init__(self, cell: Cell, method: str, gains: tuple[float, float] | None) -> None:
        self.cell, self.method, self.follower = cell, method, cell.follower
        self.detection = detection(cell)
        self.n_d = cell.follower.n_d
        self.feedforward: Feedforward = PassThrough(cell.world.t_ipo)
        self.deflection: GearDeflection | None = None
        self.latency = 0.0
        if method == "ideal":
            from ideal_robot.feedforward.ideal import IdealRobot

            model = model_for(cell.scene, cell.robot)
            self.feedforward = IdealRobot.of(model, cell.robot, self.n_d, delay=int(cell.world.correction_delay))
            self.deflection = GearDeflection(model, cell.world.t_ipo)
            self.latency = assumed_latency(model)
        self.direct = DirectFeedback(self.follower, *gains) if method == "direct_feedback" and gains else None
        self.state: Any
        self.state = self.feedforward.init(self.follower.q_start)
        # Once for nothing, so that compiling does not fall into the first cycles.
        self.feedforward.step(self.state, np.tile(self.follower.q_start, (self.n_d, 1)))
        self.follower.reference.project(self.follower.reference.position(np.array([0.1])), 0.1)

    def sense(self, arrived: Field) -> LineField:
        """Line points of a field and what follows from them for the path."""
        follower = self.follower
        arrived = replace(arrived, t_stamp=arrived.t_stamp + self.latency)
        pose = follower.history.pose(arrived.t_stamp)
        seen = detect_line(arrived, self.cell.camera, follower.predict(arrived.t_stamp).seen_from(pose), self.detection)
        if self.direct is not None:
            self.direct.update(seen, pose)
        follower.update(seen, pose)
        return seen

    def desired(self, t: float) -> Array:
        """Desired joint positions over the horizon ``(n_d, n)``: of the sensed path, or of the reference."""
        if self.method in ("sensor_path", "ideal"):
            return self.follower.horizon(t)
        self.follower.fusion.travel(float(self.follower.profile.s(t - START)))
        k = min(max(round((t - START) / self.cell.world.t_ipo), 0), len(self.follower.q_reference) - self.n_d)
        return self.follower.q_reference[k : k + self.n_d]

    def command(self, t: float, q_d: Array) -> Array:
        """Commanded joint positions ``(n,)``."""
        if self.direct is not None:
            return self.direct.command(t)
        q_c, self.state = self.feedforward.step(self.state, q_d)
        return q_c

    def observe(self, t: float, q: Array, q_d: Array) -> None:
        """Takes the motor angles at ``t``; the arm's are those less the gears' deflection, where a model knows it."""
        q_a = q if self.deflection is None else q - self.deflection.at(q_d)
        self.follower.observe(t, q_a)


def _play(cell: Cell, method: str, gains: tuple[float, float] | None, shared: Prepared, progress: Progress, *,
          pictures: bool) -> LineResult:
    scene, follower = cell.scene, cell.follower
    if shared.hand_eye is not None:
        cell.camera = shared.hand_eye.camera
    loop, log = _Loop(cell, method, gains), _Log()
    with SimulatedArm(cell.robot, cell.world, cell.noise, follower.q_start) as arm:
        started = time.perf_counter()
        _cycles(loop, arm, shared.camera, log, progress)
        wall = time.perf_counter() - started
        history = arm.history()
        tcp = np.array([arm.tcp_of(q).translation for q in history["q_a"]])
        recording = line_recording(arm, scene, method, np.array(log.t), np.array(log.q_d), log.fields, log.failure,
                                   cell.camera)
    shown = tuple(replace(seen, image=shared.camera.frame(pose)) for pose, seen in log.shown) if pictures else ()
    whole, error, followed_from = _control_error(cell, history["t"], tcp, log.first_used)
    return LineResult(
        scene=scene, method=method, control_error=error, control_error_from_start=whole,
        path_errors=_path_errors(cell, log, history["t"], tcp), fields_seen=len(log.fields), fields_used=log.used,
        recording=recording, timing=Timing(np.array(log.cycles), np.array(log.with_field, dtype=bool), wall,
                                           float(history["t"][-1])),
        geometry=cell.geometry, followed_from=followed_from, failure=log.failure, urdf=cell.robot.urdf,
        shown=shown, world=cell.world.table(), hand_eye=shared.hand_eye, warning=shared.uncalibrated,
        s_reference=np.array(log.s), believed=np.array(log.believed))


def _cycles(loop: _Loop, arm: SimulatedArm, camera: RenderedCamera, log: _Log, progress: Progress) -> None:
    """Cycle by cycle until the path is done and the arm at rest."""
    follower, T = loop.follower, arm.t_ipo
    count = int(np.ceil((START + follower.duration + REST) / T))
    picture_at = set(np.linspace(0.35 * count, 0.9 * count, SHOWN).astype(int))
    under_way: list[Field] = []
    q = follower.q_start
    stopping: Iterator[Array] | None = None
    still = 0
    last = np.tile(q, (loop.n_d, 1))
    for k in range(count):
        t = k * T
        begin = time.perf_counter()
        loop.observe(t, q, last)
        new = [item for item in under_way if item.t_arrival <= t]
        under_way = [item for item in under_way if item.t_arrival > t]
        if stopping is None:
            try:
                for item in sorted(new, key=lambda late: late.t_arrival):
                    seen = loop.sense(item)
                    log.fields.append(seen)
                    log.used += int(seen.seen)
                    if seen.seen and not np.isfinite(log.first_used):
                        log.first_used = t
                last = loop.desired(t)
            except (LineLostError, OutOfReachError) as error:
                log.failure = str(error)
                speed = float(follower.profile.speed(t - START))
                stopping = stopping_rows(last[1:], T, speed, loop.cell.scene.reference.acceleration)
        if stopping is not None:
            last = next(stopping)
        q_c = loop.command(t, last) if log.failure is None or loop.direct is None else loop.direct.command(t)
        log.cycles.append(time.perf_counter() - begin)
        log.with_field.append(bool(new))
        log.t.append(t)
        log.q_d.append(last[0])
        log.s.append(float(follower.profile.s(t - START)))
        log.believed.append(follower.planned(t)[0] if loop.method in ("sensor_path", "ideal") else 0.0)
        exposures = camera.due(t, t + T)
        windows = []
        for exposure in exposures:
            pose = follower.history.pose(exposure)
            windows.append(search_windows(loop.cell.camera, follower.predict(exposure).seen_from(pose), loop.detection))
        q = arm.cycle(q_c).q
        for exposure, wanted in zip(exposures, windows, strict=True):
            under_way.append(camera.windows(exposure, arm.tcp_at, wanted))
        if k in picture_at and new and log.fields and log.fields[-1].seen:
            log.shown.append((arm.tcp_at(log.fields[-1].t), _picture(loop, log.fields[-1], new[-1])))
            picture_at.discard(k)
        elif k in picture_at:
            picture_at.discard(k)
            picture_at.add(k + 1)
        still = still + 1 if stopping is not None and np.allclose(last, last[0], atol=1e-9) else 0
        if still * T > REST:
            break
        if k % 8 == 0:
            progress(k / count, loop.method)


def _picture(loop: _Loop, seen: LineField, raw: Field) -> FieldShown:
    """The points found in a field and the polynomial through them ([L] 5); the image itself is rendered later."""
    follower, reference = loop.follower, loop.cell.reference
    pose = follower.history.pose(seen.t)
    points = seen.points_tcp[seen.used] @ pose.rotation.T + pose.translation
    s, deviation, _ = reference.project(points, float(follower.profile.s(seen.t - START)) + 0.06)
    polynomial = fit_line_polynomial(s, deviation, seen.sigma[seen.used])
    at = np.linspace(polynomial.span[0] - 0.01, polynomial.span[1] + 0.01, 60)
    frames = reference.frames(at)
    curve = frames.position + polynomial.deviation(at)[0][:, None] * frames.normal
    return FieldShown(seen.t, np.empty((0, 0), dtype=np.uint8), raw.windows, seen.pixels, seen.used,
                      loop.cell.camera.project_tool((curve - pose.translation) @ pose.rotation))


def _control_error(cell: Cell, t: Array, tcp: Array, first_used: float) -> tuple[ControlError, ControlError, float]:
    """Distance of the true TCP from the drawn line: over all of it, and from 0.3 s after it is first followed."""
    up = cell.geometry.plane.rotation[:, 2]
    nearest = cell.line.nearest(tcp - np.outer((tcp - cell.geometry.plane.translation) @ up, up))
    inside = (nearest.s > 1e-6) & (nearest.s < cell.line.length - 1e-6)
    if not inside.any() or not np.isfinite(first_used):
        nothing = ControlError.of(np.empty(0), np.empty(0), np.empty(0))
        return nothing, nothing, float("nan")
    followed_from = max(first_used, float(t[np.argmax(inside)]))
    counts = inside & (t >= followed_from + SETTLING)
    whole, counted = (ControlError.of(t[which], nearest.s[which], nearest.lateral[which]) for which in (inside, counts))
    return whole, counted, followed_from


def _path_errors(cell: Cell, log: _Log, t: Array, tcp: Array) -> PathErrors | None:
    """The true TCP against the desired path, once the line is followed."""
    times, q_d = np.array(log.t), np.array(log.q_d)
    moving = np.flatnonzero(np.abs(np.diff(q_d, axis=0)).max(axis=1) > 1e-7)
    if len(moving) < 8:
        return None
    pose = cell.robot.fk()
    part = slice(moving[0], moving[-1] + 1)
    x_d = np.array([pose(q).translation for q in q_d[part]])
    return path_errors(times[part], x_d, t, tcp)
