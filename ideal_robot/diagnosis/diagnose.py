"""The diagnosis: residual, search, extended model, and errors before and after on data that took no part."""

from __future__ import annotations

import dataclasses

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.channels.arm import arm_experiment, tcp_experiment, with_equivalents
from ideal_robot.diagnosis.channels.force import blocks_of, force_experiments
from ideal_robot.diagnosis.channels.line import line_blocks, line_experiment
from ideal_robot.diagnosis.channels.motor_torque import Experiment, about, experiment, with_blur
from ideal_robot.diagnosis.channels.reversal import fitted_blur
from ideal_robot.diagnosis.search.choice import Choice, Options
from ideal_robot.diagnosis.search.forward_selection import Search
from ideal_robot.diagnosis.search.scoring import Progress
from ideal_robot.diagnosis.statistics.block_regression import Design, Fit, channel_weights
from ideal_robot.diagnosis.statistics.cross_products import Blocks, Data, time_blocks
from ideal_robot.diagnosis.statistics.estimate import Estimate, estimate
from ideal_robot.diagnosis.statistics.rebase import with_parameters
from ideal_robot.diagnosis.validation.part import Part, rms
from ideal_robot.diagnosis.validation.result import ChannelResult, Diagnosis, FoundEffect, NotTransferred
from ideal_robot.diagnosis.validation.transfer import transferring
from ideal_robot.effects import ARM_POSITION, MOTOR_TORQUE, SENSOR, TCP_POSITION, FittedEffect, library
from ideal_robot.identification.checks import checked
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording


def diagnose(recording: Recording, robot: Robot, *, model: Model | None = None, validate: Recording | None = None,
             options: Options | None = None, seed: int = 0, progress: Progress | None = None,
             only: tuple[tuple[str, int], ...] | None = None) -> Diagnosis:
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
        only: names and joints of the effects that may be looked for, for an oracle; then nothing is learned either.

    Raises:
        InputError: a recording that cannot be used, or a model of another arm.
    """
    options = options or Options()
    report: Progress = progress or (lambda share, word: None)
    rng = np.random.default_rng(seed)
    report(0.0, "reading")
    if model is not None:
        model.require_arm(robot)
    # Torques made of currents without known gains are in amperes: then joints must not share inertias.
    amperes = not recording.has("tau") and bool(np.all(robot.drive_gain == 1.0)) and robot.n > 1
    (recording,), warnings = checked([recording], robot)
    if validate is not None:
        (validate,), more = checked([validate], robot)
        warnings += more
    shared = model is not None or not amperes
    return TorqueDiagnosis(recording, robot, model, validate, options, rng, report, warnings, shared, only).run()


class TorqueDiagnosis:
    """The diagnosis of the motor torques; see ``diagnose`` for the arguments."""

    def __init__(self, recording: Recording, robot: Robot, model: Model | None, validate: Recording | None,
                 options: Options, rng: np.random.Generator, report: Progress, warnings: list[str],
                 shared: bool, only: tuple[tuple[str, int], ...] | None) -> None:
        self.robot, self.options, self.rng, self.report, self.warnings = robot, options, rng, report, warnings
        self.recording, self.validate, self.only = recording, validate, only
        self.given = model
        self.blur: Array | None = None
        self.shared = shared
        self.start = model if model is not None else Model.nominal(robot)

    def run(self) -> Diagnosis:
        """All steps in order."""
        self.report(0.05, "model")
        raw = self._experiment(self.recording, self.start)
        if len(raw.undecided) == self.robot.n:
            return self._undecided(raw)
        blocks = time_blocks(len(raw.t), float(raw.t[1] - raw.t[0]), held_out=self.validate is None)
        every = Blocks(blocks.edges, np.zeros(blocks.count, dtype=int), 0)
        if self.shared:
            self.blur = fitted_blur(raw, Data(raw.y, raw.W, raw.use, blocks), self.start)
            raw = with_blur(raw, self.start, self.blur)
        if self.given is None and self.shared:
            first = estimate(raw, Data(raw.y, raw.W, raw.use, blocks), [], None, spread=False)
            self.start = with_parameters(self.start, first.change)
            raw = about(raw, self.start)
        data = Data(raw.y, raw.W, raw.use, blocks)
        choices, prior = self._search(raw, data)
        self.report(0.92, "fit")
        # The columns of some effects follow from the model; with the effects in it they are taken once more.
        if choices and self.shared:
            found = estimate(raw, data, [c.candidate for c in choices], prior, spread=False)
            raw = dataclasses.replace(raw, signals=about(raw, with_parameters(self.start, found.change)).signals)
            data = Data(raw.y, raw.W, raw.use, blocks)
        seen = self._seen(raw, data, choices, prior)
        dropped: tuple[NotTransferred, ...] = ()
        if seen is not None:
            choices, dropped = transferring(raw, data, choices, prior, seen)
        final = estimate(raw, Data(raw.y, raw.W, raw.use, every), [c.candidate for c in choices], prior)
        torque = Part(raw, data, choices, prior, final, seen, self.given is not None, self.recording.hash)
        return self._reported(torque, dropped)

    # -- steps -------------------------------------------------------------------------------------------------------

    def _experiment(self, recording: Recording, model: Model, cutoff: float | None = None) -> Experiment:
        made = experiment(recording, self.robot, model, cutoff=cutoff, shared=self.shared, blur=self.blur,
                          payload=self.given is not None)
        return made if self.shared else in_own_units(made)

    def _search(self, raw: Experiment, data: Data) -> tuple[list[Choice], Array | None]:
        effects = tuple(effect for effect in library() if effect.domain == MOTOR_TORQUE)

        def search(prior: Array | None, absorbed: bool) -> Search:
            return Search(raw, data, effects, prior=prior, absorbed=absorbed, options=self.options, rng=self.rng,
                          progress=self.report, only=self.only)

        if self.given is None or not np.any(self.start.covariance):
            return search(None, False).run(), None
        # Against a model known before: its parameters hold unless the data say that they have changed, and then the
        # change itself is an effect.
        prior = prior_precision(self.start, raw, data)
        held = search(1e4 * prior, True)
        held.run()
        held.settle(prior)
        free = search(None, False)
        free.choices = [c for c in held.choices if not c.candidate.effect.absorbed_by_base]
        free.adopt(held)
        if self._loss(held) < 1.05 * self._loss(free):
            return held.choices, prior
        free.choices = []
        free.run()
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

    def _undecided(self, raw: Experiment) -> Diagnosis:
        everywhere = np.ones(len(raw.t), bool)
        levels = [rms(values, raw.use, everywhere) for values in (raw.y, raw.measured)]
        channels = tuple(ChannelResult(name, unit, float(levels[0][j]), float(levels[0][j]), float(levels[0][j]),
                                       float(raw.quiet[j]), float(levels[1][j]))
                         for j, (name, unit) in enumerate(zip(raw.channels, raw.units, strict=True)))
        return Diagnosis("undecided", channels, (), (), "nothing: no joint moves enough to decide anything", 0.0,
                         raw.undecided, warnings=tuple(self.warnings), model=self.given)

    # -- report ------------------------------------------------------------------------------------------------------

    def _seen(self, raw: Experiment, data: Data, choices: list[Choice], prior: Array | None) -> Experiment | None:
        """The regression of the validation recording, if there is one."""
        if self.validate is None:
            return None
        seen = self._experiment(self.validate, self.start, raw.filtered.cutoff)
        if choices and self.shared:
            change = estimate(raw, data, [c.candidate for c in choices], prior, spread=False).change
            seen = dataclasses.replace(seen, signals=about(seen, with_parameters(self.start, change)).signals)
        return seen

    def _reported(self, torque: Part, dropped: tuple[NotTransferred, ...]) -> Diagnosis:
        self.report(0.8, "held-out errors")
        raw = torque.raw
        parts = [torque, *self._other_domains(raw, torque.seen)]
        results = [part.result(self.rng) for part in parts]
        if self.validate is not None:
            how = (f"parameters and selection from {_name(self.recording)}; of {_name(self.validate)} every second "
                   "block of time decides what transfers, and the errors are those of the others")
        else:
            how = (f"every fourth of {torque.data.blocks.count} blocks of time of {_name(self.recording)}, which "
                   "neither selection nor estimation saw")
        found = [f for r in results for f in r.found]
        effects = tuple(f for f in found if f.fitted.name != "unknown")
        unknown = tuple(f for f in found if f.fitted.name == "unknown")
        verdict = "unknown" if unknown else ("effects" if effects else "none")
        return Diagnosis(verdict, tuple(c for r in results for c in r.channels), effects, unknown, how,
                         torque.held_out_seconds, raw.undecided, tuple(x for r in results for x in r.before),
                         tuple(x for r in results for x in r.remaining), tuple(self.warnings),
                         self._extended(torque.final, found), tuple(r.traces for r in results), dropped)

    def _other_domains(self, raw: Experiment, seen: Experiment | None) -> list[Part]:
        """Arm angles and TCP positions, where the recording has them."""
        parts = []
        for build, domain in ((arm_experiment, ARM_POSITION), (tcp_experiment, TCP_POSITION)):
            stiffness = None if self.given is None else self.given.stiffness
            made = build(self.recording, self.robot, raw, stiffness)
            if made is None:
                continue
            self.report(0.85, domain.name.replace("_", " "))
            other = None if seen is None or self.validate is None else build(self.validate, self.robot, seen, stiffness)
            blocks = time_blocks(len(made.t), float(made.t[1] - made.t[0]), held_out=other is None)
            data = Data(made.y, made.W, made.use, blocks)
            search = Search(made, data, tuple(e for e in library() if e.domain == domain), prior=None, absorbed=True,
                            options=self.options, rng=self.rng, progress=lambda share, word: None, only=self.only)
            choices = search.run()
            if domain == TCP_POSITION:
                choices = with_equivalents(made, data, choices)
            every = Blocks(blocks.edges, np.zeros(blocks.count, dtype=int), 0)
            final = estimate(made, Data(made.y, made.W, made.use, every), [c.candidate for c in choices], None)
            parts.append(Part(made, data, choices, None, final, other, True, self.recording.hash))
        stiffness = None if self.given is None else self.given.stiffness
        for made, other in force_experiments(self.recording, self.validate, self.robot, raw, seen, stiffness):
            self.report(0.88, "force sensor")
            parts.append(self._sensor_part(made, other, blocks_of(made, held_out=other is None)))
        # The curve of another recording's line would say nothing here.
        line = line_experiment(self.recording, self.robot, raw, stiffness)
        if line is not None:
            self.report(0.9, "line")
            parts.append(self._sensor_part(line, None, line_blocks(line, held_out=True)))
        return parts

    def _sensor_part(self, made: Experiment, other: Experiment | None, blocks: Blocks) -> Part:
        """What a sensor's regression shows; nothing is learned there."""
        effects = tuple(e for e in library() if e.domain == SENSOR)
        allowed = tuple((e.name, 0) for e in effects if self.only is None or (e.name, 0) in self.only)
        data = Data(made.y, made.W, made.use, blocks)
        choices = Search(made, data, effects, prior=None, absorbed=True, options=self.options, rng=self.rng,
                         progress=lambda share, word: None, only=allowed).run()
        every = Blocks(blocks.edges, np.zeros(blocks.count, dtype=int), 0)
        final = estimate(made, Data(made.y, made.W, made.use, every), [c.candidate for c in choices], None)
        return Part(made, data, choices, None, final, other, False, self.recording.hash)

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
        moves = 0.002 * np.sqrt(torque[:, None] / squares)
        visible = np.min(np.where(squares > 0, moves, np.inf), axis=0)
    values = np.abs(np.concatenate([model.base_values, *[law.coefficients[:, 0] for law in model.friction.laws],
                                    *[law.shape[:, 0] for law in model.friction.laws]]))
    size = len(values)
    floor = np.where(np.isfinite(visible[:size]), np.hypot(0.02 * values, visible[:size]), 1.0)
    covariance = model.covariance + np.diag(floor**2)
    # Ratio of the parameters' actual scatter over blocks to that of white noise: the inflation by colour.
    plain = np.diag(fit._inverse[0])
    inflation = float(np.median(np.diag(fit.covariance()) / np.maximum(plain, 1e-300)))
    return np.asarray(max(inflation, 1.0) * np.linalg.pinv(covariance))


def _name(recording: Recording) -> str:
    return str(recording.source).rsplit("/", 1)[-1]
