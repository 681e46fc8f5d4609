"""The circle with a camera whose time stamps are wrong: follow the line, diagnose that run alone, follow it again.

What the diagnosis finds of the camera's latency goes into the model file, from where the follower takes what it
assumes. The oracle is told that it is the latency, and fits it to the same recording.
"""

from __future__ import annotations

import dataclasses
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ideal_robot.diagnosis import Diagnosis, diagnose
from ideal_robot.diagnosis.channels.line import told_line
from ideal_robot.effects import FittedEffect
from ideal_robot.errors import InputError
from ideal_robot.model.model import Model
from ideal_robot.signals.recording import Recording
from scenes.line.cell import Prepared, prepared, set_up
from scenes.line.play import assumed_latency
from scenes.line.play import run as follow
from scenes.line.result import ControlError, LineResult
from scenes.line.scene import LineScene
from scenes.models import model_for
from scenes.result import Progress, silent

EFFECT = "camera_latency"


@dataclass(frozen=True)
class CloseLineResult:
    """One turn of the loop.

    Attributes:
        scene: what was played.
        before, after, oracle, true: distance of the tool from the line with the model as it was, as extended, with the
            oracle's latency, and with the true one.
        latency: assumed in each of them [s].
        diagnosis: what was found.
        recording: what it was found from.
    """

    scene: LineScene
    before: ControlError
    after: ControlError
    oracle: ControlError
    true: ControlError
    latency: dict[str, float]
    diagnosis: Diagnosis = field(repr=False)
    recording: Recording = field(repr=False)
    model_path: Path | None = None
    report: Path | None = None

    @property
    def errors(self) -> dict[str, ControlError]:
        """The four runs by name."""
        return {"before": self.before, "after": self.after, "oracle": self.oracle, "true": self.true}

    def json(self) -> dict[str, Any]:
        """The content of ``--json``."""
        return {
            "scene": self.scene.name, "undeclared": [{"effect": EFFECT, "joint": 0}],
            "path_error_mm": {name: {"mean": 1e3 * e.mean, "p95": 1e3 * e.p95, "max": 1e3 * e.max}
                              for name, e in self.errors.items()},
            "latency_ms": {name: 1e3 * value for name, value in self.latency.items()},
            "after_over_oracle": self.after.mean / self.oracle.mean, "diagnosis": self.diagnosis.to_dict(),
            "model": self.model_path, "report": self.report,
        }

    columns = ("model", "latency ms", "mean", "95 %", "max")

    def table(self) -> list[list[Any]]:
        """One row a model: latency in ms and errors in mm."""
        return [[name, 1e3 * self.latency[name], 1e3 * e.mean, 1e3 * e.p95, 1e3 * e.max]
                for name, e in self.errors.items()]


def close_line(scene: LineScene, *, out: Path | None = None, progress: Progress = silent) -> CloseLineResult:
    """Follows a line, finds what is wrong with the camera's time, and follows it again.

    Raises:
        InputError: a scene whose time stamps are right.
    """
    if scene.camera.stamp_offset == 0.0:
        raise InputError("the camera's time stamps are right; nothing is there to be found",
                         file=f"scene {scene.name}", field="camera.stamp_offset", value=0.0)
    robot = set_up(scene).robot
    model = model_for(scene, robot)
    with prepared(scene, progress) as shared, tempfile.TemporaryDirectory() as folder:
        progress(0.1, "before")
        before = follow(scene, method="ideal", shared=shared)
        progress(0.3, "diagnose")
        found = diagnose(before.recording, robot, model=model,
                         progress=lambda share, word: progress(0.3 + 0.2 * share, word))
        added = [f.fitted for f in found.effects if f.fitted.channel == "line"]
        extended = with_effects(model, added)
        runs = {"after": extended, "oracle": with_effects(model, [told_line(before.recording, robot, model, EFFECT)]),
                "true": with_effects(model, [_of_size(-scene.camera.stamp_offset)])}
        again: dict[str, LineResult] = {}
        for i, (name, known) in enumerate(runs.items()):
            progress(0.5 + 0.15 * i, name)
            again[name] = _played(scene, known, shared, Path(folder))
    latency = {"before": assumed_latency(model), **{name: assumed_latency(known) for name, known in runs.items()}}
    result = CloseLineResult(scene, before.control_error, again["after"].control_error, again["oracle"].control_error,
                             again["true"].control_error, latency, found, before.recording)
    if out is None:
        return result
    from scenes.refine.page import write_line_circle

    return write_line_circle(result, extended, out)


def with_effects(model: Model, effects: list[FittedEffect]) -> Model:
    """The model with effects added."""
    return dataclasses.replace(model, effects=model.effects + tuple(effects))


def _of_size(latency: float) -> FittedEffect:
    return FittedEffect(EFFECT, 0, "line", (latency,))


def _played(scene: LineScene, model: Model, shared: Prepared, folder: Path) -> LineResult:
    file = model.save(folder / "model.json")
    return follow(scene.model_copy(update={"model": str(file)}), method="ideal", shared=shared)
