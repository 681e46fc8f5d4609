"""The data of a force scene that are known before the motion, without those of the simulated world."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from planning import OutOfReachError
from planning.force.contact import CLEAR, FORCE_ERRORS, ContactSettings
from planning.force.contour import ContourFollower, ContourSettings
from planning.force.force_follower import Errors, SurfaceFollower, surface_filter
from planning.line.filter_bank import FilterBank
from planning.path.kinematics import InverseKinematics
from planning.path.pose_history import check_cycle
from planning.path.reference import ReferencePath
from planning.path.speed_profile import Limits, SpeedProfile
from scenes.line_way import check_clear, shapes_about
from scenes.online.known import Known
from scenes.scene_files.force_scene import ForceScene
from sensing.camera.hand_eye import BENT

HORIZON = 0.24
"""How far ahead the ideal robot is given desired positions [s]."""
POSITION_NOISE = 5e-6
"""Standard deviation of the estimated tip position from cycle to cycle [m]; with more, stiff contacts lag."""
DOWN = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])
"""Orientation of a tool that points down."""
JERK = 40.0
"""Of a travel [m/s³]."""
BRAKING = 2.0
"""Deceleration of a stop on the path [m/s²]."""
LONGEST = 60.0
"""A run that has not ended so long after its travel is stuck [s]."""
START_HEIGHT = 0.01
"""Of the tip above the reference when the approach begins, where nothing is in its way [m]."""


@dataclass(kw_only=True)
class KnownSurface(Known):
    """Data for a follower of a surface; the surface's place and shape are not among them.

    Attributes:
        model: of the arm.
        profile: travel along the reference.
        asking: see ``ContactSettings``.
        start_height: of the tip above the reference when the approach begins [m].
    """

    clear: ClassVar[float] = CLEAR
    prior: ClassVar[Mapping[str, float]] = BENT
    scene: ForceScene
    model: Model
    profile: SpeedProfile
    asking: float = 0.0
    start_height: float = START_HEIGHT

    @property
    def n_d(self) -> int:
        """Number of desired positions in the horizon, one per cycle; at least three, to define an acceleration."""
        return max(round(HORIZON / self.robot.t_ipo), 3)

    def follower(self, elasticity: float,
                 fusion: Callable[[Errors], FilterBank] | None = None) -> SurfaceFollower:
        """A new follower with this assumed elasticity [N/m]; with ``fusion`` a camera shows the line, too."""
        estimated = self.scene.assumed.elasticity_estimated
        settings = ContactSettings(force=self.scene.force, elasticity=elasticity, position_noise=POSITION_NOISE,
                                   asking=self.asking, start_height=self.start_height,
                                   force_errors=FORCE_ERRORS if estimated else (1e-6, FORCE_ERRORS[1]))
        profile, acceleration = self.profile, self.scene.reference.acceleration
        jerk = settings.jerk(acceleration, JERK)
        if fusion is None and jerk < JERK:
            with suppress(InputError):  # a path too short for this speed with a gentle start uses the default start
                gentle = Limits(self.scene.speed, acceleration, jerk=jerk)
                profile = SpeedProfile.plan(self.robot, self.reference, gentle)
        return SurfaceFollower(self.robot, self.reference, profile, self.n_d, settings,
                               fusion=fusion or surface_filter, lateral=fusion is not None)

    def contour_follower(self, elasticity: float) -> ContourFollower:
        """A new follower of a contour, which knows only the starting point."""
        scene, frames = self.scene, self.reference.frames(np.zeros(1))
        out = frames.up[0]
        start = pin.SE3(self.reference.rotation(0.0), frames.position[0] + self.start_height * out)
        towards = -out / np.linalg.norm(out)
        along = np.cross([0.0, 0.0, 1.0], towards)
        axes = np.stack([towards, along if along @ frames.tangent[0] > 0 else -along])
        q_start = InverseKinematics(self.robot).search(start, self.robot.home)
        settings = ContourSettings(force=scene.force, elasticity=elasticity, speed=scene.speed,
                                   length=float(scene.line.length or 0.5))
        return ContourFollower(self.robot, start, axes, q_start, self.n_d, settings)

    def q_start(self) -> Array:
        """Joint angles at which the arm rests before the start ``(n,)`` [rad]."""
        return self.contour_follower(1e4).q_start if self.scene.task == "contour" else self.follower(1e4).q_start


def force_reference(scene: ForceScene, robot: Robot, points: Array) -> tuple[ReferencePath, SpeedProfile]:
    """Reference path of a scene, and the travel along it.

    Args:
        scene: speed and task.
        robot: the arm with the controller's cycle.
        points: of the reference ``(N, 3)`` [m].

    Raises:
        InputError: path out of reach, unreachable speed, a motion longer than the scene allows, a cycle too long for
            a camera.
    """
    if scene.task == "glue":
        check_cycle(robot)
    out = scene.surface.pose().rotation[:, 2]
    if scene.task == "contour":
        # Pressed sideways, the tool keeps its orientation: straight down.
        reference = ReferencePath(points, up=out, rotation=DOWN)
    else:
        reference = ReferencePath(points, up=out, turning=1.0)
    try:
        profile = SpeedProfile.plan(robot, reference, Limits(scene.speed, scene.reference.acceleration, jerk=JERK))
    except OutOfReachError as error:
        raise InputError(f"the path is out of reach: {error}", field="surface.origin",
                         value=list(scene.surface.origin)) from error
    if profile.joint_path is not None:
        check_clear(shapes_about(scene, robot), profile.joint_path)
    scene.check_duration(profile.duration)
    return reference, profile
