"""Builds the task of a scene: its sensors and its follower."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ideal_robot.effects.force import ForceErrors
from ideal_robot.errors import InputError
from ideal_robot.feedforward.friction_at_work import FrictionAtWork
from ideal_robot.feedforward.method import Setting
from ideal_robot.model.model import Model
from planning.force.contour import SPARE
from planning.force.force_follower import DirectForceFeedback, Errors, SurfaceFollower
from planning.force.line_on_surface import LineOnSurface, SightSettings
from planning.force.surface_forecast import surfaces
from planning.line.deviation_model import Expected, PathDeviation
from planning.line.deviation_sensor import DeviationSensor
from planning.line.direct_feedback import DirectFeedback
from planning.line.filter_bank import FilterBank
from planning.line.fusion import DeviationFilter
from planning.line.line_follower import Uncorrected
from planning.path.desired_path import planned_cycles
from scenes.methods import DIRECT, SceneMethod
from scenes.online.arm_angles import FreeArm, PressingArm
from scenes.online.contact import ContactSensor
from scenes.online.force_known import KnownSurface
from scenes.online.line_camera import AT_ONCE, LineCamera
from scenes.online.line_known import KnownLine
from scenes.online.log import TaskLog
from scenes.online.own_sensor import OwnSensor
from scenes.online.task import Baseline, Sensor, Task
from sensing.camera.camera_device import Camera
from sensing.force.force_calibration import ContactElasticity, ToolLoad
from sensing.force.sensors import ForceSensor


@dataclass(frozen=True)
class Configured:
    """A task and those of its sensors that need devices.

    Attributes:
        contact: None where nothing is pressed.
        camera: None without a camera.
    """

    task: Task
    contact: ContactSensor | None = None
    camera: LineCamera | None = None

    def connect(self, force: ForceSensor | None = None, camera: Camera | None = None) -> None:
        """Connects the task's sensors with their devices."""
        if self.contact is not None and force is not None:
            self.contact.connect(force)
        if self.camera is not None and camera is not None:
            self.camera.connect(camera)


KNOWN = 1e-6
"""Standard deviation of a relative error that is not estimated."""


def line_task(known: KnownLine, method: SceneMethod, model: Model | None, gains: tuple[float, float] | None = None,
              sensors: Sequence[DeviationSensor] = ()) -> Configured:
    """The task of following a line: a camera, and sensors of the user's.

    Args:
        known: the scene's data that are known beforehand.
        method: the method that computes ``q_c`` from ``q_d``.
        model: of the arm; None for a method that knows of none.
        gains: K_p, K_d of direct sensor feedback [1 per cycle].
        sensors: besides the camera.
    """
    follower, log = known.follower, TaskLog()
    direct = DirectFeedback(follower, *gains) if method.key == DIRECT and gains else None
    baseline: Baseline | None = direct or (None if method.senses else Uncorrected(follower))
    setting = Setting(known.robot, model, min(follower.n_d, known.scene.n_d or follower.n_d), known.delay)
    camera = LineCamera(known, follower, follower.history, log, model, points=known.scene.points,
                        shown_to=None if direct is None else direct.update)
    # A first call with dummy data, so that compiling does not delay the first cycles.
    follower.reference.project(follower.reference.position(np.array([0.1])), 0.1)
    names = [sensor.name for sensor in sensors]
    if twice := next((name for i, name in enumerate(names) if name in names[:i]), None):
        raise InputError("two sensors have that name; give each its own", field="sensors", value=twice)
    own = [OwnSensor(sensor, follower, log) for sensor in sensors]
    feedforward = method.following(setting)
    follower.led_by(feedforward)
    task = Task(follower, [camera, *own], method, feedforward, FreeArm(known.robot, model), log, baseline)
    return Configured(task, camera=camera)


def force_task(known: KnownSurface, method: SceneMethod, tool: ToolLoad, elasticity: ContactElasticity,
               gains: tuple[float, float] | None = None, friction: FrictionAtWork | None = None,
               newest: bool = False) -> Configured:
    """The task of pressing on a surface or along a contour: a force sensor, for ``glue`` also a camera on the line.

    Args:
        known: the scene's data that are known beforehand.
        method: the method that computes ``q_c`` from ``q_d``.
        tool: bias and weight, from calibration.
        elasticity: of tip and surface, from calibration.
        gains: K_p [m/N per cycle], K_d [m/N] of direct feedback.
        friction: as the dry run has shown it; the model's if None.
        newest: see ``LineCamera``.
    """
    model, scene, log = known.model if method.knows_model else None, known.scene, TaskLog()
    errors = ForceErrors.of(() if model is None else model.effects)
    assumed = errors.stiffness(scene.assumed.elasticity_ratio * elasticity.stiffness)
    glue = scene.task == "glue"
    follower = (known.contour_follower(assumed) if scene.task == "contour"
                else known.follower(assumed, glue_fusion(known) if glue else None))
    direct = (DirectForceFeedback(follower, *gains)
              if method.key == DIRECT and gains is not None and isinstance(follower, SurfaceFollower) else None)
    arm = PressingArm(known.robot, model, follower.q_start)
    contact, camera = ContactSensor(scene, follower, arm, log, tool, elasticity, model, direct=direct,
                                    at_once=AT_ONCE, in_one=AT_ONCE), None
    if glue and isinstance(follower, SurfaceFollower):
        span = (scene.reference.run_up, known.reference.length - scene.reference.run_out)
        sight = LineOnSurface(follower, known.camera.T_tool_camera,
                              SightSettings(distance_ratio=scene.assumed.distance_ratio), span)
        # A field updates five filters, which takes longer than an answer may: fields are fused after it.
        camera = LineCamera(known, sight, follower.history, log, model, at_once=np.inf, newest=newest)
    setting = Setting(known.robot, model, follower.n_d, known.delay, friction=friction)
    sensors: list[Sensor] = [contact] if camera is None else [contact, camera]
    return Configured(Task(follower, sensors, method, method.following(setting), arm, log, direct), contact, camera)


def glue_fusion(known: KnownSurface) -> Callable[[Errors], FilterBank]:
    """A filter bank for both sensors: deviation across the path, height along it, and the sensors' own errors."""
    sight = SightSettings()
    camera = (sight.yaw, sight.stamp, sight.scale if known.scene.assumed.distance_estimated else KNOWN)
    ahead = planned_cycles(known.n_d, known.robot.t_ipo, SPARE) * known.robot.t_ipo * known.profile.top_speed + 0.2

    def across() -> PathDeviation:
        return PathDeviation(known.reference, across=Expected(shape=0.01), ahead=ahead, behind=0.04, knot=0.02)

    def made(errors: Errors) -> FilterBank:
        biases = {"camera": camera, "force": errors}
        return FilterBank([DeviationFilter(model, biases=biases) for model in surfaces(across)])

    return made
