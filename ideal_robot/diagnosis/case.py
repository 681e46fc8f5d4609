"""What a diagnosis is asked, and what its stages have found so far."""

from __future__ import annotations

from dataclasses import dataclass

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.channels.motor_torque import in_own_units, torque_regression, without_dead_channels
from ideal_robot.diagnosis.channels.regression import Regression
from ideal_robot.diagnosis.search.choice import Options
from ideal_robot.diagnosis.search.forward_selection import Only
from ideal_robot.diagnosis.statistics.problem import Candidate, Problem
from ideal_robot.diagnosis.validation.domain_diagnosis import DomainDiagnosis, DomainResult
from ideal_robot.diagnosis.validation.result import NotTransferred
from ideal_robot.model.model import Model
from ideal_robot.progress import Progress
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording


@dataclass(frozen=True)
class Case:
    """What is asked; see ``diagnose`` for what has no words here.

    Attributes:
        given: the model that was known before, or None.
        shared: whether the joints share inertias; not where torques are in amperes of unknown gain.
        dead: joints (from 0) whose torque channel does not measure them, in one of the recordings.
        cutoff: of the position filter [Hz], or None for the usual one.
        explain: whether each cause is weighed against all others in its place.
    """

    recording: Recording
    robot: Robot
    given: Model | None
    validate: Recording | None
    options: Options
    progress: Progress
    shared: bool
    only: Only | None
    dead: tuple[int, ...] = ()
    cutoff: float | None = None
    explain: bool = False

    @property
    def stiffness(self) -> Array | None:
        """Of the gears as far as the given model knows it ``(n,)`` [N m/rad]."""
        return None if self.given is None else self.given.known_stiffness

    def torque_regression(self, recording: Recording, model: Model, *, cutoff: float | None = None,
                          reversal_width: Array | None = None) -> Regression:
        """See ``torque_regression``. The regression of the motor torques of one of the recordings about a model."""
        regression = without_dead_channels(torque_regression(
            recording, self.robot, model, cutoff=self.cutoff if cutoff is None else cutoff, shared=self.shared,
            reversal_width=reversal_width, payload=self.given is not None), self.dead)
        return regression if self.shared else in_own_units(regression)


def joints_share(recording: Recording, robot: Robot, model: Model | None) -> bool:
    """Whether joints share inertias: not where torques are made of currents without known gains, and so in amperes.

    Args:
        recording, robot: as it was read (checks add the torques), and the arm.
        model: that was given, in the recording's units, or None.
    """
    return model is not None or recording.has("tau") or robot.knows_drive_gains or robot.n == 1


@dataclass(frozen=True)
class Findings:
    """What was found so far.

    Attributes:
        start: the model about which the regression is made.
        problem: the regression of the motor torques.
        reversal_width: speed over which dry friction changes sign ``(n,)`` [rad/s], where it was fitted.
        choices: effects of the motor torque.
        validation: the regression of the validation recording, or None.
        not_transferred: effects that were dropped because they do not carry over.
        domains: the domains after their search, that of the motor torque first.
        results: what they add to the report.
        warnings: for people.
        beside_known: where the given model's parameters do not hold, what was selected with them held all the same.
        held: parameters, from 0, that are zero as they would drive the joint instead of braking it.
    """

    start: Model
    problem: Problem
    reversal_width: Array | None = None
    choices: tuple[Candidate, ...] = ()
    validation: Regression | None = None
    not_transferred: tuple[NotTransferred, ...] = ()
    domains: tuple[DomainDiagnosis, ...] = ()
    results: tuple[DomainResult, ...] = ()
    warnings: tuple[str, ...] = ()
    beside_known: tuple[tuple[Candidate, ...], ...] = ()
    held: tuple[int, ...] = ()
