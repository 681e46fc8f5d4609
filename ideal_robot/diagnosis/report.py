"""From the findings to the answer."""

from __future__ import annotations

import dataclasses

import numpy as np

from ideal_robot.diagnosis.case import Case, Findings
from ideal_robot.diagnosis.channels.unused import unused_columns
from ideal_robot.diagnosis.statistics.estimate import fitted_effect
from ideal_robot.diagnosis.statistics.prior import prior_precision
from ideal_robot.diagnosis.statistics.with_parameters import with_parameters, with_possible_inertias
from ideal_robot.diagnosis.validation.beside_lag import beside_lag
from ideal_robot.diagnosis.validation.braking import without_scatter
from ideal_robot.diagnosis.validation.domain_diagnosis import rms
from ideal_robot.diagnosis.validation.refit import explained_by_refitting
from ideal_robot.diagnosis.validation.result import ChannelResult, Diagnosis, FoundEffect
from ideal_robot.effects import FittedEffect
from ideal_robot.errors import IdealRobotError
from ideal_robot.model.model import Model
from ideal_robot.signals.recording import Recording


def diagnosis_of(case: Case, found: Findings) -> Diagnosis:
    """The answer after all stages."""
    every = [effect for result in found.results for effect in result.found]
    effects = tuple(f for f in every if not f.fitted.effect.learned)
    unknown = tuple(f for f in every if f.fitted.effect.learned)
    channels = tuple(channel for result in found.results for channel in result.channels)
    refitted = () if case.given is None else explained_by_refitting(case.given, found.domains[0],
                                                                    found.results[0].channels)
    left = bool(unknown or refitted) or any(channel.unexplained for channel in channels)
    verdict = "unknown" if left else ("effects" if effects else "none")
    model, warnings = _extended(case, found, every)
    return Diagnosis(verdict, channels, effects,
                     unknown, _held_out(case, found), found.domains[0].held_out_seconds,
                     found.problem.regression.undecided,
                     before=tuple(structure for result in found.results for structure in result.before),
                     remaining=tuple(structure for result in found.results for structure in result.remaining),
                     warnings=found.warnings + warnings, model=model,
                     traces=tuple(result.traces for result in found.results), not_transferred=found.not_transferred,
                     unused=unused_columns(case.recording, tuple(d.problem.regression for d in found.domains)),
                     refitted=refitted, beside_known=_beside_known(found))


def _beside_known(found: Findings) -> tuple[tuple[FittedEffect, ...], ...]:
    result = []
    for candidates in found.beside_known:
        problem = found.problem.with_prior(prior_precision(found.start, found.problem)).held()
        fit = problem.on_all_blocks().fit(candidates, uncertainty=True)
        result.append(tuple(fitted_effect(candidate, fit, k) for k, candidate in enumerate(candidates)))
    return tuple(result)


def undecided(case: Case, found: Findings) -> Diagnosis:
    """The answer where no joint moves enough to decide anything of the arm: what sensors show beside it as it is."""
    made = found.problem.regression
    error, signal = (rms(values, made.use) for values in (made.y, made.measured))
    channels = tuple(ChannelResult(name, unit, float(error[j]), float(error[j]), float(error[j]),
                                   float(made.noise_floor[j]), float(signal[j]), float(np.mean(made.use[:, j])))
                     for j, (name, unit) in enumerate(zip(made.channels, made.units, strict=True)))
    effects = tuple(effect for result in found.results for effect in result.found)
    model = None if case.given is None else case.given.with_effects(tuple(f.fitted for f in effects))
    how, seconds = "nothing: no joint moves enough to decide anything", 0.0
    if found.domains:
        how = f"of sensors alone, no joint moves enough: {_held_out(case, found)}"
        seconds = found.domains[0].held_out_seconds
    return Diagnosis("effects" if effects else "undecided",
                     channels + tuple(channel for result in found.results for channel in result.channels), effects, (),
                     how, seconds, made.undecided,
                     before=tuple(structure for result in found.results for structure in result.before),
                     remaining=tuple(structure for result in found.results for structure in result.remaining),
                     warnings=found.warnings, model=model, traces=tuple(result.traces for result in found.results),
                     not_transferred=found.not_transferred,
                     unused=unused_columns(case.recording, (made, *(d.problem.regression for d in found.domains))))


def _held_out(case: Case, found: Findings) -> str:
    """How the data on which errors are reported were kept apart."""
    if case.validate is not None:
        return (f"parameters and selection from {_name(case.recording)}; of {_name(case.validate)} every second "
                "block of time decides what transfers, and the errors are those of the others")
    return (f"every fourth of {found.problem.blocks.count} blocks of time of {_name(case.recording)}, which "
            "neither selection nor estimation saw")


def _extended(case: Case, found: Findings, added: list[FoundEffect]) -> tuple[Model | None, tuple[str, ...]]:
    """The model with the parameters of the joint fit and all effects, and warnings; None for torques in amperes."""
    if not case.shared:
        return None, ()
    final = found.domains[0].final if case.only is None else without_scatter(beside_lag(found.domains[0]), found.held)
    model = with_parameters(found.start, final.change, final.covariance)
    warnings: tuple[str, ...] = ()
    try:
        known = Model.nominal(case.robot) if case.given is None else case.given
        model = with_possible_inertias(model, known.consistent)
    except IdealRobotError as error:
        # What was found does not depend on it: torques come from the base parameters.
        warnings = (f"the extended model predicts torques, but cannot be simulated: {error}",)
    provenance = dict(model.provenance)
    provenance["diagnosis"] = {"recording": case.recording.source, "hash": case.recording.hash,
                               "effects": [f.fitted.name for f in added]}
    effects = model.effects + tuple(f.fitted for f in added)
    return dataclasses.replace(model, effects=effects, provenance=provenance), warnings


def _name(recording: Recording) -> str:
    return str(recording.source).rsplit("/", 1)[-1]
