"""A candidate: an effect at a joint, with fixed theta."""

from __future__ import annotations

from dataclasses import dataclass

from ideal_robot.effects import Effect


@dataclass(frozen=True)
class Candidate:
    """An effect at a joint with fixed theta.

    Attributes:
        effect, joint, theta: see ``Effect``.
        tries: how many values of theta were looked at to arrive here; p-values are corrected for them.
    """

    effect: Effect
    joint: int
    theta: tuple[float, ...] = ()
    tries: int = 1

    @property
    def key(self) -> str:
        """Name of its group of columns."""
        return f"{self.place}@{','.join(f'{value:.9g}' for value in self.theta)}"

    @property
    def place(self) -> str:
        """Effect, channel and joint without theta: what competes with itself over theta."""
        return f"{self.effect.name}:{self.effect.channel(self.joint)}:{self.joint}:{id(self.effect)}"

    @property
    def parameter_count(self) -> int:
        """Number of parameters, theta included."""
        return len(self.effect.coefficient_names) + len(self.theta)
