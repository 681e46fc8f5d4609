"""Runs a line-following scene: camera, sensing, planning and ideal robot around the simulated arm ([L] Fig. 1)."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import replace
from typing import Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.feedforward.arm_of_its_type import arm_of_its_type
from ideal_robot.feedforward.registry import method as registered
from planning.line.deviation_sensor import DeviationSensor
from planning.line.line_follower import REST
from scenes.line.cell import Cell, LineWorld, Prepared, prepared, set_up
from scenes.line.pictures import Pictures
from scenes.line.result import LineResult, Timing, far_from_line
from scenes.methods import DIRECT, IDEAL, NONE, SceneMethod, following_methods, method_of
from scenes.metrics import ControlError, PathErrors, path_errors
from scenes.models import model_for
from scenes.online.configured import line_task
from scenes.online.cycle import CycleSettings
from scenes.online.log import SETTLING, TaskLog, plan_error
from scenes.result import Progress, silent
from scenes.scene_files.line_scene import LineScene
from scenes.scene_files.scene import SceneError
from scenes.simulated import done, recorded
from sensing.camera.camera_model import CameraModel
from sim.arm.arm import SimulatedArm
from sim.equipped_arm import CarriedCamera, Knock

POINTS = "ideal_points"
"""The ideal robot behind a map of single points in place of polynomials, for comparison."""


def methods() -> tuple[str, ...]:
    """Every key that ``--method`` takes."""
    return (NONE, DIRECT, *following_methods(), POINTS)


def play(scene: LineScene, method: Any, *, shared: Prepared | None = None,
         gains: tuple[float, float] | None = None, sensors: Sequence[DeviationSensor] = (),
         progress: Progress = silent, pictures: bool = False) -> LineResult:
    """Follows the line once without writing files.

    Args:
        scene: the scene.
        method: method that turns sensor data into commands: a key, a ``Feedforward``, a factory of one, or a
            ``SceneMethod``.
        shared: from ``prepared`` of the same scene, to save its time.
        gains: K_p, K_d of direct sensor feedback [1 per cycle].
        sensors: besides the camera.
        progress: called with the fraction done.
        pictures: whether camera fields are kept as pictures.

    Raises:
        InputError: the scene cannot be run: line out of reach, unreachable speed.
    """
    method = method_of(method, methods())
    if method.key == POINTS:
        scene, method = scene.changed(measurement="points"), SceneMethod(POINTS, registered(IDEAL).make)
    with prepared(scene, progress) if shared is None else nullcontext(shared) as ready:
        cell = set_up(scene, ready.hand_eye, ready.believed, ready.shape)
        cell = replace(cell, known=replace(cell.known, detection=ready.detection))
        return _play(cell, method, gains, ready, sensors, progress, pictures)


def _play(cell: Cell, method: SceneMethod, gains: tuple[float, float] | None, shared: Prepared,
          sensors: Sequence[DeviationSensor], progress: Progress, pictures: bool) -> LineResult:
    scene, follower = cell.known.scene, cell.known.follower
    with SimulatedArm(cell.known.robot, cell.world, cell.noise, follower.q_start) as arm:
        carried = CarriedCamera(shared.camera, arm, Knock.of(scene.camera))
        # Simulated sensors get access to the true world.
        for sensor in (candidate for candidate in sensors if hasattr(candidate, "mount")):
            sensor.mount(LineWorld(arm, cell.line))
        model = model_for(scene, cell.known.robot) if method.knows_model else None
        if model is not None and method.adapts and shared.recorded is not None:
            model = arm_of_its_type(shared.recorded, model, cell.known.robot)
        configured = line_task(cell.known, method, model, gains, sensors)
        configured.connect(camera=carried)
        task, log = configured.task, configured.task.log
        if pictures and configured.camera is not None:
            task.sensors.append(Pictures(configured.camera, follower))
        task.learn(shared.moved)
        longest = (follower.lasts + 0.5) * arm.t_ipo
        wall = done(task, arm, [carried], cell.known.robot,
                    CycleSettings(scene.reference.acceleration, REST, longest, longest, method.key), progress)
        t, tcp = arm.tcp_path()
        if log.failure and len(t) < 2:
            raise SceneError(f"the arm did not move: {log.failure or 'no cycle was run'}")
        shown = tuple(replace(frame, image=carried.whole(frame.field)) for frame in log.shown)
        recording = recorded(arm, scene, method.key, log, scene.tracker, _mounted(cell.known.camera), scene.points)
    whole, error = _control_error(cell, t, tcp, log.first_used)
    far = "" if method.key == NONE else far_from_line(error.mean)
    return LineResult(
        scene=scene, method=method.key, control_error=error, control_error_from_start=whole,
        path_errors=_path_errors(cell, log, t, tcp), fields_seen=len(log.fields), fields_used=log.used,
        left_out=dict(log.left_out().most_common()),
        recording=recording, timing=Timing(np.array(log.cycles), np.array(log.with_field, dtype=bool), wall,
                                           float(t[-1])),
        geometry=cell.geometry, failure=log.failure, urdf=cell.known.robot.urdf, shown=shown,
        world=cell.world.table(), hand_eye=shared.hand_eye, warning="; ".join(filter(None, [shared.warning, far])),
        assumed=cell.known.robot.assumed,
        s_reference=np.array(log.s), believed=log.lateral,
        looked_back=follower.fusion.looked_back(np.array(log.s))[0][:, 0],
        plan_error_mm=plan_error(log, follower.fusion),
        sensors=dict(log.readings))


def _mounted(camera: CameraModel) -> dict[str, Any]:
    """Place where the believed camera's optical axis meets the surface, and its distance."""
    mount = camera.T_tool_camera
    return {"camera": {"axis": [float(v) for v in camera.axis_on_surface],
                       "distance": float(-mount.translation[2] / mount.rotation[2, 2])}}


def _control_error(cell: Cell, t: Array, tcp: Array, first_used: float) -> tuple[ControlError, ControlError]:
    """Distance of the true TCP from the drawn line: over all of it, and from 0.3 s after it is first followed."""
    s, lateral = cell.line.beside(tcp)
    inside = (s > 1e-6) & (s < cell.line.length - 1e-6)
    if not inside.any() or not np.isfinite(first_used):
        nothing = ControlError.of(t, s, lateral, np.zeros(len(t), dtype=bool))
        return nothing, nothing
    followed_from = max(first_used, float(t[np.argmax(inside)]))
    counts = inside & (t >= followed_from + SETTLING)
    return ControlError.of(t, s, lateral, inside), ControlError.of(t, s, lateral, counts)


def _path_errors(cell: Cell, log: TaskLog, t: Array, tcp: Array) -> PathErrors | None:
    """The true TCP against the desired path, once the line is followed."""
    times, q_d = np.array(log.t), np.array(log.q_d)
    moving = np.flatnonzero(np.logical_or.reduce([np.abs(np.diff(column)) > 1e-7 for column in q_d.T]))
    if len(moving) < 8:
        return None
    pose = cell.known.robot.fk()
    part = slice(moving[0], moving[-1] + 1)
    x_d = np.empty((part.stop - part.start, 3))
    for i, q in enumerate(q_d[part]):
        x_d[i] = pose(q).translation
    return path_errors(times[part], x_d, t, tcp)
