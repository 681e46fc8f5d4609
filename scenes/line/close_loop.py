"""The circle with a camera whose time stamps are wrong: follow the line, diagnose that run alone, follow it again.

What the diagnosis finds of the camera's latency goes into the model file, from where the follower takes what it
assumes. The oracle knows that it is the latency, and fits it to the same recording.
"""

from __future__ import annotations

import dataclasses
import tempfile
from pathlib import Path

from ideal_robot.diagnosis import diagnose
from ideal_robot.diagnosis.validation.oracle import named_camera_effect
from ideal_robot.effects import FittedEffect
from ideal_robot.errors import InputError
from ideal_robot.model.model import Model
from scenes.line.cell import Prepared, prepared, set_up
from scenes.line.close_loop_page import write_line_circle
from scenes.line.close_loop_result import EFFECT, CloseLineResult
from scenes.line.play import play
from scenes.line.result import LineResult
from scenes.line.scene import LineScene
from scenes.line.task import assumed_latency
from scenes.measured import checked_measured, visible
from scenes.methods import IDEAL
from scenes.models import model_for
from scenes.result import Progress, silent


def close_loop(scene: LineScene, *, measured: str = "tcp", out: Path | None = None,
               progress: Progress = silent) -> CloseLineResult:
    """Follows a line, finds what is wrong with the camera's time, and follows it again.

    Args:
        scene: what to play.
        measured: what the arm measures: ``motor``, ``arm`` or ``tcp`` (``scenes.measured``).
        out: folder for recording, model and report; nothing is written without.
        progress: called with the fraction done.

    Raises:
        InputError: a scene whose time stamps are right.
    """
    if scene.camera.stamp_offset == 0.0:
        raise InputError("the camera's time stamps are right; nothing is there to be found",
                         file=f"scene {scene.name}", field="camera.stamp_offset", value=0.0)
    seen_by = checked_measured(measured)
    robot = set_up(scene).robot
    model = model_for(scene, robot)
    with prepared(scene, progress) as shared, tempfile.TemporaryDirectory() as folder:
        progress(0.1, "before")
        before = play(scene, IDEAL, shared=shared)
        progress(0.3, "diagnose")
        run = visible(before.recording, seen_by)
        found = diagnose(run, robot, model=model,
                         progress=lambda share, word: progress(0.3 + 0.2 * share, word))
        added = [f.fitted for f in found.effects if f.fitted.channel == "line"]
        extended = with_effects(model, added)
        fitted = named_camera_effect(run, robot, model, EFFECT)
        runs = {"after": extended, "oracle": with_effects(model, [fitted]),
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
    return write_line_circle(result, extended, out)


def with_effects(model: Model, effects: list[FittedEffect]) -> Model:
    """The model with effects added."""
    return dataclasses.replace(model, effects=model.effects + tuple(effects))


def _of_size(latency: float) -> FittedEffect:
    return FittedEffect(EFFECT, 0, "line", (latency,))


def _played(scene: LineScene, model: Model, shared: Prepared, folder: Path) -> LineResult:
    file = model.save(folder / "model.json")
    return play(scene.model_copy(update={"model": str(file)}), IDEAL, shared=shared)
