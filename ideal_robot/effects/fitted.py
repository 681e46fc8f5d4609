"""An effect with its numbers, as it stands in a model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects.base import Domain, Effect, EffectParameter, prefix_of
from ideal_robot.effects.learned import Unknown
from ideal_robot.effects.registry import find
from ideal_robot.effects.signals import Signals


@dataclass(frozen=True)
class FittedEffect:
    """An effect with its numbers, as it stands in a model file.

    Attributes:
        name: key of the effect in the library, or ``unknown``.
        joint: joint from 1, or 0 for the whole arm.
        channel: channel it was found in, e.g. ``tau_3``.
        coefficients, std: linear coefficients ``(m,)`` and their standard deviations.
        theta, theta_std: nonlinear parameters.
        data: what the effect must remember of the data it was fitted to (e.g. knots and bounds of a spline).
        parameters: the physical numbers for people.
        evidence: p-value, error before and after, how it was held out, what it cannot be told apart from.
    """

    name: str
    joint: int
    channel: str
    coefficients: tuple[float, ...]
    std: tuple[float, ...] = ()
    theta: tuple[float, ...] = ()
    theta_std: tuple[float, ...] = ()
    data: Mapping[str, Any] = field(default_factory=dict)
    parameters: tuple[EffectParameter, ...] = ()
    evidence: Mapping[str, Any] = field(default_factory=dict)

    @property
    def effect(self) -> Effect:
        """The effect of the library behind it, by name and channel.

        Raises:
            InputError: this version does not know it.
        """
        if self.name == Unknown.name:
            return Unknown.from_data(self.data)
        return find(self.name, prefix_of(self.channel))

    @property
    def domain(self) -> Domain:
        """Where it acts: see ``Effect.domain``."""
        return self.effect.domain

    def contribution(self, signals: Signals) -> Array:
        """What the effect adds to its channels ``(N, c)`` [N m for motor torque, rad or m for positions]."""
        # A file of an earlier version may have fewer coefficients; what it does not say is none.
        columns = self.effect.columns(signals, self.joint, self.theta)[..., : len(self.coefficients)]
        return np.asarray(columns @ np.asarray(self.coefficients, dtype=float))

    def to_dict(self) -> dict[str, Any]:
        """The effect as plain values for the model file."""
        return {"name": self.name, "joint": self.joint, "channel": self.channel,
                "coefficients": list(self.coefficients), "std": list(self.std), "theta": list(self.theta),
                "theta_std": list(self.theta_std), "data": dict(self.data),
                "parameters": [parameter.to_dict() for parameter in self.parameters], "evidence": dict(self.evidence)}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> FittedEffect:
        """Reads what ``to_dict`` wrote; keys of later versions are ignored."""
        return cls(
            name=str(values["name"]), joint=int(values["joint"]), channel=str(values.get("channel", "")),
            coefficients=tuple(float(v) for v in values["coefficients"]),
            std=tuple(float(v) for v in values.get("std", ())),
            theta=tuple(float(v) for v in values.get("theta", ())),
            theta_std=tuple(float(v) for v in values.get("theta_std", ())),
            data=dict(values.get("data", {})),
            parameters=tuple(map(EffectParameter.from_dict, values.get("parameters", ()))),
            evidence=dict(values.get("evidence", {})),
        )
