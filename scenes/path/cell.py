"""A path scene: the cell, the feedforward of each method, one run, and its result."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from ideal_robot.arrays import Array, interpolated
from ideal_robot.execution.play import play as play_path
from ideal_robot.feedforward.base import Feedforward
from ideal_robot.feedforward.built_in import HORIZON
from ideal_robot.feedforward.joint_errors import AXES, joint_errors, pose_errors
from ideal_robot.feedforward.learning import Learned
from ideal_robot.feedforward.method import Practice, Rehearsed, Setting
from ideal_robot.feedforward.registry import methods, settings
from ideal_robot.feedforward.training_motion import REST_AFTER, REST_BEFORE, training_motion
from ideal_robot.loop.from_model import loop_model
from ideal_robot.loop.loop import Loop
from ideal_robot.model.model import Model
from ideal_robot.results import over_time
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from scenes.arms import arm_of
from scenes.methods import DELAY, SceneMethod
from scenes.metrics import PathErrors, path_errors
from scenes.models import model_for
from scenes.result import Progress, ShownRun, silent
from scenes.scene_file import as_typed
from scenes.scene_files.path_scene import JointPath, PathScene, joint_path
from sim.arm.arm import SimulatedArm
from sim.arm.world import World

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TWO_DOF = ("y", "z")
"""What the external sensor of ``learn_from = "two_dof"`` measures, in the base frame."""


@dataclass(frozen=True)
class Play:
    """The result of one run along a path.

    Attributes:
        errors: errors of the true TCP along the path.
        motor_errors: errors of the TCP computed from motor angles, without gear deflection, as [G] could measure them.
        t, tcp: the true TCP positions ``(M,)`` [s], ``(M, 3)`` [m].
        q_c: commands handed over ``(N, n)`` [rad].
        q_a, q_m: true arm and motor angles at the cycles ``(N, n)`` [rad].
        recording: what the controller logged, with the external device's columns.
        cycle_times: of the feedforward ``(N,)`` [s].
        wall: elapsed time of the run [s].
        state: the feedforward's last state.
    """

    errors: PathErrors
    motor_errors: PathErrors
    t: Array
    tcp: Array
    q_c: Array
    q_a: Array
    q_m: Array
    recording: Recording
    cycle_times: Array
    wall: float
    state: object


def play(robot: Robot, world: World, path: JointPath, feedforward: Feedforward, rng: np.random.Generator
         ) -> Play:
    """Runs ``path`` once, from rest at its start.

    Args:
        robot: the arm as its data sheet has it.
        world: the arm as it is.
        path: the path.
        feedforward: corrects the commands.
        rng: of the arm's noise.
    """
    q_d = path.q_d
    with SimulatedArm(robot, world, rng, q_d[0]) as arm:
        begun = time.perf_counter()
        # The simulated controller keeps the limits itself.
        played = play_path(arm, feedforward, q_d)
        wall = time.perf_counter() - begun
        if played.error is not None:
            raise played.error
        history = arm.history()
        recording = arm.recording(external=True)
        tcp = arm.tcp_path()[1]
        of_motors = np.array([arm.tcp_of(q).translation for q in history["q_m"]])
    every = round(world.t_ipo / (history["t"][1] - history["t"][0]))
    # The log has several rows per cycle: each is compared with the desired position of its own time.
    wanted = interpolated(recording.t, path.t, q_d)
    columns = {**recording.columns, **{f"q_d_{i + 1}": wanted[:, i].copy() for i in range(robot.n)}}
    wanted_t, wanted_x = path.t[path.counts], path.x_d[path.counts]
    return Play(
        errors=path_errors(wanted_t, wanted_x, history["t"], tcp),
        motor_errors=path_errors(wanted_t, wanted_x, history["t"], of_motors),
        t=history["t"], tcp=tcp, q_c=played.q_c, q_a=history["q_a"][::every], q_m=history["q_m"][::every],
        recording=Recording(columns, recording.meta, recording.source), cycle_times=played.compute_times, wall=wall,
        state=played.state)


def measured_errors(robot: Robot, path: JointPath, recording: Recording, source: str) -> Array:
    """Joint errors ``q_d - q (N, n)`` [rad] for learning, from the log of a controller or of an external device.

    Args:
        robot: kinematics.
        path: the desired path.
        recording: of a run, from its start on, at a whole fraction of the interpolation cycle.
        source: ``motor``, ``arm``, ``tcp`` or ``two_dof``.
    """
    every = round((path.t[1] - path.t[0]) / float(np.median(np.diff(recording.t))))
    rows = slice(0, len(path.t) * every, every)
    if source in ("motor", "arm"):
        return np.asarray(path.q_d - recording.joints("q" if source == "motor" else "qa")[rows])
    position = np.column_stack([recording.columns[name][rows] for name in "xyz"])
    turned = Rotation.from_quat(np.column_stack([recording.columns[name][rows] for name in ("qx", "qy", "qz", "qw")]))
    fk = robot.fk()
    desired = [fk(q) for q in path.q_d]
    error = pose_errors(desired, [pin.SE3(R, x) for R, x in zip(turned.as_matrix(), position, strict=True)])
    axes = AXES if source == "tcp" else TWO_DOF
    # Controllers delay the two measured degrees of freedom alike, by tens of milliseconds; the residual is small.
    speed = np.gradient(path.q_d, path.t, axis=0)
    return joint_errors(robot, path.q_d, error[:, [AXES.index(axis) for axis in axes]], axes=axes,
                        prior=3e-4 + 5e-4 * np.abs(speed), common=0.02 * speed)


@dataclass(frozen=True, repr=False)
class PathResult(ShownRun):
    """The result of one path with one method; ``world`` holds the settings of its world."""

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
        """Errors of the true TCP: time-matched, aligned in time, and geometric."""
        return self.played.errors

    @property
    def recording(self) -> Recording:
        """What the controller logged, with desired and externally measured angles."""
        return self.played.recording

    def json(self) -> dict[str, Any]:
        """The content of ``--json``."""
        times = 1e3 * self.played.cycle_times
        return {
            **self.scene.played(),
            "speed_m_s": self.scene.speed,
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

    def plot(self) -> Figure:
        """Figure of the tool's time-matched error, axis by axis, along the path."""
        t = self.path.t[self.path.counts]
        off = 1e3 * (interpolated(t, self.played.t, self.played.tcp) - self.path.x_d[self.path.counts])
        return over_time(t, [(f"{axis} [mm]", [(self.method, off[:, i])]) for i, axis in enumerate("xyz")],
                         self.scene.title)

    def next_steps(self) -> list[tuple[str, str]]:
        """The next steps, each a sentence and its command line; see ``ShownRun.next_steps``."""
        return [("See what each method is worth on this path.", f"ideal-robot compare {as_typed(self.scene)}"),
                ("Correct a path of your own arm.",
                 "ideal-robot precorrect PATH.csv --model MODEL.json -o corrected.csv")]

    def summary(self) -> list[tuple[str, str]]:
        """The main figures as rows of label and value."""
        errors = [(f"{figure} {kind.replace('_', '-')}", f"{1e3 * getattr(getattr(self.errors, kind), figure):.3f} mm")
                  for kind in ("time_matched", "aligned", "geometric") for figure in ("E_car", "E_max")]
        return [("method", self.method), ("speed", f"{self.scene.speed:g} m/s"), *errors,
                ("delay", f"{1e3 * self.errors.delay:.2f} ms")]


# Sets up a path scene, and makes the feedforward of each method for its path.

def path_methods() -> tuple[str, ...]:
    """Every key that ``--method`` takes, settings included."""
    keys = (*methods(), *settings())
    return (*keys, *(key + DELAY for key in keys))


@dataclass
class PathCell:
    """One path in one world: makes the feedforward of each method for it, and caches slow results.

    Attributes:
        robot, world, model, path: the arm, its world, its model and its path; ``world`` says whether the planner's
            delay is active.
        learn_from: the measurement that learning uses, see ``PathScene``.
        seed: of the arm's noise.
    """

    robot: Robot
    world: World
    model: Model
    path: JointPath
    learn_from: str
    seed: int
    plays: int = 0

    @property
    def delay(self) -> int:
        """Cycles between hand-over of a command and the start of its interpolation."""
        return int(self.world.correction_delay)

    def loop(self) -> Loop:
        """The identified closed loop, with or without the path planner's delay as in this world."""
        return loop_model(self.model, self.robot, delay=self.delay)

    def play(self, feedforward: Feedforward, path: JointPath | None = None) -> Play:
        """Runs a path once, with new noise."""
        self.plays += 1
        rng = np.random.default_rng([self.seed, self.delay, self.plays])
        return play(self.robot, self.world, path or self.path, feedforward, rng)

    def feedforward(self, method: str | SceneMethod, progress: Progress = silent) -> Feedforward:
        """The feedforward of a method: a key with or without suffix, or one of the user's.

        Raises:
            InputError: no such method.
        """
        scene_method = method if isinstance(method, SceneMethod) else SceneMethod(method)
        return scene_method.feedforward(Setting(self.robot, self.model, round(HORIZON / self.robot.t_ipo), self.delay,
                                                self.path.q_d, practice=self.practice, progress=progress))

    @cached_property
    def practice(self) -> Practice:
        """Runs on this arm before the path, and what was learned in them."""
        return Practice(self._rehearsed, self.robot)

    def learned(self, progress: Progress = silent) -> Learned:
        """Learning of the path on the arm, [G] (10), (11), from the uncorrected path."""
        return self.practice.learned(self.path.q_d, self.loop(), progress)

    def _rehearsed(self, feedforward: Feedforward, q_d: Array) -> Rehearsed:
        path = self.path if q_d is self.path.q_d else without_tcp(q_d, self.world.t_ipo)
        played = self.play(feedforward, path)
        return Rehearsed(played.state, lambda: measured_errors(self.robot, path, played.recording, self.learn_from),
                         played.recording)


def training_path(path: JointPath, t_ipo: float) -> JointPath:
    """The motion about a path that training, adaptation and diagnosis learn from."""
    return without_tcp(training_motion(path.q_d, t_ipo), t_ipo)


def without_tcp(q_d: Array, t_ipo: float) -> JointPath:
    """A joint motion about a path, without a desired TCP of its own.

    Args:
        q_d: joint motion at the cycles ``(N, n)`` [rad].
        t_ipo: cycle [s].
    """
    counts = np.zeros(len(q_d), dtype=bool)
    counts[round(REST_BEFORE / t_ipo) : len(q_d) - round(REST_AFTER / t_ipo)] = True
    return JointPath(q_d, np.zeros((len(q_d), 3)), np.asarray(t_ipo * np.arange(float(len(q_d)))), counts)


def set_up(scene: PathScene, *, delay: bool, model: Model | None = None) -> PathCell:
    """Sets up a path scene, with or without the standard path planner's delay.

    Args:
        scene: the scene.
        delay: whether the delay is in force.
        model: of the arm; None for the one that the scene asks for.

    Raises:
        InputError: path out of reach, no model, a value of the world that makes no sense.
    """
    world = World.from_table(scene.robot, {**scene.arm_world, "correction_delay": delay}, scene.source)
    robot = world.with_cycles(arm_of(scene.robot))
    return PathCell(robot, world, model or model_for(scene, robot), joint_path(scene, robot, world.t_ipo),
                    scene.learn_from, scene.seed)
