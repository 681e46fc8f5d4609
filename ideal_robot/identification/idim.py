"""Conventional identification: inverse dynamic model and weighted least squares over whole motions ([J] 3).

Friction, rigid body, rotor inertias and offsets are found together. Nominal inertias of the URDF are used only where
the data have no information.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.dynamics import BaseParameters, base_parameters, full_regressor
from ideal_robot.dynamics.consistent_inertias import Consistency
from ideal_robot.errors import InputError
from ideal_robot.identification.against_urdf import Finding, contradicting
from ideal_robot.identification.checks import checked, excitation_warnings, require_distinct, require_motion
from ideal_robot.identification.joint_fit import JointFit, JointProblem
from ideal_robot.identification.weighted_least_squares import Solution, prior_of
from ideal_robot.model.described_arm import DescribedArm
from ideal_robot.model.model import Model
from ideal_robot.model.parametrisation import Prediction, joined
from ideal_robot.results import Summarised, listed
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.channels import ChannelFinding, channel_findings, dead_joints
from ideal_robot.signals.cutoff import CutoffChoice, choose_cutoff
from ideal_robot.signals.error_budget import ErrorBudget, error_budget
from ideal_robot.signals.filters import decimated
from ideal_robot.signals.preprocess import FilteredSignals, evenly_sampled
from ideal_robot.signals.recording import Recording
from ideal_robot.signals.sampling import on_its_clock

_PROBE = 8.0
"""Cut-off at which the size of the torque and of the acceleration is looked at beforehand [Hz]."""
_TURNS = 0.003
"""Dry friction turns over within this share of a joint's top speed."""


def chosen_filters(recordings: Sequence[Recording], robot: Robot, *, amperes: bool = False,
                   base: BaseParameters | None = None) -> CutoffChoice:
    """Cut-offs by held-out error of the rigid body with dry and viscous friction.

    Args:
        recordings: checked ones, with ``tau_i``; a dead channel's torque is NaN.
        robot: kinematics and nominal inertias.
        amperes: torques are currents with unknown gains.
        base: grouping of the robot's parameters, where the caller has it already.
    """
    base = base_parameters(robot.pinocchio) if base is None else base
    n = robot.n

    def columns(s: FilteredSignals, stride: int) -> Array:
        q, qd, qdd = s.q[::stride], s.qd[::stride], s.qdd[::stride]
        beyond = base.layout.size + np.arange(2 * n)
        W = full_regressor(robot.pinocchio, q, qd, qdd, [*base.independent, *beyond])
        joints = np.arange(n)
        W[:, joints, base.count + joints] = qd
        # The jumps of this column have all frequencies, unlike the others, so it is filtered separately.
        slow = _TURNS * np.maximum(np.max(np.abs(s.qd), axis=0), 1e-9)
        W[:, joints, base.count + n + joints] = decimated(np.tanh((s.qd / slow).astype(np.float32)), stride)
        return W

    probes = [evenly_sampled(r, columns=False).filtered(min(_PROBE, 0.1 * len(r.t) / float(r.t[-1] - r.t[0])))
              for r in recordings]
    prior = prior_of(robot, base, probes, amperes=amperes)
    return choose_cutoff(recordings, columns, start=np.concatenate([prior.start, np.zeros(2 * n)]),
                         information=prior.padded(base.count + 2 * n))


@dataclass(frozen=True, repr=False)
class Identification(Summarised):
    """The result of an identification.

    Attributes:
        model: the identified model.
        solution: the final least-squares solution and its statistics.
        estimation: prediction of each estimation recording.
        validation: prediction of each validation recording.
        friction_scores: per joint, held-out residual of each friction law tried, in units of the noise.
        consistency: how far the physically possible parameters are from the identified ones.
        warnings: named warnings, each ``name: sentence``.
        recordings, unseen: the estimation and validation recordings as they were used, torque in N m.
        contradictions: contradictions of the recordings to the URDF.
    """

    model: Model
    solution: Solution
    estimation: tuple[Prediction, ...]
    validation: tuple[Prediction, ...]
    friction_scores: tuple[dict[str, float], ...]
    consistency: Consistency
    warnings: tuple[str, ...]
    recordings: tuple[Recording, ...]
    unseen: tuple[Recording, ...]
    contradictions: tuple[Finding, ...] = ()

    def summary(self) -> list[tuple[str, str]]:
        """Fit of the model to the measurements as rows of label and value."""
        errors = [(title, listed(joined(predictions).relative_error_percent, "%")) for title, predictions in
                  (("error of the torque", self.estimation), ("on what was not used", self.validation)) if predictions]
        return [("model", f"{self.model.arm.name!r}: {len(self.recordings)} recordings"), *errors,
                ("warnings", str(len(self.warnings)))]


def identify(recordings: Sequence[Recording], robot: Robot, *, validation: Sequence[Recording] = (),
             friction: str = "auto", cutoff: float | None = None,
             cutoff_decimation: float | None = None) -> Identification:
    """Identifies a dynamic model from recordings of free motion.

    Args:
        recordings: with ``t``, ``q_i`` and ``tau_i`` or ``current_i``.
        robot: kinematics, nominal inertias, limits, drive gains.
        validation: recordings the model is compared with and never fitted to.
        friction: key of a friction law for all joints; ``auto`` chooses law and refinements per joint by the error on
            held-out intervals of the estimation recordings.
        cutoff: of the position filter [Hz]; chosen from the data if None.
        cutoff_decimation: of the decimation filter [Hz]; chosen from the data if None.

    Raises:
        InputError: recordings that cannot be used, and why.
    """
    if not recordings:
        raise InputError("no recording was given", field="recordings")
    require_distinct([*recordings, *validation])
    usable, warnings = checked(recordings, robot, commands=True)
    require_motion(usable)
    unseen, more = checked(validation, robot) if validation else ([], [])
    warnings += [f"{text} (validation)" for text in more]
    amperes = any(text.startswith("unknown-drive-gain") for text in warnings)
    live = []
    for recording in usable:
        alive, findings = without_dead_channels(recording)
        live.append(on_its_clock(alive))
        warnings += [f"{finding.warning} [{recording.source}]" for finding in findings]
    base = base_parameters(robot.pinocchio)
    filters = None if cutoff is not None else chosen_filters(live, robot, amperes=amperes, base=base)
    if filters is not None:
        cutoff = filters.cutoff
        warnings += [filters.warning] * bool(filters.warning)
    signals = [evenly_sampled(r, columns=False).filtered(cutoff, cutoff_decimation) for r in live]
    prior = prior_of(robot, base, signals, amperes=amperes)
    budgets = [error_budget(r, s) for r, s in zip(usable, signals, strict=True)]
    fit = JointProblem(robot, base, prior, signals, budgets).fit(friction)
    settings = {"cutoff": signals[0].cutoff, "cutoff_decimation": signals[0].cutoff_decimation,
                **(_described(filters) if filters is not None else {})}
    model = _model_of(fit, robot, base, usable, settings, budgets)
    if amperes:
        model = replace(model, provenance={**model.provenance, "amperes": robot.without_gain})
    warnings += excitation_warnings(model, fit.solution)
    contradictions, said = contradicting(usable, robot, amperes=amperes)
    warnings += said
    estimation = tuple(model.predict(r) for r in usable)
    held_out = tuple(model.predict(r) for r in unseen)
    model = with_errors(model, estimation, held_out, warnings)
    return Identification(model, fit.solution, estimation, held_out, fit.scores, fit.consistency, tuple(warnings),
                          tuple(usable), tuple(unseen), contradictions)


def _model_of(fit: JointFit, robot: Robot, base: BaseParameters, recordings: Sequence[Recording],
              filters: dict[str, Any], budgets: Sequence[ErrorBudget]) -> Model:
    """The model of a fit, with where it comes from."""
    solution = fit.solution
    # For a joint without a torque nothing is identified: the whole logged signal is noise.
    logged = np.std(np.concatenate([r.joints("tau") for r in recordings]), axis=0)
    noise = np.where(fit.counted > 0.0, solution.noise_std, logged)
    return Model(
        DescribedArm.of(robot), base, solution.value[: base.count],
        fit.friction, solution.covariance, fit.consistency.full, noise,
        provenance={
            "method": "joint",
            "recordings": [{"source": r.source, "hash": r.hash} for r in recordings],
            "filters": filters,
            "condition_number": solution.condition_number,
            "samples_counted_percent": (100.0 * fit.counted).tolist(),
            "position_error": _errors(budgets),
        },
        effects=fit.springs,
    )


def with_errors(model: Model, estimation: Sequence[Prediction], held_out: Sequence[Prediction],
                warnings: list[str]) -> Model:
    """The model with its warnings and relative errors noted in its provenance.

    Args:
        model, warnings: the identified model, and named warnings, each ``name: sentence``.
        estimation, held_out: its predictions of the recordings it is fitted to, and of those it has not seen.
    """
    return replace(model, provenance={**model.provenance, "warnings": warnings, "relative_error_percent": {
        "estimation": joined(estimation).relative_error_percent.tolist(),
        "validation": joined(held_out).relative_error_percent.tolist() if held_out else []}})


def without_dead_channels(recording: Recording) -> tuple[Recording, tuple[ChannelFinding, ...]]:
    """The recording with NaN for torques that do not measure their joint, and the findings about all channels."""
    findings = channel_findings(recording)
    dead = {f"tau_{j + 1}": np.full(len(recording.t), np.nan) for j in dead_joints(findings)}
    return (replace(recording, columns={**recording.columns, **dead}) if dead else recording), findings


def _described(filters: CutoffChoice) -> dict[str, Any]:
    return {"band": filters.band, "held_out_percent": {f"{c:g} Hz": 100.0 * e for c, e in filters.errors.items()},
            "limit": filters.limit}


def _errors(budgets: Sequence[ErrorBudget]) -> dict[str, Any]:
    """The error budget in words of the model file: the largest of the recordings, and the typical effect."""
    return {"step": np.max([b.step for b in budgets], axis=0).tolist(),
            "noise": np.max([b.noise for b in budgets], axis=0).tolist(),
            "jitter": max(b.jitter for b in budgets),
            "velocity": np.median(np.concatenate([b.velocity for b in budgets]), axis=0).tolist(),
            "acceleration": np.median(np.concatenate([b.acceleration for b in budgets]), axis=0).tolist()}
