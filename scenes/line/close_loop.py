"""The circle with a camera that is wrong: follow the line, diagnose that run alone, follow it again.

What the diagnosis finds of time stamps, mounting and lens goes into the model file, from where the follower takes what
it believes. It stays only if the points that the camera saw then lie closer to one smooth curve: all the cell itself
can measure of its camera. What is found of the arm stays only if the tool then keeps closer to what the follower
wanted. The oracle knows which of them are wrong, and fits them to the same recording.
"""

from __future__ import annotations

import dataclasses
import tempfile
from pathlib import Path

import numpy as np

from ideal_robot.diagnosis import Diagnosis, diagnose
from ideal_robot.diagnosis.channels.line import line_regression
from ideal_robot.diagnosis.channels.motor_torque import torque_regression
from ideal_robot.diagnosis.validation.refit import named_camera_effects, with_named_effects
from ideal_robot.effects import FittedEffect
from ideal_robot.errors import InputError
from ideal_robot.identification.checks import checked
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from scenes.line.cell import Prepared, prepared, set_up
from scenes.line.close_arm import acting, effects_of_arm, kept, motion_about
from scenes.line.close_loop_page import write_line_circle
from scenes.line.close_loop_result import CloseLineResult
from scenes.line.play import play
from scenes.line.result import LineResult
from scenes.measured import checked_measured, visible
from scenes.methods import IDEAL
from scenes.models import model_for
from scenes.online.line_task import assumed_latency
from scenes.result import Progress, silent
from scenes.scene_files.line_scene import LineScene
from scenes.scene_files.scene import SceneError
from scenes.sensor_loop import LEAST, Trial, with_effects, words
from scenes.undeclared import GEOMETRY, effects_of_world, keys_of_arm

ROUNDS = 4
"""Of run and diagnosis, at most: an error of some percent is found with some percent of itself."""


def close_loop(scene: LineScene, *, measured: str = "tcp", out: Path | None = None,
               progress: Progress = silent) -> CloseLineResult:
    """Follows a line, finds what is wrong with the camera, and follows it again.

    Args:
        scene: what to play.
        measured: what the arm measures: ``motor``, ``arm`` or ``tcp`` (``scenes.measured``).
        out: folder for recording, model and report; nothing is written without.
        progress: called with the fraction done.

    Raises:
        InputError: a scene whose camera is right and whose arm is as its model.
    """
    undeclared = undeclared_effects(scene)
    arm = acting(effects_of_world(scene, Robot.load(scene.robot).n)) if keys_of_arm(scene) else ()
    return closed(scene, undeclared, arm=arm, measured=measured, out=out, progress=progress)


def closed(scene: LineScene, undeclared: tuple[str, ...], *, arm: tuple[tuple[str, int], ...] = (),
           measured: str = "tcp", out: Path | None = None, progress: Progress = silent) -> CloseLineResult:
    """The same with what an oracle is told, which may be nothing.

    Args:
        scene: what to play.
        undeclared: names of the effects by which the camera differs from what its follower knows.
        arm: effects, with their joints, by which the arm differs from its model; without any it is not looked at.
        measured: what the arm measures.
        out: folder for recording, model and report; nothing is written without.
        progress: called with the fraction done.
    """
    seen_by = checked_measured(measured)
    cell = set_up(scene)
    robot, model = cell.known.robot, model_for(scene, cell.known.robot)
    with prepared(scene, progress) as shared, tempfile.TemporaryDirectory() as folder:
        def again(known: Model, own: Prepared = shared) -> LineResult:
            file = known.save(Path(folder) / "model.json")
            tried = play(scene.model_copy(update={"model": str(file)}), IDEAL, shared=own)
            if tried.failure and not before.failure:
                # Of the piece before it stopped nothing can be compared.
                raise SceneError(tried.failure)
            return tried

        progress(0.1, "before")
        before = present = play(scene, IDEAL, shared=shared)
        run = visible(before.recording, seen_by)
        first = error = spread(run, robot, model)
        extended, steps, found = model, list[Trial](), list[Diagnosis]()
        names: tuple[str, ...] = ()
        for round_ in range(1, ROUNDS + 1):
            share = 0.2 + 0.5 * (round_ - 1) / ROUNDS
            progress(share, f"round {round_}: diagnosis")
            now = diagnose(visible(present.recording, seen_by), robot, model=extended)
            found.append(now)
            new = [f.fitted.name for f in now.effects if f.fitted.channel == "line"]
            if not new:
                break
            taken = False
            # All together, then each alone: what a poor run cannot tell apart may be too much of everything.
            for some in (new, *([one] for one in new if len(new) > 1)):
                # What was taken before is fitted anew with it: the numbers of one camera hang together.
                tried_names = tuple(dict.fromkeys([*names, *some]))
                added = named_camera_effects(visible(present.recording, seen_by), robot, extended, tried_names)
                progress(share + 0.06, f"round {round_}: {words(added)}")
                candidate = with_effects(extended, added)
                try:
                    tried = again(candidate)
                    reached = spread(visible(tried.recording, seen_by), robot, model)
                except (SceneError, InputError) as failed:
                    steps.append(Trial(round_, words(added), False, f"cannot be played: {failed}", float("nan")))
                    continue
                taken = reached < LEAST * error
                refused = "" if taken else "the points that were seen lie no closer to one curve"
                steps.append(Trial(round_, words(added), taken, refused, reached))
                if taken:
                    extended, present, error, names = candidate, tried, reached, tried_names
                    break
            if not taken:
                break
        if arm:
            about = visible(motion_about(cell), seen_by)
            of_arm = effects_of_arm(diagnose(about, robot, model=extended), about, robot, extended)
            reached_by_tool = kept(visible(present.recording, seen_by), robot, model)
            alone = tuple((one,) for one in of_arm) if len(of_arm) > 1 else ()
            for part in (of_arm, *alone) if of_arm else ():
                progress(0.72, words(part))
                try:
                    tried = again(with_effects(extended, part))
                except SceneError as failed:
                    steps.append(Trial(len(found), f"{words(part)} of the arm", False, f"cannot be played: {failed}",
                                       float("nan")))
                    continue
                left = kept(visible(tried.recording, seen_by), robot, model)
                refused = "" if left < LEAST * reached_by_tool else \
                    f"the tool keeps no closer to what it was to follow: {1e3 * reached_by_tool:.3g} mm before"
                steps.append(Trial(len(found), f"{words(part)} of the arm", not refused, refused, left))
                if not refused:
                    extended, present = with_effects(extended, part), tried
                    break
        progress(0.75, "oracle")
        told = with_effects(model, named_camera_effects(run, robot, model, undeclared)) if undeclared else model
        told = with_named_effects(about, robot, told, arm) if arm else told
        try:
            oracle = again(told) if undeclared or arm else before
        except SceneError:
            # With what it fitted to the first run the line is lost: it would leave that out.
            oracle = before
        progress(0.9, "true")
        known = with_effects(model, _true_stamps(scene))
        right = dataclasses.replace(shared, believed=cell.true_camera) if not scene.calibration.by_moving else shared
        true = again(known, right)
    latency = {"before": assumed_latency(model), "after": assumed_latency(extended), "oracle": assumed_latency(told),
               "true": assumed_latency(known)}
    result = CloseLineResult(scene, undeclared, before.control_error, present.control_error, oracle.control_error,
                             true.control_error, latency, found[0], before.recording, first, tuple(steps), arm)
    if out is None:
        return result
    return write_line_circle(result, extended, out)


def undeclared_effects(scene: LineScene) -> tuple[str, ...]:
    """Effects by which the camera of a scene differs from what its follower knows.

    Raises:
        InputError: none, nor any of the arm, or one that cannot be seen along a line; names the keys.
    """
    camera, wrong = scene.camera, scene.calibration
    found = []
    if not wrong.by_moving:
        for key in ("lateral_mm", "roll_deg", "principal_px"):
            if getattr(wrong, key):
                raise InputError("along a line nobody can see it: a camera that is shifted across the line, or rolled, "
                                 "sees another line; set it to 0, or let the camera be calibrated (by_moving = true)",
                                 file=scene.source, field=f"calibration.{key}", value=getattr(wrong, key))
    if camera.stamp_offset != 0.0 and not scene.stamp_estimate:
        found.append("camera_latency")
    if camera.stamp_drift != 0.0 and not scene.stamp_estimate:
        found.append("clock_drift")
    if not wrong.by_moving:
        if wrong.focal_percent or wrong.height_mm:
            found.append("camera_scale")
        if wrong.yaw_deg or wrong.pitch_deg:
            found.append("camera_offset")
        if wrong.k1:
            found.append("lens_distortion")
    keys = keys_of_arm(scene)
    if not found and keys and all(key in GEOMETRY for key in keys):
        raise InputError("along a line nothing of it is left to be found: the camera rides on the arm, and sees the "
                         "line by the same wrong geometry with which the arm goes there; close a path scene with this "
                         "world",
                         file=scene.source, field=f"world.{keys[0]}", value=scene.world[keys[0]])
    if not found and not keys:
        raise InputError("the camera is right, or its follower finds out by itself: nothing is there to be found; set "
                         "camera.stamp_offset or camera.stamp_drift with stamp_estimate = false, or the sizes in "
                         "[calibration] with by_moving = false, or one of the arm's keys in [world]",
                         file=scene.source, field="camera")
    return tuple(found)


def spread(recording: Recording, robot: Robot, model: Model) -> float:
    """How far the seen points lie from one smooth curve, root mean square [m]: what the cell itself measures.

    Args:
        recording: of a run along a line.
        robot: the arm.
        model: of the arm, for its gears.
    """
    (recording,), _ = checked([recording], robot)
    made = line_regression(recording, robot, torque_regression(recording, robot, model), model.stiffness)
    if made is None:
        return float("inf")
    return float(np.sqrt(np.mean((made.y - made.y.mean(axis=0)) ** 2)))


def _true_stamps(scene: LineScene) -> list[FittedEffect]:
    camera = scene.camera
    if scene.stamp_estimate:
        return []
    return [FittedEffect("camera_latency", 0, "line", (-camera.stamp_offset,)),
            FittedEffect("clock_drift", 0, "line", (-camera.stamp_drift / (1.0 + camera.stamp_drift),))]
