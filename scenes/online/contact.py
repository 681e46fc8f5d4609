"""The force sensor as a sensor of a task: contact forces, fused into what is followed, and when they end the motion."""

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
    """Who looks on devices whether what is felt can be."""

    @property
    def owes(self) -> bool:
        """See ``scenes.online.task.Sensor``."""

    def fused(self, innovation: float, values: int) -> None:
        """Takes the normalised innovation squared of forces that were fused, and of how many values it is."""

    def stood(self) -> None:
        """The arm stood: what was felt before belongs to no motion that goes on."""

    def look(self) -> None:
        """Looks at what was felt since it was last called."""

    def check(self, t: float) -> None:
        """Raises ``PlanningError`` where what is felt at ``t`` [s] cannot be."""

    def ended(self, t0: float, measured: RobotState, torque: Array) -> None:
        """See ``Sensor.ended``."""


class ContactSensor(Sensor):
    """A force sensor behind a tip that presses.

    Args:
        scene: how hard, and what must not happen; of its tables those of the world are not looked at.
        follower: what is fused into.
        arm: which the forces bend.
        log: is written to.
        tool: bias and weight, from calibration.
        elasticity: of tip and surface, from calibration; the follower says what is assumed of it.
        model: of the arm, whose effects say what is wrong with the sensor; None for a method that knows of none.
        direct: direct feedback of the force, where that is the method.
        at_once, in_one: see ``Sensor``. In cycles shorter than the latter what is felt is worked out behind one
            command, and fused behind the next.

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
        """Takes the force sensor that is read from now on."""
        self.device = device

    def witnessed(self, witness: Witness, short: bool) -> None:
        """Has a witness check what the sensor feels from now on.

        Args:
            witness: that stops the arm where the sensor cannot be right.
            short: whether a cycle is too short for all that is done in one, see ``in_one``.
        """
        self.witness, self._in_two = witness, short

    def takes(self, usual: float) -> None:
        """Takes how long this computer usually needs to fuse, to plan and to command [s], see ``Sensor``."""
        self.at_once, self.in_one = usual / IN_ANSWER, usual / IN_CYCLE

    def calibrated(self, tool: ToolLoad, elasticity: ContactElasticity, ratio: float = 1.0) -> None:
        """Takes what a calibration has found meanwhile.

        The model's ``ForceErrors`` are not added: turning the tool shows the sensor's bias as it is, and pressing all
        that gives under the force. They would count twice.

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
        """See ``Sensor``."""
        return self.witness is not None and self.witness.owes

    def take(self, t: float) -> None:
        """See ``Sensor``: raises ``EmergencyStopError`` where too much is felt."""
        if arrived := [sample for sample in self.device.arrived(t) if sample.t >= self._from]:
            self._felt.append(self._contact(t, arrived))

    def fuse(self, t: float) -> Work:
        """See ``Sensor``."""
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
        """See ``Sensor``."""
        if self.witness is not None:
            self.witness.look()

    def check(self, t: float) -> None:
        """See ``Sensor``: the contact was lost, or none was found."""
        follower = self.follower
        if follower.phase is Phase.TRAVEL:
            # Samples are late: contact is judged at the time of the newest one.
            newest = self.log.samples[-1][0] if self.log.samples else t
            self._stop.contact(newest, follower.last_touch)
        elif follower.phase is Phase.APPROACH:
            self._stop.approach(t, follower.descended, follower.settings.reach)

    def bears(self, t: float, q_d: Array) -> None:
        """See ``Sensor``: within the joints' limits, and what is felt can be."""
        self._stop.command(t, q_d)
        if self.witness is not None:
            self.witness.check(t)

    def stood(self, t: float) -> None:
        """See ``Sensor``: what was felt meanwhile was looked at by the guard."""
        self.device.arrived(t)
        if self.witness is not None:
            self.witness.stood()
        self._felt, self._measured, self._from = [], None, t

    def ended(self, t0: float, measured: RobotState, torque: Array | None) -> None:
        """See ``Sensor.ended``."""
        if self.witness is not None and torque is not None:
            self.witness.ended(t0, measured, torque)

    def away(self, q_d: Array) -> Array | None:
        """Joint angles with the tip off the surface, to go to after any stop; None where it is off already."""
        if self._direct.done(0.0) if self._direct is not None else (
                isinstance(self.follower, SurfaceFollower) and self.follower.phase is Phase.DONE):
            return None
        distance = CLEAR + most_force(self.scene.force) / self.assumed_stiffness
        return self._kinematics.away(q_d[0], distance * self.follower.normal)
