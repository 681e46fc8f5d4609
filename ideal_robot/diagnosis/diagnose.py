"""The diagnosis: residual, search, extended model, and errors before and after on held-out data."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from ideal_robot.diagnosis import stages
from ideal_robot.diagnosis.case import Case, Findings, joints_share
from ideal_robot.diagnosis.causes import Only
from ideal_robot.diagnosis.channels.regression import rms, spread, unused_columns
from ideal_robot.diagnosis.prior import TYPE
from ideal_robot.diagnosis.report import DomainResult
from ideal_robot.diagnosis.statistics.problem import with_parameters, with_possible_inertias
from ideal_robot.diagnosis.validation.result import ChannelResult, Diagnosis, MovedParameter
from ideal_robot.effects import MOTOR_TORQUE
from ideal_robot.errors import IdealRobotError
from ideal_robot.identification.checks import checked
from ideal_robot.model.model import Model
from ideal_robot.model.parametrisation import parameter_vector
from ideal_robot.progress import Progress, Steps, silent
from ideal_robot.registry import in_words
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.channels import channel_findings, dead_joints
from ideal_robot.signals.recording import Recording, expect
from ideal_robot.signals.sampling import shortened


def diagnosis_of(case: Case, found: Findings) -> Diagnosis:
    """The result after all stages."""
    answer = _of_domains(case, found)
    unexplained = answer.unknown or answer.unexplained
    model, warnings = _extended(case, found)
    moved = _moved(case, found)
    if found.taken_for == TYPE:
        warnings = (*warnings, "the model's parameters are those of another arm of its type: this recording is "
                    "predicted better with all of them free within what arms of a type differ by than as this arm")
    return replace(answer, verdict="effects" if answer.effects else "unknown" if unexplained else "none", model=model,
                   warnings=answer.warnings + warnings, taken_for=found.taken_for, moved=moved)


def undecided(case: Case, found: Findings) -> Diagnosis:
    """The result where no joint moves, with the findings of sensors."""
    answer, torque = _of_domains(case, found), found.problem.regression
    error, signal = (rms(values, torque.use) for values in (torque.y, torque.measured))
    numbers = (values.tolist() for values in (error, torque.noise_floor, signal, torque.use.mean(axis=0)))
    channels = tuple(ChannelResult(name, unit, own, own, own, floor, whole, used) for
                     name, unit, own, floor, whole, used in zip(torque.channels, torque.units, *numbers, strict=True))
    return replace(answer, verdict="effects" if answer.effects else "undecided", channels=channels + answer.channels,
                   held_out_how=f"of sensors alone, no joint moves: {answer.held_out_how}" if found.domains else
                   "nothing: no joint moves",
                   model=None if case.given is None else
                   case.given.with_effects(tuple(f.fitted for f in answer.effects)))


def _of_domains(case: Case, found: Findings) -> Diagnosis:
    """What an answer says of the domains that were searched."""
    results, searched = found.results, [domain.regression for domain in found.domains]
    if not any(regression.domain == MOTOR_TORQUE for regression in searched):
        searched.insert(0, found.problem.regression)
    effects, unknown = (tuple(f for result in results for f in result.found if f.fitted.effect.learned is learned)
                        for learned in (False, True))
    return Diagnosis(
        "none", tuple(channel for result in results for channel in result.channels), effects, unknown,
        _held_out(case), found.domains[0].held_out_seconds if found.domains else 0.0,
        found.problem.regression.undecided, warnings=(
            *found.warnings, *_small(results), *_contradicted(case, results), *_perhaps(results)),
        before=tuple(structure for result in results for structure in result.before),
        remaining=tuple(structure for result in results for structure in result.remaining),
        traces=tuple(result.traces for result in results), unused=unused_columns(case.recording, tuple(searched)),
        arguments=tuple(argument for result in results for argument in result.arguments))


def _small(results: Sequence[DomainResult]) -> Iterator[str]:
    """One sentence on causes that are there and too small to matter."""
    small = [f"{in_words(effect.name)} in {effect.channel}" for result in results for effect in result.small]
    if small:
        yield f"also found, too small to matter: {', '.join(small)}"


def _contradicted(case: Case, results: Sequence[DomainResult]) -> Iterator[str]:
    """One sentence on causes that the other recording contradicts."""
    gone = [name for result in results for name in result.gone]
    if gone and case.validate is not None:
        yield (f"left out, for with it {_name(case.validate)}, which took no part, is predicted worse than without: "
               f"{', '.join(gone)}")


def _perhaps(results: Sequence[DomainResult]) -> Iterator[str]:
    """One sentence on causes that the data cannot distinguish from none."""
    names = [name for result in results for name in result.perhaps]
    if names:
        yield f"may be there, with odds below three to one against nothing: {', '.join(names)}"


def _moved(case: Case, found: Findings) -> tuple[MovedParameter, ...]:
    """Parameters of the given model that this recording moves far."""
    if case.given is None or not found.domains:
        return ()
    model, regression = case.given, found.problem.regression
    change = found.domains[0].final.change
    value, names = parameter_vector(model.base_values, model.friction), model.parameters
    rows = regression.W * regression.use[:, :, None]
    return tuple(MovedParameter(names[i].name, names[i].unit, float(value[i]), float(value[i] + change[i]), sigmas)
                 for i, sigmas in stages.moved_parameters(model, change, found.problem.root, rows) if i < len(value))


def _held_out(case: Case) -> str:
    """How the data on which errors are reported were kept apart."""
    if case.validate is not None:
        return (f"parameters and causes from {_name(case.recording)}; the errors are those of {_name(case.validate)}, "
                "which took no part")
    return (f"each block of time of {_name(case.recording)} is predicted by parameters and sizes that were fitted to "
            "all the others")


def _extended(case: Case, found: Findings) -> tuple[Model | None, tuple[str, ...]]:
    """The model with the parameters of the joint fit and all effects, and warnings; None for torques in amperes."""
    if not case.shared:
        return None, ()
    torques, whole = found.domains[0].regression, found.domains[0].final
    final = whole.of_model(len(parameter_vector(found.start.base_values, found.start.friction)))
    added = [effect for result in found.results
             for effect in (*(named.fitted for named in result.found), *result.small)]
    change, covariance = final.change.copy(), final.covariance.copy()
    # A parameter at its bound has no variance.
    index = list(found.fixed)
    covariance[index], covariance[:, index], change[index] = 0.0, 0.0, 0.0
    left, seen = rms(whole.residual(torques), torques.use), torques.use.any(axis=0)
    model = replace(with_parameters(found.start, change, covariance),
                    noise_std=np.where(seen, left, found.start.noise_std))
    warnings = tuple[str, ...]()
    try:
        known = Model.nominal(case.robot) if case.given is None else case.given
        model = with_possible_inertias(model, known.consistent)
    except IdealRobotError as error:
        # The found effects do not depend on it: torques come from the base parameters.
        warnings = (f"the extended model predicts torques, but cannot be simulated: {error}",)
    found_in = {"recording": case.recording.source, "hash": case.recording.hash,
                "effects": [effect.name for effect in added]}
    return replace(model, effects=model.effects + tuple(added),
                   provenance={**model.provenance, "diagnosis": found_in}), warnings


def _name(recording: Recording) -> str:
    return str(recording.source).rsplit("/", 1)[-1]


_READING = "Reading"
SHARES = {_READING: 0.03, "Baseline": 0.02, "Causes of the motor torque": 0.70, "Causes of other channels": 0.20,
          "Errors before and after": 0.05}
"""Measured shares of the time, an arm of six joints."""
STAGES = dict(zip(list(SHARES)[1:], (
    stages.baseline, stages.causes_of_motor_torque, stages.causes_of_other_channels,
    stages.errors_before_and_after), strict=True))
"""Heading, and what is done: a function of the case and of what was found before."""


def _usable(recording: Recording, robot: Robot) -> tuple[Recording, list[str]]:
    """The recording as it can be used, and warnings."""
    recording, warnings = shortened(recording)
    (recording,), more = checked([recording], robot)
    return recording, warnings + more


def _prepared(case: Case, warnings: list[str]) -> tuple[Case, Findings]:
    """What is known before any search; without the validation recording where nothing predicts it."""
    findings = stages.prepared(case, tuple(warnings))
    missed = () if case.validate is None or case.given is not None else _unlike(case, findings, case.validate)
    if not missed:
        return case, findings
    case = replace(case, validate=None)
    return case, stages.prepared(case, (
        *warnings, "validation-not-predicted: with the parameters of the recording alone the error of the other one is "
        f"larger than what it varies by in {', '.join(missed)}; it reports nothing, blocks of the recording do (give "
        "--model, or a recording that moves as widely as the other)"))


def _unlike(case: Case, found: Findings, validate: Recording) -> tuple[str, ...]:
    """Channels of the validation recording that the first one's parameters miss by more than they vary.

    Short motions leave parameters open, above all in amperes, where each joint has its own. An error of many times the
    torque then falls by whatever moves these parameters, which no cause explains.
    """
    problem = found.problem
    other = case.torque_regression(validate, found.start, cutoff=problem.regression.filtered.cutoff)
    error, varies = rms(problem.fit().residual(other), other.use), spread(other.measured, other.use)
    still = {*problem.regression.undecided, *other.undecided}
    return tuple(name for j, name in enumerate(other.channels) if j + 1 not in still and error[j] > varies[j])


def diagnose(recording: Recording, robot: Robot, *, model: Model | None = None, validate: Recording | None = None,
             progress: Progress = silent, only: Only | None = None, cutoff: float | None = None) -> Diagnosis:
    """Finds the physical effects that a model lacks in a recording, their joints and their improvement.

    Args:
        recording: the measured recording.
        robot: the arm it was measured on.
        model: a model known before; without it a rigid body with Coulomb and viscous friction, rotors and offsets is
            identified from the recording first.
        validate: another recording of the same arm on which errors are reported; without it each block of time of
            ``recording`` is predicted by the fit to all others.
        progress: called with the share done and a word.
        only: names and joints of the effects that are permitted, for an oracle; then no curve is learned either.
        cutoff: of the position filter [Hz]; 20 Hz if None, or a quarter of a slower sampling rate. The used band of
            torques and the time excluded around reversals depend on it.

    Raises:
        InputError: a recording that cannot be used, or a model of another arm.
    """
    steps = Steps(progress, SHARES)
    steps.begin(_READING)
    if model is not None:
        model.require_arm(robot)
    shared = joints_share(recording, robot, model)
    recording, warnings = _usable(recording, robot)
    if validate is not None:
        expect(validate, Recording, "validate", "give one recording; diagnose once for each where there are several")
        validate, more = _usable(validate, robot)
        warnings += more
    known = [finding for run in (recording, validate) if run is not None for finding in channel_findings(run)]
    warnings += [finding.warning for finding in known]
    case = Case(recording, robot, model, validate, progress, shared=shared, only=only,
                dead=tuple(dead_joints(tuple(known))), cutoff=cutoff)
    case, findings = _prepared(case, warnings)
    if not findings.problem.regression.use.any():
        return undecided(case, stages.errors_before_and_after(case, stages.sensors_alone(case, findings)))
    for heading, stage in STAGES.items():
        findings = stage(replace(case, progress=steps.begin(heading)), findings)
    return diagnosis_of(case, findings)
