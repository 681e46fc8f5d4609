"""Scenes of kind ``path``: tool paths known beforehand, [G] sections 4 and 5, with every way of correcting them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ideal_robot.errors import InputError
from ideal_robot.feedforward.registry import methods
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from scenes.metrics import PathErrors, reduction_percent
from scenes.models import model_for
from scenes.path.methods import Workshop
from scenes.path.player import Play
from scenes.path.scene import JointPath, PathScene, joint_path
from scenes.result import Progress, silent
from sim.arm.world import World

SceneModel = PathScene
DELAY = "_delay"
"""Behind a method's key: the standard path planner's delay is in force."""
REFERENCE = "none"
"""What reductions are relative to, with the planner's delay too: it is the smaller error, so the stricter measure."""


@dataclass(frozen=True)
class PathResult:
    """One path played with one method.

    Attributes:
        scene, method: what was played.
        path: the path in joint space.
        played: errors, motion, commands and timing.
        urdf: file of the arm.
        world: the world's settings.
        recording_path, report: files written, if any.
    """

    scene: PathScene
    method: str
    path: JointPath = field(repr=False)
    played: Play = field(repr=False)
    urdf: Path
    world: dict[str, Any] = field(repr=False, default_factory=dict)
    failure: str | None = None
    recording_path: Path | None = None
    report: Path | None = None

    @property
    def errors(self) -> PathErrors:
        """Errors of the true TCP, three ways."""
        return self.played.errors

    @property
    def recording(self) -> Recording:
        """What the controller logged, with desired and externally measured angles."""
        return self.played.recording

    def json(self) -> dict[str, Any]:
        """The content of ``--json``."""
        times = 1e3 * self.played.cycle_times
        return {
            "scene": self.scene.name,
            "speed_m_s": self.scene.speed,
            "seed": self.scene.seed,
            "method": self.method,
            "failure": self.failure,
            "path_error_mm": self.errors.json_mm(),
            "motor_path_error_mm": self.played.motor_errors.json_mm(),
            "recording": self.recording_path,
            "recording_hash": self.recording.hash,
            "urdf": self.urdf,
            "report": self.report,
            "real_time_factor": float(self.path.t[-1] / self.played.wall),
            "cycle_time_ms": {"median": float(np.median(times)), "p99": float(np.quantile(times, 0.99)),
                              "max": float(np.max(times))},
        }

    def summary(self) -> list[tuple[str, str]]:
        """The few figures a person wants first."""
        rows = [("method", self.method), ("speed", f"{self.scene.speed:g} m/s")]
        for name, error in (("time-matched", self.errors.time_matched), ("aligned", self.errors.aligned),
                            ("geometric", self.errors.geometric)):
            rows.append((f"E_car {name}", f"{1e3 * error.E_car:.3f} mm"))
            rows.append((f"E_max {name}", f"{1e3 * error.E_max:.3f} mm"))
        return [*rows, ("delay", f"{1e3 * self.errors.delay:.2f} ms")]


@dataclass(frozen=True)
class PathComparison:
    """Every method on the same path.

    Attributes:
        scene: what was played.
        runs: method → result.
        learning_criterion: root mean square of the errors that learning on the arm saw at each play [rad].
    """

    scene: PathScene
    runs: dict[str, PathResult]
    learning_criterion: tuple[float, ...]
    report: Path | None = None

    def reduction(self, method: str) -> dict[str, dict[str, float]]:
        """Reduction of E_car and E_max against no correction [%]: time-matched, aligned, and the weaker of the two."""
        before, after = self.runs[REFERENCE].errors, self.runs[method].errors
        found = {}
        for name in ("E_car", "E_max"):
            both = {kind: reduction_percent(getattr(getattr(before, kind), name), getattr(getattr(after, kind), name))
                    for kind in ("time_matched", "aligned")}
            found[name] = {**both, "weaker": min(both.values())}
        return found

    def motor_reduction(self, method: str) -> dict[str, float]:
        """Reduction of the aligned error that motor angles show [%]: what [G] could measure, gears unseen."""
        before, after = (self.runs[key].played.motor_errors.aligned for key in (REFERENCE, method))
        return {name: reduction_percent(getattr(before, name), getattr(after, name)) for name in ("E_car", "E_max")}

    def json(self) -> dict[str, Any]:
        """The content of ``--json``: the runs stand under ``methods``."""
        return {
            "scene": self.scene.name,
            "speed_m_s": self.scene.speed,
            "seed": self.scene.seed,
            "methods": {method: {**run.json(), "reduction_percent": self.reduction(method),
                                 "motor_aligned_reduction_percent": self.motor_reduction(method)}
                        for method, run in self.runs.items()},
            "learning_criterion_mrad": [1e3 * value for value in self.learning_criterion],
            "paper": self.scene.paper.model_dump(),
            "recording": {method: run.recording_path for method, run in self.runs.items()},
            "urdf": next(iter(self.runs.values())).urdf,
            "report": self.report,
        }

    def table(self) -> tuple[list[str], list[list[Any]]]:
        """One row a method, what fits a terminal: E_car [mm], its reduction and the paper's [%]."""
        paper = self.scene.paper.E_car_reduction_percent
        columns = ["method", "timed mm", "aligned", "E_car −%", "E_max −%", "paper −%"]
        rows: list[list[Any]] = []
        for method, run in self.runs.items():
            less = self.reduction(method)
            rows.append([method, 1e3 * run.errors.time_matched.E_car, 1e3 * run.errors.aligned.E_car,
                         less["E_car"]["weaker"], less["E_max"]["weaker"], paper.get(method)])
        return columns, rows

    def full_table(self) -> tuple[list[str], list[list[Any]]]:
        """One row a method: errors in mm, reductions in per cent, the paper's beside them."""
        columns = ["method", "E_car t.-m. mm", "aligned", "geometric", "E_max t.-m. mm", "aligned", "delay ms",
                   "E_car less %", "E_max less %", "by motors %", "paper E_car %", "paper E_max %"]
        paper = self.scene.paper
        rows = []
        for method, run in self.runs.items():
            e, less = run.errors, self.reduction(method)
            rows.append([
                method, 1e3 * e.time_matched.E_car, 1e3 * e.aligned.E_car, 1e3 * e.geometric.E_car,
                1e3 * e.time_matched.E_max, 1e3 * e.aligned.E_max, 1e3 * e.delay, less["E_car"]["weaker"],
                less["E_max"]["weaker"], self.motor_reduction(method)["E_car"],
                paper.E_car_reduction_percent.get(method), paper.E_max_reduction_percent.get(method)])
        return columns, rows


def workshop(scene: PathScene, *, delay: bool) -> Workshop:
    """Everything a path scene needs, with or without the standard path planner's delay.

    Raises:
        InputError: path out of reach, no model, a value of the world that makes no sense.
    """
    robot = Robot.load(scene.robot)
    world = World.from_table(scene.robot, {**scene.world, "correction_delay": delay})
    return Workshop(robot, world, model_for(scene, robot), joint_path(scene, robot, world.t_ipo), scene.learn_from,
                    scene.seed)


def run(scene: PathScene, *, method: str | None = None, out: Path | None = None, progress: Progress = silent
        ) -> PathResult:
    """Plays the scene's path with one method.

    Raises:
        InputError: no such method, or a scene that cannot be played.
    """
    chosen = method or scene.method
    if chosen.removesuffix(DELAY) not in methods():
        raise InputError(f"expected one of {', '.join(methods())}, with or without {DELAY}", field="method",
                         value=chosen)
    place = workshop(scene, delay=chosen.endswith(DELAY))
    result = _played(scene, place, chosen, progress)
    if out is None:
        return result
    from scenes.path.page import write_run

    return write_run(result, out)


def compare(scene: PathScene, *, out: Path | None = None, progress: Progress = silent) -> PathComparison:
    """Plays the scene's path with every method, with and without the standard path planner's delay."""
    runs: dict[str, PathResult] = {}
    criterion: tuple[float, ...] = ()
    keys = methods()
    for delay in (False, True):
        place = workshop(scene, delay=delay)
        for i, method in enumerate(keys):
            key = method + DELAY if delay else method
            share = (i + len(keys) * delay) / (2 * len(keys))
            progress(share, key)
            runs[key] = _played(scene, place, key, _part(progress, share, 1 / (2 * len(keys)), key))
        if not delay:
            criterion = place.learned().criterion
    comparison = PathComparison(scene, runs, criterion)
    if out is None:
        return comparison
    from scenes.path.page import write_comparison

    return write_comparison(comparison, out)


def _part(progress: Progress, start: float, share: float, key: str) -> Progress:
    return lambda fraction, text: progress(start + share * fraction, text if text == key else f"{key}: {text}")


def _played(scene: PathScene, place: Workshop, key: str, progress: Progress) -> PathResult:
    played = place.play(place.feedforward(key.removesuffix(DELAY), progress))
    progress(1.0, key)
    meta = {**played.recording.meta, "scene": scene.name, "method": key, "seed": scene.seed}
    played = replace(played, recording=replace(played.recording, meta=meta))
    return PathResult(scene, key, place.path, played, place.robot.urdf, place.world.table())
