"""The stages of a diagnosis: residual, best set of causes of each domain, and errors before and after."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.best_set import BestSet
from ideal_robot.diagnosis.case import Case, Findings
from ideal_robot.diagnosis.causes import Candidate
from ideal_robot.diagnosis.channels.arm import arm_angle_regression, punctual, tool_regression, with_loose_weights
from ideal_robot.diagnosis.channels.force import force_regressions
from ideal_robot.diagnosis.channels.line import line_regression
from ideal_robot.diagnosis.channels.motor_torque import about_model, in_position_band, with_reversal_width
from ideal_robot.diagnosis.channels.regression import Regression, without_known
from ideal_robot.diagnosis.prior import hypotheses, known, noise_of, positions_known
from ideal_robot.diagnosis.report import DomainDiagnosis
from ideal_robot.diagnosis.statistics.dependence import reversal_widths
from ideal_robot.diagnosis.statistics.problem import Problem, with_parameters
from ideal_robot.effects import ARM_POSITION, MOTOR_TORQUE, SENSOR, TCP_POSITION, library
from ideal_robot.effects.backlash import Backlash
from ideal_robot.effects.drive import DeadTime
from ideal_robot.effects.kinematics import GeometryChange
from ideal_robot.model.model import Model
from ideal_robot.model.parametrisation import friction_places, parameter_vector


def prepared(case: Case, warnings: tuple[str, ...]) -> Findings:
    """The regression of the motor torques about the given or the nominal model."""
    start = case.given if case.given is not None else Model.nominal(case.robot)
    regression = case.torque_regression(case.recording, start)
    return Findings(start, Problem(regression), warnings=warnings)


def baseline(case: Case, found: Findings) -> Findings:
    """Width of friction's sign change, and without a given model the parameters from the recording itself."""
    if not case.shared:
        return found
    start, problem = found.start, found.problem
    width = reversal_widths(problem, start)
    problem = problem.with_regression(with_reversal_width(problem.regression, start, width))
    if case.given is None:
        start = with_parameters(start, problem.fit().change)
        problem = problem.with_regression(about_model(problem.regression, start))
    return replace(found, start=start, problem=problem, reversal_width=width)


def causes_of_motor_torque(case: Case, found: Findings) -> Findings:
    """The best set of causes of the motor torques.

    Some columns depend on the model, which at first lacks the causes; so the search is continued once with columns from
    the model that has them.
    """
    first = _searched(case, found, ())
    if not first.best_set.choices or not case.shared or case.given is not None:
        return _finished(case, first)
    change = first.best_set.fit_of(first.best_set.choices).change
    signals = about_model(found.problem.regression, with_parameters(found.start, change)).signals
    again = replace(found, problem=found.problem.with_regression(replace(found.problem.regression, signals=signals)))
    return _finished(case, _searched(case, again, first.best_set.choices))


def _searched(case: Case, found: Findings, start: Sequence[Candidate]) -> Findings:
    """The best set beside free parameters, or beside those of a given model: as of the same arm, or as of its type."""
    effects = [effect for effect in library() if effect.domain == MOTOR_TORQUE]
    if case.given is None or not np.any(found.start.covariance):
        best = BestSet(found.problem, effects, absorbed=False, only=case.only, progress=case.progress)
        best.run(start)
        return replace(found, best=best)
    about = known(case.given, case.robot, found.problem.regression, case.recording)
    found, sets = replace(found, problem=found.problem.with_regression(about.regression), pushed=about.pushed), []
    # Noise is what no smooth function explains, in addition to the differences of any arm of the type; outliers are
    # excluded.
    widest = max(hypotheses(case.given, about.differs), key=lambda h: float(np.sum(h.root**2)))
    beside = BestSet(found.problem.with_root(widest.root), [], absorbed=True)
    noise = noise_of(case.given, beside.noise, about.regression.step)
    found = replace(found, problem=found.problem.with_regression(replace(about.regression, use=beside.rows)))
    for hypothesis in hypotheses(case.given, about.differs):
        best = BestSet(found.problem.with_root(hypothesis.root), effects, absorbed=True, only=case.only,
                       noise=noise, progress=case.progress)
        best.run(start)
        sets.append((hypothesis, best))
    every = [choice for _, best in sets for choice in best.choices]
    hypothesis, best = max(sets, key=lambda s: s[0].logarithm + s[1].total(every))
    return replace(found, best=best, taken_for=hypothesis.name, problem=best.problem)


def _finished(case: Case, found: Findings) -> Findings:
    """The findings with the motor torques' result, and with the other recording's regression where there is one.

    Before it is made, friction that would drive the arm is taken out of the model; anew where causes leave, for what
    they made drive may brake without them.
    """
    gone: tuple[Candidate, ...] = ()
    perhaps: tuple[Candidate, ...] = ()
    while True:
        braked = _with_braking_friction(case, found)
        validation = _validation(case, braked)
        domain = DomainDiagnosis.of(braked.best_set, validation, case.given is not None, case.recording.hash)
        gone, perhaps = (*gone, *domain.gone), (*perhaps, *domain.perhaps)
        if not (braked.fixed and (domain.gone or domain.perhaps)):
            break
        found.best_set.take(list(domain.choices))
    return replace(braked, domains=(replace(domain, gone=gone, perhaps=perhaps),), validation=validation)


def _validation(case: Case, found: Findings) -> Regression | None:
    """The regression of the other recording's torques, where there is one."""
    if case.validate is None:
        return None
    validation = case.torque_regression(case.validate, found.start, cutoff=found.problem.regression.filtered.cutoff,
                                        reversal_width=found.reversal_width)
    if found.taken_for and case.given is not None:
        validation = known(case.given, case.robot, validation, case.validate, found.pushed).regression
    validation = replace(validation, signals=replace(validation.signals, elsewhere=found.problem.regression.signals.t))
    if found.fixed:
        W = validation.W.copy()
        W[:, :, list(found.fixed)] = 0.0
        validation = replace(validation, W=W)
    return validation


def _with_braking_friction(case: Case, found: Findings) -> Findings:
    """The findings about a model in which coefficients of friction that come out negative are zero and stay so.

    A model that was given brakes already, and is what errors are compared with.
    """
    if not case.shared or case.given is not None:
        return found
    for _ in range(case.robot.n):
        start, best = found.start, found.best_set
        value = parameter_vector(start.base_values, start.friction)
        brakes = np.zeros(len(value), dtype=bool)
        for law, place in zip(start.friction.laws, friction_places(start.base, start.friction), strict=True):
            brakes[place] = law.nonnegative
        brakes[list(found.fixed)] = False
        change = best.fit_of(best.choices).change
        index = np.flatnonzero(brakes & (value + change < 0.0))
        if not len(index):
            break
        zeroed = np.zeros(len(value))
        zeroed[index] = -value[index]
        start = with_parameters(start, zeroed)
        regression = found.problem.regression
        W = regression.W.copy()
        W[:, :, index] = 0.0
        regression = replace(about_model(regression, start), signals=regression.signals, W=W)
        problem = found.problem.with_regression(regression)
        found = replace(found, start=start, problem=problem, best=best.about(problem),
                        fixed=(*found.fixed, *index.tolist()))
    return found


def causes_of_other_channels(case: Case, found: Findings) -> Findings:
    """The best sets of causes of arm angles, TCP positions, force sensor and camera, as far as recorded."""
    return replace(found, domains=(*found.domains, *_other_channels(case, found)))


def sensors_alone(case: Case, found: Findings) -> Findings:
    """The best sets of causes of force sensor and camera, where no joint moves; the model is not changed."""
    if case.validate is not None:
        found = replace(found, validation=case.torque_regression(case.validate, found.start))
    torque, validation = _in_position_band(case, found)
    return replace(found, domains=tuple(_sensors(case, torque, validation)))


def _other_channels(case: Case, found: Findings) -> Iterator[DomainDiagnosis]:
    """The domains that the recording has beside the motor torque, after their search."""
    found = _with_what_gears_carry(case, found)
    torque, validation = _in_position_band(case, found)
    for build in (arm_angle_regression, tool_regression):
        if found.taken_for:
            # With a known model the torques' band suffices; above it arms oscillate, which no gear of a model explains.
            regression = build(case.recording, case.robot, found.problem.regression, case.stiffness)
            if regression is not None:
                regression = without_known(regression, found.start.effects)
                if regression.domain == ARM_POSITION:
                    regression = with_loose_weights(regression, found.best_set.choices)
                yield _about_model(case, found, regression)
            continue
        regression = build(case.recording, case.robot, torque, case.stiffness)
        if regression is None:
            continue
        other = None if validation is None or case.validate is None else \
            build(case.validate, case.robot, validation, case.stiffness)
        regression = without_known(regression, found.start.effects)
        other = None if other is None else without_known(other, found.start.effects)
        if regression.domain == ARM_POSITION:
            regression = with_loose_weights(regression, found.best_set.choices)
            other = None if other is None or other.W.shape != regression.W.shape else other
        yield (arm := _diagnosed(case, regression, other))
        if regression.domain == ARM_POSITION:
            # Without this the tool would appear early relative to the found delays of arm angles.
            late = [(choice.joint, float(own[0])) for choice, own in
                    zip(arm.choices, arm.final.coefficients, strict=True) if isinstance(choice.effect, DeadTime)]
            case = replace(case, recording=punctual(case.recording, late),
                           validate=None if case.validate is None else punctual(case.validate, late))
    yield from _sensors(case, torque, validation)


def _about_model(case: Case, found: Findings, regression: Regression) -> DomainDiagnosis:
    """The search in arm angles or TCP positions about a model that was given."""
    regression, root, noise = positions_known(found.start, regression, found.taken_for)
    effects = [effect for effect in library() if effect.domain == regression.domain]
    best = BestSet(Problem(regression, root), effects, absorbed=True, only=case.only, noise=noise)
    best.run()
    return DomainDiagnosis.of(best, None, True, case.recording.hash)


def _with_what_gears_carry(case: Case, found: Findings) -> Findings:
    """The findings with signals of the model as it came out, its causes in it: a load bends the gears that carry it."""
    if not case.shared:
        return found
    final = found.domains[0].final
    model = with_parameters(found.start, final.change)
    fitted = final.all_fitted(found.problem.regression.prismatic)
    model = replace(model, effects=model.effects + tuple(f for f in fitted if not f.effect.learned))
    about = partial(about_model, model=model)
    regression = replace(found.problem.regression, signals=about(found.problem.regression).signals)
    validation = found.validation
    return replace(found, problem=found.problem.with_regression(regression), validation=None if validation is None else
                   replace(validation, signals=about(validation).signals))


def _sensors(case: Case, torque: Regression, validation: Regression | None) -> Iterator[DomainDiagnosis]:
    """The domains of a force sensor and of a camera, as far as the recording has them, after their search."""
    for regression, other in force_regressions(case.recording, case.validate, case.robot, torque, validation,
                                               case.stiffness):
        yield _diagnosed(case, regression, other)
    # Another recording has another line, so its curve does not apply.
    line = line_regression(case.recording, case.robot, torque, case.stiffness)
    if line is not None:
        yield _diagnosed(case, line, None)


def _in_position_band(case: Case, found: Findings) -> tuple[Regression, Regression | None]:
    validation = None if found.validation is None or case.validate is None else \
        in_position_band(found.validation, case.validate)
    return in_position_band(found.problem.regression, case.recording), validation


def _diagnosed(case: Case, regression: Regression, validation: Regression | None) -> DomainDiagnosis:
    """The search in one regression; of a sensor nothing is learned, and what is reported as before is refitted."""
    effects = [effect for effect in library() if effect.domain == regression.domain]
    sensor, only = regression.domain == SENSOR, case.only
    if regression.domain == TCP_POSITION and regression.absent:
        # Two of three axes do not separate a length of the arm from an angle, nor a learned curve from either; backlash
        # is a function of the load.
        only = tuple((e.name, j) for e in effects if not isinstance(e, GeometryChange) and e.name != Backlash.name
                     for j in range(case.robot.n + 1) if only is None or (e.name, j) in only)
    if sensor:
        only = tuple((e.name, 0) for e in effects if only is None or (e.name, 0) in only)
    best = BestSet(Problem(regression), effects, absorbed=True, only=only)
    best.run()
    return DomainDiagnosis.of(best, validation, not sensor, case.recording.hash)


def errors_before_and_after(case: Case, found: Findings) -> Findings:
    """Errors on held-out data, and the dependences of the residual."""
    return replace(found, results=tuple(domain.result() for domain in found.domains))


def moved_parameters(model: Model, change: Array, root: Array | None, W: Array) -> list[tuple[int, float]]:
    """Parameters ``(P,)`` of a given model that this recording changes much, by their change, with their σ.

    Args:
        model, change: the model that was given, and the change of its parameters.
        root: matrix ``R``, the parameters' prior covariance being ``R R'``.
        W: derivative of the torques ``(N, c, P)``.
    """
    if root is None:
        return []
    sigma = np.sqrt(np.maximum((root**2).sum(axis=1), 1e-300))
    weight = np.abs(change) * np.sqrt(np.mean(np.square(W), axis=(0, 1)))
    return [(int(i), float(change[i] / sigma[i])) for i in np.argsort(-weight)
            if abs(change[i]) > 2.0 * sigma[i] and weight[i] > 0.0][:4]
