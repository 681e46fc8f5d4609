"""Closing with a wrong force sensor and contact: press and move, diagnose that run, press again.

The diagnosed bias and compliance go into the model file, from which the force controller takes its assumptions. A
change is accepted by the residual of the run under the assumed sensor and contact: the measured force error would not
show a sensor error, as it contains it. The run ``oracle`` knows which effects are wrong; ``true`` also knows their
values.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.diagnosis import diagnose
from ideal_robot.diagnosis.channels.force import force_regressions
from ideal_robot.diagnosis.channels.motor_torque import in_position_band, torque_regression
from ideal_robot.diagnosis.statistics.problem import Problem
from ideal_robot.diagnosis.validation.refit import named_sensor_effects
from ideal_robot.effects import SENSOR
from ideal_robot.errors import InputError
from ideal_robot.identification.checks import checked
from ideal_robot.model.model import Model
from ideal_robot.progress import Steps
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from scenes.arms import arm_of
from scenes.closing.loop import Found, Group, Subject, close
from scenes.closing.result import SHARES, Closing, Measured, Played, Words, checked_measured, visible
from scenes.force.play import ForceResult, play
from scenes.methods import IDEAL
from scenes.models import model_for
from scenes.result import Progress, silent
from scenes.scene_files.force_scene import ForceScene
from scenes.undeclared import keys_of_arm

WORDS = Words(
    "force_error_N", "RMS force error [N]", "left in the run N",
    ("model", "RMS force error N", "mean force N", "largest N", "contact lost ms"),
    "sensor and contact as they were assumed", "Of the true normal force while the tip travels.",
    "What the sensor and the contact that are believed leave unexplained of wrench and place in the run.")


def close_loop(scene: ForceScene, *, measured: str = "tcp", out: Path | None = None,
               progress: Progress = silent) -> Closing:
    """Runs a force scene and diagnoses its sensor and contact; see ``CloseLoop.__call__``."""
    undeclared, job, robot = undeclared_effects(scene), Steps(progress, SHARES), arm_of(scene.robot)
    known = model_for(scene, robot)
    with tempfile.TemporaryDirectory() as folder:
        force = _Force(scene, robot, known, checked_measured(measured), Path(folder))
        job.begin("before")
        before = force.play(known)
        done = close(force, known, before, out=out, progress=job.part("rounds"))
        job.begin("oracle")
        oracle = force.play(known.with_effects(named_sensor_effects(force.seen(before), robot, known, undeclared)))
        right = {"sensor": scene.sensor.model_copy(update={"drift": ()}),
                 "assumed": scene.assumed.model_copy(update={"elasticity_ratio": 1.0})}
        true = force.play(known, scene.model_copy(update=right))
    runs = {"before": before, "after": done.run, "oracle": oracle, "true": true}
    job.begin("report")
    return Closing(scene, tuple((name, 0) for name in undeclared),
                   {name: _played(name, run) for name, run in runs.items()}, done, WORDS,
                   {"recording.parquet": before.recording}).written(out)


@dataclass
class _Force(Subject[ForceResult]):
    """The force sensor and the contact of a scene."""

    unit, scale = "N", 1.0
    scene: ForceScene
    robot: Robot
    known: Model
    measured: Measured
    folder: Path

    def play(self, model: Model, scene: ForceScene | None = None) -> ForceResult:
        file = model.save(self.folder / "model.json")
        return play((scene or self.scene).model_copy(update={"model": str(file)}), IDEAL)

    def find(self, model: Model, run: ForceResult, progress: Progress) -> Found:
        diagnosis = diagnose(self.seen(run), self.robot, model=model, progress=progress)
        effects = [effect.fitted for effect in diagnosis.effects
                   if effect.fitted.domain == SENSOR and effect.fitted.name in ("force_bias", "force_compliance")]
        return Found(diagnosis, self.seen(run), (Group.adding(effects),))

    def readings(self, before: ForceResult, after: ForceResult, known: Model, model: Model
                 ) -> list[tuple[Array, Array]]:
        without, with_it = self._left(before), self._left(after)
        shared = [channel for channel in without if channel in with_it]
        return [(np.concatenate([without[c] for c in shared]), np.concatenate([with_it[c] for c in shared]))]

    def _left(self, run: ForceResult) -> dict[str, Array]:
        """What is unexplained of each force ``(N,)`` [N]; of the tip's place by the contact's stiffness."""
        (recording,), _ = checked([self.seen(run)], self.robot)
        torque = in_position_band(torque_regression(recording, self.robot, self.known), recording)
        left = dict[str, Array]()
        for made, _ in force_regressions(recording, None, self.robot, torque, None, self.known.known_stiffness):
            residual = Problem(made).fit([]).residual(made)
            left |= {channel: residual[:, k] * (self.scene.tip.stiffness if unit == "m" else 1.0)
                     for k, (channel, unit) in enumerate(zip(made.channels, made.units, strict=True)) if unit != "N m"}
        return left

    def seen(self, run: ForceResult) -> Recording:
        """The recording of a run, without what the arm does not measure."""
        return visible(run.recording, self.measured)


def _played(name: str, run: ForceResult) -> Played:
    f = run.figures
    return Played(f, f.rms, [name, f.rms, f.mean, f.largest, 1e3 * f.lost],
                  {"rms": f.rms, "mean": f.mean, "largest": f.largest, "lost_s": f.lost})


def undeclared_effects(scene: ForceScene) -> tuple[str, ...]:
    """Effects by which sensor and contact differ from what the controller assumes.

    Raises:
        InputError: none; names the keys that would be some.
    """
    compliance = scene.assumed.elasticity_ratio != 1.0 and not scene.assumed.elasticity_estimated
    wrong = {"force_bias": any(scene.sensor.drift), "force_compliance": compliance}
    effects = tuple(name for name, differs in wrong.items() if differs)
    keys = keys_of_arm(scene)
    if not effects and keys:
        raise InputError("sensor and contact are right, and its influence on the force is not diagnosed here: close "
                         "a path scene with this world, and give its model to this one",
                         file=scene.source, field=f"world.{keys[0]}", value=scene.world[keys[0]])
    if not effects:
        raise InputError("sensor and contact are right, or the controller estimates their errors by itself: there is "
                         "nothing to diagnose; set sensor.drift, or assumed.elasticity_ratio with "
                         "elasticity_estimated = false",
                         file=scene.source, field="sensor.drift")
    return effects
