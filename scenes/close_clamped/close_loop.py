"""Model without stiffness → clamped recordings ([J]) → stiffness → model → path: one command, no tracker.

For comparison the same with the stiffness that an external device's arm angles give on a motion in the same world,
and with the true one.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.elasticity.clamped_signals import WRENCH
from ideal_robot.elasticity.stiffness_analysis import StiffnessAnalysis, analyse_stiffness
from ideal_robot.errors import InputError
from ideal_robot.feedforward.base import PassThrough
from ideal_robot.identification.joint_fit import stiffness_from_arm
from ideal_robot.model.model import Model
from ideal_robot.progress import Steps
from ideal_robot.signals.recording import Recording
from scenes.clamped.play import configurations, record
from scenes.close_clamped.page import write_close_clamped
from scenes.close_clamped.result import CloseClampedResult
from scenes.close_clamped.scene import CloseClampedScene
from scenes.methods import IDEAL
from scenes.metrics import PathErrors
from scenes.path.cell import PathCell, set_up, training_path
from scenes.result import Progress, silent
from scenes.scene_files.clamped_scene import ClampedScene
from sim.contact.clamp_world import ClampWorld

SHARES = {"before": 0.14, "clamping the flange": 0.13, "stiffness": 0.11, "after": 0.13,
          "with a tracker, and with the truth": 0.29, "report": 0.2}
"""Measured shares of the time."""


def close_loop(scene: CloseClampedScene, *, measured: str = "motor", out: Path | None = None,
               progress: Progress = silent) -> CloseClampedResult:
    """Clamps the flange, identifies the gears' stiffness and plays the path with it.

    Args:
        scene: path, arm, and how the flange is clamped.
        measured: ``tcp``: the wrench at the clamp too; ``motor``: motor angles and currents alone, so that an error of
            the data sheet's drive gains goes into the stiffness in full. ``arm`` is not for an arm that is clamped.
        out: folder for recordings, model and report; nothing is written without.
        progress: called with the fraction done.

    Raises:
        InputError: a scene that cannot be played, or recordings that do not say all gears.
    """
    if measured not in ("motor", "tcp"):
        raise InputError("expected motor (angles and currents alone) or tcp (the wrench at the clamp too)",
                         field="measured", value=measured)
    cell = set_up(scene, delay=False)
    truth = cell.world.per_joint("stiffness", cell.robot.n)
    without = dataclasses.replace(cell.model, stiffness=None, damping=None)
    job = Steps(progress, SHARES)
    job.begin("before")
    before = _played(cell, without)
    job.begin("clamping the flange")
    rng = np.random.default_rng(scene.seed)
    clamped = ClampedScene(name=scene.name, kind="clamped", title=scene.title, robot=scene.robot, seed=scene.seed,
                           clamp=scene.clamp)
    world = dataclasses.replace(ClampWorld.default(cell.robot), stiffness=np.array(truth))
    recordings, _ = record(clamped, cell.robot, world, configurations(clamped, cell.robot, rng), rng)
    if measured == "motor":
        recordings = [_without_wrench(one) for one in recordings]
    job.begin("stiffness")
    analysis = analyse_stiffness(recordings, cell.robot)
    found = stiffness_of(analysis, cell.robot.n)
    extended = dataclasses.replace(without, stiffness=found)
    job.begin("after")
    after = _played(cell, extended)
    job.begin("with a tracker, and with the truth")
    moved = cell.play(PassThrough(cell.world.t_ipo), path=training_path(cell.path, cell.world.t_ipo)).recording
    by_tracker, damping = stiffness_from_arm([moved], cell.model)
    tracker = _played(cell, dataclasses.replace(without, stiffness=by_tracker, damping=damping))
    oracle = _played(cell, dataclasses.replace(without, stiffness=np.array(truth)))
    result = CloseClampedResult(scene, before, after, tracker, oracle,
                                {"after": found, "tracker": by_tracker, "oracle": np.array(truth)}, analysis,
                                measured)
    job.begin("report")
    return result if out is None else write_close_clamped(result, extended, recordings, out)


def stiffness_of(analysis: StiffnessAnalysis, n: int) -> Array:
    """The best known stiffness of each joint ``(n,)`` [N m/rad]: of the methods that say one, the surest.

    Args:
        analysis: of clamped recordings.
        n: joints of the arm.

    Raises:
        InputError: a joint that no recording loaded.
    """
    result = np.full(n, np.nan)
    for joint in range(1, n + 1):
        said = [one for one in analysis.joints if one.joint == joint]
        if said:
            best = min(said, key=lambda one: (one.interval[1] - one.interval[0]) / one.stiffness)
            result[joint - 1] = best.stiffness
    missing = np.flatnonzero(~np.isfinite(result)) + 1
    if len(missing):
        raise InputError("no clamped recording loads these joints; clamp in another configuration", field="clamp",
                         value=missing.tolist())
    return result


def _without_wrench(recording: Recording) -> Recording:
    columns = {name: values for name, values in recording.columns.items() if name not in (*WRENCH, "t_wrench")}
    return dataclasses.replace(recording, columns=columns)


def _played(cell: PathCell, model: Model) -> PathErrors:
    again = dataclasses.replace(cell, model=model)
    return again.play(again.feedforward(IDEAL)).errors
