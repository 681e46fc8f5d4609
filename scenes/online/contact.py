"""The force sensor in a task: contact forces are fused into the follower, or end the motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects.force import ForceErrors
from ideal_robot.model.model import Model
from ideal_robot.robots.interface import RobotState
from planning.follower import Phase
from planning.force.contact import CLEAR, StopConditions, Tare, most_force
from planning.force.contour import ContourFollower
from planning.force.force_follower import DirectForceFeedback, SurfaceFollower
from planning.line.measurement import Fused, Measurement
from planning.path.kinematics import InverseKinematics
from scenes.online.arm_angles import PressingArm
from scenes.online.log import TaskLog
from scenes.online.task import Sensor, Work
from scenes.scene_files.force_scene import ForceScene
from sensing.force.force_calibration import ContactElasticity, ToolLoad
from sensing.force.sensors import ForceSensor, WrenchSample

GATHERED = 0.01
"""Time for which samples are gathered before they are fused [s]: three samples at 250 Hz take no longer than one."""

IN_ANSWER, IN_CYCLE = 0.2, 0.75
"""Shares of a cycle that computing may take between packet and answer, and all in all, as the rehearsal has it. Beside
other work it takes up to two and a half times as long (3.0 ms, and 4.4 to 7.5 ms with both cores busy), and a
controller wants its answer within three quarters of its cycle; behind it less is done where answers are behind."""


class Witness(Protocol):
    """Interface of a check, on devices, whether the sensed force is plausible."""

    @property
    def owes(self) -> bool:
        """Whether data have been fused since the last health check; see ``scenes.online.task.Sensor``."""

    def fused(self, innovation: float, values: int) -> None:
        """Adds the normalised squared innovation of forces that were fused, and the number of values in it."""

    def stood(self) -> None:
        """Notes that the arm stood: earlier forces do not belong to the motion that follows."""

    def look(self) -> None:
        """Checks the forces since the last call."""

    def check(self, t: float) -> None:
        """Raises ``PlanningError`` where the force at ``t`` [s] is implausible."""

    def ended(self, t0: float, measured: RobotState, torque: Array) -> None:
        """Notes the end of the cycle that began at ``t0`` [s]; see ``Sensor.ended``."""


class ContactSensor(Sensor):
    """The force sensor of a tip in contact, as a ``Sensor`` of a task.

    Args:
        scene: desired force and limits; its tables of the simulated world are not used.
        follower: receives the fused deviations.
        arm: the arm, whose gears deflect under the forces.
        log: is written to.
        tool: bias and weight, from calibration.
        elasticity: of tip and surface, from calibration.
        model: of the arm, whose effects contain the sensor's errors; None for a method without a model.
        direct: direct feedback of the force, where that is the method.
        at_once, in_one: see ``Sensor``. In cycles shorter than the latter the forces are evaluated after one command,
            and fused after the next.

    Attributes:
        assumed_stiffness: E of tip and surface that is assumed [N/m].
    """

    def __init__(self, scene: ForceScene, follower: SurfaceFollower | ContourFollower, arm: PressingArm, log: TaskLog,
                 tool: ToolLoad, elasticity: ContactElasticity, model: Model | None = None, *,
                 direct: DirectForceFeedback | None = None, at_once: float = 0.0, in_one: float = 0.0) -> None:
        self.scene, self.follower, self.log, self.at_once, self.in_one = scene, follower, log, at_once, in_one
        self._arm, self._direct = arm, direct
        errors = ForceErrors.of(() if model is None else model.effects)
        self.tool = replace(tool, bias=tool.bias + errors.wrench)
        self.elasticity, self.assumed_stiffness = elasticity, follower.settings.elasticity
        self.device: ForceSensor
        self.witness: Witness | None = None
        self._kinematics = InverseKinematics(follower.robot)
        self._stop = StopConditions(follower.robot, scene.emergency.limits())
        self._tare = Tare()
        self._felt: list[tuple[Array, Array]] = []
        self._fused_at = self._from = -np.inf
        self._in_two = False
        self._measured: tuple[Array, Measurement | None] | None = None

    def connect(self, device: ForceSensor) -> None:
        """Sets the force sensor that is read from now on."""
        self.device = device

    def witnessed(self, witness: Witness, short: bool) -> None:
        """Sets the witness that checks the sensor's forces from now on.

        Args:
            witness: check by the motor torques that stops the arm where the sensor cannot be right.
            short: whether a cycle is too short for all that is done in one, see ``in_one``.
        """
        self.witness, self._in_two = witness, short

    def takes(self, usual: float) -> None:
        """Sets the time that this computer usually needs to fuse, to plan and to command [s], see ``Sensor``."""
        self.at_once, self.in_one = usual / IN_ANSWER, usual / IN_CYCLE

    def calibrated(self, tool: ToolLoad, elasticity: ContactElasticity, ratio: float = 1.0) -> None:
        """Sets the results of a calibration.

        The model's ``ForceErrors`` are not added: the calibration already contains the sensor's bias and the
        compliance, which would be used twice.

        Args:
            tool: bias and weight.
            elasticity: of tip and surface.
            ratio: the true force over the shown one, at most.
        """
        self.tool, self.elasticity = tool, elasticity
        limits = self.scene.emergency.limits()
        self._stop = StopConditions(self.follower.robot, replace(limits, force=limits.force / ratio))
        self.assumed_stiffness = self.scene.assumed.elasticity_ratio * elasticity.stiffness
        self.follower.press_as(self.assumed_stiffness)

    @property
    def owes(self) -> bool:  # type: ignore[override]
        """Whether data have been fused since the last health check; see ``Sensor``."""
        return self.witness is not None and self.witness.owes

    def take(self, t: float) -> None:
        """Reads the sensor; raises ``EmergencyStopError`` where the force is too large. See ``Sensor.take``."""
        if arrived := [sample for sample in self.device.arrived(t) if sample.t >= self._from]:
            self._felt.append(self._contact(t, arrived))

    def fuse(self, t: float) -> Work:
        """Fuses what has arrived by ``t`` [s], or does the next part of it; see ``Sensor``."""
        if self._measured is not None:
            measured, self._measured = self._measured, None
            return self._fuse(*measured)
        if not self._felt or (self._direct is None and t - self._fused_at < GATHERED):
            return Work.NOTHING
        self._fused_at = t
        t_felt, contact = (np.concatenate(part) for part in zip(*self._felt, strict=True))
        self._felt = []
        self._arm.feel(t_felt, contact, self.follower.history)
        measurement = self.follower.measured(t_felt, contact)
        if self._in_two:
            self._measured = t_felt, measurement
            return Work.PREPARED
        return self._fuse(t_felt, measurement)

    def _fuse(self, t_felt: Array, measurement: Measurement | None) -> Work:
        """Forces of instants ``(m,)`` [s] go into the follower's map, where it has one."""
        follower = self.follower
        if measurement is not None and isinstance(follower, SurfaceFollower):
            self._fused(t_felt, follower.fuse(t_felt, measurement))
        else:
            self._fused(t_felt, None)
        return Work.FUSED

    def _fused(self, t_felt: Array, fused: Fused | None) -> None:
        """Writes down what became of the forces of instants ``(m,)`` [s]."""
        nis = float("nan") if fused is None or not fused.dof else fused.nis / fused.dof
        self.log.samples.append((float(t_felt[-1]), self.follower.force, nis, len(t_felt)))
        if self._direct is not None:
            self._direct.update(self.follower.force)
        if self.witness is not None:
            self.witness.fused(nis, len(t_felt))

    def _contact(self, t: float, arrived: Sequence[WrenchSample]) -> tuple[Array, Array]:
        """Instants ``(m,)`` [s] and contact forces ``(m, 3)`` [N, tool frame] of samples; ends on a force too large."""
        history = self.follower.history
        contact = np.array([self.tool.contact(s.wrench, history.pose(max(s.t, history.first)).rotation)[:3]
                            for s in arrived])
        t_felt = np.array([s.t for s in arrived])
        if self.follower.phase is Phase.APPROACH:
            self._tare.add(t_felt, contact)
        contact = contact - self._tare.force
        self._stop.force(t, float(np.median(np.linalg.norm(contact, axis=1))))
        return t_felt, contact

    def look(self) -> None:
        """Checks the device's health by what was fused since the last call; see ``Sensor``."""
        if self.witness is not None:
            self.witness.look()

    def check(self, t: float) -> None:
        """Raises an error where the contact was lost, or none was found; see ``Sensor.check``."""
        follower = self.follower
        if follower.phase is Phase.TRAVEL:
            # Samples are late, so contact is judged at the time of the newest one.
            newest = self.log.samples[-1][0] if self.log.samples else t
            self._stop.contact(newest, follower.last_touch)
        elif follower.phase is Phase.APPROACH:
            self._stop.approach(t, follower.descended, follower.settings.reach)

    def bears(self, t: float, q_d: Array) -> None:
        """Raises an error where the joints' limits are exceeded, or the force is implausible; see ``Sensor.bears``."""
        self._stop.command(t, q_d)
        if self.witness is not None:
            self.witness.check(t)

    def stood(self, t: float) -> None:
        """Discards forces from a stop, which the guard has checked; see ``Sensor.stood``."""
        self.device.arrived(t)
        if self.witness is not None:
            self.witness.stood()
        self._felt, self._measured, self._from = [], None, t

    def ended(self, t0: float, measured: RobotState, torque: Array | None) -> None:
        """Notes the end of the cycle that began at ``t0`` [s]; see ``Sensor.ended``."""
        if self.witness is not None and torque is not None:
            self.witness.ended(t0, measured, torque)

    def away(self, q_d: Array) -> Array | None:
        """Joint angles with the tip off the surface, for after any stop; None where it is off already."""
        if self._direct.done(0.0) if self._direct is not None else (
                isinstance(self.follower, SurfaceFollower) and self.follower.phase is Phase.DONE):
            return None
        distance = CLEAR + most_force(self.scene.force) / self.assumed_stiffness
        return self._kinematics.away(q_d[0], distance * self.follower.normal)
