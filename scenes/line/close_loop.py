"""Closing with a line: follow it, diagnose that run alone, follow it again.

Diagnosed errors of time stamps, mounting and lens go into the model file, from which the follower takes its
assumptions. A change is accepted by the distance of the seen points from one smooth curve, which is all that a real
cell can measure of its camera.

A run along a line does not determine the arm's gears and friction, as hardly a joint reverses. So a motion about the
line is diagnosed once no more camera errors are found, and its changes are accepted by the tool's distance from the
follower's desired path. In a cell (``world = "cell"``) the joint controllers are identified anew from that motion, too:
drives there compensate friction, and their gains follow the inertia. The arm is cold, so its friction is adapted
meanwhile. The arm's geometry stays as drawn: a camera that rides on the arm sees the line by the same wrong geometry
with which the arm then goes there, and what one line shows of it would bend everything off that line.
"""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ideal_robot.arrays import Array, interpolated
from ideal_robot.diagnosis import diagnose
from ideal_robot.diagnosis.channels.line import line_regression
from ideal_robot.diagnosis.channels.motor_torque import torque_regression
from ideal_robot.diagnosis.validation.refit import named_sensor_effects, with_named_effects
from ideal_robot.effects import MOTOR_TORQUE, SENSOR, FittedEffect
from ideal_robot.effects.camera import CameraErrors
from ideal_robot.errors import InputError
from ideal_robot.execution.play import play as play_motion
from ideal_robot.feedforward.base import PassThrough
from ideal_robot.feedforward.training_motion import training_motion
from ideal_robot.identification.checks import checked
from ideal_robot.model.model import Model
from ideal_robot.progress import Steps
from ideal_robot.registry import in_words
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from scenes.arms import arm_of
from scenes.closing.drives import DRIVES, controllers_anew
from scenes.closing.loop import Form, Found, Group, Place, Subject, close
from scenes.closing.result import (
    SHARES,
    Closing,
    Measured,
    Played,
    Words,
    at_speeds,
    checked_measured,
    measured_places,
    visible,
)
from scenes.line.cell import Cell, Prepared, prepared, set_up
from scenes.line.play import play
from scenes.line.result import LineResult
from scenes.methods import ADAPTED, IDEAL
from scenes.models import model_for
from scenes.result import Progress, silent
from scenes.scene_files.line_scene import LineScene
from scenes.scene_files.scene import CELL, SceneError
from scenes.undeclared import GEOMETRY, effects_of_world, keys_of_arm, of_controllers
from sim.arm.arm import SimulatedArm

WORDS = Words(
    "path_error_mm", "Mean distance from the line [mm]", "spread of seen points mm",
    ("model", "latency ms", "mean mm", "95 % mm", "max mm"), "the camera as it was believed",
    "Distance of the true TCP from the line, in the surface; the last row knows the true camera and its time stamps.",
    "How far the line's points, as the camera saw them from many poses, lie from one smooth curve: all that the cell "
    "itself measures of its camera. Of a change of the arm, how far the tool was from where the follower wanted it.",
    ("arc length of the line [m]", "distance [mm]", "Distance of the true TCP from the line."))

EFFECTS = {"camera_latency": ("camera", "stamp_offset"), "clock_drift": ("camera", "stamp_drift"),
           "camera_scale": ("calibration", "focal_percent", "height_mm"),
           "camera_offset": ("calibration", "yaw_deg", "pitch_deg"), "lens_distortion": ("calibration", "k1")}
"""What a camera that is wrong is called in the effect library: table of the scene and its keys."""


def assumed_latency(model: Model) -> float:
    """Error of the camera's time stamps in the model [s]; 0 where it has none."""
    return CameraErrors.of(model.effects).late_by(0.0)


def close_loop(scene: LineScene, *, measured: str = "tcp", out: Path | None = None,
               progress: Progress = silent) -> Closing:
    """Runs a line scene and diagnoses its camera and arm; see ``CloseLoop.__call__``."""
    undeclared = undeclared_effects(scene)
    arm = effects_of_world(scene, arm_of(scene.robot).n) if keys_of_arm(scene) else _drives(scene)
    return closed(scene, undeclared, arm=tuple(pair for pair in arm if pair[0] != "kinematic_error"), measured=measured,
                  out=out, progress=progress)


def closed(scene: LineScene, undeclared: tuple[str, ...], *, arm: tuple[Place, ...] = (), measured: str = "tcp",
           out: Path | None = None, progress: Progress = silent) -> Closing:
    """``close-loop`` on a line with given true errors of camera and arm, which may be none.

    Args:
        scene: the scene.
        undeclared: names of the effects by which the camera differs from the follower's model.
        arm: effects, with their joints, by which the arm differs from its model; without any the arm is not diagnosed.
        measured: the quantities that the arm measures.
        out: folder for recording, model and report; nothing is written without.
        progress: called with the fraction done.
    """
    cell, job = set_up(scene), Steps(progress, SHARES)
    known = model_for(scene, cell.known.robot)
    with prepared(scene, progress) as shared, tempfile.TemporaryDirectory() as folder:
        line = _Line(scene, cell, known, checked_measured(measured), shared, Path(folder), looks_at_arm=bool(arm))
        job.begin("before")
        before = line.play(known)
        done = close(line, known, before, out=out, progress=job.part("rounds"))
        job.begin("oracle")
        oracle_model = known.with_effects(line.fitted(before, known, undeclared)) if undeclared else known
        named = tuple(place for place in arm if place != DRIVES)
        if len(named) < len(arm) and (anew := line.controllers()) is not None:
            oracle_model = anew.change(oracle_model, before)
        oracle_model = with_named_effects(line.moved(), line.robot, oracle_model, named) if named else oracle_model
        try:
            oracle = line.play(oracle_model) if undeclared or arm else before
        except SceneError:
            # With the parameters fitted to the first run the line is lost, so the oracle does not use them.
            oracle = before
        stamped = known.with_effects(_true_stamps(scene))
        right = shared if scene.calibration.by_moving else dataclasses.replace(shared, believed=cell.true_camera)
        runs = {"before": (before, known), "after": (done.run, done.model), "oracle": (oracle, oracle_model),
                "true": (line.play(stamped, right), stamped)}
    plays = {name: _played(name, run, 1e3 * assumed_latency(model)) for name, (run, model) in runs.items()}
    job.begin("report")
    return Closing(scene, (*((name, 0) for name in undeclared), *arm), plays, done, WORDS,
                   {"recording.parquet": before.recording},
                   {"latency_ms": {name: entry.row[1] for name, entry in plays.items()}}).written(out)


@dataclass
class _Line(Subject[LineResult]):
    """A line, the camera that sees it and the arm that follows it."""

    scene: LineScene
    cell: Cell
    known: Model
    measured: Measured
    shared: Prepared
    folder: Path
    looks_at_arm: bool
    stops: bool = False
    about: list[Recording] = field(default_factory=list)

    def play(self, model: Model, shared: Prepared | None = None) -> LineResult:
        scene = self.scene.model_copy(update={"model": str(model.save(self.folder / "model.json"))})
        run = play(scene, ADAPTED if _of_cell(scene) else IDEAL, shared=shared or self.shared)
        if run.failure and model is not self.known and not self.stops:
            # A run that stopped early cannot be compared, unless the first one stopped, too.
            raise SceneError(run.failure)
        self.stops = self.stops or bool(run.failure)
        return run

    def find(self, model: Model, run: LineResult, progress: Progress) -> Found:
        diagnosis = diagnose(self.seen(run), self.robot, model=model, progress=progress)
        names = tuple(dict.fromkeys(f.fitted.name for f in diagnosis.effects if f.fitted.channel == "line"))
        # Causes that a poor run does not distinguish may be too large together, so each is tried alone, too.
        together = (self._camera(names),) if len(names) > 1 else ()
        return Found(diagnosis, self.seen(run), (Group(together, tuple((self._camera((name,)),) for name in names)),))

    def _camera(self, names: tuple[str, ...]) -> Form:
        def change(model: Model, run: LineResult) -> Model:
            # Effects that were accepted before are fitted again with the new one, as the camera's parameters are
            # correlated.
            before = [effect.name for effect in model.effects if effect.channel == "line"]
            return model.with_effects(self.fitted(run, model, tuple(dict.fromkeys([*before, *names]))))

        return Form(" and ".join(map(in_words, names)), change, tuple((name, 0) for name in names))

    def asked(self, found: Found, model: Model, run: LineResult, progress: Progress) -> Found | None:
        if not self.looks_at_arm or self.about:
            return None
        moved = self.moved()
        diagnosis = diagnose(moved, self.robot, model=model, progress=progress)
        effects = [e.fitted for e in (*diagnosis.effects, *diagnosis.unknown) if e.fitted.domain != SENSOR]
        anew = self.controllers() if _drives(self.scene) else None
        return Found(diagnosis, moved, (*([Group((anew,))] if anew is not None else []),
                                        Group.adding([effect for effect in effects if _acts(effect)])))

    def controllers(self) -> Form | None:
        """The joint controllers anew, from the motion about the line; None where it does not tell them."""
        return controllers_anew(self.known, self.moved(), self.robot)

    def readings(self, before: LineResult, after: LineResult, known: Model, model: Model) -> list[tuple[Array, Array]]:
        if model.controller is not known.controller:
            # Controllers are judged by the motor angles, whatever gears and geometry add behind the motors.
            return [(self._kept(before, "motor"), self._kept(after, "motor"))]
        of_camera = not model.effects or model.effects[-1].channel == "line"
        deviation = self._spread if of_camera or before is after else self._kept
        return [(deviation(before), deviation(after))]

    def _spread(self, run: LineResult) -> Array:
        """How far the seen points lie from one smooth curve ``(N, 1)`` [m]."""
        (recording,), _ = checked([self.seen(run)], self.robot)
        torque = torque_regression(recording, self.robot, self.known)
        regression = line_regression(recording, self.robot, torque, self.known.known_stiffness)
        return np.empty(0) if regression is None else regression.y - regression.y.mean(axis=0)

    def _kept(self, run: LineResult, measured: Measured | None = None) -> Array:
        """How far the tool was across its way from where it was wanted ``(N, 2)`` [m], by what is ``measured``.

        When it comes to a place is no distance from a line. It is asked where the distance from the line counts: what a
        line that was just found is approached by is the plan's.
        """
        if not len(run.control_error.t):
            return np.empty((0, 2))
        first, last = run.control_error.t[[0, -1]]
        seen = self.seen(run) if measured is None else visible(run.recording, measured)
        (recording,), _ = checked([seen], self.robot)
        t = np.arange(recording.t[0], recording.t[-1], self.robot.t_ipo)
        q_d = interpolated(t, recording.t, recording.joints("q_d"))
        counts = (t >= first) & (t <= last)
        if np.count_nonzero(counts) < 8:
            return np.empty((0, 2))
        wanted = self.robot.tool_places(q_d)
        off = interpolated(t, recording.t, measured_places(recording, (t, q_d), self.robot, self.known)) - wanted
        along = np.gradient(wanted, axis=0)
        across = np.cross(self.cell.known.reference.frames(np.zeros(1)).up[0], along)
        sides = np.stack([across, np.cross(along, across)], axis=1)[counts]
        size = np.maximum(np.linalg.norm(sides, axis=2), 1e-12)
        return np.asarray(np.einsum("nsk,nk->ns", sides, off[counts]) / size)

    @property
    def robot(self) -> Robot:
        """The arm as the follower knows it."""
        return self.cell.known.robot

    def seen(self, run: LineResult) -> Recording:
        """The recording of a run, without what the arm does not measure."""
        return visible(run.recording, self.measured)

    def fitted(self, run: LineResult, model: Model, names: Sequence[str]) -> tuple[FittedEffect, ...]:
        """Effects of the camera by their names, in a run with a model."""
        return named_sensor_effects(self.seen(run), self.robot, model, names)

    def moved(self) -> Recording:
        """What is measured in a motion about the reference path, to and fro at full and at a third of the speed."""
        if not self.about:
            t_ipo = self.robot.t_ipo
            q_d = at_speeds(training_motion(self.cell.known.follower.q_reference, t_ipo), (1.0, 3.0))
            with SimulatedArm(self.robot, self.cell.world, self.cell.noise, q_d[0]) as arm:
                ended = play_motion(arm, PassThrough(t_ipo), q_d).error
                if ended is not None:
                    raise ended
                self.about.append(visible(arm.recording(external=True), self.measured))
        return self.about[0]


def _of_cell(scene: LineScene) -> bool:
    """Whether the arm stands in a cell, whose drives do more than the loops of the model."""
    return scene.world.get("base") == CELL


def _drives(scene: LineScene) -> tuple[Place, ...]:
    """What a cell, or a world with other joint controllers, hides of its arm: nothing elsewhere."""
    return (DRIVES,) if _of_cell(scene) or of_controllers(scene) else ()


def _acts(effect: FittedEffect) -> bool:
    """Whether it acts, and is not what currents say of a gear: arm angles say that better."""
    change = effect.effect.loop_change(effect.coefficients, effect.theta)
    if change.nowhere or change.zero or change.geometry is not None:
        return False
    return effect.domain != MOTOR_TORQUE or not change.of_gear


def _played(name: str, run: LineResult, latency: float) -> Played:
    error = run.control_error
    sizes = [1e3 * size for size in (error.mean, error.p95, error.max)]
    return Played(error, sizes[0], [name, latency, *sizes], error.json_mm(), (error.s, 1e3 * error.lateral))


def undeclared_effects(scene: LineScene) -> tuple[str, ...]:
    """Effects by which the camera of a scene differs from the follower's model.

    Raises:
        InputError: none, nor any of the arm, or one that cannot be seen along a line; names the keys.
    """
    wrong = scene.calibration
    if not wrong.by_moving:
        for key in ("lateral_mm", "roll_deg", "principal_px"):
            if getattr(wrong, key):
                raise InputError("along a line this error cannot be seen: a camera that is shifted across the line, or "
                                 "rolled, sees another line; set it to 0, or let the camera be calibrated (by_moving "
                                 "= true)",
                                 file=scene.source, field=f"calibration.{key}", value=getattr(wrong, key))
    known = {"camera": scene.stamp_estimate, "calibration": wrong.by_moving}
    effects = tuple(effect for effect, (table, *keys) in EFFECTS.items() if not known[table]
                    and any(getattr(getattr(scene, table), key) for key in keys))
    keys = keys_of_arm(scene)
    if not effects and keys and all(key in GEOMETRY for key in keys):
        raise InputError("along a line this error cannot be seen: the camera is on the arm, and sees the line by "
                         "the same wrong geometry by which the arm follows it; close a path scene with this "
                         "world",
                         file=scene.source, field=f"world.{keys[0]}", value=scene.world[keys[0]])
    if not effects and not keys and not _drives(scene):
        raise InputError("the camera is right, or its follower estimates its errors by itself: there is nothing to "
                         "diagnose; set camera.stamp_offset or camera.stamp_drift with stamp_estimate = false, or the "
                         "sizes in "
                         "[calibration] with by_moving = false, one of the arm's keys in [world], or world = "
                         '"cell"',
                         file=scene.source, field="camera")
    return effects


def _true_stamps(scene: LineScene) -> tuple[FittedEffect, ...]:
    camera = scene.camera
    if scene.stamp_estimate:
        return ()
    return (FittedEffect("camera_latency", 0, "line", (-camera.stamp_offset,)),
            FittedEffect("clock_drift", 0, "line", (-camera.stamp_drift / (1.0 + camera.stamp_drift),)))
