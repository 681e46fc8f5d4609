"""Which of a diagnosis' findings go into the loop: those that lower the path error that this arm measures.

Torque prediction alone does not decide: a stiffness that explains the currents a little better can bend the path by
millimetres. A candidate is first played on the identified loop, which has to explain more of the last play with it, and
then on the arm; what does not lower the measured error is taken back. The ladder of trials with the reason of every
refusal is the report's first table.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.diagnosis import Diagnosis
from ideal_robot.effects import FittedEffect
from ideal_robot.elasticity.observer import GearDeflection
from ideal_robot.errors import IdealRobotError
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from scenes.measured import Measured, visible
from scenes.methods import IDEAL
from scenes.metrics import path_errors
from scenes.path.candidates import Candidate, Refusal, candidates
from scenes.path.cell import PathCell
from scenes.path.foreseen import left_unexplained
from scenes.path.result import Play
from scenes.scene_files.path_scene import JointPath

_LEAST, _LEAST_FALL = 0.95, 3e-6
"""An error that falls by less than a twentieth, or by less than 3 µm, has not fallen: so much worse a path still counts
as no worse, and no arm repeats it to better than that from one day to the next."""
_LEAST_OF_REFIT = 0.75
"""Nor, where nothing but friction known before was fitted anew, by less than a quarter: of a healthy arm, too, it
differs between two recordings, with the temperature at the least."""
_NO_LESS = 1.01
"""A hundredth more left on the identified loop says nothing against a change: what gears carry hardly shows there."""
_DOUBT_OF_GEARS = 0.3
"""Share by which the give of gears may be wrong that no device on the arm's side has shown: a gear is softer under
small loads than under large ones, by about so much from end to end of its catalogue's stiffness, and motor angles show
nothing of it. What a load's own standard deviation leaves open comes on top."""
_SIGMAS = 2.0


@dataclass(frozen=True)
class Step:
    """One trial of a change of the model.

    Attributes:
        round: of run and diagnosis, from 1.
        tried: what was changed.
        taken: whether it stays.
        refused: why it does not; empty where it does.
        error: measured E_car, aligned, with it [m]; NaN where it was not played.
    """

    round: int
    tried: str
    taken: bool
    refused: str
    error: float


def measured_error(played: Play, path: JointPath, robot: Robot, known: Model, measured: Measured,
                   effects: tuple[FittedEffect, ...] = (), doubt: float = 0.0) -> float:
    """Path error ``E_car``, aligned, as this arm measures it [m].

    Motor angles are brought behind the gears by what was known of these before, so that a changed stiffness cannot
    confirm itself; what the gears carry, which currents show, counts.

    Args:
        played: the play.
        path: what was wanted.
        robot: kinematics.
        known: the model of before.
        measured: what is measured.
        effects: of the model that is tried, those of before first.
        doubt: share by which what these loads bend is taken to be more.
    """
    recording = played.recording
    if measured == "tcp":
        x: Array = np.column_stack([recording.columns[axis] for axis in "xyz"])
    else:
        q = recording.joints("qa" if measured == "arm" else "q")
        if measured == "motor":
            bent = _deflections(known, path, recording.t)
            loads = carried(effects[len(known.effects):])
            if loads:
                more = _deflections(known.with_effects(loads), path, recording.t) - bent
                bent = bent + (1.0 + doubt) * more
            q = q - bent
        pose = robot.fk()
        x = np.array([pose(row).translation for row in q])
    return path_errors(path.t[path.counts], path.x_d[path.counts], recording.t, x).aligned.E_car


class _Ladder:
    """The model as far as it was taken, the play with it, and every trial.

    Args:
        cell: path, arm and present model.
        present: the play with that model.
        known: the model of before the first round.
        measured: what the arm measures.
        round_: of run and diagnosis, from 1.
    """

    def __init__(self, cell: PathCell, present: Play, known: Model, measured: Measured, round_: int) -> None:
        self.cell, self.present, self.steps = cell, present, list[Step]()
        self._known, self._measured, self._round = known, measured, round_

    @property
    def model(self) -> Model:
        """As it is now."""
        return self.cell.model

    def refused(self, refusal: Refusal) -> None:
        """Notes what is not tried at all."""
        self.steps.append(Step(self._round, refusal.label, False, refusal.reason, float("nan")))

    def climb(self, forms: tuple[Candidate, ...]) -> bool:
        """Tries the forms of one change, the one first with which the identified loop explains most; whether one stays.

        Args:
            forms: of which one may be taken.
        """
        label, models = forms[0].label, [one.change(self.model) for one in forms]
        before = self._left(self.model)
        left = [self._left(model) for model in models]
        order = [int(k) for k in np.argsort(left)]
        if forms[0].shows_in_loop:
            order = [k for k in order if left[k] < _NO_LESS * before]
            if not order:
                return self._note(label, f"played on the identified loop it explains no more of the run: "
                                         f"{1e3 * before:.3g} to {1e3 * min(left):.3g} mm are left")
        return any(self._played(forms[k].label, models[k]) for k in order)

    def _left(self, model: Model) -> float:
        """Of the last play, unexplained [m]; infinite for a loop that cannot be."""
        try:
            return left_unexplained(self.cell, model, self.present, self._measured)
        except IdealRobotError:
            return float("inf")

    def _played(self, label: str, model: Model) -> bool:
        tried = dataclasses.replace(self.cell, model=model)
        try:
            played = tried.play(tried.feedforward(IDEAL))
            pairs = [self._errors(played, model, doubt) for doubt in self._doubts(model)]
        except IdealRobotError as failed:
            return self._note(label, f"cannot be played: {failed}")
        # Whatever is doubtful about what is not measured, the error has to fall.
        reached, present = max(pairs, key=lambda pair: pair[0] / pair[1])
        adds = len(model.effects) > len(self.model.effects)
        if reached >= min((_LEAST if adds else _LEAST_OF_REFIT) * present, present - _LEAST_FALL):
            return self._note(label, f"the path error does not fall: {1e3 * present:.3g} to {1e3 * reached:.3g} mm",
                              reached)
        self.cell, self.present = tried, played
        self.steps.append(Step(self._round, label, True, "", pairs[0][0]))
        return True

    def _errors(self, played: Play, model: Model, doubt: float) -> tuple[float, float]:
        """With the model and at present, both with the same idea of what the gears carry."""
        reached, present = (measured_error(one, self.cell.path, self.cell.robot, self._known, self._measured,
                                           model.effects, doubt) for one in (played, self.present))
        return reached, present

    def _doubts(self, model: Model) -> tuple[float, ...]:
        loads = self._measured == "motor" and carried(model.effects[len(self._known.effects):])
        if not loads:
            return (0.0,)
        doubt = min(float(np.hypot(_DOUBT_OF_GEARS, max(doubt_of_load(one) for one in loads))), 1.0)
        return (0.0, doubt, -doubt)

    def _note(self, label: str, reason: str, error: float = float("nan")) -> bool:
        self.steps.append(Step(self._round, label, False, reason, error))
        return False


def adopt_on_path(cell: PathCell, found: Diagnosis, moved: Recording, before: Play, known: Model, measured: Measured,
                  round_: int) -> tuple[Model, Play, tuple[Step, ...]]:
    """The cell's model with those findings that lower the measured path error, the play with it, and the trials.

    First everything together, then joint by joint, each on top of what was taken.

    Args:
        cell: path, arm and present model.
        found: what the diagnosis found with that model.
        moved: the recording it was found in.
        before: the play with that model.
        known: the model of before the first round.
        measured: what the arm measures.
        round_: of run and diagnosis, from 1.
    """
    ladder = _Ladder(cell, before, known, measured, round_)
    whole, apart, refused = candidates(cell.model, found, moved, visible(before.recording, measured), cell.robot,
                                       measured)
    for one in refused:
        ladder.refused(one)
    taken = bool(whole) and ladder.climb(whole)
    at_tool = [forms for forms in apart if forms[0].at_tool]
    together = at_tool and ladder.climb(_joined(at_tool)) if len(at_tool) > 1 else False
    for forms in apart:
        # Behind what was taken together only the tool is left to be looked at.
        if not (together if forms[0].at_tool else taken):
            ladder.climb(forms)
    return ladder.model, ladder.present, tuple(ladder.steps)


def _joined(several: list[tuple[Candidate, ...]]) -> tuple[Candidate, ...]:
    effects = tuple(effect for forms in several for effect in forms[0].effects)
    return (Candidate.adding("all that the tool shows", effects),)


def carried(effects: tuple[FittedEffect, ...]) -> tuple[FittedEffect, ...]:
    """Those that change what the gears carry."""
    changes = [(effect, effect.effect.loop_change(effect.coefficients, effect.theta)) for effect in effects]
    return tuple(effect for effect, change in changes if change.body or change.gravity is not None)


def doubt_of_load(effect: FittedEffect) -> float:
    """Share by which what an effect puts on the gears may be wrong, by its own standard deviation."""
    # Of a body its mass stands for all of it, and of gravity its two components: moments have other units.
    change = effect.effect.loop_change(effect.coefficients, effect.theta)
    count = 1 if change.body else 2 if change.gravity is not None else len(effect.coefficients)
    size = float(np.linalg.norm(effect.coefficients[:count]))
    return _SIGMAS * float(np.linalg.norm(effect.std[:count])) / max(size, 1e-300)


def _deflections(model: Model, path: JointPath, t: Array) -> Array:
    """Deflection of the gears at times ``(M,)`` [s] along a path ``(M, n)`` [rad], as a model expects it."""
    gears = GearDeflection(model, float(path.t[1] - path.t[0]))
    at_cycles = gears.along(np.concatenate([path.q_d[:1], path.q_d, path.q_d[-1:]]))[1:-1]
    return np.column_stack([np.interp(t, path.t, column) for column in at_cycles.T])
