"""Uses the stiffness from clamped recordings on a path, for an arm without any external measuring device.

Model without stiffness → clamped recordings ([J]) → stiffness → model → path: one command, no tracker. A change is
accepted by the motor shifts of each clamped recording that the stiffness of the other ones leaves unexplained: without
an external device the path itself shows nothing of the gears' deflection. For comparison the same with the stiffness
that an external device's arm angles give on a motion in the same world, and with the true one.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import ClassVar, cast

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.elasticity.clamped_signals import WRENCH
from ideal_robot.elasticity.stiffness import Method, identify_joint, joint_loads
from ideal_robot.elasticity.stiffness_analysis import StiffnessAnalysis, analyse_stiffness
from ideal_robot.errors import InputError
from ideal_robot.feedforward.base import PassThrough
from ideal_robot.identification.joint_fit import stiffness_from_arm
from ideal_robot.model.described_arm import Gears
from ideal_robot.model.model import Model
from ideal_robot.progress import Steps
from ideal_robot.signals.recording import Recording
from scenes.clamped import configurations, record
from scenes.closing.loop import Form, Found, Group, Subject, close
from scenes.closing.result import SHARES, Closing
from scenes.kind import SceneKind
from scenes.methods import IDEAL
from scenes.path.cell import PathCell, Play, set_up, training_path
from scenes.path.close_loop import WORDS, played
from scenes.path.kind import PATH
from scenes.report.page import Report
from scenes.result import Progress, silent
from scenes.scene_files.clamped_scene import ClampedScene, ClampTable
from scenes.scene_files.path_scene import PathScene
from scenes.scene_files.scene import BENCH
from sim.contact.clamp_world import ClampWorld


class CloseClampedScene(PathScene):
    """A tool path of an arm whose gears are known from recordings with the flange clamped alone."""

    worlds: ClassVar[tuple[str, ...]] = (BENCH,)
    clamp: ClampTable = ClampTable(most=3)


SOURCES = {"before": "none", "after": "clamped flange", "tracker": "arm angles of a tracker", "oracle": "true"}
"""Where each play's stiffness is from."""


def close_loop(scene: CloseClampedScene, *, measured: str = "motor", out: Path | None = None,
               progress: Progress = silent) -> Closing:
    """Clamps the flange, identifies the gears' stiffness and runs the path with it; see ``CloseLoop.__call__``.

    With ``tcp`` measured the wrench at the clamp is used, too; with ``motor`` only angles and currents are used, so
    that errors of the data sheet's drive gains appear in the stiffness in full. ``arm`` is not possible for a clamped
    arm.
    """
    if measured not in ("motor", "tcp"):
        raise InputError("expected motor (angles and currents alone) or tcp (the wrench at the clamp too)",
                         field="measured", value=measured)
    cell, job = set_up(scene, delay=False), Steps(progress, SHARES)
    without = dataclasses.replace(cell.model, gears=None)
    clamp = _Clamp(scene, cell, cast(Method, "wrench" if measured == "tcp" else "motor"))
    job.begin("before")
    before = clamp.play(without)
    done = close(clamp, without, before, rounds=1, out=out, progress=job.part("rounds"))
    job.begin("oracle", "with a tracker, and with the truth")
    moved = cell.play(PassThrough(cell.world.t_ipo), path=training_path(cell.path, cell.world.t_ipo)).recording
    by_tracker = stiffness_from_arm([moved], cell.model)
    runs = {"before": before, "after": done.run,
            "tracker": clamp.play(dataclasses.replace(without, gears=by_tracker)),
            "oracle": clamp.play(dataclasses.replace(without, gears=Gears(clamp.true)))}
    job.begin("report")
    plays = {name: played(SOURCES[name], run.errors) for name, run in runs.items()}
    clamp.stiffness |= {"tracker": by_tracker.stiffness, "oracle": clamp.true}
    more = {"E_car_aligned_mm": {name: play.error for name, play in plays.items()}, "measured": measured,
            "after_over_tracker": plays["after"].error / plays["tracker"].error, "clamped": clamp.analysis.to_dict(),
            "stiffness": {name: [float(k) if np.isfinite(k) else None for k in values]
                          for name, values in clamp.stiffness.items()}}
    words = dataclasses.replace(
        WORDS, judged="shift of clamped motors mrad", as_it_was="no stiffness",
        columns=("stiffness", *WORDS.columns[1:]),
        decides="Shift of the motors in each clamped recording that the other ones' stiffness leaves unexplained.")
    recordings = {f"clamped_{number}.parquet": recording for number, recording in enumerate(clamp.recordings, start=1)}
    return Closing(scene, (), plays, done, words, recordings, more, clamp.section).written(out)


class _Clamp(Subject[Play]):
    """A path, and the arm that plays it and can be clamped."""

    unit = "mrad"
    analysis: StiffnessAnalysis
    recordings: list[Recording]

    def __init__(self, scene: CloseClampedScene, cell: PathCell, method: Method) -> None:
        self.true = np.array(cell.world.per_joint("stiffness", cell.robot.n))
        self.stiffness: dict[str, Array] = {}
        self._scene, self._cell, self._robot, self._method = scene, cell, cell.robot, method

    def play(self, model: Model) -> Play:
        again = dataclasses.replace(self._cell, model=model)
        return again.play(again.feedforward(IDEAL))

    def find(self, model: Model, run: Play, progress: Progress) -> Found:
        scene, rng = self._scene, np.random.default_rng(self._scene.seed)
        clamped = ClampedScene(name=scene.name, kind="clamped", title=scene.title, robot=scene.robot, seed=scene.seed,
                               clamp=scene.clamp)
        world = dataclasses.replace(ClampWorld.default(self._robot), stiffness=self.true)
        recordings, _ = record(clamped, self._robot, world, configurations(clamped, self._robot, rng), rng)
        self.recordings = [_without_wrench(r) for r in recordings] if self._method == "motor" else recordings
        self.analysis = analyse_stiffness(self.recordings, self._robot)
        stiffness = self.stiffness["after"] = stiffness_of(self.analysis, self._robot.n)
        form = Form("stiffness of all joints", lambda model, _: dataclasses.replace(model, gears=Gears(stiffness)))
        return Found(None, self.recordings[0], (Group((form,)),))

    def readings(self, before: Play, after: Play, known: Model, model: Model) -> list[tuple[Array, Array]]:
        without, with_it = list[Array](), list[Array]()
        for joint in range(1, self._robot.n + 1):
            loads = joint_loads(self.analysis.signals, self._robot, self._method, joint)
            for own in loads if len(loads) > 1 else []:
                fit = identify_joint([load for load in loads if load is not own], joint, self._method)
                shift, torque = own.q_m - own.q_m.mean(), own.tau - own.tau.mean()
                without.append(shift)
                with_it.append(shift - torque / fit.stiffness)
        if not without:
            raise InputError("no gear is loaded by two clamped recordings, so its stiffness cannot be "
                             "checked; clamp in more configurations", file=self._scene.source, field="clamp",
                             value=len(self.recordings))
        return [(np.concatenate(without), np.concatenate(with_it))]

    def section(self, page: Report) -> None:
        by_method = {(result.joint, result.method): result.stiffness for result in self.analysis.joints}
        page.heading("Stiffness")
        page.table(["joint", "clamp, motor", "clamp, wrench", "taken", "tracker", "true N m/rad"],
                   [[j + 1, by_method.get((j + 1, "motor")), by_method.get((j + 1, "wrench")),
                     *(float(values[j]) for values in self.stiffness.values())] for j in range(self._robot.n)],
                   "[J] (15)-(17); of the two methods the one with the narrower interval is taken.")
        for warning in self.analysis.warnings:
            page.warning(warning)


def stiffness_of(analysis: StiffnessAnalysis, n: int) -> Array:
    """Best stiffness estimate of each joint ``(n,)`` [N m/rad]: that of the method with the smallest deviation.

    Raises InputError for a joint that no recording loaded.
    """
    result = np.full(n, np.nan)
    for joint in range(1, n + 1):
        fits = [fit for fit in analysis.joints if fit.joint == joint]
        if fits:
            best = min(fits, key=lambda fit: (fit.interval[1] - fit.interval[0]) / fit.stiffness)
            result[joint - 1] = best.stiffness
    missing = np.flatnonzero(~np.isfinite(result)) + 1
    if len(missing):
        raise InputError("no clamped recording loads these joints; clamp in another configuration", field="clamp",
                         value=missing.tolist())
    return result


def _without_wrench(recording: Recording) -> Recording:
    columns = {name: values for name, values in recording.columns.items() if name not in (*WRENCH, "t_wrench")}
    return dataclasses.replace(recording, columns=columns)


CLOSE_CLAMPED = SceneKind(CloseClampedScene, PATH.methods, PATH.run, PATH.compare, None, close_loop, PATH.replay)
