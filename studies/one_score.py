"""The diagnosis by one score, beside the diagnosis by rules, on the same recordings.

The score is the log density of the rows under one coloured noise a channel, the parameters integrated out, plus the log
prior of the set (``studies.best_set``). It is the motor torques' alone; beside a given model its parameters are taken
for those of the same arm or of another one of its type, whichever has the higher score.
"""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import Any

import numpy as np

from ideal_robot.diagnosis import Options, diagnose, stages
from ideal_robot.diagnosis.case import Case
from ideal_robot.effects import MOTOR_TORQUE, library
from ideal_robot.errors import IdealRobotError
from ideal_robot.identification.checks import checked
from ideal_robot.model.model import Model
from ideal_robot.progress import silent
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.sampling import shortened
from scenes.commands.common import numbers, whole_numbers
from studies.best_set.prior import hypotheses
from studies.best_set.search import BestSet
from studies.diagnoses import GAVE_UP, known_before
from studies.report import head, row
from studies.strangers.arm import robot_of
from studies.strangers.score import Score, score
from studies.strangers.trial import Trial, draw_trial


def best_set_of(trial: Trial, robot: Robot, model: Model | None) -> BestSet:
    """The search for the causes of the motor torques of a trial, which has run."""
    recording, _ = shortened(trial.recording)
    (recording,), _ = checked([recording], robot)
    case = Case(recording, robot, model, None, Options(), silent, shared=True, only=None)
    found = stages.baseline(case, stages.prepared(case, ()))
    effects = [effect for effect in library() if effect.domain == MOTOR_TORQUE]
    if model is None or not np.any(model.covariance):
        best = BestSet(found.problem, effects, absorbed=False)
        best.run()
        return best
    sets: list[tuple[float, int, BestSet]] = []
    for known in hypotheses(model, found.problem.regression):
        best = BestSet(found.problem.with_prior(known.precision), effects, absorbed=True)
        best.run()
        sets.append((best.total + known.logarithm, len(sets), best))
    return max(sets)[2]


def said_by_score(best: BestSet) -> Any:
    """The best set as ``studies.strangers.score`` takes an answer."""
    fitted = best.estimate().all_fitted(best.regression.prismatic)
    effects, unknown = ([SimpleNamespace(fitted=f) for f in fitted if f.effect.learned is learned]
                        for learned in (False, True))
    return SimpleNamespace(verdict="unknown" if unknown else "effects" if effects else "none", effects=effects,
                           unknown=unknown)


def one_score(seeds: str = "7310000-7310019", sizes: str = "0.5,5") -> None:
    """Strangers diagnosed by rules, and by one score over sets of causes, on the same recordings.

    Trials as in `strangers`, of 20 to 35 s and of kinds as they are drawn there; those whose cause shows in arm angles
    alone are left out, for the score looks at torques.
    """
    least, most = numbers(sizes, "--sizes")
    pairs: list[tuple[Score, Score]] = []
    for seed in whole_numbers(seeds, "--seeds"):
        try:
            trial = draw_trial(seed, size=(least, most), seconds=(20.0, 35.0))
        except RuntimeError as error:
            print(error, flush=True)
            continue
        if trial.kind == "arm":
            continue
        with robot_of(trial.urdf) as robot:
            pairs.append(_both(trial, robot))
        rules, own = pairs[-1]
        causes = [(c.name, c.joint, round(c.size, 1)) for c in trial.causes]
        print(f"{seed} {trial.engine:10s} {trial.kind:8s} {causes}: "
              f"rules {'ok' if rules.right else 'BAD'} {rules.said}, score {'ok' if own.right else 'BAD'} {own.said}",
              flush=True)
    _table(pairs)


def _both(trial: Trial, robot: Robot) -> tuple[Score, Score]:
    """The scores of both diagnoses of a trial."""
    model, results = known_before(trial, robot), []
    for answer in (lambda: diagnose(trial.recording, robot, model=model),
                   lambda: said_by_score(best_set_of(trial, robot, model))):
        start = time.process_time()
        try:
            results.append(score(trial, answer(), time.process_time() - start))
        except (IdealRobotError, ArithmeticError, ValueError) as error:
            print(f"{trial.seed}: {error}", flush=True)
            results.append(score(trial, GAVE_UP))
    return results[0], results[1]


def _table(pairs: list[tuple[Score, Score]]) -> None:
    head("figure", "recordings", "by rules", "by one score", "difference")

    def count(name: str, value: Any, some: list[tuple[Score, Score]]) -> None:
        own = np.array([[float(value(s)) for s in pair] for pair in some]).reshape(-1, 2)
        difference = own[:, 1] - own[:, 0]
        error = float(np.std(difference, ddof=1) * np.sqrt(len(difference))) if len(difference) > 1 else float("nan")
        rules, by_score = own.sum(axis=0)
        row(name, len(some), f"{rules:.0f}", f"{by_score:.0f}", f"{difference.sum():+.0f} ± {error:.1f}")

    count("right, and nothing else", lambda s: s.right, pairs)
    count("empty left alone", lambda s: s.right, [pair for pair in pairs if pair[0].kind in ("none", "known")])
    count("false names", lambda s: len(s.false), pairs)
    for name, k in (("rules", 0), ("one score", 1)):
        errors = np.array([error for pair in pairs for _, error in pair[k].covered])
        if len(errors):
            print(f"\n{name}: (estimate - truth)/sigma has an RMS of {np.sqrt(np.mean(errors**2)):.2f} and a median "
                  f"size of {np.median(np.abs(errors)):.2f} over {len(errors)} numbers; "
                  f"{np.mean([pair[k].seconds for pair in pairs]):.1f} s a diagnosis")
