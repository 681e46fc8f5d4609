"""The argument for a cause, as plain values: every set of causes that was weighed, and what told them apart."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ideal_robot.diagnosis.statistics.least_squares import TOLD


@dataclass(frozen=True)
class Weighed:
    """One set of causes: the named one with something else, or nothing, in the place of a cause.

    Attributes:
        name, joint: of what stands there; no name where nothing does.
        nats: by which the set is worse than the named one.
        std: standard error of that, over blocks of time.
        learned: whether it is a curve without a physical cause.
    """

    name: str
    joint: int
    nats: float
    std: float
    learned: bool = False

    @property
    def told(self) -> bool:
        """Whether the data tell it from the named one."""
        return abs(self.nats) > TOLD * self.std

    @property
    def words(self) -> str:
        """What stands there, with its joint."""
        return f"{self.name} of joint {self.joint}" if self.joint else self.name or "nothing"

    @property
    def amount(self) -> str:
        """The difference, to what its standard error allows."""
        digits = 0 if self.std >= 1.0 else 1
        return f"{abs(self.nats):.{digits}f} ± {self.std:.{digits}f} nats {'worse' if self.nats >= 0.0 else 'better'}"

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {"effect": self.name or None, "joint": self.joint, "nats_worse": self.nats, "std": self.std,
                "told_apart": self.told}


@dataclass(frozen=True)
class Argument:
    """Why one cause was named.

    Attributes:
        name, joint, channel: of the cause.
        place: where it sits, in words.
        sets: every set that was weighed, the best first.
        band: octaves that hold half of the difference to the next best one [Hz].
        when: in which quarter of the time most of that difference lies.
        share: of the difference in that quarter.
    """

    name: str
    joint: int
    channel: str
    place: str
    sets: tuple[Weighed, ...]
    band: tuple[float, float]
    when: str
    share: float

    @property
    def rivals(self) -> tuple[Weighed, ...]:
        """The sets with another cause in its place, the best first."""
        return tuple(one for one in self.sets if one.name)

    @property
    def text(self) -> str:
        """The argument in a few sentences."""
        said = [f"{self.place}: {self.name} in {self.channel}."]
        best = next((one for one in self.rivals if not one.learned), None)
        if best is not None:
            what = best.words if best.joint != self.joint else best.name
            low, high = self.band
            between = (f"above {low:g} Hz" if not np.isfinite(high) else
                       f"between {low:g} and {high:g} Hz" if low else f"below {high:g} Hz")
            where = (f"half of the difference lies {between}, {100.0 * min(self.share, 1.0):.0f} % of it in the "
                     f"quarter of the time {self.when}.")
            said.append(
                f"Not told from {what}, {best.amount}." if not best.told else
                f"Next best is {what}, {best.amount}: {where}" if best.nats > 0.0 else
                f"With {what} it is {best.amount}: {where} Where both explain nearly the same, the likelier cause or "
                "the one with fewer parameters is named.")
        said += [f"With {one.name}, which has no cause, {one.amount}." for one in self.rivals if one.learned]
        said += [f"With nothing in its place {one.amount}." for one in self.sets if not one.name]
        return f"{' '.join(said)} Sets weighed: {len(self.sets) + 1}."

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        low, high = self.band
        return {"effect": self.name, "joint": self.joint, "channel": self.channel, "text": self.text,
                "sets": [one.to_dict() for one in self.sets],
                "next_best_decided": {"from_hz": low, "to_hz": high if np.isfinite(high) else None, "when": self.when,
                                      "share": self.share}}
