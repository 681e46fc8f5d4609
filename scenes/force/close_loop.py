"""The circle with a force sensor and a contact that are wrong: press and move, diagnose that run, press again.

What the diagnosis finds of bias and compliance goes into the model file, from where the force controller takes what it
assumes. It stays only if less of the same is left in the run with it: that is all the cell itself can say, as its force
reading holds the error. The oracle is told what is wrong; the true one knows the numbers.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

from ideal_robot.diagnosis import Diagnosis, diagnose
from ideal_robot.diagnosis.validation.refit import named_force_effects
from ideal_robot.effects import SENSOR, FittedEffect
from ideal_robot.errors import InputError
from ideal_robot.model.model import Model
from ideal_robot.progress import Steps
from ideal_robot.robots.robot import Robot
from scenes.force.close_loop_page import write_force_circle
from scenes.force.close_loop_result import CloseForceResult
from scenes.force.play import play
from scenes.force.result import ForceResult
from scenes.measured import checked_measured, visible
from scenes.methods import IDEAL
from scenes.models import model_for
from scenes.result import Progress, silent
from scenes.scene_files.force_scene import ForceScene
from scenes.sensor_loop import LEAST, Trial, with_effects, words
from scenes.undeclared import keys_of_arm

SHARES = {"before": 0.09, "diagnosis": 0.14, "after": 0.1, "oracle": 0.08, "true": 0.08, "report": 0.51}
"""Measured shares of the time."""


def close_loop(scene: ForceScene, *, measured: str = "tcp", out: Path | None = None,
               progress: Progress = silent) -> CloseForceResult:
    """Presses and moves, finds what is wrong with sensor and contact, and does it again.

    Args:
        scene: what to play.
        measured: what the arm measures: ``motor``, ``arm`` or ``tcp`` (``scenes.measured``).
        out: folder for recording, model and report; nothing is written without.
        progress: called with the fraction done.

    Raises:
        InputError: a scene whose sensor and contact are right.
    """
    undeclared = undeclared_effects(scene)
    seen_by = checked_measured(measured)
    robot = Robot.load(scene.robot)
    model = model_for(scene, robot)
    job = Steps(progress, SHARES)
    with tempfile.TemporaryDirectory() as folder:
        def again(known: Model, own: ForceScene = scene) -> ForceResult:
            file = known.save(Path(folder) / "model.json")
            return play(own.model_copy(update={"model": str(file)}), IDEAL)

        def fitted(run: ForceResult, names: Sequence[str]) -> tuple[FittedEffect, ...]:
            return named_force_effects(visible(run.recording, seen_by), robot, model, names)

        job.begin("before")
        before = after = play(scene, IDEAL)
        found = diagnose(visible(before.recording, seen_by), robot, model=model, progress=job.begin("diagnosis"))
        extended, steps = model, list[Trial]()
        added = of_sensor(found)
        if added:
            job.begin("after", words(added))
            candidate = with_effects(model, added)
            tried = again(candidate)
            named = [effect.name for effect in added]
            reached, first = (size(fitted(run, named), scene) for run in (tried, before))
            taken = reached < LEAST * first
            steps.append(Trial(1, words(added), taken, "" if taken else "as much is left after it as before", reached))
            if taken:
                extended, after = candidate, tried
        job.begin("oracle")
        oracle = again(with_effects(model, fitted(before, undeclared)))
        job.begin("true")
        right = scene.model_copy(update={
            "sensor": scene.sensor.model_copy(update={"drift": ()}),
            "assumed": scene.assumed.model_copy(update={"elasticity_ratio": 1.0})})
        true = again(model, right)
    result = CloseForceResult(scene, undeclared, before.figures, after.figures, oracle.figures, true.figures, found,
                              before.recording, size(added, scene), tuple(steps))
    job.begin("report")
    return result if out is None else write_force_circle(result, extended, out)


def of_sensor(found: Diagnosis) -> list[FittedEffect]:
    """What a diagnosis found of the force sensor and the contact."""
    return [one.fitted for one in found.effects
            if one.fitted.domain == SENSOR and one.fitted.name in ("force_bias", "force_compliance")]


def size(effects: Sequence[FittedEffect], scene: ForceScene) -> float:
    """What effects are worth at the wanted force [N]: a bias as it is, a compliance by the contact's stiffness.

    Args:
        effects: of the force sensor and the contact.
        scene: the force that is wanted.
    """
    total = 0.0
    for effect in effects:
        if effect.name == "force_bias":
            total += sum(value**2 for value in effect.coefficients[:3]) ** 0.5
        else:
            total += abs(effect.coefficients[0]) * scene.force * scene.tip.stiffness
    return total


def undeclared_effects(scene: ForceScene) -> tuple[str, ...]:
    """Effects by which sensor and contact differ from what the controller assumes.

    Raises:
        InputError: none; names the keys that would be some.
    """
    found = []
    if any(scene.sensor.drift):
        found.append("force_bias")
    if scene.assumed.elasticity_ratio != 1.0 and not scene.assumed.elasticity_estimated:
        found.append("force_compliance")
    keys = keys_of_arm(scene)
    if not found and keys:
        raise InputError("sensor and contact are right, and what this does to the force is not looked for here: close "
                         "a path scene with this world, and give its model to this one",
                         file=scene.source, field=f"world.{keys[0]}", value=scene.world[keys[0]])
    if not found:
        raise InputError("sensor and contact are right, or the controller finds out by itself: nothing is there to be "
                         "found; set sensor.drift, or assumed.elasticity_ratio with elasticity_estimated = false",
                         file=scene.source, field="sensor.drift")
    return tuple(found)
