"""The stages of a diagnosis, in their order: each says of a case and of what was found before it what it finds."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from ideal_robot.diagnosis.case import Case, Findings
from ideal_robot.diagnosis.channels.arm import arm_angle_regression, punctual, tool_regression, with_loose_weights
from ideal_robot.diagnosis.channels.force import force_regressions
from ideal_robot.diagnosis.channels.line import line_regression
from ideal_robot.diagnosis.channels.motor_torque import about_model, in_position_band, with_reversal_width
from ideal_robot.diagnosis.channels.regression import Regression, without_known
from ideal_robot.diagnosis.search.forward_selection import Search
from ideal_robot.diagnosis.search.scoring import with_equivalents
from ideal_robot.diagnosis.statistics.dependence import reversal_widths
from ideal_robot.diagnosis.statistics.least_squares import TOLD
from ideal_robot.diagnosis.statistics.problem import Candidate, Problem, prior_precision, with_parameters
from ideal_robot.diagnosis.validation.domain_diagnosis import DomainDiagnosis
from ideal_robot.diagnosis.validation.refit import with_braking_friction, without_scatter
from ideal_robot.diagnosis.validation.result import NotTransferred
from ideal_robot.diagnosis.validation.transfer import deciding, transferring
from ideal_robot.effects import ARM_POSITION, MOTOR_TORQUE, SENSOR, TCP_POSITION, library
from ideal_robot.effects.backlash import Backlash
from ideal_robot.effects.drive import DeadTime
from ideal_robot.effects.kinematics import GeometryChange
from ideal_robot.model.model import Model

Settled = tuple[DomainDiagnosis, tuple[NotTransferred, ...]]
"""A domain after its search, and what does not hold in the end."""


def _diagnosed_channels(case: Case, found: Findings) -> Iterator[Settled]:
    """The domains that the recording has beside the motor torque, after their search."""
    torque, validation = _in_position_band(case, found)
    for build in (arm_angle_regression, tool_regression):
        regression = build(case.recording, case.robot, torque, case.stiffness)
        if regression is None:
            continue
        other = None if validation is None or case.validate is None else \
            build(case.validate, case.robot, validation, case.stiffness)
        regression = without_known(regression, found.start.effects)
        other = None if other is None else without_known(other, found.start.effects)
        if regression.domain == ARM_POSITION:
            regression = with_loose_weights(regression, found.choices)
        yield (settled := _diagnosed(case, regression, other))
        if regression.domain == ARM_POSITION:
            # Else the tool would be early beside the delays of arm angles that were found.
            arm = settled[0]
            late = [(choice.joint, float(own[0])) for choice, own in
                    zip(arm.choices, arm.final.coefficients, strict=True) if isinstance(choice.effect, DeadTime)]
            case = replace(case, recording=punctual(case.recording, late),
                           validate=None if case.validate is None else punctual(case.validate, late))
    yield from _diagnosed_sensors(case, torque, validation)


def _diagnosed_sensors(case: Case, torque: Regression, validation: Regression | None) -> Iterator[Settled]:
    """The domains of a force sensor and of a camera, as far as the recording has them, after their search."""
    for regression, other in force_regressions(case.recording, case.validate, case.robot, torque, validation,
                                               case.stiffness):
        yield _diagnosed(case, regression, other)
    # The curve of another recording's line would say nothing here.
    line = line_regression(case.recording, case.robot, torque, case.stiffness)
    if line is not None:
        yield _diagnosed(case, line, None)


def _in_position_band(case: Case, found: Findings) -> tuple[Regression, Regression | None]:
    validation = None if found.validation is None or case.validate is None else \
        in_position_band(found.validation, case.validate)
    return in_position_band(found.problem.regression, case.recording), validation


def _diagnosed(case: Case, regression: Regression, validation: Regression | None) -> Settled:
    """The search in one regression; of a sensor nothing is learned, and what is reported as before is refitted."""
    effects = [effect for effect in library() if effect.domain == regression.domain]
    sensor, only = regression.domain == SENSOR, case.only
    if regression.domain == TCP_POSITION and regression.absent:
        # Two axes of three do not tell a length of the arm from an angle, nor a curve from either; play is one over
        # the load.
        only = tuple((e.name, j) for e in effects if not isinstance(e, GeometryChange) and e.name != Backlash.name
                     for j in range(case.robot.n + 1) if only is None or (e.name, j) in only)
    if sensor:
        only = tuple((e.name, 0) for e in effects if only is None or (e.name, 0) in only)
    problem = Problem.of(regression, held_out=validation is None)
    choices = Search(problem, effects, case.options.finer(), absorbed=True, only=only).run()
    choices = with_equivalents(problem, choices)
    final = problem.on_all_blocks().fit(choices, uncertainty=True)
    return DomainDiagnosis(problem, final, validation, not sensor, case.recording.hash).settled()


def prepared(case: Case, warnings: tuple[str, ...]) -> Findings:
    """The regression of the motor torques about the model that is known, or about the nominal one."""
    start = case.given if case.given is not None else Model.nominal(case.robot)
    regression = case.torque_regression(case.recording, start)
    return Findings(start, Problem.of(regression, held_out=case.validate is None), warnings=warnings)


def baseline(case: Case, found: Findings) -> Findings:
    """How sharply friction changes sign, and without a known model its parameters from the recording itself."""
    if not case.shared:
        return found
    start, problem = found.start, found.problem
    width = reversal_widths(problem, start)
    problem = problem.with_regression(with_reversal_width(problem.regression, start, width))
    if case.given is None:
        start = with_parameters(start, problem.fit().change)
        problem = problem.with_regression(about_model(problem.regression, start))
    return replace(found, start=start, problem=problem, reversal_width=width)


def effects_of_motor_torque(case: Case, found: Findings) -> Findings:
    """Effects that the motor torques show, selected one by one.

    The columns of some effects follow from the model, which at first had to do without them; so the search is resumed
    once with columns that follow from the model with the effects in it.
    """
    first = _searched(case, found)
    if not first.choices or not case.shared:
        return first
    first = replace(first, problem=first.problem.with_regression(_with_signals(case, first, found.problem.regression)))
    if not _columns_changed(found.problem.regression, first, case.options.smallest):
        return first
    last = _searched(case, replace(found, problem=found.problem.with_regression(first.problem.regression),
                                   choices=first.choices))
    return replace(last, problem=last.problem.with_regression(_with_signals(case, last, last.problem.regression)))


def _columns_changed(before: Regression, found: Findings, share: float) -> bool:
    """Whether the columns of the effects changed so much since they were selected that a residual was made of it.

    As large a ``share`` of a channel's squares counts as is asked of an effect.
    """
    after, effects = found.problem.regression, found.choices
    fit = found.problem.fit(effects)
    residual = fit.residual(after) * after.use
    changes = [(new - old) * after.use for old, new in zip(fit.contributions(before), fit.contributions(after),
                                                           strict=True)]
    return any(bool(np.any((change**2).sum(axis=0) > share * (residual**2).sum(axis=0))) for change in changes)


def _searched(case: Case, found: Findings) -> Findings:
    """What a search finds that begins with the physical causes found before."""
    effects = [effect for effect in library() if effect.domain == MOTOR_TORQUE]
    start = [choice for choice in found.choices if not choice.effect.learned]
    # The other recording decides what stays.
    options = case.options if case.validate is None else case.options.finer()

    def search(problem: Problem, absorbed: bool) -> Search:
        return Search(problem, effects, options, absorbed=absorbed, only=case.only, progress=case.progress)

    if case.given is None or not np.any(found.start.covariance):
        return replace(found, choices=tuple(search(found.problem, False).run(start)))
    return _searched_beside_known(found, start, search)


def _searched_beside_known(found: Findings, start: Sequence[Candidate],
                           search: Callable[[Problem, bool], Search]) -> Findings:
    """Effects selected with the known model's parameters held, or with free ones where the model does not hold.

    Then it is said what a search with held ones selected all the same: all of it, and what of it the parameters, as
    uncertain as they are, do not take over.
    """
    prior = prior_precision(found.start, found.problem)
    held = search(found.problem.with_prior(prior).held(), True)
    every = tuple(held.run(start))
    held.settle(prior)
    settled = tuple(held.model.choices)
    holding = replace(found, problem=found.problem.with_prior(prior), choices=settled, beside_known=())
    free = search(found.problem, False)
    # A curve without a cause is no reason to hold what other parameters explain as well.
    free.model.replace([c for c in settled if not (c.effect.absorbed_by_base or c.effect.learned)])
    # What was known holds until data tell otherwise, and where it takes curves to hold, data have to tell that.
    limit = -TOLD if any(c.effect.learned for c in settled) else TOLD
    if held.model.worse_than(free.model) < limit:
        return holding
    # The search begins without effects, but with the weights that they leave.
    free.model.choices = []
    free.run()
    if held.model.worse_than(free.model) < limit:
        return holding
    return replace(found, problem=found.problem.with_prior(None), choices=tuple(free.model.choices), warnings=(
        *found.warnings, "the model's parameters do not hold for this recording and were fitted anew; changes of "
        "parameters are therefore not listed as effects"),
        beside_known=tuple(dict.fromkeys(own for own in (every, settled) if own)))


def found_but_not_added(case: Case, found: Findings) -> Findings:
    """Effects that make the error of the validation recording, or of the blocks kept apart, worse are dropped."""
    problem, validation = found.problem, None
    samples = ~problem.blocks.selecting_samples
    if case.validate is not None:
        validation = _with_signals(case, found, case.torque_regression(
            case.validate, found.start, cutoff=problem.regression.filtered.cutoff, reversal_width=found.reversal_width))
        samples = deciding(validation)
    choices, dropped = transferring(problem, found.choices, validation or problem.regression, samples)
    return replace(found, choices=tuple(choices), validation=validation, not_transferred=dropped)


def joint_fit(case: Case, found: Findings) -> Findings:
    """Parameters and effects of the motor torque, fitted together to all of the recording."""
    found = with_braking_friction(case, found)
    torque, dropped = _domain_of(case, found).settled()
    if dropped:
        # What was dropped leaves more to friction.
        found = with_braking_friction(case, replace(found, choices=torque.choices))
        torque = _domain_of(case, found)
    return replace(found, domains=(torque,), choices=torque.choices,
                   not_transferred=found.not_transferred + dropped)


def _domain_of(case: Case, found: Findings) -> DomainDiagnosis:
    final = without_scatter(found.problem.on_all_blocks().fit(found.choices, uncertainty=True), found.held)
    return DomainDiagnosis(found.problem, final, found.validation, case.given is not None, case.recording.hash)


def effects_of_other_channels(case: Case, found: Findings) -> Findings:
    """Arm angles, TCP positions, force sensor and camera, as far as the recording has them."""
    return _settled(found, _diagnosed_channels(case, found))


def _settled(found: Findings, domains: Iterator[Settled]) -> Findings:
    for domain, dropped in domains:
        found = replace(found, domains=(*found.domains, domain), not_transferred=found.not_transferred + dropped)
    return found


def sensors_alone(case: Case, found: Findings) -> Findings:
    """Force sensor and camera, where no joint moves enough to decide anything of the arm: the model stays as it is."""
    if case.validate is not None:
        found = replace(found, validation=case.torque_regression(case.validate, found.start))
    return errors_before_and_after(case, _settled(found, _diagnosed_sensors(case, *_in_position_band(case, found))))


def errors_before_and_after(case: Case, found: Findings) -> Findings:
    """Errors on data that had no part in finding anything, and what the residual depends on."""
    return replace(found, results=tuple(domain.result() for domain in found.domains))


def _with_signals(case: Case, found: Findings, regression: Regression) -> Regression:
    """A regression with the signals that follow from the model as it is with the selected effects."""
    if not found.choices or not case.shared:
        return regression
    change = found.problem.fit(found.choices).change
    return replace(regression, signals=about_model(regression, with_parameters(found.start, change)).signals)
