"""What keeping a force along a path does in each interpolation cycle: [L] Fig. 1 with a force sensor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects.force import ForceErrors
from ideal_robot.elasticity.observer import ArmObserver
from ideal_robot.feedforward.corrected_arm import CorrectedArm
from ideal_robot.feedforward.friction_at_work import FrictionAtWork
from ideal_robot.feedforward.method import Setting
from ideal_robot.robots.interface import RobotState
from planning.follower import ForceFollower
from planning.force.contact import Phase
from planning.force.direct_force import DirectForceFeedback
from planning.force.felt_arm import FeltArm
from planning.force.stop_conditions import StopConditions
from planning.force.tare import Tare
from planning.path.kinematics import InverseKinematics
from scenes.force.known import N_D, Known
from scenes.force.line_camera import GlueCamera, glue_fusion
from scenes.force.log import ForceLog
from scenes.methods import DIRECT, SceneMethod
from sensing.camera.camera_device import Camera
from sensing.force.force_calibration import ContactElasticity, ToolLoad
from sensing.force.force_deviation import WrenchFilter
from sensing.force.force_device import ForceSensor

WINDOW = 0.0
"""Length of the moving average over wrenches [s]; the map averages better, and without delay."""


class ForceTask:
    """Pressing and moving with one method; a ``scenes.cycle.Task``.

    Args:
        cell: what is known of the scene.
        method: how ``q_d`` becomes ``q_c``.
        gains: K_p [m/N per cycle], K_d [m/N] of direct feedback.
        tool: bias and weight, from calibration.
        elasticity: of tip and surface, from calibration.
        rng: draws what a camera in trouble shows.
        friction: as the dry run has shown it; the model's if None.
    """

    n_d = N_D

    def __init__(self, cell: Known, method: SceneMethod, gains: tuple[float, float] | None, tool: ToolLoad,
                 elasticity: ContactElasticity, rng: np.random.Generator,
                 friction: FrictionAtWork | None = None) -> None:
        known = ForceErrors.of(cell.model.effects if method.knows_model else ())
        tool = replace(tool, bias=tool.bias + known.wrench)
        self.cell, self.method, self.tool, self.elasticity = cell, method, tool, elasticity
        self.assumed_stiffness = assumed = known.stiffness(cell.scene.assumed.elasticity_ratio * elasticity.stiffness)
        self.vision: GlueCamera | None = None
        self._direct: DirectForceFeedback | None = None
        self.follower: ForceFollower
        if cell.scene.task == "contour":
            self.follower = cell.contour_follower(assumed)
        else:
            glue = cell.scene.task == "glue"
            self.follower = self._surface = cell.follower(assumed, glue_fusion(cell) if glue else None)
            self.vision = GlueCamera(cell, self._surface, rng) if glue else None
            if method.key == DIRECT and gains is not None:
                self._direct = DirectForceFeedback(self._surface, *gains)
        self._stop = StopConditions(cell.robot, cell.scene.emergency.limits())
        self._filter, self._tare = WrenchFilter(WINDOW), Tare()
        model = cell.model if method.knows_model else None
        self.feedforward = method.following(Setting(cell.robot, model, N_D, cell.delay, friction=friction))
        # Where the gears are not known, commands and motor angles share the same error: q_a ≈ q.
        self._geometry = CorrectedArm(cell.robot, () if model is None else model.effects)
        self._kinematics = InverseKinematics(cell.robot)
        self._arm = None if model is None else FeltArm(ArmObserver(model, cell.robot.t_ipo), self.q_start,
                                                       self._kinematics.torque)
        self._state = self.feedforward.init(self.q_start)
        self.log = ForceLog()
        self._torque = np.zeros((N_D, cell.robot.n))
        self._sensor: ForceSensor
        self._camera: Camera | None = None

    def connect(self, sensor: ForceSensor, camera: Camera | None) -> None:
        """Connects the devices: the force sensor, and the camera of a scene that has one."""
        self._sensor, self._camera = sensor, camera

    def calibrated(self, tool: ToolLoad, elasticity: ContactElasticity) -> None:
        """Takes what a calibration has found meanwhile.

        Args:
            tool: bias and weight.
            elasticity: of tip and surface.
        """
        self.tool, self.elasticity = tool, elasticity
        self.assumed_stiffness = self.cell.scene.assumed.elasticity_ratio * elasticity.stiffness
        self.follower.press_as(self.assumed_stiffness)

    @property
    def q_start(self) -> Array:
        """Where the arm rests at first ``(n,)`` [rad]."""
        return self.follower.q_start

    def observe(self, t: float, q: Array, q_d: Array) -> None:
        """Takes the motor angles at ``t``.

        Args:
            t: begin of the cycle [s].
            q: motor angles ``(n,)`` [rad].
            q_d: horizon of the last cycle ``(n_d, n)`` [rad]; not needed.
        """
        arm = q if self._arm is None else self._geometry.as_drawn(self._arm.step(t, q, self._torque[0]))
        self.follower.observe(t, arm)

    def plan(self, t: float, q_d: Array) -> Array:
        """Desired joint positions over the horizon ``(n_d, n)``."""
        self._sense(t)
        if self.vision is not None and self._camera is not None:
            self.vision.sense(t, self._camera.arrived(t))
        self._check(t)
        # Direct feedback goes its own way between touch-down and lift: no need to plan.
        if self._direct is not None and self.follower.phase is not Phase.APPROACH:
            self._surface.advance(t)
            return q_d
        q_d = self.follower.horizon(t)
        self._stop.command(t, q_d)
        return q_d

    def command(self, t: float, q_d: Array) -> Array:
        """Commanded joint positions ``(n,)``."""
        self._torque = self.follower.contact_torque(q_d)
        if self._direct is not None:
            return self._direct.command(t, q_d)
        n_d = self.feedforward.n_d
        q_c, self._state = self.feedforward.step(self._state, q_d[:n_d], self._torque[:n_d])
        return q_c

    def request(self, t0: float, t1: float) -> None:
        """Asks the camera for windows where the line should be."""
        self.log.add(t0, self.follower)
        if self.vision is not None and self._camera is not None:
            self._camera.request(t0, t1, self.vision.windows)

    def collect(self, t0: float, t1: float, measured: RobotState) -> None:
        """Lets a feedforward that adapts learn from the cycle.

        Args:
            t0: begin of the cycle [s].
            t1: its end [s].
            measured: what the controller reported at its end.
        """
        self._state = self.feedforward.observe(self._state, measured)

    def speed(self, t: float) -> float:
        """Path speed [m/s]; at least a tenth, so that a stop at rest takes some time, too."""
        return max(self.follower.speed_at(t), 0.1)

    def done(self, t: float) -> bool:
        """Whether the tip has been lifted again."""
        lifted = self._direct is not None and self._direct.lifted >= self._surface.settings.clearance
        return self.follower.phase is Phase.DONE or lifted

    def _sense(self, t: float) -> None:
        arrived = self._sensor.arrived(t)
        if not arrived:
            return
        samples = [self._filter.add(sample) for sample in arrived]
        history = self.follower.history
        contact = np.array([self.tool.contact(s.wrench, history.pose(max(s.t, history.first)).rotation)[:3]
                            for s in samples])
        t_felt = np.array([s.t for s in samples])
        if self.follower.phase is Phase.APPROACH:
            self._tare.add(t_felt, contact)
        contact = contact - self._tare.force
        if self._arm is not None:
            force = np.array([history.pose(max(s.t, history.first)).rotation @ f
                              for s, f in zip(samples, contact, strict=True)])
            for at, q_a in self._arm.feel(t_felt, force):
                history.revise(at, self._geometry.as_drawn(q_a))
        fused = self.follower.update_force(t_felt, contact)
        nis = float("nan") if fused is None or not fused.dof else fused.nis / fused.dof
        self.log.samples.append((samples[-1].t, self.follower.force, nis))
        if self._direct is not None:
            self._direct.update(self.follower.force)
        self._stop.force(t, float(np.median(np.linalg.norm(contact, axis=1))))

    def _check(self, t: float) -> None:
        follower = self.follower
        if follower.phase is Phase.TRAVEL:
            # Samples are late: contact is judged at the time of the newest one.
            newest = self.log.samples[-1][0] if self.log.samples else t
            self._stop.contact(newest, follower.last_touch)
            if self.vision is not None:
                self.vision.sight.check(t)
        elif follower.phase is Phase.APPROACH:
            self._stop.approach(t, follower.descended, follower.settings.reach)
