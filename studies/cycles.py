"""What one control cycle costs: of the ideal robot alone, of following a line with its camera, of planning alone."""

from __future__ import annotations

import gc
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any
from unittest import mock

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.feedforward.base import Feedforward
from ideal_robot.feedforward.friction_adaptation import AdaptedIdeal, FrictionAdaptation
from ideal_robot.feedforward.friction_curve import FrictionCurve
from ideal_robot.feedforward.inverse import AHEAD, Inverse
from ideal_robot.feedforward.linear_inverse import LinearInverse
from ideal_robot.loop.from_model import loop_model
from ideal_robot.loop.impulse_response import LinearLoop
from ideal_robot.model.model import Model
from ideal_robot.robots.interface import RobotState
from ideal_robot.robots.robot import Robot
from planning.line.line_follower import FollowerSettings, LineFollower
from scenes.line.cell import prepared
from scenes.line.kind import run
from scenes.methods import ADAPTED, IDEAL
from scenes.models import shipped_model
from scenes.online.task import Task
from scenes.scene_files.line_scene import LineScene
from scenes.scene_files.scene import chosen
from sim.camera.bullet_camera import BulletCamera
from studies.report import head, row, scene_of
from tests.planning.cell import Camera, T, displaced, distance, follow, kr6, profile, reference, sine_points

N_D = 30


def cycle(cycles: int = 20000) -> None:
    """A cycle of the ideal robot: six joints, n_d = 30, another horizon in every cycle, as with a sensor [ms].

    The methods play the same cycle in turn, so that what the machine does besides falls on all of them.
    """
    robot = Robot.load("kr15")
    model = Model.load(shipped_model("kr15"))
    loop = loop_model(model, robot, delay=1)
    t = 0.012 * np.arange(2000)
    q_d = robot.home + 0.2 * np.sin(np.outer(t, 2 * np.pi * np.array([0.3, 0.4, 0.5, 0.6, 0.7, 0.8])))
    tool = robot.tool_place
    laws: dict[str, Feedforward] = {
        "`linear`": LinearInverse(LinearLoop.of(loop, robot.home), N_D),
        "`precorrected`": Inverse(loop, None, AHEAD),
        "`ideal`": Inverse(loop, N_D),
        "`adapted`, a line": AdaptedIdeal(Inverse(loop, N_D), FrictionAdaptation(loop, tool=tool)),
        "`adapted`, a known path": AdaptedIdeal(Inverse(loop, N_D), FrictionAdaptation(loop, tool=tool),
                                                curve=FrictionCurve(loop)),
    }
    # A tenth more than the model expects: torques far from it would not be learned from, and cost less.
    qd = np.gradient(q_d, 0.012, axis=0)
    tau = 1.1 * model.inverse_dynamics(q_d, qd, np.gradient(qd, 0.012, axis=0))
    elapsed, busy = (1e3 * seconds for seconds in _timed(list(laws.values()), q_d, tau, cycles))
    ideal = np.median(busy[list(laws).index("`ideal`")])
    head("[ms]", "median", "processor median", "processor mean", "processor p99.9", "processor median over `ideal`")
    for name, times, own in zip(laws, elapsed, busy, strict=True):
        # Adaptation works in every fourth cycle; the largest percent is what the machine does besides.
        mean = np.sort(own)[: round(0.99 * cycles)].mean()
        figures = np.median(times), np.median(own), mean, np.quantile(own, 0.999)
        row(name, *(f"{figure:.3f}" for figure in figures), f"{figures[1] / ideal:.2f}")


def _timed(laws: list[Feedforward], q_d: Array, tau: Array, cycles: int) -> tuple[Array, Array]:
    """Elapsed and processor seconds of each law's cycles ``(laws, cycles)``, after a warm-up that compiles."""
    states: list[Any] = [law.init(q_d[0]) for law in laws]
    times, busy = np.empty((len(laws), cycles)), np.empty((len(laws), cycles))
    bends = np.random.default_rng(0).normal(scale=1e-5, size=(64, 1, q_d.shape[1]))
    gc.disable()
    for k in range(-50, cycles):
        if k % 1000 == 0:
            gc.collect()
        start = k % (len(q_d) - N_D)
        # Another path in every cycle: the planned one plus what a sensor has just found.
        horizon = q_d[start : start + N_D] + bends[k % 64]
        # Where the motors are planned to be at the end of the cycle, but for the gears' deflection.
        measured = RobotState(0.012 * k, q_d[start + 1], tau[start + 1])
        for i, law in enumerate(laws):
            working, begun = time.thread_time(), time.perf_counter()
            _, states[i] = law.step(states[i], horizon)
            if isinstance(law, AdaptedIdeal):
                states[i] = law.observe(states[i], measured)
            if k >= 0:
                times[i, k], busy[i, k] = time.perf_counter() - begun, time.thread_time() - working
    gc.enable()
    return times, busy


@contextmanager
def _timed_tasks() -> Iterator[list[float]]:
    """Yields how long each task's part of each of its cycles takes, by processor time [s]."""
    cycles, begun = list[float](), [0.0]
    observe, command = Task.observe, Task.command

    def observed(task: Task, t: float, q: Array, q_d: Array) -> None:
        begun[0] = time.thread_time()
        observe(task, t, q, q_d)

    def commanded(task: Task, t: float, q_d: Array) -> Array:
        q_c = command(task, t, q_d)
        cycles.append(time.thread_time() - begun[0])
        return q_c

    with mock.patch.object(Task, "observe", observed), mock.patch.object(Task, "command", commanded):
        yield cycles


def line_cycles(runs: int = 5, world: str = "", tool_mm: float = 0.0, seed: int = 1) -> None:
    """Following a line: real-time factor, and sensing, planning and feedforward of a cycle, by processor time.

    `ideal` and `adapted` play in turn, medians and 99 % of their cycles. All world effects are on, 320×240 at 50 Hz,
    rendering counts in the real-time factor. --tool-mm puts a tool on, and the arm's links into the picture. The mean
    error is that of `adapted`.
    """
    scene = chosen(scene_of(LineScene, "line"), world=world or None).changed(tool_mm=tool_mm, seed=seed)
    with _timed_tasks() as cycles, prepared(scene) as cell:
        run(scene, method=ADAPTED, shared=cell)
        played: dict[str, list[tuple[float, Array, Any]]] = {IDEAL: [], ADAPTED: []}
        for _ in range(runs):
            for method, figures in played.items():
                cycles.clear()
                begun = time.process_time()
                result = run(scene, method=method, shared=cell)
                factor = result.timing.simulated / (time.process_time() - begun)
                figures.append((factor, 1e3 * np.array(cycles), result.timing.with_field))
        camera = cell.camera
    shown = len(camera.arm.bodies) if isinstance(camera, BulletCamera) and camera.arm is not None else 0
    head("", "real-time factor", "a cycle with a new field", "one without")
    for method, figures in played.items():
        factors, busy, fields = zip(*figures, strict=True)
        times, with_field = np.concatenate(busy), np.concatenate(fields)
        kinds = [times[with_field], times[~with_field]]
        row(f"`{method}`", f"{np.median(factors):.1f}", *(f"{np.median(kind):.2f} ms" for kind in kinds))
        row("99 %", "", *(f"{np.quantile(kind, 0.99):.2f} ms" for kind in kinds))
    print(f"\nmean error {1e3 * result.control_error.mean:.3f} mm, fields used {result.fields_used} of "
          f"{result.fields_seen}; shapes of the arm that came into view: {shown}")


LATENCIES, SPEEDS = (0.02, 0.04, 0.08, 0.12), (0.2, 0.4, 0.7, 1.0, 1.3)


def planning(n_d: int = 25, speed: float = 0.7) -> None:
    """Processor time of planning's calls, and the distance from a displaced line by speed and latency.

    The line is seen with 0.03 mm of noise a point. Of a field's 3 ms and a cycle's 1 ms without one, the time is
    planning's share.
    """
    head(f"processor time, n_d = {n_d}", "median", "99 %", "calls")
    for name, seconds in _times(n_d, speed).items():
        ms = 1e3 * np.array(seconds)
        row(name, f"{np.median(ms):.2f} ms", f"{np.percentile(ms, 99):.2f} ms", len(ms))
    print()
    head("m/s", *(f"{1e3 * latency:.0f} ms" for latency in LATENCIES))
    for v in SPEEDS:
        row(v, *("{:.0f} / {:.0f}".format(*_error(v, latency)) for latency in LATENCIES))


def _times(n_d: int, speed: float, passes: int = 3) -> dict[str, list[float]]:
    """Processor times of each call [s]."""
    names = ("`predict` where the line will be", "`update` with one field", "`horizon` with a new field",
             "`horizon` without")
    times: dict[str, list[float]] = defaultdict(list)
    for seed in range(passes):
        follower = LineFollower(kr6(), reference(), profile(speed), n_d,
                                settings=FollowerSettings())
        camera = Camera(displaced(sine_points()), np.random.default_rng(seed))
        under_way: list[Any] = []
        exposure = 3 * T
        for k in range(int(follower.duration / T)):
            t = k * T
            new = bool(under_way) and under_way[0].t + 0.04 <= t
            while under_way and under_way[0].t + 0.04 <= t:
                field = under_way.pop(0)
                begin = time.thread_time()
                follower.update(field)
                times[names[1]].append(time.thread_time() - begin)
            begin = time.thread_time()
            q_d = follower.horizon(t)
            times[names[2 if new else 3]].append(time.thread_time() - begin)
            follower.observe(t, q_d[0])
            while exposure <= t - 2 * T:
                begin = time.thread_time()
                pose = follower.history.pose(exposure)
                follower.predict(exposure).seen_from(pose)
                times[names[0]].append(time.thread_time() - begin)
                under_way.append(camera.look(follower, exposure, pose))
                exposure += 0.02
    return {name: times[name] for name in names}


def _error(speed: float, latency: float, seeds: int = 3) -> tuple[float, float]:
    """Mean and 95 % of the distance from the line, from 0.5 s on [µm]."""
    line, distances = displaced(sine_points()), []
    for seed in range(seeds):
        follower = LineFollower(kr6(), reference(), profile(speed),
                                settings=FollowerSettings(latency=latency))
        run = follow(follower, Camera(line, np.random.default_rng(seed)), latency=latency)
        inside = (run.t > 0.5) & (run.tcp[:, 1] < line[-1, 1] - 0.005)
        distances.append(distance(run.tcp[inside], line))
    whole = 1e6 * np.concatenate(distances)
    return float(whole.mean()), float(np.percentile(whole, 95))
