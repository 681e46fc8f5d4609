"""The seam of all effects: one physical cause of a residual, its regressor, and what it became when fitted.

An effect is *separable*: given its nonlinear parameters theta, what it adds to the channels it acts on is linear in
its coefficients,

    delta y = C(signals, theta) c ,

so that a fit over theta only (variable projection) is small, and so that it can be fitted jointly with everything
else that is linear: base parameters, friction, offsets.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from ideal_robot.arrays import Array

MOTOR_TORQUE = "motor_torque"
ARM_POSITION = "arm_position"
TCP_POSITION = "tcp_position"
SENSOR = "sensor"

RigidBody = Callable[[Array, Array, Array], Array]
"""Rigid-body torque ``(N, n)`` of ``q, qd, qdd`` ``(N, n)`` each, without friction and rotors."""


@dataclass(frozen=True)
class Frames:
    """Kinematics along a motion.

    Attributes:
        axis: joint axes in the base frame ``(N, n, 3)``.
        normal: a direction of each joint's frame across its axis ``(N, n, 3)``.
        position: origins of the joint frames ``(N, n, 3)`` [m].
        tool: TCP ``(N, 3)`` [m].
        jacobian: of the TCP's position ``(N, 3, n)``.
    """

    axis: Array
    normal: Array
    position: Array
    tool: Array
    jacobian: Array


@dataclass(frozen=True)
class Signals:
    """What effects may look at: everything on one uniform time grid of ``N`` samples.

    Attributes:
        t: time since the start of the recording ``(N,)`` [s].
        q, qd, qdd: motor position, velocity and acceleration on the joint side ``(N, n)`` [rad or m, SI].
        load: torque at the gear output, i.e. of the rigid body without friction and rotors ``(N, n)`` [N m].
        torque: what the model so far predicts for the motor ``(N, n)`` [N m].
        friction: the part of ``torque`` that is friction ``(N, n)`` [N m].
        temperature: gear temperature ``(N, n)`` [°C], or None where it was not measured.
        rigid: the rigid body as a function, for effects that change positions; None where there is none.
        extra: further columns by name ``(N,)``, e.g. those of the sensor loop.
        frames: kinematics along the motion, or None.
        payload: regressor ``(N, n, 10)`` of a body rigidly on the last link (mass, first moments, inertias), or None.
        cutoff: of the zero-phase filter that the positions went through [Hz]; None where they are exact.
        v_small: velocity below which the direction of motion is lost in noise ``(n,)`` [rad/s]; None for exact data.
        sliding: direction of sliding ``(N, n)``, -1 to 1, of joints whose friction in the model builds up over a
            displacement, NaN for others; None where no model says so.
    """

    t: Array
    q: Array
    qd: Array
    qdd: Array
    load: Array
    torque: Array
    friction: Array
    temperature: Array | None = None
    rigid: RigidBody | None = None
    extra: Mapping[str, Array] = field(default_factory=dict)
    payload: Array | None = None
    frames: Frames | None = None
    v_small: Array | None = None
    cutoff: float | None = None
    sliding: Array | None = None

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.q.shape[1])

    @property
    def dt(self) -> float:
        """Sampling interval [s]; 1 for a single sample, where nothing may depend on it."""
        return float(self.t[1] - self.t[0]) if len(self.t) > 1 else 1.0

    def direction(self, qd: Array, joint: int) -> Array:
        """Sign of a velocity ``(N,)`` of ``joint`` (from 1), smooth where it is lost in noise."""
        if self.v_small is None:
            return np.sign(qd)
        return np.tanh(qd / self.v_small[joint - 1])

    def sliding_direction(self, joint: int) -> Array:
        """Direction ``(N,)`` in which dry friction of ``joint`` (from 1) acts, with the memory that the model gives it.

        What belongs to dry friction builds up after a reversal like dry friction itself.
        """
        if self.sliding is not None and len(self.t) and np.isfinite(self.sliding[0, joint - 1]):
            return np.asarray(self.sliding[:, joint - 1])
        return self.direction(self.qd[:, joint - 1], joint)

    def on_joint(self, joint: int, *columns: Array) -> Array:
        """Columns ``(N,)`` that act on one joint (from 1) only, as ``(N, n, m)``."""
        result = np.zeros((len(self.t), self.n, len(columns)))
        for i, column in enumerate(columns):
            result[:, joint - 1, i] = column
        return result

    def rate(self, values: Array) -> Array:
        """Time derivative ``(N, …)`` by central differences; zero for a single sample."""
        if len(self.t) < 3:
            return np.zeros_like(values)
        return np.gradient(values, self.dt, axis=0)


@dataclass(frozen=True)
class EffectParameter:
    """A physical number of a fitted effect.

    Attributes:
        name, unit: what it is.
        value, std: estimate and its standard deviation.
    """

    name: str
    value: float
    std: float
    unit: str

    def to_dict(self) -> dict[str, Any]:
        """The parameter as plain values for JSON."""
        return {"name": self.name, "value": self.value, "std": self.std, "unit": self.unit}


class Effect(ABC):
    """One physical cause of a residual.

    Attributes:
        name: key in files and tables.
        domain: where it acts: one of ``MOTOR_TORQUE``, ``ARM_POSITION``, ``TCP_POSITION``, ``SENSOR``.
        theta_names, theta_units: nonlinear parameters.
        coefficient_names: linear coefficients, one per column of ``columns``.
        in_base: whether an ordinary identified model already has a parameter of the same form, so that the effect can
            only be seen against a model identified before.
        theta_is_physical: False where theta only serves the computation and has no uncertainty of its own.
        source: where the equation comes from.
    """

    name: ClassVar[str]
    domain: ClassVar[str] = MOTOR_TORQUE
    theta_names: ClassVar[tuple[str, ...]] = ()
    theta_units: ClassVar[tuple[str, ...]] = ()
    coefficient_names: ClassVar[tuple[str, ...]] = ("gain",)
    coefficient_units: ClassVar[tuple[str, ...]] = ("N m",)
    in_base: ClassVar[bool] = False
    theta_is_physical: ClassVar[bool] = True
    source: ClassVar[str] = ""

    def acts_on(self, channel: str) -> bool:
        """Whether a fitted effect of this name in ``channel`` is one of these."""
        heads = {MOTOR_TORQUE: ("tau",), ARM_POSITION: ("qa",), TCP_POSITION: ("tcp",), SENSOR: ("line", "force")}
        return channel.startswith(heads[self.domain])

    def channel(self, joint: int) -> str:
        """Name of the channel it is reported in."""
        head = {MOTOR_TORQUE: "tau", ARM_POSITION: "qa", TCP_POSITION: "tcp", SENSOR: "line"}[self.domain]
        return f"{head}_{joint}" if joint else head

    def joints(self, signals: Signals) -> Iterator[int]:
        """Joints (from 1; 0 for the whole arm) at which the effect may sit."""
        yield from range(1, signals.n + 1)

    def usable(self, signals: Signals, joint: int) -> bool:
        """Whether the signals it needs are there and the joint moves enough for it to show."""
        return True

    def starts(self, signals: Signals, joint: int) -> list[tuple[float, ...]]:
        """Values of theta to start from, within the physical bounds; one empty tuple where there is no theta."""
        return [()]

    def bounds(self, signals: Signals, joint: int) -> list[tuple[float, float]]:
        """Physical bounds of each theta."""
        return []

    @abstractmethod
    def columns(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> Array:
        """What a unit of each coefficient adds to the channels ``(N, n, m)``."""

    def plausible(self, coefficients: Array, theta: tuple[float, ...], signals: Signals, joint: int) -> bool:
        """Whether the coefficients have the sign and size physics allows."""
        return True

    def agreeing(self, coefficients: Array, theta: tuple[float, ...]) -> tuple[float, ...]:
        """Theta with which the coefficients are exact; by default as it is, for a physical one is fitted."""
        return theta

    def parameters(self, coefficients: Array, std: Array, theta: tuple[float, ...],
                   theta_std: tuple[float, ...]) -> list[EffectParameter]:
        """The physical numbers to report; by default the coefficients and theta as they are."""
        linear = [EffectParameter(name, float(value), float(s), unit) for name, unit, value, s in
                  zip(self.coefficient_names, self.coefficient_units, coefficients, std, strict=True)]
        return linear + [EffectParameter(name, float(value), float(s), unit) for name, unit, value, s in
                         zip(self.theta_names, self.theta_units, theta, theta_std, strict=True)]


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
    def domain(self) -> str:
        """Where it acts: see ``Effect.domain``."""
        heads = {"qa": ARM_POSITION, "tcp": TCP_POSITION, "line": SENSOR, "force": SENSOR}
        return heads.get(self.channel.split("_")[0], MOTOR_TORQUE)

    def contribution(self, signals: Signals) -> Array:
        """What the effect adds to its channels ``(N, n)`` [N m for motor torque, rad or m for positions]."""
        from ideal_robot.effects import effect_of

        columns = effect_of(self).columns(signals, self.joint, self.theta)
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
            parameters=tuple(EffectParameter(str(p["name"]), float(p["value"]), float(p["std"]), str(p["unit"]))
                             for p in values.get("parameters", ())),
            evidence=dict(values.get("evidence", {})),
        )
