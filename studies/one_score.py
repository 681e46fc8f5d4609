"""The diagnosis by one score and one search over sets, beside the diagnosis by rules, on the same recordings.

A set of causes is as good as the log density that it gives to blocks of time which it was not fitted to. With ``s_c²``
the mean square of channel c on blocks left out, ``N_c`` its samples and ``g_c`` how many neighbours count for one,

    log p = - sum_c N_c / (2 g_c) log(s_c² + v_c²) - sum_i cost_i ,

where ``v_c`` is a torque that nobody asks for and ``cost_i`` what a cause has to be worth: a visible share of its
channel's squares, and the logarithm of how many causes and values of theta it was chosen among. The colour ``g_c`` is
that of the set which leaves least in the channel. Adding, exchanging and removing are equal moves of a beam of the best
sets. Named is what no set lacks that the data cannot reject by two standard errors over blocks.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.diagnosis import Options, stages
from ideal_robot.diagnosis.case import Case
from ideal_robot.diagnosis.search.choice import overlap
from ideal_robot.diagnosis.search.forward_selection import Search
from ideal_robot.diagnosis.statistics.least_squares import Fit
from ideal_robot.diagnosis.statistics.problem import Candidate
from ideal_robot.errors import IdealRobotError
from ideal_robot.identification.checks import checked
from ideal_robot.progress import silent
from ideal_robot.signals.sampling import shortened
from scenes.commands.common import numbers, whole_numbers
from studies.ablation import altered, said
from studies.diagnoses import GAVE_UP, known_before
from studies.report import head, kept, row
from studies.strangers.arm import robot_of
from studies.strangers.score import Score, score
from studies.strangers.trial import Trial, draw_trial

VISIBLE = 0.15
"""Share of a channel's squares that a cause has to be worth, twice that for a curve without a cause."""
UNSEEN = 0.002
"""Torque over its standard deviation that nobody asks for."""
BEAM, PER_JOINT, EXPANSIONS = 3, 2, 8
"""Sets that are kept, causes of a joint that are weighed with a fit of their own, sets that are expanded at most."""
REJECTED = 2.0
"""Standard errors of a difference from which on the data tell two sets from each other."""


@dataclass(frozen=True)
class Weighed:
    """A set that was weighed.

    Attributes:
        choices: its causes.
        squares: of the blocks left out ``(B, c)``.
        colour: neighbouring samples that count for one ``(c,)``, of what it leaves.
    """

    choices: tuple[Candidate, ...]
    squares: Array
    colour: Array

    @property
    def key(self) -> frozenset[str]:
        """What it is known by: its causes without theta, but for those of which a joint may have several."""
        return frozenset(c.key if c.effect.scanned else c.place for c in self.choices)


class SetSearch(Search):
    """A beam over sets in the place of forward selection; arguments as for ``Search``."""

    def run(self, start: Sequence[Candidate] = ()) -> list[Candidate]:
        """See ``Search.run``."""
        products, self.selecting = self.model.problem.products, self.model.problem.blocks.selecting
        self.count = products.count[self.selecting].sum(axis=0)
        self.kept = self.count > 0
        self.unseen = (UNSEEN * self.scoring.measured_std) ** 2
        self.known: dict[frozenset[str], Weighed] = {}
        expanded: set[frozenset[str]] = set()
        self._weigh(())
        if start:
            self._weigh(start)
        for _ in range(EXPANSIONS):
            ranked = sorted(self.known.values(), key=lambda weighed: -self._score(weighed))[:BEAM]
            waiting = [weighed for weighed in ranked if weighed.key not in expanded]
            if not waiting:
                break
            expanded.add(waiting[0].key)
            self._expand(waiting[0])
        return self._named(max(self.known.values(), key=self._score))

    def _weigh(self, choices: Sequence[Candidate]) -> Weighed:
        """A set with its squares."""
        self.model.replace(list(choices))
        fit = self.model.fit()
        weighed = Weighed(tuple(self.model.choices), fit.held_out_squares[self.selecting], self._colour(fit))
        old = self.known.get(weighed.key)
        if old is None or weighed.squares.sum() < old.squares.sum():
            self.known[weighed.key] = weighed
        return weighed

    def _colour(self, fit: Fit) -> Array:
        """Sum of each channel's autocorrelation up to where it has fallen to a twentieth ``(c,)``."""
        blocks, use = self.model.problem.blocks, self.model.problem.products.use
        use = (use & self.selecting[blocks.of_samples(), None]).astype(float)
        rest, size = self.model.left_out(fit) * use, 2 * len(use)
        both = [np.fft.irfft(np.abs(np.fft.rfft(x, size, axis=0)) ** 2, size, axis=0)[: len(use)] for x in (rest, use)]
        rho = both[0] / np.maximum(both[1], 1.0)
        rho = rho / np.maximum(rho[0], 1e-300)
        ends = np.argmax(rho <= 0.05, axis=0)
        return np.array([1.0 + 2.0 * rho[1:end, j].sum() for j, end in enumerate(ends)])

    def _weight(self) -> Array:
        """Half the samples that count for one each ``(c,)``, by the set that leaves least in the channel."""
        every = list(self.known.values())
        least = np.argmin([weighed.squares.sum(axis=0) for weighed in every], axis=0)
        colour = np.array([every[k].colour[j] for j, k in enumerate(least)])
        return np.where(self.kept, self.count / (2.0 * colour), 0.0)

    def _mean(self, squares: Array) -> Array:
        return np.asarray(squares / np.maximum(self.count, 1.0) + self.unseen)

    def _score(self, one: Weighed) -> float:
        return float(-(self._weight() * np.log(self._mean(one.squares.sum(axis=0)))).sum()
                     - sum(self._cost(c) for c in one.choices))

    def _cost(self, choice: Candidate) -> float:
        effect, joint = choice.effect, choice.joint
        channel = self.model.problem.regression.channel_of(joint)
        weight = self._weight()
        weight = weight.max() if channel is None else weight[channel]
        share = VISIBLE * (2.0 if effect.learned else effect.caution if self.scoring.signals.n > 1 else 1.0)
        return float(np.log(max(len(self.pool), 1) * max(choice.tries, 1)) - weight * np.log1p(-share))

    def _difference(self, a: Weighed, b: Weighed) -> tuple[float, float]:
        """By how much a set is better than another one, and the standard error over blocks."""
        each = (b.squares / self._mean(b.squares.sum(axis=0)) - a.squares / self._mean(a.squares.sum(axis=0)))
        each = (each / np.maximum(self.count, 1.0) * self._weight()).sum(axis=1)
        return self._score(a) - self._score(b), float(np.std(each, ddof=1) * np.sqrt(len(each)))

    def _expand(self, base: Weighed) -> None:
        """Adds the best causes of each joint; where that helps nowhere, exchanges and removes."""
        if len(base.choices) > 1:
            # Their theta was found without each other.
            self.model.replace(list(base.choices))
            for c in base.choices:
                self._retune(c)
            base = self._weigh(self.model.choices)
        before, better = self._score(base), list[Candidate]()
        for joint in range(self.model.problem.regression.signals.n + 1):
            added = [(self._weigh((*base.choices, c)), c) for c in self._promising(base, None, joint)]
            good = [(weighed, c) for weighed, c in added if self._score(weighed) > before]
            if good:
                better.append(max(good, key=lambda pair: self._score(pair[0]))[1])
        if len(better) > 1:
            self._weigh((*base.choices, *(c for c in better if c.joint)))
            self._weigh((*base.choices, *better))
        if better:
            return
        for hole in base.choices:
            rest = tuple(c for c in base.choices if c is not hole)
            self._weigh(rest)
            for joint in {hole.joint, 0}:
                for c in self._promising(base, hole, joint):
                    self._weigh((*rest, c))

    def _promising(self, one: Weighed, hole: Candidate | None, joint: int) -> list[Candidate]:
        """The most promising causes of a joint beside a set, or in the place of one of its causes, theta refined."""
        self.model.replace(list(one.choices))
        fit = self.model.fit(*(() if hole is None else (hole,)))
        pool = [starts for starts in self.pool if starts[0].joint == joint
                and (hole is None or starts[0].place != hole.place)]
        scored = sorted(self.scoring.scored(fit, pool), key=lambda s: -s.test.total)
        refined = [self.scoring.refined(fit, s) for s in scored[: 2 * PER_JOINT] if s.share > 0.5 * VISIBLE]
        best = sorted((s for s in refined if s.share > VISIBLE and self.scoring.holds_slowly(s)
                       and self.scoring.holds_everywhere(fit, s)),
                      key=lambda s: -s.test.total)[:PER_JOINT]
        channel = self.model.problem.regression.channel_of(joint)
        if self.learns and channel is not None and self.kept[channel]:
            curves = self.scoring.curves_in(fit, self.model.residual(fit), channel,
                                            least=2.0 * VISIBLE * self.count[channel])
            best += sorted((s for s in curves if s.share > 2.0 * VISIBLE), key=lambda s: -s.test.total)[:1]
        return best

    def _named(self, best: Weighed) -> list[Candidate]:
        """Of the best set what no set lacks that the data cannot reject; with what may stand in its place."""
        while True:
            for c in best.choices:
                without = self._weigh([other for other in best.choices if other is not c])
                ahead, error = self._difference(best, without)
                if ahead + self._cost(c) < REJECTED * error + np.log(len(self.pool) * c.tries):
                    best = without
                    break
            else:
                break
        rivals = []
        for weighed in self.known.values():
            ahead, error = self._difference(best, weighed)
            if weighed.key != best.key and ahead < REJECTED * error:
                rivals.append(weighed)
        self.model.replace(list(best.choices))
        self.model.replace([self._taken(c, rivals) for c in best.choices])
        return self.model.choices

    def _taken(self, choice: Candidate, told: Sequence[Weighed]) -> Candidate:
        tested = self.scoring.tested(self.model.fit(choice), choice)
        rest = {c.place for c in self.model.choices if c is not choice}
        rivals = {(c.effect.name, c.joint, 1.0) for weighed in told
                  if rest <= (places := {c.place for c in weighed.choices})
                  and choice.place not in places
                  for c in weighed.choices if c.place not in rest and not c.effect.learned
                  and overlap(self.model, choice, c)}
        return dataclasses.replace(tested, rivals=tuple(sorted(rivals)), asked=VISIBLE)


def one_score(seeds: str = "1200000-1200041", sizes: str = "3,10", lines: Path = Path("one_score.jsonl")) -> None:
    """Strangers diagnosed by rules, and by one score and one search over sets of causes, on the same recordings.

    Trials as in `strangers`, of 15 to 25 s. Each pair of scores is a line of --lines, and seeds that stand there are
    not played again. Differences are those of the pairs, with their standard error.
    """
    least, most = numbers(sizes, "--sizes")

    def play(seed: int) -> list[dict[str, Any]]:
        trial = draw_trial(seed, None, None, (least, most), (15.0, 25.0))
        return [_played(trial, kind).to_dict() for kind in (Search, SetSearch)]

    _table([[Score.from_dict(one) for one in scores] for scores in kept(lines, whole_numbers(seeds, "--seeds"), play)])


def _played(trial: Trial, kind: type[Search]) -> Score:
    """The score of a trial with one kind of search."""
    with robot_of(trial.urdf) as robot, altered(stages, "Search", kind):
        model = known_before(trial, robot)
        start = time.process_time()
        try:
            (recording,), _ = checked([shortened(trial.recording)[0]], robot)
            case = Case(recording, robot, model, None, Options(), silent, True, None)
            diagnosis = said(case, stages.baseline(case, stages.prepared(case, ())))
        except (IdealRobotError, ArithmeticError, ValueError):
            diagnosis = GAVE_UP
        return score(trial, diagnosis, time.process_time() - start)


def _table(pairs: list[list[Score]]) -> None:
    """What the pairs say."""
    head("figure", "recordings", "by rules", "by one score", "difference")
    empty = [pair for pair in pairs if pair[0].kind == "none"]
    for name, some, value in (("right, and nothing else", pairs, lambda s: float(s.right)),
                              ("empty left alone", empty, lambda s: float(s.right)),
                              ("false names", pairs, lambda s: float(len(s.false))),
                              ("processor time [s]", pairs, lambda s: s.seconds)):
        both = np.array([[value(s) for s in pair] for pair in some]).reshape(-1, 2)
        change = both[:, 1] - both[:, 0]
        error = np.std(change, ddof=1) * np.sqrt(len(change)) if len(change) > 1 else 0.0
        row(name, len(some), f"{both[:, 0].sum():.0f}", f"{both[:, 1].sum():.0f}", f"{change.sum():+.0f} ± {error:.1f}")
