"""Why a cause was named: every set of causes that was weighed, its score against the named one, what told them apart.

The score of a set is the log density that it gives to blocks of time which it was not fitted to. The noise of a channel
is Gaussian, as large as what the named set leaves there, and coloured: so many samples count for one as the parameters
scatter more over blocks than white noise has them scatter. Up to a constant

    log p = -sum_bc w_c |r_bc|^2 / (2 colour)

with ``r_bc`` the residual of block b in channel c, predicted without its fold. Differences are in nats; their standard
error is that of a sum over blocks.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.search.choice import FINALISTS, Options, PresentModel, overlap
from ideal_robot.diagnosis.search.forward_selection import candidates
from ideal_robot.diagnosis.search.scoring import Scoring
from ideal_robot.diagnosis.statistics.least_squares import Fit
from ideal_robot.diagnosis.statistics.problem import Candidate
from ideal_robot.diagnosis.validation.domain_diagnosis import DomainDiagnosis
from ideal_robot.diagnosis.validation.result import Argument, Weighed
from ideal_robot.effects import ARM_POSITION, MOTOR_TORQUE, Effect, library
from ideal_robot.effects.fitted import Unknown


def arguments(domain: DomainDiagnosis, options: Options) -> Iterator[Argument]:
    """Why each cause of a settled domain was named, in their order, by the thresholds of the search."""
    model = PresentModel(domain.problem.held())
    model.replace(list(domain.choices))
    scoring = Scoring(model, options)
    for choice in domain.choices:
        yield _Weighing(scoring, choice).argument([*_instead(scoring, choice), *_curve_instead(scoring, choice)])


def _instead(scoring: Scoring, own: Candidate) -> list[Candidate]:
    """Every cause of the library that can stand in the place of a choice, its theta as the search has it."""
    model, regression = scoring.model, scoring.model.problem.regression
    effects = [effect for effect in library() if effect.domain == regression.domain]
    known = model.problem.prior is not None or regression.domain != MOTOR_TORQUE
    pool = [starts for starts in candidates(effects, regression.signals, regression.undecided, known)
            if (not own.joint or starts[0].joint in (own.joint, 0)) and starts[0].place != own.place]
    fit = model.fit(own)
    scored = [s for s in scoring.scored(fit, pool) if overlap(model, own, s)]
    scored.sort(key=lambda s: -s.test.total)
    return [scoring.refined(fit, s) if k < FINALISTS else s for k, s in enumerate(scored)]


def _curve_instead(scoring: Scoring, own: Candidate) -> list[Candidate]:
    """The learned curve that explains most in the place of a cause of one joint, if there is one."""
    model = scoring.model
    channel, fit = model.problem.regression.channel_of(own.joint), model.fit(own)
    if channel is None or own.effect.learned:
        return []
    return sorted(scoring.curves_in(fit, model.residual(fit), channel), key=lambda s: -s.test.total)[:1]


class _Weighing:
    """What stands for and against one choice of the named set that ``scoring`` is about."""

    def __init__(self, scoring: Scoring, choice: Candidate) -> None:
        self.scoring, self.model, self.choice = scoring, scoring.model, choice
        best = self.model.fit()
        self.rows = self.model.problem.blocks.selecting_samples
        self.scale = np.sqrt(self.model.weights / (2.0 * best.inflation))
        self.best = self._left(best)

    def _left(self, fit: Fit) -> Array:
        """What a set leaves of blocks that it was not fitted to, so that its squares are nats ``(N, c)``."""
        return np.asarray(self.model.left_out(fit) * self.scale * self.rows[:, None])

    def argument(self, others: Sequence[Candidate]) -> Argument:
        """The argument, from what can stand in the choice's place."""
        own = self.choice
        misfit = [self._left(self.model.fit(own)), *(self._left(self.model.fit_beside(other, own)) for other in others)]
        sets = [self._weighed(r, other) for r, other in zip(misfit, [None, *others], strict=True)]
        # Nothing in its place tells what the cause is worth; the next best cause why it is this.
        next_best = min(range(len(sets)), key=lambda k: (not sets[k].name or sets[k].learned, sets[k].nats))
        when, share = self._when(misfit[next_best])
        return Argument(own.effect.name, own.joint, own.effect.channel(own.joint),
                        f"joint {own.joint}" if own.joint else self.model.problem.regression.domain.whole,
                        tuple(sorted(sets, key=lambda s: s.nats)), self._band(misfit[next_best]), when, share)

    def _weighed(self, misfit: Array, other: Candidate | None) -> Weighed:
        blocks = self.model.problem.blocks
        gain = np.add.reduceat((misfit**2 - self.best**2).sum(axis=1), blocks.edges[:-1])[blocks.selecting]
        return Weighed("" if other is None else _name(other.effect), 0 if other is None else other.joint,
                       float(gain.sum()), float(np.std(gain, ddof=1) * np.sqrt(len(gain))),
                       other is not None and other.effect.learned)

    def _band(self, misfit: Array) -> tuple[float, float]:
        """The fewest adjoining octaves that hold half of the difference [Hz]."""
        f = np.fft.rfftfreq(len(misfit), self.model.problem.regression.step)
        octaves = np.exp2(np.arange(np.ceil(np.log2(f[1])), np.log2(f[-1])))
        edges = [0.0, *octaves.tolist(), np.inf]
        power = (np.abs(np.fft.rfft(misfit, axis=0)) ** 2 - np.abs(np.fft.rfft(self.best, axis=0)) ** 2).sum(axis=1)
        parts = np.array([power[(f >= low) & (f < high)].sum() for low, high in pairwise(edges)])
        parts = parts / (parts.sum() or 1.0)
        spans = [(b - a, -parts[a:b].sum(), a, b) for a in range(len(parts)) for b in range(a + 1, len(parts) + 1)
                 if parts[a:b].sum() >= 0.5] or [(0, 0.0, 0, len(parts))]
        _, _, a, b = min(spans)
        return edges[a], edges[b]

    def _when(self, misfit: Array) -> tuple[str, float]:
        """The quarter of the time in which most of the difference lies, in words, and its share."""
        gain = misfit**2 - self.best**2
        regression, s = self.model.problem.regression, self.scoring.at_rows
        channel = int(np.argmax(gain.sum(axis=0)))
        joint = self.choice.joint or (channel + 1 if regression.domain in (MOTOR_TORQUE, ARM_POSITION) else 0)
        signs = {"at the end": s.t, "at the beginning": -s.t}
        if joint:
            q, qd, qdd, load = (values[:, joint - 1] for values in (s.q, s.qd, s.qdd, s.load))
            signs = {"at the highest speed": np.abs(qd), "near reversals and rest": -np.abs(qd),
                     "at the largest acceleration": np.abs(qdd), "under the largest load": np.abs(load),
                     "at the upper end of the range": q, "at the lower end of the range": -q, **signs}
        rows = self.rows & regression.use.any(axis=1)
        total = float(gain[rows].sum()) or 1.0
        shares = {words: float(gain[rows][x[rows] >= np.quantile(x[rows], 0.75)].sum()) / total
                  for words, x in signs.items()}
        words = max(shares, key=lambda key: shares[key])
        return words, shares[words]


def _name(effect: Effect) -> str:
    """Name of what stands in a place; of causes with several forms the form as well."""
    if isinstance(effect, Unknown):
        return f"a curve over {' and '.join(effect.depends_on)}"
    return effect.key if effect.channel_prefix != effect.domain.prefix else effect.name
