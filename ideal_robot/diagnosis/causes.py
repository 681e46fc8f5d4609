"""Candidates for causes: an effect at a joint with its shapes, and the cost of naming it.

    ln prior(S) = −Σ_c [ ln(candidates) + ln(starts) + ½ ln(1000) per physical shape − prior of its effect ]

The sum is over the causes c of a set S. A cause is one of all candidates. A shape is a nonlinear parameter of an effect
(``theta``), such as a gap or a time constant; the prior of each physical one is about thirty times as wide as its
uncertainty. A start is one of the values from which the fit of the shapes begins; each of them was one more chance to
explain noise. The prior of an effect is its log odds against other effects (``Effect.prior``): tools are often changed,
links hardly ever.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ideal_robot.effects import Effect, Signals
from ideal_robot.effects.drive import DeadTime
from ideal_robot.effects.fitted import Unknown
from ideal_robot.effects.loads import AngleLaw
from ideal_robot.errors import RaisedBy

SHAPE = 0.5 * float(np.log(1000.0))
"""Nats that a physical shape costs: half the logarithm of how many values of it a recording of a thousand independent
rows distinguishes (the asymptotic cost of one parameter)."""
CURVE = 20.0
"""Nats that a curve without a cause costs beside its place, for each signal that it is over: what the library has is
likelier than what it lacks."""


@dataclass(frozen=True)
class Candidate:
    """An effect at a joint with fixed shapes.

    Attributes:
        effect, joint, theta: see ``Effect``.
        tries: number of starts of theta that were tried.
    """

    effect: Effect
    joint: int
    theta: tuple[float, ...] = ()
    tries: int = 1

    @cached_property
    def key(self) -> str:
        """Name of its group of columns."""
        return f"{self.place}@{','.join(f'{value:.9g}' for value in self.theta)}"

    @cached_property
    def place(self) -> str:
        """Effect, channel and joint without theta; candidates with the same place differ in theta only."""
        return f"{self.effect.name}:{self.effect.channel(self.joint)}:{self.joint}:{hash(self.effect)}"

    @property
    def cost(self) -> float:
        """Cost in nats of its starts and shapes, with the effect's prior."""
        own = np.log(max(self.tries, 1)) - self.effect.prior
        if isinstance(self.effect, Unknown):
            return float(own + CURVE * len(self.effect.depends_on))
        physical = self.effect.theta_is_physical and not self.effect.scanned
        return float(own + SHAPE * len(self.theta) * physical)

    def one_at_most_with(self, other: Candidate) -> bool:
        """Whether the two are forms of one cause at one joint, of which a set has one at most.

        A signal has one delay; and a sum of two springs would fit any curve over the angle.
        """
        alike = any(isinstance(self.effect, kind) and isinstance(other.effect, kind) for kind in (DeadTime, AngleLaw))
        return self.joint == other.joint and (self.effect.name == other.effect.name or alike)


Only = tuple[tuple[str, int], ...]
"""Names and joints of the effects that may be looked for."""


def candidates(effects: Sequence[Effect], signals: Signals, absorbed: bool,
               only: Only | None = None) -> Iterator[list[Candidate]]:
    """Candidates of every effect and joint: a list each, with one for each start of theta.

    Args:
        effects, signals: to try, in a recording.
        absorbed: whether effects may be tried that the model's own parameters can take over.
        only: names and joints of the effects that are permitted; all if None.
    """
    for effect in effects:
        if effect.absorbed_by_base and not absorbed:
            continue
        with RaisedBy(f"effect {effect.key}, as its starts are found"):
            for joint in effect.joints(signals):
                if (only is None or (effect.name, joint) in only) and effect.usable(signals, joint):
                    starts = [()] if effect.scanned else effect.starts(signals, joint)
                    yield [Candidate(effect, joint, theta, len(starts)) for theta in starts]
