"""Conventional identification: inverse dynamic model and weighted least squares over whole motions ([J] 3).

Friction, rigid body, rotor inertias and offsets are found together. Nominal inertias of the URDF are used only where
the data say nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.dynamics import (
    BaseParameters,
    base_parameters,
    full_regressor,
    link_parameters,
    torques,
    with_link_parameters,
)
from ideal_robot.dynamics.consistency import Consistency, consistent_parameters, parameter_scales
from ideal_robot.errors import InputError
from ideal_robot.friction import Asymmetric, FrictionModel, PerJointFriction, law_of
from ideal_robot.identification.checks import checked
from ideal_robot.identification.excitation_warnings import excitation_warnings
from ideal_robot.identification.friction_choice import AUTO, FrictionChoice, braking, candidates, with_coefficients
from ideal_robot.identification.weighted_least_squares import Solution, weighted_least_squares
from ideal_robot.model.model import Model
from ideal_robot.model.parametrisation import shape_columns
from ideal_robot.model.prediction import Prediction
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.preprocess import FilteredSignals, chosen_cutoff, preprocess, resampled, uniform_time
from ideal_robot.signals.recording import Recording


@dataclass(frozen=True)
class Identification:
    """What identification returns.

    Attributes:
        model: the identified model.
        solution: the final least-squares solution and its statistics.
        estimation: prediction of each estimation recording.
        validation: prediction of each validation recording.
        friction_scores: per joint, held-out residual of each friction law tried, in units of the noise.
        consistency: how far the physically possible parameters are from the identified ones.
        warnings: named warnings, each ``name: sentence``.
        recordings, unseen: the estimation and validation recordings as they were used, torque in N m.
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


def identify(recordings: Sequence[Recording], robot: Robot, *, validation: Sequence[Recording] = (),
             friction: str = "auto", cutoff: float | None = None,
             cutoff_decimation: float | None = None) -> Identification:
    """Identifies a dynamic model from recordings of free motion.

    Args:
        recordings: with ``t``, ``q_i`` and ``tau_i`` or ``current_i``.
        robot: kinematics, nominal inertias, limits, drive gains.
        validation: recordings the model is compared with and never fitted to.
        friction: key of a friction law for all joints, taken as it is; ``auto`` chooses law and refinements per joint
            by the error on held-back stretches of the estimation recordings.
        cutoff: of the position filter [Hz]; chosen from the data if None.
        cutoff_decimation: of the decimation filter [Hz]; chosen from the data if None.

    Raises:
        InputError: recordings that cannot be used, and why.
    """
    if not recordings:
        raise InputError("no recording given", field="recordings")
    usable, warnings = checked(recordings, robot)
    unseen, more = checked(validation, robot) if validation else ([], [])
    warnings += [f"{text} (validation)" for text in more]
    if cutoff is None:
        cutoff = float(np.median([_cutoff_of(recording) for recording in usable]))
    signals = [preprocess(r, cutoff=cutoff, cutoff_decimation=cutoff_decimation) for r in usable]

    base = base_parameters(robot.pinocchio)
    independent = list(base.independent)
    W = np.concatenate([s.decimate_of(lambda rows, s=s: full_regressor(  # type: ignore[misc]
        robot.pinocchio, s.q[rows], s.qd[rows], s.qdd[rows])[:, :, independent]) for s in signals])
    y = np.concatenate([s.decimate(s.tau) for s in signals])
    segments = np.concatenate([np.full(s.keep.sum(), i) for i, s in enumerate(signals)])
    nominal = np.concatenate([link_parameters(robot.pinocchio), robot.rotor_inertia, np.zeros(robot.n)])
    start = base.of(nominal)
    known = known_beforehand(base, nominal, y, signals, robot)

    laws, scores, load = _friction(signals, W, y, segments, base, nominal, robot, friction, known)
    for j, law in enumerate(laws):
        if isinstance(law, Asymmetric):
            # An offset is the difference of the two dry frictions; the law has it, so it is no parameter of its own.
            W[:, :, base.names.index(f"offset_{j + 1}")] = 0.0
    joined = np.concatenate([W, _friction_columns(signals, laws, load)], axis=2)
    nonnegative = np.concatenate([np.zeros(base.count, dtype=bool), *[braking(law) for law in laws]])
    solution = weighted_least_squares(joined, y, np.concatenate([start, np.zeros(joined.shape[2] - base.count)]),
                                      segments=segments, information=_padded(known, joined.shape[2]),
                                      nonnegative=nonnegative)
    fitted = with_coefficients(laws, solution.value[base.count :])
    solution = _with_shape(solution, joined, signals, fitted, load, segments, known)
    values = solution.value[: base.count]
    consistency = consistent_parameters(base, values, solution.covariance[: base.count, : base.count], nominal)
    model = Model(
        robot.name, robot.urdf.read_text(encoding="utf-8"), robot.urdf_hash, base, values, fitted, solution.covariance,
        consistency.full, solution.noise_std,
        provenance={
            "method": "joint",
            "recordings": [{"source": r.source, "hash": r.hash} for r in usable],
            "filters": {"cutoff": cutoff, "cutoff_decimation": signals[0].cutoff_decimation},
            "condition_number": solution.condition_number,
        },
    )
    warnings += excitation_warnings(model, solution)
    estimation = tuple(model.predict(r) for r in usable)
    held_out = tuple(model.predict(r) for r in unseen)
    model = replace(model, provenance={**model.provenance, "warnings": warnings, "relative_error_percent": {
        "estimation": relative_error(estimation).tolist(),
        "validation": relative_error(held_out).tolist() if held_out else []}})
    return Identification(model, solution, estimation, held_out, tuple(scores), consistency, tuple(warnings),
                          tuple(usable), tuple(unseen))


def relative_error(predictions: Sequence[Prediction]) -> Array:
    """``100 ‖y - ŷ‖ / ‖y‖`` per joint over several recordings ``(n,)`` [%]."""
    y = np.concatenate([p.measured for p in predictions])
    e = y - np.concatenate([p.tau for p in predictions])
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(100.0 * np.linalg.norm(e, axis=0) / np.linalg.norm(y, axis=0))


def _cutoff_of(recording: Recording) -> float:
    grid, _ = uniform_time(recording)
    return chosen_cutoff(resampled(recording.t, recording.joints("q"), grid, smooth=True), float(grid[1] - grid[0]))


def _friction(signals: Sequence[FilteredSignals], W: Array, y: Array, segments: Array, base: BaseParameters,
              nominal: Array, robot: Robot, wanted: str, known: Array,
              ) -> tuple[list[FrictionModel], list[dict[str, float]], list[Array]]:
    """Friction laws with their shape, the scores of those tried, and the load they look at."""
    options = candidates(AUTO, refine=True) if wanted == "auto" else candidates([law_of(wanted)], refine=False)
    simple = candidates([law_of("viscous_coulomb")], refine=False)[0]
    first = [simple.make(()) for _ in range(robot.n)]
    none = [np.zeros_like(s.q) for s in signals]
    columns = _friction_columns(signals, first, none)
    rough = weighted_least_squares(np.concatenate([W, columns], axis=2), y,
                                   np.concatenate([base.of(nominal), np.zeros(columns.shape[2])]), segments=segments,
                                   information=_padded(known, base.count + columns.shape[2]))
    if len(options) == 1 and not options[0].bounds:
        return [options[0].make(()) for _ in range(robot.n)], [{} for _ in range(robot.n)], none
    full = base.nearest_full(rough.value[: base.count], nominal)
    links = with_link_parameters(robot.pinocchio, full[: 10 * robot.n])
    load = [torques(links, s.q, s.qd, s.qdd) for s in signals]
    choice = FrictionChoice(signals, W, y - W @ base.of(nominal), load, rough.noise_std, known)
    laws, scores = choice.choose(options)
    return laws, scores, load


def _friction_columns(signals: Sequence[FilteredSignals], laws: Sequence[FrictionModel],
                      load: Sequence[Array]) -> Array:
    """Decimated regressor of all joints' friction coefficients ``(M, n, Σm)``."""
    n, total = len(laws), sum(len(law.coefficients) for law in laws)
    parts = []
    for s, load_s in zip(signals, load, strict=True):
        block, at = np.zeros((int(s.keep.sum()), n, total)), 0
        for j, law in enumerate(laws):
            span = slice(at, at + len(law.coefficients))
            block[:, j, span] = s.decimate(law.regressor(s.qd[:, [j]], load_s[:, [j]], s.q[:, [j]])[:, 0])
            at = span.stop
        parts.append(block)
    return np.concatenate(parts)


def _with_shape(solution: Solution, W: Array, signals: Sequence[FilteredSignals], friction: PerJointFriction,
                load: Sequence[Array], segments: Array, known: Array) -> Solution:
    """The solution with the shape parameters' share of the covariance, by linearisation about the optimum."""
    shape = np.concatenate([law.shape[:, 0] for law in friction.laws])
    if not len(shape):
        return solution
    parts = []
    for s, load_s in zip(signals, load, strict=True):
        block, at = np.zeros((int(s.keep.sum()), W.shape[1], len(shape))), 0
        for j, law in enumerate(friction.laws):
            span = slice(at, at + len(law.shape))
            block[:, j, span] = s.decimate(shape_columns(law, s.qd[:, [j]], load_s[:, [j]], s.q[:, [j]]))
            at = span.stop
        parts.append(block)
    joined = np.concatenate([W, np.concatenate(parts)], axis=2)
    # At the optimum the linearised problem has the residual for its measurement and no step as its solution.
    joined[:, :, : W.shape[2]][:, :, solution.at_bound] = 0.0
    linear = weighted_least_squares(joined, solution.residual, np.zeros(joined.shape[2]), segments=segments,
                                    information=_padded(known, joined.shape[2]))
    return replace(linear, value=np.concatenate([solution.value, shape]), residual=solution.residual,
                   condition_number=solution.condition_number,
                   condition_number_scaled=solution.condition_number_scaled,
                   unexcited=np.concatenate([solution.unexcited, np.zeros(len(shape), dtype=bool)]),
                   at_bound=np.concatenate([solution.at_bound, np.zeros(len(shape), dtype=bool)]))


def known_beforehand(base: BaseParameters, nominal: Array, y: Array, signals, robot: Robot) -> Array:
    """What is known of the base parameters before any data, as an inverse covariance ``(b, b)``.

    Link parameters are nominal to their own size, offsets zero to a fifth of the torque that was measured. A motion
    that excites is not moved by it; what a motion leaves open is not filled with noise.
    """
    n = len(nominal) // 12
    scale = parameter_scales(nominal, n)
    import os
    scale *= float(os.environ.get("PRIOR", "1"))
    acceleration = np.std(np.concatenate([s.decimate(s.qdd) for s in signals]), axis=0)
    torque = np.maximum(np.nan_to_num(np.std(y, axis=0)), 1e-6)
    scale[10 * n : 11 * n] = np.maximum(scale[10 * n : 11 * n], torque / np.maximum(acceleration, 1e-6))
    scale[11 * n :] = float(os.environ.get("OFFS","0.2")) * torque
    return np.asarray(np.linalg.pinv((base.grouping * scale**2) @ base.grouping.T, hermitian=True))


def _padded(information: Array, size: int) -> Array:
    padded = np.zeros((size, size))
    padded[: len(information), : len(information)] = information
    return padded
