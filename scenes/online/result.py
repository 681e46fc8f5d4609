"""The result of following on devices; it has no true errors, as devices do not measure them."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ideal_robot.signals.recording import Recording
from scenes.report.call import Call
from scenes.result import ShownRun
from scenes.scene_files.scene import Scene
from scenes.verdict import BAD, GOOD, Verdict

if TYPE_CHECKING:
    from matplotlib.figure import Figure


NOT_CHECKED = "not looked at: a camera that shows any distance beside the line would pass"
"""What is said where no look was taken before the job."""


@dataclass(frozen=True, repr=False)
class FollowResult(ShownRun):
    """Result of one run on devices.

    Attributes:
        recording: the controller's side of it: ``t``, ``q_d_i``, ``q_c_i``, ``q_i``, torques, line points, wrenches.
        figures: of the kind of scene.
        devices: statistics of each device, and how its clock relates to this computer's.
        timing: answers to the controller [ms], computing, privileges granted by the system.
        planned: time [s] and planned deviation from the reference [m] of each cycle ``(N, 2)``.
        left_behind: recording of an earlier run that was killed, if any.
    """

    scene: Scene
    method: str
    failure: str | None
    recording: Recording = field(repr=False)
    figures: dict[str, Any] = field(repr=False)
    devices: dict[str, Any] = field(repr=False)
    timing: dict[str, Any] = field(repr=False)
    planned: Any = field(repr=False, default_factory=lambda: np.empty((0, 2)))
    left_behind: Path | None = None
    recording_path: Path | None = None
    report: Path | None = None

    def json(self) -> dict[str, Any]:
        """The content of ``--json``."""
        return {"scene": self.scene.name, "method": self.method, "model": self.scene.model, "failure": self.failure,
                **self.figures, "cycles": len(self.recording.t), "devices": self.devices, "timing": self.timing,
                "recording": self.recording_path, "recording_hash": self.recording.hash, "report": self.report,
                "left_behind": self.left_behind}

    def plot(self) -> Figure:
        """Motor angles and torques of a run over time."""
        return self.recording.plot()

    def answer(self) -> str:
        """The result of the run in a sentence or two, with the figures that a real cell can measure."""
        whole = "The whole path was followed" if self.failure is None else "The run ended early"
        said = [f"{whole}: {self.method} on devices, {len(self.recording.t)} cycles."]
        error = self.figures.get("plan_error_mm", {})
        if error.get("mean") is not None:
            said.append(f"By its own pictures the planned path was {error['mean']:.3f} mm from the line on average, "
                        f"{error['max']:.3f} mm at most.")
        force = self.figures.get("force_N", {})
        if np.isfinite(force.get("rms_error", np.nan)):
            said.append(f"The felt force was {force['rms_error']:.2f} N (RMS) from the {force['wanted']:g} N wanted.")
        return " ".join(said)

    def next_steps(self) -> list[tuple[str, str]]:
        """The next steps, each a sentence and its command line; see ``ShownRun.next_steps``."""
        call = Call(self.recording_path or "RECORDING", self.scene.robot)
        return [("See what the model of this arm lacks.", f"ideal-robot diagnose {call}"),
                ("Watch the run.", f"ideal-robot view {call}")]

    def summary(self) -> list[tuple[str, str]]:
        """The main figures as rows of label and value."""
        rows = [("method", self.method), ("cycles", str(len(self.recording.t)))]
        link = self.devices.get("arm", {}).get("link", {})
        rows += [(f"packets {key}", Verdict(str(link[key]), BAD if link[key] else GOOD))
                 for key in ("lost", "late", "refused") if key in link]
        if count := self.devices.get("arm", {}).get("cycles_not_recorded", 0):
            rows.append(("cycles missing in the recording", f"{count}: the disk did not take them"))
        answers, t = self.timing["answer_ms"], self.recording.t
        cycle = 1e3 * float(np.median(np.diff(t))) if len(t) > 1 else np.nan
        rows.append(("longest answer, of a cycle", Verdict(f"{answers['max']:.1f} of {cycle:.0f} ms",
                                                           GOOD if answers["max"] < cycle else BAD)))
        if "self_test" in self.timing:
            rows.append(("this computer, before the job", self.timing["self_test"]["text"]))
        if (share := self.devices.get("arm", {}).get("holding_share", 0.0)) > 1.0:
            rows.append(("a missing answer (--absolute)", f"up to {share:.1f} times the acceleration limit"))
        camera = self.devices.get("camera", {})
        if "check" in camera:
            rows.append(("camera before the job", camera["check"].get("text", NOT_CHECKED)))
        if "fields" in self.figures:
            rows.append(("fields used", f"{self.figures['fields']['used']} of {self.figures['fields']['seen']}"))
        if "force_N" in self.figures:
            rows.append(("felt force, RMS error", f"{self.figures['force_N']['rms_error']:.2f} N"))
            rows.append(("the force sensor's gain", self.figures["force_gain"]["text"]))
        shares, peaks = self.timing["processor_share"], self.timing["peak_memory_MB"]
        rows += [(f"{name}'s process", f"{1e2 * share:.0f} % of a core, {peaks[name]:.0f} MB at most")
                 for name, share in shares.items()]
        if len(peaks) > 1:
            rows.append(("both together", f"{self.timing['memory_together_MB']:.0f} MB"))
        for name, device in self.devices.items():
            clock = device.get("clock", {})
            if clock.get("drift_ppm") is not None:
                rows.append((f"clock of the {name}",
                             f"{clock['drift_ppm']:+.0f} ± {clock['drift_std_ppm']:.0f} ppm against this computer's"))
        return rows
