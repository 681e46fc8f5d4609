"""What closed loops about a sensor share: the trial of what a diagnosis found, and its row in the ladder."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from ideal_robot.effects import FittedEffect
from ideal_robot.model.model import Model

LEAST = 0.99
"""An error that falls by less than a hundredth has not fallen."""


@dataclass(frozen=True)
class Trial:
    """One change of the model that was played.

    Attributes:
        round: of run and diagnosis, from 1.
        tried: what was changed.
        taken: whether it stays.
        refused: why it does not; empty where it does.
        error: what the cell itself measures with it [SI].
    """

    round: int
    tried: str
    taken: bool
    refused: str
    error: float

    def json(self, scale: float) -> dict[str, Any]:
        """For ``--json``, the error times ``scale``."""
        return {"round": self.round, "tried": self.tried, "taken": self.taken, "refused": self.refused or None,
                "error": scale * self.error}


def with_effects(model: Model, effects: Sequence[FittedEffect]) -> Model:
    """The model with effects added."""
    return dataclasses.replace(model, effects=model.effects + tuple(effects))


def words(effects: Sequence[FittedEffect]) -> str:
    """Effects in words."""
    return " and ".join(dict.fromkeys(effect.name.replace("_", " ") for effect in effects))
