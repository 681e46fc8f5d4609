"""Plans the motion that distinguishes causes which the recording could not."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import reduce
from operator import add
from typing import Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.diagnosis import stages
from ideal_robot.diagnosis.case import Case, Findings, joints_share
from ideal_robot.diagnosis.channels.arm import position_regressions
from ideal_robot.diagnosis.channels.motor_torque import in_position_band
from ideal_robot.diagnosis.next_motion.motion import Foresight, MotionSearch
from ideal_robot.diagnosis.next_motion.questions import Causes, Open, undecided_joints
from ideal_robot.diagnosis.next_motion.separation import Pair, Products, Separation
from ideal_robot.diagnosis.prior import same_arm
from ideal_robot.diagnosis.statistics.problem import Problem
from ideal_robot.effects import ARM_POSITION, MOTOR_TORQUE, Domain, library
from ideal_robot.errors import InputError
from ideal_robot.estimate.score import CLEAR
from ideal_robot.identification.checks import checked
from ideal_robot.identification.excitation import Workspace
from ideal_robot.identification.program import require_within_limits
from ideal_robot.model.model import Model
from ideal_robot.progress import Progress, silent
from ideal_robot.results import Summarised, plain
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording

LONGEST = 30.0
"""Length of a motion [s], at most, unless asked otherwise."""
_BEHIND = ("no motion within the limits distinguishes them by what motors show; a device on the arm's side (qa_i or "
           "x y z) or a clamped flange ([J], ideal-robot stiffness) would")
_NOTHING = "no motion within the limits and this time distinguishes them"


@dataclass(frozen=True)
class PlannedPair:
    """One pair of causes, or a joint without one, and how well recording and planned motion distinguish it.

    Attributes:
        cause, rival: in words; the rival is empty for a joint that is to be decided.
        before, planned: by the recording's motion and by the planned one.
        only: what would distinguish them where the planned motion does not; empty where it does.
    """

    cause: str
    rival: str
    before: Separation
    planned: Separation
    only: str = ""

    @property
    def told_apart(self) -> bool:
        """Whether the planned motion is expected to distinguish them."""
        return self.planned.told_apart

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {"cause": self.cause, "rival": self.rival or None, "told_apart": self.told_apart,
                **{name: {"before": getattr(self.before, name), "planned": getattr(self.planned, name)}
                   for name in ("sigma", "own_share", "seen_share")}, "only": self.only or None}


@dataclass(frozen=True, repr=False)
class DiagnosisPlan(Summarised):
    """A motion that resolves the open questions of a diagnosis, with the expected separation.

    Attributes:
        pairs: the open questions.
        commands: ``(N, n)`` [rad] every ``t_ipo``, from rest to rest; empty where no motion helps or no question is
            open.
        t_ipo: interpolation cycle [s].
        not_asked: open questions that a motion of the joints cannot answer, with the reason.
        still_undecided: joints that move too little even then.
    """

    pairs: tuple[PlannedPair, ...]
    commands: Array = field(repr=False)
    t_ipo: float
    not_asked: tuple[str, ...] = ()
    still_undecided: tuple[int, ...] = ()

    def summary(self) -> list[tuple[str, str]]:
        """Rows of label and value: which pairs the motion distinguishes."""
        count = sum(pair.told_apart for pair in self.pairs)
        return [("motion", f"{self.seconds:.1f} s that tell {count} of {len(self.pairs)} pairs"),
                ("not asked", str(len(self.not_asked)))]

    @property
    def seconds(self) -> float:
        """Length of the motion [s]."""
        return len(self.commands) * self.t_ipo

    @property
    def useful(self) -> bool:
        """Whether the motion distinguishes a pair that the recording did not."""
        return len(self.commands) > 0 and any(pair.told_apart for pair in self.pairs)

    def path(self) -> Recording:
        """The motion as a recording: ``t``, ``q_d_i`` and the same as commands ``q_c_i``.

        Raises:
            InputError: there is none.
        """
        if not len(self.commands):
            raise InputError("there is no motion to write", field="motion")
        columns = {f"{name}_{i + 1}": self.commands[:, i].copy() for name in ("q_d", "q_c")
                   for i in range(self.commands.shape[1])}
        return Recording({"t": self.t_ipo * np.arange(float(len(self.commands))), **columns}, {}, "plan-diagnosis")

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return plain({
            "pairs": [pair.to_dict() for pair in self.pairs], "duration_s": self.seconds, "cycle_s": self.t_ipo,
            "samples": len(self.commands), "useful": self.useful, "not_asked": list(self.not_asked),
            "still_undecided": list(self.still_undecided)})


def plan_diagnosis(recording: Recording, robot: Robot, questions: Open, *, model: Model | None = None,
                   longest: float = LONGEST, workspace: Workspace | None = None, seed: int = 1,
                   progress: Progress = silent) -> DiagnosisPlan:
    """Plans the motion that best resolves the open questions of a diagnosis.

    Args:
        recording, robot, model: as ``diagnose`` was given them.
        questions: findings and open questions of the diagnosis (``open_questions``, ``read_questions``).
        longest: the motion may take [s].
        workspace: where tool and links may go; wherever the recording has been is added.
        seed: of the search.
        progress: called with the share done and a word.

    Raises:
        InputError: a recording that cannot be used, a model of another arm, no motion within limits.
    """
    if not 4.0 <= longest <= 600.0:
        raise InputError("expected 4 to 600 s", field="length", value=longest)
    if model is not None:
        model.require_arm(robot)
    shared = joints_share(recording, robot, model)
    (recording,), _ = checked([recording], robot)
    case = Case(recording, robot, model, None, silent, shared=shared, only=None)
    progress(0.02, "the recording")
    findings = stages.prepared(case, ())
    if findings.problem.regression.use.any():
        findings = stages.baseline(case, findings)
    problems = dict(_problems(case, findings))
    open_pairs, not_asked = _asked_of(questions, problems, robot)
    if not open_pairs:
        return DiagnosisPlan((), np.zeros((0, robot.n)), robot.t_ipo, not_asked)
    room = (workspace or Workspace.of(robot)).widened(robot, recording.joints("q"))
    foresight = Foresight(case, findings)
    q_c = _best_motion(open_pairs, foresight, room, longest, seed, progress)
    progress(0.95, "what it will tell")
    before = [pair.products(problems[pair.domain].regression) for pair in open_pairs]
    pairs = tuple(_planned_pair(pair, pair.separation(own), pair.separation(planned), recording)
                  for pair, own, planned in zip(open_pairs, before, _told(open_pairs, foresight, q_c), strict=True))
    still = foresight.regression(q_c, MOTOR_TORQUE).undecided
    return DiagnosisPlan(pairs, q_c, robot.t_ipo, not_asked,
                         tuple(joint for joint in questions.undecided if joint in still))


def _problems(case: Case, found: Findings) -> Iterator[tuple[Domain, Problem]]:
    """The domains in which a motion of the joints is informative, with the diagnosis' problem of each."""
    problem = found.problem
    torque = in_position_band(problem.regression, case.recording)
    if case.given is not None and np.any(found.start.covariance):
        problem = problem.with_root(same_arm(found.start))
    yield MOTOR_TORQUE, problem
    for regression in position_regressions(case.recording, case.robot, torque, case.stiffness):
        yield regression.domain, Problem(regression)


def _asked_of(questions: Open, problems: Mapping[Domain, Problem], robot: Robot) -> tuple[list[Pair], tuple[str, ...]]:
    """Pairs and joints that a motion may decide, and questions that no motion of the joints can answer."""
    open_pairs, not_asked = list[Pair](), list[str]()
    for problem in problems.values():
        pairs, mute = Causes(problem).pairs(questions)
        open_pairs += pairs
        not_asked += mute
    open_pairs += undecided_joints(problems[MOTOR_TORQUE], robot, questions.undecided)
    not_asked += [f"{c.name}: no motion of the joints by itself distinguishes it from "
                  f"{', '.join(name for name, _ in c.rivals)}; follow a line longer, with other speeds and curvature"
                  for c in questions.found
                  if c.rivals and not any(effect.domain in problems for effect in c.effects)]
    return open_pairs, tuple(not_asked)


def _told(pairs: Sequence[Pair], foresight: Foresight, q_c: Array) -> list[Products]:
    """How well a motion ``(N, n)`` [rad] distinguishes each pair."""
    regressions = {domain: foresight.regression(q_c, domain) for domain in dict.fromkeys(pair.domain for pair in pairs)}
    return [pair.products(regressions[pair.domain]) for pair in pairs]


def _best_motion(pairs: Sequence[Pair], foresight: Foresight, room: Workspace, longest: float,
                 seed: int, progress: Progress) -> Array:
    """The commands ``(N, n)`` [rad] that distinguish the pairs best, within the arm's limits and the room."""
    case, robot = foresight.case, foresight.case.robot
    start = np.clip(case.recording.joints("q")[0], robot.q_min, robot.q_max)

    def worth(several: Sequence[list[Products]]) -> float:
        margins = np.array([pair.separation(reduce(add, own)).margin
                            for pair, own in zip(pairs, zip(*several, strict=True), strict=True)])
        # Pairs that no motion distinguishes must not dominate; margins above one add little.
        return float(np.mean(np.minimum(margins, 1.0) + 0.1 * np.minimum(margins, CLEAR)))

    search = MotionSearch(robot, start, room, longest, np.random.default_rng(seed),
                          lambda q_c: _told(pairs, foresight, q_c))
    q_c = search.best(worth, 1.0 + 0.1 * CLEAR, lambda share, word: progress(0.05 + 0.85 * share, word))
    require_within_limits(robot, q_c, room)
    return q_c


def _planned_pair(pair: Pair, before: Separation, after: Separation, recording: Recording) -> PlannedPair:
    """How well recording and planned motion distinguish a pair, and what else would where they do not."""
    only = ""
    if not after.told_apart:
        names = {c.candidate.effect.name for c in (pair.cause, pair.rival) if c is not None}
        behind = any(effect.name in names and effect.domain == ARM_POSITION for effect in library())
        only = _BEHIND if behind and pair.domain == MOTOR_TORQUE and not recording.has("qa") else _NOTHING
    return PlannedPair(pair.cause.label, pair.rival.label if pair.rival else "", before, after, only)
