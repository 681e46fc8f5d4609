"""What a force scene yields: forces, what was felt of the surface, the recording, the timing."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.signals.recording import Recording
from planning.force.contact import Phase
from planning.force.force_follower import SurfaceFollower
from scenes.force.scene import ForceScene
from sensing.force.wrench import WrenchSample
from sim.arm.arm import SimulatedArm
from sim.contact.contact import TipContact

if TYPE_CHECKING:
    from scenes.force.play import ForceLoop


@dataclass
class ForceLog:
    """What is written down while a scene is played."""

    t: list[float] = field(default_factory=list)
    q_d: list[Array] = field(default_factory=list)
    q_c: list[Array] = field(default_factory=list)
    phase: list[str] = field(default_factory=list)
    s: list[float] = field(default_factory=list)
    planned: list[Array] = field(default_factory=list)
    cycles: list[float] = field(default_factory=list)
    samples: list[tuple[float, float, float]] = field(default_factory=list)
    wrenches: list[WrenchSample] = field(default_factory=list)
    fields: list[tuple[float, int, str]] = field(default_factory=list)
    failure: str | None = None

    def add(self, t: float, q_d: Array, q_c: Array, follower: SurfaceFollower, seconds: float) -> None:
        """One cycle."""
        self.t.append(t)
        self.q_d.append(q_d.copy())
        self.q_c.append(q_c)
        self.phase.append(follower.phase.value)
        self.s.append(follower.s_at(t))
        self.planned.append(follower.planned())
        self.cycles.append(seconds)


@dataclass(frozen=True)
class ForceFigures:
    """How well the force was kept, from the beginning of the travel to its end, start and end included.

    Attributes:
        rms, mean: of the true normal force's error, and its mean [N].
        largest: true normal force over the whole run, touch-down included [N].
        least: during the travel [N].
        lost: time without contact during the travel [s].
        travel: length of the travel [s].
    """

    rms: float
    mean: float
    largest: float
    least: float
    lost: float
    travel: float


@dataclass(frozen=True)
class ForceResult:
    """One force scene played with one method."""

    scene: ForceScene
    method: str
    figures: ForceFigures
    elasticity: tuple[float, float, float]
    """E assumed, its standard deviation from calibration, and the truth [N/m]."""
    tool: dict[str, float]
    history: dict[str, Array] = field(repr=False)
    log: ForceLog = field(repr=False)
    recording: Recording = field(repr=False)
    urdf: Path
    real_time_factor: float
    lateral: dict[str, Any] = field(default_factory=dict)
    """For ``glue``: distance from the drawn line."""
    lateral_series: tuple[Array, Array] = field(default=(np.empty(0), np.empty(0)), repr=False)
    """For ``glue``: instants [s] and signed distances from the line [m]."""
    failure: str | None = None
    recording_path: Path | None = None
    report: Path | None = None

    def json(self) -> dict[str, Any]:
        """The content of ``--json``."""
        f = self.figures
        return {
            "scene": self.scene.name, "task": self.scene.task, "speed_m_s": self.scene.speed, "seed": self.scene.seed,
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

    def summary(self) -> list[tuple[str, str]]:
        """The few figures a person wants first."""
        f = self.figures
        rows = [("method", self.method), ("speed", f"{self.scene.speed:g} m/s"),
                ("RMS force error", f"{f.rms:.2f} N of {self.scene.force:g} N"),
                ("largest force", f"{f.largest:.1f} N"), ("contact lost", f"{1e3 * f.lost:.0f} ms")]
        if "control_error_mm" in self.lateral:
            rows.append(("mean distance from the line", f"{self.lateral['control_error_mm']['mean']:.3f} mm"))
        rows.append(("real-time factor", f"{self.real_time_factor:.1f}"))
        return rows


def force_figures(scene: ForceScene, history: dict[str, Array], log: ForceLog) -> ForceFigures:
    """From the true normal force of every 0.5 ms."""
    moving = [t for t, phase in zip(log.t, log.phase, strict=True) if phase == Phase.TRAVEL.value]
    largest = float(history["normal"].max(initial=0.0))
    if len(moving) < 2:
        return ForceFigures(float("nan"), float("nan"), largest, float("nan"), float("nan"), 0.0)
    at = (history["t"] >= moving[0]) & (history["t"] <= moving[-1])
    force = history["normal"][at]
    return ForceFigures(float(np.sqrt(np.mean((force - scene.force) ** 2))), float(force.mean()), largest,
                        float(force.min()), float(np.count_nonzero(force <= 0) * 0.0005), moving[-1] - moving[0])


def force_result(scene: ForceScene, method: str, loop: ForceLoop, arm: SimulatedArm, contact: TipContact,
                 wall: float) -> ForceResult:
    """Collects what a run leaves behind."""
    history, log = contact.history(), loop.log
    lateral: dict[str, Any] = {}
    series = (np.empty(0), np.empty(0))
    moving = [t for t, phase in zip(log.t, log.phase, strict=True) if phase == Phase.TRAVEL.value]
    if loop.vision is not None and moving:
        log.fields = loop.vision.fields
        at = (history["t"] >= moving[0]) & (history["t"] <= moving[-1])
        plane = loop.cell.surface.plane
        tip = history["tip"][at] @ plane.rotation.T + plane.translation
        lateral, series = loop.vision.control_error(history["t"][at], tip)
    return ForceResult(
        scene=scene, method=method, figures=force_figures(scene, history, log),
        elasticity=(loop.follower.settings.elasticity, loop.elasticity.std, scene.tip.stiffness),
        tool={"mass": loop.tool.mass, "force_residual_N": float(loop.tool.residual[0])}, history=history, log=log,
        recording=force_recording(arm, scene, method, loop), urdf=loop.cell.robot.urdf,
        real_time_factor=arm.t / wall, lateral=lateral, lateral_series=series, failure=log.failure)


def force_recording(arm: SimulatedArm, scene: ForceScene, method: str, loop: ForceLoop) -> Recording:
    """The controller's recording with ``q_d_i``, the wrench as sensed, the felt force ``f_normal``, what calibration
    said of tool and contact, and why the arm stopped."""
    recording, log = arm.recording(external=True), loop.log
    columns = dict(recording.columns)
    t, q_d = np.array(log.t), np.array(log.q_d)
    for i in range(q_d.shape[1]):
        columns[f"q_d_{i + 1}"] = np.interp(recording.t, t, q_d[:, i])
    if log.samples:
        felt = np.array(log.samples)
        order = np.argsort(felt[:, 0])
        columns["f_normal"] = np.interp(recording.t, felt[order, 0], felt[order, 1])
    if log.wrenches:
        times, sensed = np.array([s.t for s in log.wrenches]), np.array([s.wrench for s in log.wrenches])
        for i, name in enumerate(("fx", "fy", "fz", "mx", "my", "mz")):
            columns[name] = np.interp(recording.t, times, sensed[:, i])
    tool = {"bias": loop.tool.bias.tolist(), "mass": loop.tool.mass, "com": loop.tool.com.tolist()}
    meta = {**recording.meta, "tool": tool, "contact_stiffness": loop.assumed_stiffness, "scene": scene.name,
            "method": method, "speed": scene.speed, "seed": scene.seed,
            "stopped_because": log.failure}
    return Recording(columns, meta, recording.source)
