"""The diagnosis: residual, search, extended model, and errors before and after on data that took no part."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from ideal_robot.diagnosis.candidates import Candidate
from ideal_robot.diagnosis.estimate import Estimate, estimate, fitted_effect
from ideal_robot.diagnosis.evidence import ranked_structure, would_tell
from ideal_robot.diagnosis.experiment import Experiment, experiment
from ideal_robot.diagnosis.gram import Blocks, Data, time_blocks
from ideal_robot.diagnosis.rebase import with_parameters
from ideal_robot.diagnosis.regression import Design, Fit, channel_weights
from ideal_robot.diagnosis.result import ChannelResult, Diagnosis, FoundEffect, Traces
from ideal_robot.diagnosis.reversal import fitted_blur
from ideal_robot.diagnosis.search import Choice, Options, Progress, Search
from ideal_robot.effects import MOTOR_TORQUE, FittedEffect, library
from ideal_robot.identification.checks import checked
from ideal_robot.interface import Array
from ideal_robot.model import Model
from ideal_robot.recording import Recording
from ideal_robot.robot import Robot


def diagnose(recording: Recording, robot: Robot, *, model: Model | None = None, validate: Recording | None = None,
             options: Options | None = None, seed: int = 0, progress: Progress | None = None) -> Diagnosis:
    """Says which physical effect a model misses in a recording, in which joint, and what it is worth.

    Args:
        recording: what was measured.
        robot: the arm it was measured on.
        model: what was known before; without it a rigid body with Coulomb and viscous friction, rotors and offsets is
            identified from the recording first.
        validate: another recording of the same arm on which errors are reported; without it every fourth block of
            time of ``recording`` is kept apart for that.
        options: thresholds.
        seed: of the null distributions.
        progress: called with the share done and a word.

    Raises:
        InputError: a recording that cannot be used, or a model of another arm.
    """
    options = options or Options()
    report: Progress = progress or (lambda share, word: None)
    rng = np.random.default_rng(seed)
    report(0.0, "reading")
    # Torques made of currents without known gains are in amperes: then joints must not share inertias.
    amperes = not recording.has("tau") and bool(np.all(robot.drive_gain == 1.0)) and robot.n > 1
    (recording,), warnings = checked([recording], robot)
    if validate is not None:
        (validate,), more = checked([validate], robot)
        warnings += more
    shared = model is not None or not amperes
    return TorqueDiagnosis(recording, robot, model, validate, options, rng, report, warnings, shared).run()


class TorqueDiagnosis:
    """The diagnosis of the motor torques; see ``diagnose`` for the arguments."""

    def __init__(self, recording: Recording, robot: Robot, model: Model | None, validate: Recording | None,
                 options: Options, rng: np.random.Generator, report: Progress, warnings: list[str],
                 shared: bool) -> None:
        self.robot, self.options, self.rng, self.report, self.warnings = robot, options, rng, report, warnings
        self.recording, self.validate = recording, validate
        self.given = model
        self.blur: Array | None = None
        self.shared = shared
        self.start = model if model is not None else Model.nominal(robot)

    def run(self) -> Diagnosis:
        """All steps in order."""
        self.report(0.05, "model")
        raw = experiment(self.recording, self.robot, self.start, shared=self.shared)
        if len(raw.undecided) == self.robot.n:
            return self._undecided(raw)
        blocks = time_blocks(len(raw.t), float(raw.t[1] - raw.t[0]), held_out=self.validate is None)
        every = Blocks(blocks.edges, np.zeros(blocks.count, dtype=int), 0)
        self.blur = fitted_blur(raw, Data(raw.y, raw.W, raw.use, blocks))
        raw = self._experiment(self.recording, self.start)
        if self.given is None and self.shared:
            first = estimate(raw, Data(raw.y, raw.W, raw.use, blocks), [], None, spread=False)
            self.start = with_parameters(self.start, first.change)
            raw = self._experiment(self.recording, self.start)
        data = Data(raw.y, raw.W, raw.use, blocks)
        choices, prior = self._search(raw, data)
        self.report(0.92, "fit")
        # The columns of some effects follow from the model; with the effects in it they are taken once more.
        if choices and self.shared:
            found = estimate(raw, data, [c.candidate for c in choices], prior, spread=False)
            raw = self._about(raw, found.change)
            data = Data(raw.y, raw.W, raw.use, blocks)
        final = estimate(raw, Data(raw.y, raw.W, raw.use, every), [c.candidate for c in choices], prior)
        return self._reported(raw, data, choices, prior, final)

    # -- steps -------------------------------------------------------------------------------------------------------

    def _experiment(self, recording: Recording, model: Model, cutoff: float | None = None) -> Experiment:
        made = experiment(recording, self.robot, model, cutoff=cutoff, shared=self.shared, blur=self.blur)
        return made if self.shared else in_own_units(made)

    def _search(self, raw: Experiment, data: Data) -> tuple[list[Choice], Array | None]:
        effects = tuple(effect for effect in library() if effect.domain == MOTOR_TORQUE)

        def search(prior: Array | None, in_base: bool) -> Search:
            return Search(raw, data, effects, prior=prior, in_base=in_base, options=self.options, rng=self.rng,
                          progress=self.report)

        free = search(None, False)
        free.run()
        covariance = self.start.covariance
        if self.given is None or not np.any(covariance):
            return free.choices, None
        # Against a model known before: its parameters hold unless the data say that they have changed, and then the
        # change itself is an effect.
        prior = prior_precision(self.start, raw, data)
        held = search(1e4 * prior, True)
        held.run()
        if self._loss(held) < 1.1 * self._loss(free):
            return held.choices, prior
        self.warnings.append("the model's parameters do not hold for this recording and were fitted anew; changes of "
                             "parameters are therefore not listed as effects")
        return free.choices, None

    @staticmethod
    def _loss(search: Search) -> float:
        fit = search.fit()
        selecting = search.data.blocks.fold >= 0
        squares, count = fit.held_out_squares()[selecting].sum(axis=0), search.data.count[selecting].sum(axis=0)
        kept = count > 0
        return float(np.exp(np.mean(np.log(np.maximum(squares[kept], 1e-300) / count[kept]))))

    def _about(self, raw: Experiment, change: Array) -> Experiment:
        """The same regression with load and torque of the model as the joint fit leaves it."""
        moved = self._experiment(self.recording, with_parameters(self.start, change))
        return dataclasses.replace(raw, signals=moved.signals)

    def _undecided(self, raw: Experiment) -> Diagnosis:
        rms = _rms(raw.y, raw.use, np.ones(len(raw.t), bool))
        signal = _rms(raw.measured, raw.use, np.ones(len(raw.t), bool))
        channels = tuple(ChannelResult(name, unit, float(rms[j]), float(rms[j]), float(rms[j]), float(raw.quiet[j]),
                                       float(signal[j]))
                         for j, (name, unit) in enumerate(zip(raw.channels, raw.units, strict=True)))
        return Diagnosis("undecided", channels, (), (), "nothing: no joint moves enough to decide anything", 0.0,
                         raw.undecided, warnings=tuple(self.warnings), model=self.given)

    # -- report ------------------------------------------------------------------------------------------------------

    def _reported(self, raw: Experiment, data: Data, choices: list[Choice], prior: Array | None,
                  final: Estimate) -> Diagnosis:
        self.report(0.95, "held-out errors")
        steps = [estimate(raw, data, [c.candidate for c in choices[:k]], prior, spread=False)
                 for k in range(len(choices) + 1)]
        if self.validate is not None:
            seen = self._experiment(self.validate, self.start, raw.filtered.cutoff)
            if choices and self.shared:
                moved = self._experiment(self.validate, with_parameters(self.start, steps[-1].change),
                                         raw.filtered.cutoff)
                seen = dataclasses.replace(seen, signals=moved.signals)
            where = np.ones(len(seen.t), bool)
            how = f"parameters and selection from {_name(self.recording)}, errors on {_name(self.validate)}"
        else:
            seen = raw
            where = data.blocks.fold[data.blocks.of_samples()] < 0
            how = (f"every fourth of {data.blocks.count} blocks of time of {_name(self.recording)}, which neither "
                   "selection nor estimation saw")
        residuals = [predicted(seen, s, [c.candidate for c in choices[:k]]) for k, s in enumerate(steps)]
        before = seen.y if self.given is not None else residuals[0]
        rms = [_rms(r, seen.use, where) for r in residuals]
        rms_before, signal = _rms(before, seen.use, where), _rms(seen.measured, seen.use, where)
        channels = tuple(ChannelResult(name, unit, float(rms_before[j]), float(rms[0][j]), float(rms[-1][j]),
                                       float(seen.quiet[j]), float(signal[j]))
                         for j, (name, unit) in enumerate(zip(seen.channels, seen.units, strict=True)))
        found = [self._found(k, choice, final, rms, seen) for k, choice in enumerate(choices)]
        effects = tuple(f for f in found if f.fitted.name != "unknown")
        unknown = tuple(f for f in found if f.fitted.name == "unknown")
        verdict = "unknown" if unknown else ("effects" if effects else "none")
        # Dependences are looked for in the recording itself, where the fit is at home.
        own = predicted(raw, steps[-1], [c.candidate for c in choices])
        start = raw.y if self.given is not None else predicted(raw, steps[0], [])
        return Diagnosis(verdict, channels, effects, unknown, how, float(where.sum() * (seen.t[1] - seen.t[0])),
                         raw.undecided, ranked_structure(raw, data, start, self.rng),
                         ranked_structure(raw, data, own, self.rng), tuple(self.warnings),
                         self._extended(final, found),
                         (_traces(seen, before, residuals[-1], where, choices, steps[-1]),))

    def _found(self, k: int, choice: Choice, final: Estimate, rms: Sequence[Array], seen: Experiment) -> FoundEffect:
        candidate = choice.candidate
        j = candidate.joint - 1 if candidate.joint else int(np.argmax((rms[k] - rms[k + 1]) / (rms[k] + 1e-300)))
        rivals = tuple(dict.fromkeys(name for name, joint, _ in choice.rivals if name != candidate.effect.name))
        transfers = None if self.validate is None else bool(rms[k + 1][j] < rms[k][j])
        prismatic = seen.units[j] == "N"
        evidence = {"p_value": choice.p_value, "rms_before": rms[k][j], "rms_after": rms[k + 1][j],
                    "indistinguishable_from": list(rivals), "transfers": transfers,
                    "recording": self.recording.hash}
        fitted = fitted_effect(candidate, final.coefficients[k], final.std[k], final.theta_std[k], prismatic, evidence)
        names = tuple(choice.dependence.names) if choice.dependence is not None else ()
        return FoundEffect(fitted, float(rms[k][j]), float(rms[k + 1][j]), choice.p_value, rivals,
                           would_tell(candidate.effect.name, rivals), transfers, names)

    def _extended(self, final: Estimate, found: list[FoundEffect]) -> Model | None:
        if not self.shared:
            return None
        model = with_parameters(self.start, final.change, final.covariance)
        provenance = dict(model.provenance)
        provenance["diagnosis"] = {"recording": self.recording.source, "hash": self.recording.hash,
                                   "effects": [f.fitted.name for f in found]}
        effects: tuple[FittedEffect, ...] = tuple(f.fitted for f in found)
        return dataclasses.replace(model, effects=model.effects + effects, provenance=provenance)


def in_own_units(made: Experiment) -> Experiment:
    """Torque and load of the nominal model in the units of each joint's measurement, by one factor a joint."""
    nominal = made.decimate(made.signals.torque)
    factor = (nominal * made.measured).sum(axis=0) / np.maximum((nominal**2).sum(axis=0), 1e-300)
    signals = dataclasses.replace(made.signals, torque=made.signals.torque * factor, load=made.signals.load * factor,
                                  friction=made.signals.friction * factor, rigid=None)
    return dataclasses.replace(made, signals=signals, y=made.measured, units=("A",) * len(made.units))


def prior_precision(model: Model, raw: Experiment, data: Data) -> Array:
    """Precision of the model's parameters ``(P, P)``, in the units of the weighted squares.

    The model's own covariance, never taken for better than two percent of a parameter or than what moves a torque by
    a five-hundredth of its size; times the number of samples that count for one, as the residual is coloured.
    """
    design = Design(data)
    fit = Fit(design, ["W"], channel_weights(Fit(design, ["W"], np.ones(data.c)).squares(), data.count))
    selecting = data.blocks.fold >= 0
    squares = np.einsum("bcii->ci", design.cross("W", "W")[selecting])
    torque = (raw.measured**2 * data.use).sum(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        moves = 0.002 * np.sqrt(torque[:, None] / np.maximum(squares, 1e-300))
        visible = np.nanmin(np.where(squares > 0, moves, np.inf), axis=0)
    values = np.abs(np.concatenate([model.base_values, *[law.coefficients[:, 0] for law in model.friction.laws],
                                    *[law.shape[:, 0] for law in model.friction.laws]]))
    size = len(values)
    floor = np.where(np.isfinite(visible[:size]), np.hypot(0.02 * values, visible[:size]), 1.0)
    covariance = model.covariance + np.diag(floor**2)
    # Ratio of the parameters' actual scatter over blocks to that of white noise: the inflation by colour.
    plain = np.diag(fit._inverse[0])
    inflation = float(np.median(np.diag(fit.covariance()) / np.maximum(plain, 1e-300)))
    # Nuisances have no prior: they stay free.
    precision = np.zeros((data.W.m, data.W.m))
    precision[:size, :size] = max(inflation, 1.0) * np.linalg.pinv(covariance)
    return precision


def predicted(seen: Experiment, found: Estimate, chosen: list[Candidate]) -> Array:
    """Residual ``(N, c)`` of an experiment with the numbers of an estimate."""
    r = seen.y - seen.W @ found.change
    for candidate, coefficients in zip(chosen, found.coefficients, strict=True):
        r = r - seen.decimate(candidate.effect.columns(seen.signals, candidate.joint, candidate.theta) @ coefficients)
    return np.asarray(r)


def _rms(values: Array, use: np.ndarray, where: np.ndarray) -> Array:
    mask = use & where[:, None]
    return np.sqrt((values**2 * mask).sum(axis=0) / np.maximum(mask.sum(axis=0), 1))


def _name(recording: Recording) -> str:
    return str(recording.source).rsplit("/", 1)[-1]


def _traces(seen: Experiment, before: Array, after: Array, where: np.ndarray, choices: list[Choice],
            last: Estimate) -> tuple[tuple[str, ...], Traces]:
    at = seen.decimated_signals()
    added = tuple(seen.decimate(c.candidate.effect.columns(seen.signals, c.candidate.joint, c.candidate.theta) @ own)
                  for c, own in zip(choices, last.coefficients, strict=True))
    return seen.channels, Traces(seen.t, seen.measured, before, after, seen.use, where, at.q, at.qd, added)
