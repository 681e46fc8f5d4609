"""The motion that a diagnosis asks for, played on the simulated arm and diagnosed in its turn."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from ideal_robot.diagnosis import Diagnosis, DiagnosisPlan, diagnose, open_questions, plan_diagnosis
from ideal_robot.errors import InputError
from ideal_robot.feedforward.base import PassThrough
from ideal_robot.signals.recording import Recording
from scenes.measured import Measured, visible
from scenes.path.cell import PathCell, about
from scenes.result import Progress, part_of, silent


@dataclass(frozen=True)
class AskedMotion:
    """What a diagnosis asked for, and what came of it.

    Attributes:
        round: of run and diagnosis, from 1.
        plan: pairs to be told apart and the motion; None where none lies within the limits.
        reason: why there is no motion; empty where there is one.
        recording, diagnosis: of the motion, where it was played.
    """

    round: int
    plan: DiagnosisPlan | None
    reason: str = ""
    recording: Recording | None = field(default=None, repr=False)
    diagnosis: Diagnosis | None = field(default=None, repr=False)

    def json(self) -> dict[str, Any]:
        """For ``--json``."""
        found = None if self.diagnosis is None else [
            {"effect": one.fitted.name, "joint": one.fitted.joint,
             "indistinguishable_from": list(one.indistinguishable_from)} for one in self.diagnosis.effects]
        return {"round": self.round, **({} if self.plan is None else self.plan.to_dict()),
                "played": self.recording is not None, "reason": self.reason or None, "found": found}

    def table(self) -> list[list[Any]]:
        """One row a pair: cause, rival, σ before and planned, whether the motion tells them."""
        return [] if self.plan is None else [
            [pair.cause, pair.rival or "none", pair.before.sigma, pair.planned.sigma,
             "yes" if pair.told_apart else pair.only] for pair in self.plan.pairs]


def asked_motion(cell: PathCell, found: Diagnosis, moved: Recording, measured: Measured, round_: int,
                 progress: Progress = silent) -> AskedMotion | None:
    """Plans, plays and diagnoses what a diagnosis asks for; None where it asks for nothing.

    Args:
        cell: path, arm and present model.
        found: what the diagnosis found with that model.
        moved: the recording it was found in.
        measured: what the arm measures.
        round_: of run and diagnosis, from 1.
        progress: called with the fraction done.
    """
    questions = open_questions(found)
    if not questions.asks:
        return None
    try:
        plan = plan_diagnosis(moved, cell.robot, questions, model=cell.model, seed=cell.seed,
                              progress=part_of(progress, 0.0, 0.5, "planned motion"))
    except InputError as error:
        return AskedMotion(round_, None, str(error))
    if not plan.useful:
        return AskedMotion(round_, plan, "no motion within the limits tells them apart")
    progress(0.5, "playing the planned motion")
    t_ipo = cell.world.t_ipo
    played = visible(cell.play(PassThrough(t_ipo), path=about(cell.path, plan.commands, t_ipo)).recording, measured)
    again = diagnose(played, cell.robot, model=cell.model, progress=part_of(progress, 0.6, 0.4, "planned motion"))
    return AskedMotion(round_, plan, "", played, again)
