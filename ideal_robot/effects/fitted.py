"""An effect with its fitted numbers, as in a model file; also learned curves without a physical law."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.interpolate import BSpline

from ideal_robot.arrays import Array
from ideal_robot.effects.base import (
    MOTOR_TORQUE,
    TCP_POSITION,
    Domain,
    Effect,
    EffectParameter,
    Theta,
    domain_of,
    prefix_of,
)
from ideal_robot.effects.loop_change import LoopChange
from ideal_robot.effects.registry import find
from ideal_robot.effects.signals import Signals

_MOTION = re.compile(r"(q|qd|qdd|load)_\d+")
"""Signals that follow from where the arm shall go."""


@dataclass(frozen=True)
class Unknown(Effect):
    """A learned curve: a cubic spline over one signal, or products of two, optionally times ``sign(qd)``.

    Outside the range of the fit it keeps its end value at first and goes to zero within ``margin`` of the range, as a
    path may reach a little further than the fitted motion.

    Attributes:
        depends_on: signals, e.g. ``("q_2",)`` or ``("qd_1", "qd_3")``.
        directed: whether the curve is multiplied by the sign of the joint's velocity.
        knots: knots of each signal's spline, ends included.
        domain: the domain in which it acts.
        frequency: for a term periodic in the signal: its angular frequency instead of a spline.
    """

    depends_on: tuple[str, ...]
    directed: bool
    knots: tuple[tuple[float, ...], ...]
    frequency: float = 0.0
    margin: float = 0.5
    domain: Domain = MOTOR_TORQUE

    name = "unknown"
    learned = True
    source = "learned from the residual"

    @classmethod
    def from_data(cls, data: Mapping[str, Any]) -> Unknown:
        """Reads what ``to_data`` wrote."""
        return cls(tuple(str(s) for s in data["depends_on"]), bool(data["directed"]),
                   tuple(tuple(float(v) for v in k) for k in data["knots"]), float(data.get("frequency", 0.0)),
                   # Files of earlier versions call it "head".
                   domain=domain_of(str(data.get("prefix", data.get("head", MOTOR_TORQUE.prefix)))))

    def to_data(self) -> dict[str, Any]:
        """The data of the curve for a model file."""
        return {"depends_on": list(self.depends_on), "directed": self.directed,
                "knots": [list(k) for k in self.knots], "frequency": self.frequency, "prefix": self.domain.prefix}

    def signals_of(self, joint: int) -> list[str]:
        """Names of the signals that the curve of a joint (from 1) depends on, with the direction if directed."""
        return [*self.depends_on, *([f"sign(qd_{joint})"] if self.directed else [])]

    def parameters(self, coefficients: Array, std: Array, theta: Theta, theta_std: Theta) -> list[EffectParameter]:
        """No numbers, as a learned curve has no physical ones; see ``Effect.parameters``."""
        return []

    def columns(self, signals: Signals, joint: int, theta: Theta) -> Array:
        """Columns of shape ``(N, n, m)``: the basis functions on the joint's channel; see ``Effect.columns``."""
        basis = self.basis(signals)
        if self.directed:
            basis = basis * signals.sliding_direction(joint)[:, None]
        if self.domain == TCP_POSITION:
            result = np.zeros((len(signals.t), 3, basis.shape[1]))
            result[:, joint - 1] = basis
            return result
        return signals.on_joint(joint, *basis.T)

    def loop_change(self, coefficients: tuple[float, ...], theta: Theta) -> LoopChange:
        """The change of the loop: the curve over the motor's motion, zero outside the recorded range."""
        if self.domain != MOTOR_TORQUE:
            return LoopChange(nowhere="a curve without a cause does not say whether arm or measurement is off")
        if not all(_MOTION.fullmatch(name) for name in self.depends_on):
            return LoopChange(nowhere=f"the loop does not know {' and '.join(self.depends_on)} beforehand")
        return LoopChange(torque=True)

    def basis(self, signals: Signals) -> Array:
        """Basis functions ``(N, m)`` of the signals."""
        if self.depends_on == ("t",):
            return signals.over_time(lambda t: self._basis([t]))
        return self._basis([signal_of(signals, name) for name in self.depends_on])

    def _basis(self, values: list[Array]) -> Array:
        """See ``basis``. Of the values of each signal ``(N,)``."""
        if self.frequency:
            inside = _inside(values[0], self.knots[0], self.margin)
            phase = self.frequency * values[0]
            return np.column_stack([np.cos(phase), np.sin(phase)]) * inside[:, None]
        parts = [spline_basis(v, k, self.margin) for v, k in zip(values, self.knots, strict=True)]
        if len(parts) == 1:
            return parts[0]
        return np.asarray((parts[0][:, :, None] * parts[1][:, None, :]).reshape(len(parts[0]), -1))


def spline_basis(x: Array, knots: tuple[float, ...], margin: float) -> Array:
    """Cubic B-splines ``(N, len(knots) + 2)``, fading to zero outside of their knots.

    Args:
        x, knots: arguments in the signal's unit ``(N,)``, and the knots, ends included.
        margin: share of the knots' range over which they fade.
    """
    inner = np.asarray(knots)
    full = np.concatenate([[inner[0]] * 3, inner, [inner[-1]] * 3])
    basis = BSpline(full, np.eye(len(inner) + 2), 3)(np.clip(x, inner[0], inner[-1] - 1e-12 * np.ptp(inner)))
    outside = np.flatnonzero((x < inner[0]) | (x > inner[-1]))
    basis[outside] *= _inside(x[outside], knots, margin)[:, None]
    return np.asarray(basis)


def _inside(x: Array, knots: tuple[float, ...], margin: float) -> Array:
    """One inside the knots, falling to zero over ``margin`` times their range outside, slowly at first, as a tricube.

    A steep fall would be a steep change of torque just where a path that reaches further turns round.
    """
    low, high = knots[0], knots[-1]
    outside = np.maximum(np.maximum(low - x, x - high), 0.0) / max(margin * (high - low), 1e-12)
    return np.asarray((1.0 - np.minimum(outside, 1.0) ** 3) ** 3)


def signal_of(signals: Signals, name: str) -> Array:
    """The signal ``(N,)`` of a name such as ``q_2``, ``qd_1``, ``qdd_3``, ``load_2``, ``temp_1``, ``t``."""
    if name == "t":
        return signals.t
    kind, _, tail = name.rpartition("_")
    table = {"q": signals.q, "qd": signals.qd, "qdd": signals.qdd, "load": signals.load, "temp": signals.temperature}
    if tail.isdigit() and kind in table:
        values = table[kind]
        # If another recording has no temperature, the term is zero.
        return np.zeros_like(signals.t) if values is None else np.asarray(values[:, int(tail) - 1])
    if name in signals.extra:
        return np.asarray(signals.extra[name])
    return np.zeros_like(signals.t)


@dataclass(frozen=True)
class FittedEffect:
    """An effect with its fitted numbers, as in a model file.

    Attributes:
        name: key of the effect in the library, or ``unknown``.
        joint: joint from 1, or 0 for the whole arm.
        channel: channel in which it was found, e.g. ``tau_3``.
        coefficients, std: linear coefficients ``(m,)`` and their standard deviations.
        theta, theta_std: nonlinear parameters.
        data: data of the fit that the effect needs (e.g. knots and bounds of a spline).
        parameters: the physical numbers for people.
        evidence: p-value, error before and after, kind of held-out data, causes that it cannot be distinguished from.
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
        """The library's effect of this name and channel; InputError where this version does not have it."""
        if self.name == Unknown.name:
            return Unknown.from_data(self.data)
        return find(self.name, prefix_of(self.channel))

    @property
    def domain(self) -> Domain:
        """The domain in which it acts, see ``Effect.domain``."""
        return self.effect.domain

    def contribution(self, signals: Signals) -> Array:
        """What the effect adds to its channels ``(N, c)`` [N m for motor torque, rad or m for positions]."""
        # A file of an earlier version may have fewer coefficients; missing ones are zero.
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
