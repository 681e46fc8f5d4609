"""The arguments of a diagnosis, and the findings of its stages so far."""

from __future__ import annotations

from dataclasses import dataclass

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.best_set import BestSet
from ideal_robot.diagnosis.causes import Only
from ideal_robot.diagnosis.channels.motor_torque import in_own_units, torque_regression, without_dead_channels
from ideal_robot.diagnosis.channels.regression import Regression
from ideal_robot.diagnosis.report import DomainDiagnosis, DomainResult
from ideal_robot.diagnosis.statistics.problem import Problem
from ideal_robot.model.model import Model
from ideal_robot.progress import Progress
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording


@dataclass(frozen=True)
class Case:
    """The arguments of a diagnosis; see ``diagnose`` for those not described here.

    Attributes:
        given: the model that was known before, or None.
        shared: whether the joints share inertias; not where torques are in amperes of unknown gain.
        dead: joints (from 0) whose torque channel does not measure them, in one of the recordings.
        cutoff: of the position filter [Hz], or None for the usual one.
    """

    recording: Recording
    robot: Robot
    given: Model | None
    validate: Recording | None
    progress: Progress
    shared: bool
    only: Only | None
    dead: tuple[int, ...] = ()
    cutoff: float | None = None

    @property
    def stiffness(self) -> Array | None:
        """Stiffness of the gears ``(n,)`` [N m/rad], where the given model has one."""
        return None if self.given is None else self.given.known_stiffness

    def torque_regression(self, recording: Recording, model: Model, *, cutoff: float | None = None,
                          reversal_width: Array | None = None) -> Regression:
        """Builds the regression of a recording's motor torques about a model; see ``torque_regression``."""
        regression = without_dead_channels(torque_regression(
            recording, self.robot, model, cutoff=self.cutoff if cutoff is None else cutoff, shared=self.shared,
            reversal_width=reversal_width, payload=self.given is not None), self.dead)
        return regression if self.shared else in_own_units(regression)


def joints_share(recording: Recording, robot: Robot, model: Model | None) -> bool:
    """Whether joints share inertias: not where torques are currents in amperes, without known gains.

    Args:
        recording, robot: as it was read (checks add the torques), and the arm.
        model: the model that was given, in the recording's units, or None.
    """
    return model is not None or recording.has("tau") or robot.knows_drive_gains or robot.n == 1


@dataclass(frozen=True)
class Findings:
    """The findings of a diagnosis so far.

    Attributes:
        start: the model about which the regression is made.
        problem: the regression of the motor torques.
        reversal_width: speed over which dry friction changes sign ``(n,)`` [rad/s], where it was fitted.
        best: the search for the causes of the motor torque, once it has run.
        taken_for: hypothesis about a given model's parameters.
        pushed: see ``prior.Known``.
        validation: the regression of the validation recording, or None.
        domains: the domains after their search, that of the motor torque first.
        results: their results for the report.
        warnings: for people.
        fixed: parameters, from 0, that are zero as they would drive the joint instead of braking it.
    """

    start: Model
    problem: Problem
    reversal_width: Array | None = None
    best: BestSet | None = None
    taken_for: str = ""
    pushed: int = 0
    validation: Regression | None = None
    domains: tuple[DomainDiagnosis, ...] = ()
    results: tuple[DomainResult, ...] = ()
    warnings: tuple[str, ...] = ()
    fixed: tuple[int, ...] = ()

    @property
    def best_set(self) -> BestSet:
        """The finished search for the causes of the motor torque."""
        if self.best is None:
            raise RuntimeError("the causes of the motor torque have not been searched yet")
        return self.best
