"""Runs a scene of kind ``force``: the tip presses on an unknown surface and moves along it ([L] section 4).

Its result has forces, the estimated surface, the recording and the timing.
"""

from __future__ import annotations

from contextlib import closing, nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.results import over_time
from ideal_robot.row_log import let_go
from ideal_robot.signals.recording import Recording
from scenes.force.cell import Cell, GlueWorld, Prepared, set_up, true_tip
from scenes.force.trouble import Trouble, TroubledCamera, TroubledDetector
from scenes.methods import DIRECT, following_methods, method_of
from scenes.metrics import ControlError
from scenes.online.configured import Configured, force_task
from scenes.online.contact import ContactSensor
from scenes.online.cycle import CycleSettings
from scenes.online.force_known import BRAKING, LONGEST
from scenes.online.log import TaskLog
from scenes.result import Progress, ShownRun, silent
from scenes.scene_file import as_typed
from scenes.scene_files.force_scene import CameraTrouble, ForceScene
from scenes.simulated import done, recorded
from scenes.verdict import BAD, GOOD, Verdict
from sensing.camera.hand_eye import HandEye
from sim.arm.arm import SimulatedArm
from sim.contact.contact import TipContact
from sim.equipped_arm import Carried, CarriedCamera, CarriedForceSensor, Knock

if TYPE_CHECKING:
    from matplotlib.figure import Figure

AT_A_TIME = 1_000_000
"""Values of which squares are taken at a time."""


@dataclass(frozen=True)
class ForceFigures:
    """Errors of the force over the whole travel, start and end included.

    Attributes:
        rms, mean: of the true normal force's error, and its mean [N].
        largest: true normal force over the whole run, touch-down included [N].
        least: during the travel [N].
        lost: time without contact during the travel [s].
        travel: duration of the travel [s].
    """

    rms: float
    mean: float
    largest: float
    least: float
    lost: float
    travel: float


@dataclass(frozen=True, repr=False)
class ForceResult(ShownRun):
    """The result of one force scene with one method."""

    scene: ForceScene
    method: str
    figures: ForceFigures
    elasticity: tuple[float, float, float]
    """E assumed, its standard deviation from calibration, and the truth [N/m]."""
    tool: dict[str, float]
    history: dict[str, Array] = field(repr=False)
    log: TaskLog = field(repr=False)
    recording: Recording = field(repr=False)
    urdf: Path
    real_time_factor: float
    control_error: ControlError | None = field(default=None, repr=False)
    """For ``glue``: distance from the drawn line."""
    hand_eye: HandEye | None = field(default=None, repr=False)
    """For ``glue``: how the camera was calibrated, if it was."""
    failure: str | None = None
    recording_path: Path | None = None
    report: Path | None = None

    @property
    def lateral(self) -> dict[str, Any]:
        """Figures of a ``glue`` scene: of the distance from the drawn line, and of the camera's fields."""
        if self.control_error is None:
            return {}
        return {"control_error_mm": self.control_error.json_mm(),
                "fields": self.log.counts()}

    def json(self) -> dict[str, Any]:
        """The content of ``--json``."""
        f = self.figures
        return {
            **self.scene.played(), "task": self.scene.task, "speed_m_s": self.scene.speed,
            "method": self.method, "failure": self.failure, "desired_force_N": self.scene.force,
            "force_error_N": {"rms": f.rms, "mean": f.mean - self.scene.force},
            "max_force_N": f.largest, "max_force_ratio": f.largest / self.scene.force, "min_force_N": f.least,
            "contact_lost_s": f.lost, "travel_s": f.travel,
            "elasticity_N_m": {"assumed": self.elasticity[0], "std": self.elasticity[1], "true": self.elasticity[2]},
            "tool": self.tool, **self.lateral,
            "recording": self.recording_path, "recording_hash": self.recording.hash, "urdf": self.urdf,
            "report": self.report, "real_time_factor": self.real_time_factor,
            "cycle_time_ms": {"median": 1e3 * float(np.median(self.log.cycles)),
                              "p99": 1e3 * float(np.quantile(self.log.cycles, 0.99))},
        }

    def plot(self) -> Figure:
        """Figure of the true force along the surface's normal over time, and the desired one."""
        t, normal = self.history["t"], self.history["normal"]
        wanted = np.full(len(t), self.scene.force)
        return over_time(t, [("force [N]", [("true", normal), ("wanted", wanted)])], self.scene.title)

    def next_steps(self) -> list[tuple[str, str]]:
        """The next steps, each a sentence and its command line; see ``ShownRun.next_steps``."""
        return [("See it beside direct force feedback at its best gain.",
                 f"ideal-robot compare {as_typed(self.scene)}")]

    def summary(self) -> list[tuple[str, str]]:
        """The main figures as rows of label and value."""
        f = self.figures
        rows = [("method", self.method), ("speed", f"{self.scene.speed:g} m/s"),
                ("RMS force error", f"{f.rms:.2f} N of {self.scene.force:g} N"),
                ("largest force", Verdict(f"{f.largest:.1f} N of at most {self.scene.emergency.force:g} N",
                                          GOOD if f.largest < self.scene.emergency.force else BAD)),
                ("contact lost", Verdict(f"{1e3 * f.lost:.0f} ms", BAD if f.lost else GOOD))]
        if self.control_error is not None:
            rows.append(("mean distance from the line", f"{1e3 * self.control_error.mean:.3f} mm"))
        rows.append(("speed of the simulation", f"{self.real_time_factor:.1f} × real time"))
        return rows


def force_figures(scene: ForceScene, history: dict[str, Array], moving: list[float]) -> ForceFigures:
    """Errors of the force over the whole travel.

    Args:
        scene: the scene, which says the desired force.
        history: ``normal (N,)`` [N] at ``t (N,)`` [s], every 0.5 ms.
        moving: times during which the tip travelled [s].
    """
    largest = float(history["normal"].max(initial=0.0))
    if len(moving) < 2:
        return ForceFigures(float("nan"), float("nan"), largest, float("nan"), float("nan"), 0.0)
    first, last = np.searchsorted(history["t"], moving[0]), np.searchsorted(history["t"], moving[-1], side="right")
    force = history["normal"][first:last]
    squares = sum(float(np.sum((part - scene.force) ** 2)) for part in
                  (force[begin : begin + AT_A_TIME] for begin in range(0, len(force), AT_A_TIME)))
    figures = ForceFigures(float(np.sqrt(squares / len(force))), float(force.mean()), largest, float(force.min()),
                           float(np.count_nonzero(force <= 0) * 0.0005), moving[-1] - moving[0])
    let_go(history["t"], force)
    return figures


def _calibrated(contact: ContactSensor) -> dict[str, Any]:
    """What calibration said of tool and contact."""
    load = contact.tool
    return {"tool": {"bias": load.bias.tolist(), "mass": load.mass, "com": load.com.tolist()},
            "contact_stiffness": contact.assumed_stiffness}


REST = 12
"""Cycles for which the recording goes on after a stop."""


def methods(task: str = "surface") -> tuple[str, ...]:
    """Every key that ``--method`` takes; direct feedback only follows a surface."""
    return (DIRECT, *following_methods()) if task == "surface" else following_methods()


def play(scene: ForceScene, method: Any, gains: tuple[float, float] | None = None,
         progress: Progress = silent, shared: Prepared | None = None) -> ForceResult:
    """Runs a force scene once without writing files.

    Args:
        scene: the scene.
        method: a key, a ``Feedforward``, a factory of one, or a ``Method``.
        gains: K_p [m/N per cycle], K_d [m/N] of direct feedback.
        progress: called with the fraction done.
        shared: calibrations of the same scene, to save time; the method, a limit or camera faults may differ.

    Raises:
        InputError: no such method, or a scene that cannot be run.
    """
    method = method_of(method, methods(scene.task))
    shared = shared or Prepared(scene)
    tool, elasticity = shared.contact
    shown = shared.camera
    cell = set_up(scene, shown)
    trouble = None if scene.trouble == CameraTrouble() else Trouble(scene.trouble, cell.camera_streams[0])
    known = cell.known if trouble is None else replace(
        cell.known, detector=TroubledDetector(cell.known.detector, trouble))
    configured = force_task(known, method, tool, elasticity, gains,
                            shared.friction if method.knows_model else None)
    return replace(pressed(cell, configured, method.key, progress, trouble),
                   hand_eye=None if shown is None else shown[0])


def pressed(cell: Cell, configured: Configured, method: str, progress: Progress = silent,
            trouble: Trouble | None = None) -> ForceResult:
    """Runs a task on the simulated arm and returns its result.

    Args:
        cell: the scene set up.
        configured: the task, its devices not yet connected.
        method: its key.
        progress: called with the fraction done.
        trouble: faults of the camera during the run.
    """
    scene, task = cell.known.scene, configured.task
    glue = GlueWorld(cell) if scene.task == "glue" else None
    with (nullcontext() if glue is None else closing(glue),
          SimulatedArm(cell.known.robot, cell.world, cell.noise, task.q_start) as arm):
        contact = TipContact(arm, cell.surface, true_tip(scene.tip))
        sensor = CarriedForceSensor(cell.sensor, arm, contact)
        camera = None if glue is None else CarriedCamera(glue.rendered, arm, Knock.of(scene.camera))
        if trouble is None or camera is None:
            configured.connect(sensor, camera)
        else:
            trouble.follower = task.follower
            configured.connect(sensor, TroubledCamera(camera, trouble))
        duration = cell.known.profile.duration
        carried: list[Carried] = [sensor] if camera is None else [camera, sensor]
        wall = done(task, arm, carried, cell.known.robot,
                    CycleSettings(BRAKING, REST * arm.t_ipo, duration + LONGEST, duration + 2.0, method), progress)
        task.log.wrenches = sensor.samples
        return _result(cell, method, configured, glue, arm, contact, wall)


def _result(cell: Cell, method: str, configured: Configured, glue: GlueWorld | None, arm: SimulatedArm,
            contact: TipContact, wall: float) -> ForceResult:
    """Collects what a run leaves behind."""
    scene, history, log, felt = cell.known.scene, contact.history(), configured.task.log, configured.contact
    assert felt is not None
    moving, error = log.travel, None
    if glue is not None and moving:
        first, last = np.searchsorted(history["t"], moving[0]), np.searchsorted(history["t"], moving[-1], side="right")
        error = glue.control_error(log.first_used, history["t"][first:last], history["tip"][first:last])
    return ForceResult(
        scene=scene, method=method, figures=force_figures(scene, history, moving),
        elasticity=(felt.follower.settings.elasticity, felt.elasticity.std, scene.tip.stiffness),
        tool={"mass": felt.tool.mass, "force_residual_N": float(felt.tool.residual[0])}, history=history, log=log,
        recording=recorded(arm, scene, method, log, True, _calibrated(felt)), urdf=cell.known.robot.urdf,
        real_time_factor=arm.t / wall, control_error=error, failure=log.failure)
