"""A joint whose error falls by refitting the given model alone, as plain values."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class MovedParameter:
    """A parameter of the given model that refitting has moved.

    Attributes:
        name, unit: e.g. ``Fc_2``.
        value, refitted: before and after.
        sigmas: the change over the standard deviation of before.
    """

    name: str
    unit: str
    value: float
    refitted: float
    sigmas: float


@dataclass(frozen=True)
class RefitExplains:
    """A joint whose error falls by refitting the given model alone.

    Attributes:
        joint: from 1.
        channel: its torque.
        rms_before, rms_refit: held-out error of the model as given, and refitted.
        moved: the parameters that moved far and count most for it.
        would_tell: what motion would decide.
    """

    joint: int
    channel: str
    rms_before: float
    rms_refit: float
    moved: tuple[MovedParameter, ...]
    would_tell: str

    @property
    def text(self) -> str:
        """In a sentence."""
        moved = ", ".join(f"{p.name} from {p.value:.3g} to {p.refitted:.3g} {p.unit} ({p.sigmas:+.0f} σ)"
                          for p in self.moved) or "none of them far"
        return (f"the error of {self.channel} falls from {self.rms_before:.3g} to {self.rms_refit:.3g} by refitting "
                f"the given model alone (moved: {moved}). Whether the arm has changed or a cause is missing, this "
                f"recording does not tell; a motion would in which {self.would_tell}")

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {"joint": self.joint, "channel": self.channel, "rms_before": self.rms_before,
                "rms_refit": self.rms_refit, "would_tell": self.would_tell,
                "moved": [{"name": p.name, "unit": p.unit, "value": p.value, "refitted": p.refitted,
                           "sigmas": p.sigmas} for p in self.moved]}
