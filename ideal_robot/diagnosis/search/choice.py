"""A selected candidate with its evidence, a candidate with its score, and the thresholds between them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from ideal_robot.diagnosis.statistics.candidate import Candidate
from ideal_robot.diagnosis.statistics.dependence import Dependence
from ideal_robot.diagnosis.statistics.least_squares import HeldOutTest


@dataclass(frozen=True)
class Options:
    """Thresholds of the search.

    Attributes:
        false_discovery: rate that Benjamini–Hochberg controls over joints × effects of each round.
        smallest: share of a channel's residual squares an effect has to take away on held-out blocks.
        smallest_next: the same for a channel that has an effect already: its form may be slightly another.
        smallest_learned: the same for a learned curve; twice that where the channel has an effect already.
        smallest_absorbed: the same for an effect that is a change of the model's own parameters.
        smallest_torque: rms of what an effect takes away over the torque's standard deviation below which nothing is
            claimed.
        smallest_beside: the same over the rms of the largest other effect at the same joint, at least.
        smallest_learned_bend: the same of a learned curve beside the bend of a gear, whose load is known no better:
            motions tell inertia on both sides of the gear as one.
        smallest_slow: share that a law of speed has to take away in the lower half of the band where vibrations hide it
            in the whole: twice what is asked there, as it is looked for a second time.
        learned_discovery: p-value of a learned curve; motions repeat themselves, and so does what a model leaves, so
            that blocks of time are fewer than they are counted.
        smallest_own: share of an effect's squares that the other parameters must not be able to cancel.
        unknown_margin: a learned curve replaces the best effect of the library only if it reduces squares by so many
            times as much.
        most: effects at most.
    """

    false_discovery: float = 0.01
    smallest: float = 0.15
    smallest_next: float = 0.20
    smallest_learned: float = 0.30
    smallest_absorbed: float = 0.10
    smallest_torque: float = 0.002
    smallest_beside: float = 0.05
    smallest_learned_bend: float = 0.5
    smallest_slow: float = 0.30
    learned_discovery: float = 1e-5
    smallest_own: float = 0.0005
    unknown_margin: float = 1.6
    most: int = 24

    def finer(self) -> Options:
        """A third of the shares that are asked of causes.

        For positions and forces, which no friction hides, and where another recording decides what stays. A curve
        without a cause has to be as large as anywhere: else it would stand in the way of smaller causes.
        """
        return replace(self, smallest=self.smallest / 3.0, smallest_next=self.smallest_next / 2.0)

    def scaled(self, factor: float) -> Options:
        """All shares of the residual that are asked of an effect, times a factor."""
        return replace(self, smallest=factor * self.smallest, smallest_next=factor * self.smallest_next,
                       smallest_learned=factor * self.smallest_learned,
                       smallest_absorbed=factor * self.smallest_absorbed, smallest_slow=factor * self.smallest_slow)

    def slow(self) -> Options:
        """The same for the lower half of the band; twice as much for a second effect of a joint."""
        return replace(self, smallest=self.smallest_slow, smallest_next=2.0 * self.smallest_slow)


@dataclass(frozen=True)
class Choice:
    """A selected candidate and the evidence for it in the round it was taken.

    Attributes:
        candidate: with refined theta.
        p_value: of its held-out score, corrected for the values of theta that were tried.
        rivals: names and joints of candidates that the data cannot tell from it, with the share of its reduction that
            they reach.
        share: share of the most affected channel's squares that it takes away on held-out blocks.
        dependence: for a learned term, the dependence that led to it.
        asked: share that was asked of it.
    """

    candidate: Candidate
    p_value: float
    rivals: tuple[tuple[str, int, float], ...] = ()
    share: float = 0.0
    dependence: Dependence | None = None
    asked: float = 0.0


@dataclass
class Scored:
    """A candidate with its score.

    Attributes:
        candidate: effect, joint and theta.
        test: how much it reduces the residual.
        p_value: of the test, corrected for the values of theta that were tried.
        share: of the most affected channel's squares that it takes away on held-out blocks.
        dependence: for a learned term, the dependence that led to it.
    """

    candidate: Candidate
    test: HeldOutTest
    p_value: float
    share: float
    dependence: Dependence | None = field(default=None)
