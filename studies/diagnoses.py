"""Diagnoses of recordings with hidden causes: in strangers' physics with a strict score, and of sensors."""

from __future__ import annotations

import json
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from scipy.optimize import minimize
from scipy.special import betaln

from ideal_robot.diagnosis import diagnose
from ideal_robot.effects import SENSOR
from ideal_robot.errors import IdealRobotError
from ideal_robot.identification.idim import identify
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from scenes.commands.common import numbers, whole_numbers
from studies.report import head, row, write_tables
from studies.sensors.force import draw_force_trial
from studies.sensors.scene import KINDS, draw_line_trial, gantry
from studies.sensors.tcp import draw_tcp_trial
from studies.strangers.arm import robot_of
from studies.strangers.score import SINGLE, Score, details, detection, power, reliability, report, score
from studies.strangers.trial import POOLS, Trial, draw_trial

GAVE_UP = SimpleNamespace(verdict="failed", effects=(), unknown=())
"""What counts as the answer of a diagnosis that ends with an error."""


def strangers(seeds: str = "40000-40044", kind: str | None = None, sizes: str = "0.5,10", processes: int = 1,
              lines: Path | None = None, write: bool = False, engine: str | None = None) -> None:
    """Trials of the diagnosis in engines that nothing of the program wrote: named, and nothing else named.

    Every recording follows from its seed; the engine goes by turns (mujoco, pybullet, integrator), or is that of
    --engine: one of these or dart, which was left out while the diagnosis was made. The kind is drawn
    (none, inside, new, outside, two, model, arm, known), --sizes are the least and most in multiples of visible. With
    --lines each score is a line of that file, and seeds that have one are not played again. --write puts the first two
    tables into the page. --kind known plays healthy recordings against the model that `identify` makes of another
    healthy recording.
    """
    least, most = numbers(sizes, "--sizes")
    play = partial(_play, draw=partial(draw_trial, kind=kind, engine=engine, size=(least, most)))
    scores = [s for s in _scores(whole_numbers(seeds, "--seeds"), lines, play, processes) if kind in (None, s.kind)]
    text = report(scores)
    print(text, details(scores), reliability(by_name(scores), "probability by its name"), sep="\n\n")
    if write:
        write_tables("stranger trials", text)


def each_effect(seeds: str = "1970000-1970011", sizes: str = "0.1,5", lines: Path | None = None) -> None:
    """From which size on each effect of the motor torque and of the arm's angle is found, and what is named falsely.

    Trials as in `strangers`, of 15 to 25 s, one of each effect from each of --seeds plus a hundred thousand times its
    place in the list. --lines as in `strangers`.
    """
    least, most = numbers(sizes, "--sizes")
    scores = []
    for place, (kind, cause) in enumerate([(pool, name) for pool in SINGLE for name in POOLS[pool]]):
        draw = partial(draw_trial, kind=kind, size=(least, most), seconds=(15.0, 25.0), cause=cause)
        scores += _scores([seed + 100000 * place for seed in whole_numbers(seeds, "--seeds")], lines,
                          partial(_play, draw=draw))
    print(power(scores), detection(scores, lambda cause: cause, "effect"), sep="\n\n")


def by_name(scores: Sequence[Score]) -> list[Score]:
    """The scores, with the probability of all that is said: as often as its name was right in the other recordings.

    The shares of all names are those of one Beta distribution, the likeliest (empirical Bayes, Robbins 1956).
    """
    claims = [[(name, (name, joint) not in s.false) for name, joint in s.said] for s in scores]
    every = Counter(claim for each in claims for claim in each)

    def probabilities(own: list[tuple[str, bool]]) -> Iterator[tuple[float, bool]]:
        elsewhere = every - Counter(own)
        counts = {name: np.array([elsewhere[name, True], elsewhere[name, False]]) for name, _ in every}

        def unlikely(x: np.ndarray) -> float:
            prior = np.exp(x)
            return float(sum(betaln(*prior) - betaln(*(prior + each)) for each in counts.values()))

        prior = np.exp(minimize(unlikely, np.zeros(2), method="Nelder-Mead").x)
        for name, true in own:
            right, wrong = prior + counts[name]
            yield float(right / (right + wrong)), true

    return [replace(s, probabilities=tuple(probabilities(own)) if own else ())
            for s, own in zip(scores, claims, strict=True)]


def _scores(wanted: list[int], lines: Path | None, play: Callable[[int], Score | None],
            processes: int = 1) -> list[Score]:
    """Scores of seeds, played where they are no lines of a file yet, to which they are added."""
    texts = lines.read_text(encoding="utf-8").splitlines() if lines is not None and lines.is_file() else []
    scores = [s for s in map(Score.from_dict, map(json.loads, texts)) if s.seed in wanted]
    jobs = sorted(set(wanted) - {s.seed for s in scores})
    with ProcessPoolExecutor(processes) as pool:
        for s in filter(None, pool.map(play, jobs) if processes > 1 else map(play, jobs)):
            scores.append(s)
            print(_line(s), flush=True)
            if lines is not None:
                with lines.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(s.to_dict()) + "\n")
    return scores


def _play(seed: int, *, draw: Callable[[int], Trial]) -> Score | None:
    """Draws, diagnoses and scores one trial; None where nothing can be drawn from its seed.

    A diagnosis that gives up has said nothing, and is never right.
    """
    try:
        trial = draw(seed)
    except RuntimeError as error:
        print(error, flush=True)
        return None
    with robot_of(trial.urdf) as robot:
        try:
            model = known_before(trial, robot)
            start = time.process_time()
            diagnosis = diagnose(trial.recording, robot, model=model)
        except (IdealRobotError, ArithmeticError, ValueError) as error:
            print(f"{seed}: {error}", flush=True)
            return score(trial, GAVE_UP)
        return score(trial, diagnosis, time.process_time() - start)


def known_before(trial: Trial, robot: Robot) -> Model | None:
    """The model of a trial's healthy reference, or None: a rigid body with friction, as an identification has it."""
    if trial.reference is None:
        return None
    if trial.kind == "known":
        return identify([trial.reference], robot).model
    # A lag of all torques belongs to the recording; left in the parameters it would turn inertia into friction.
    healthy = diagnose(trial.reference, robot, only=(("common_delay", 0),)).model
    return None if healthy is None else replace(healthy, effects=())


def _line(s: Score) -> str:
    """One trial for people."""
    causes = ", ".join(f"{name} {joint} ×{size:.1f}" for name, joint, size in s.causes) or "nothing"
    named = ", ".join([*(f"{name} {joint}" for name, joint in s.named), *(f"unknown {j}" for j in s.unknown)])
    return (f"{'ok ' if s.right else 'BAD'} {s.seed} {s.engine:10s} {s.kind:7s} {s.arm:13s} {s.motion:7s} "
            f"{s.logger:12s} {s.controller:15s} {s.friction:10s} {s.gears:7s} {s.seconds:5.1f} s  true: {causes}  "
            f"said: {s.verdict} {named}")


def sensors(channel: str, seeds: str) -> None:
    """Effects that a device at the tool (CHANNEL tcp), a force sensor (force) or a camera (line) shows.

    SEEDS as 6000-6069. Right: named at its joint, or of a group that the data do not separate; of nothing, nothing
    named. Beside tcp the motor torque is diagnosed too; of force and line the sensor alone counts.
    """
    answers: dict[str, Counter[str]] = defaultdict(Counter)
    right, alone = Counter[str](), Counter[str]()
    for seed in whole_numbers(seeds, "SEEDS"):
        truth, groups = (_line_groups if channel == "line" else _arm_groups)(channel, seed)
        name = truth[0] if truth else "none"
        hits = [truth in group for group in groups]
        right[name] += any(hits) if truth else not groups
        alone[name] += len(groups) == sum(hits) and (truth is None or any(hits))
        answers[name][" + ".join(f"{group[0][0]} {group[0][1]}" for group in groups) or "nothing"] += 1
    head(f"drawn, {channel}", "trials", "right", "and nothing else", "said where not")
    for name, each in sorted(answers.items()):
        other = [words for words in each if words.partition(" ")[0] != name and (name != "none" or words != "nothing")]
        row(f"`{name}`" if name != "none" else name, each.total(), right[name], alone[name], "; ".join(other))
    row("all", sum(each.total() for each in answers.values()), right.total(), alone.total(), "")


Group = list[tuple[str, int]]
"""What was said first, and what the data do not separate from it."""


def _arm_groups(channel: str, seed: int) -> tuple[tuple[str, int] | None, list[Group]]:
    """Truth of a seed, and what is said of it."""
    trial = (draw_force_trial if channel == "force" else draw_tcp_trial)(seed)
    with robot_of(trial.urdf) as robot:
        diagnosis = diagnose(trial.recording, robot)
    groups = []
    for e in diagnosis.effects:
        # Contact also shows in motor torques, of which trials of a force sensor do not ask.
        if channel == "tcp" or e.fitted.domain == SENSOR:
            rivals = [rival.partition(" of joint ") for rival in e.indistinguishable_from]
            groups.append([(e.fitted.name, e.fitted.joint),
                           *((name, int(joint) if joint else e.fitted.joint) for name, _, joint in rivals)])
    return trial.truth, [*groups, *([("unknown", u.fitted.joint)] for u in diagnosis.unknown if channel == "tcp")]


def _line_groups(channel: str, seed: int) -> tuple[tuple[str, int] | None, list[Group]]:
    """The same of a camera over a line."""
    kind, _, recording = draw_line_trial(seed)
    with robot_of(gantry()) as robot:
        named = [e for e in diagnose(recording, robot).effects if e.fitted.channel == channel]
    assert kind in KINDS
    return (None if kind == "none" else (kind, 0)), [[(e.fitted.name, 0), *((name, 0) for name in
                                                                              e.indistinguishable_from)] for e in named]
