"""The interface of all effects: one physical cause of a residual, its regressor, and its action in the loop.

An effect is *separable*: given its nonlinear parameters theta, what it adds to the channels it acts on is linear in
its coefficients,

    delta y = C(signals, theta) c ,

so that a fit over theta only (variable projection) is small, and so that it can be fitted jointly with everything
else that is linear: base parameters, friction, offsets.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects.loop_change import LoopChange
from ideal_robot.effects.signals import Signals
from ideal_robot.errors import InputError

Theta = tuple[float, ...]
"""Nonlinear parameters of an effect."""
REACH = 3.0
"""By what a single theta is refined about its start, at most."""


@dataclass(frozen=True)
class Domain:
    """One kind of measurement with its residual.

    Attributes:
        name, prefix: key, and first part of its channels' names: ``tau`` for ``tau_1 … tau_n``.
        whole: what an effect of no single joint belongs to, in words.
    """

    name: str
    prefix: str
    whole: str = "the whole arm"


MOTOR_TORQUE = Domain("motor_torque", "tau")
ARM_POSITION = Domain("arm_position", "qa")
TCP_POSITION = Domain("tcp_position", "tcp")
SENSOR = Domain("sensor", "line", "the sensor")
DOMAINS = (MOTOR_TORQUE, ARM_POSITION, TCP_POSITION, SENSOR)


def domain_of(prefix: str) -> Domain:
    """The domain whose channels' names begin with a prefix; raises InputError where there is none."""
    for domain in DOMAINS:
        if domain.prefix == prefix:
            return domain
    raise InputError(f"no such channel; known are those of {', '.join(d.prefix for d in DOMAINS)}", field="channel",
                     value=prefix)


def prefix_of(channel: str) -> str:
    """First part of a channel's name, without the joint's number."""
    first, _, tail = channel.rpartition("_")
    return first if tail.isdigit() else channel


@dataclass(frozen=True)
class EffectParameter:
    """A physical number of a fitted effect.

    Attributes:
        name, unit: name and unit of the number.
        value, std: estimate and its standard deviation.
        limit: ``≤`` or ``≥`` where the value is at a bound of the search, so that it is only a bound and ``std`` has no
            meaning; empty otherwise.
    """

    name: str
    value: float
    std: float
    unit: str
    limit: str = ""

    @property
    def text(self) -> str:
        """The parameter with its uncertainty for people, rounded to the uncertainty."""
        if self.limit:
            return f"{self.name} {self.limit} {self.value:.3g} {self.unit}"
        if not (np.isfinite(self.std) and self.std > 0):
            return f"{self.name} {self.value:.3g} {self.unit}"
        return f"{self.name} {self.value:.3g} ± {self.std:.2g} {self.unit}"

    def to_dict(self) -> dict[str, Any]:
        """The parameter as plain values for JSON; ``std`` is None at a limit."""
        return {"name": self.name, "value": self.value, "std": None if self.limit else self.std, "unit": self.unit,
                **({"limit": self.limit} if self.limit else {})}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> EffectParameter:
        """Reads what ``to_dict`` wrote."""
        std = values["std"]
        return cls(str(values["name"]), float(values["value"]), 0.0 if std is None else float(std),
                   str(values["unit"]), str(values.get("limit", "")))


class Effect(ABC):
    """One physical cause of a residual: its regressor, its bounds and its action in the loop.

    A cause is a subclass in the file of its family, and a line for each channel that shows it in
    ``ideal_robot/effects/registry.py`` (or a call of ``register``, or an entry point, from a package outside).

    Attributes:
        name: of the cause, key in files and tables; the same cause may have a class for each place where it shows.
        domain: the domain in which it acts: one of ``MOTOR_TORQUE``, ``ARM_POSITION``, ``TCP_POSITION``, ``SENSOR``.
        prefix: first part of the name of the channel it is reported in; that of the domain if empty.
        theta_names, theta_units: nonlinear parameters.
        coefficient_names, coefficient_units: linear coefficients, one per column of ``columns``.
        absorbed_by_base: whether an ordinary identified model already has a parameter of the same form, so that the
            effect can only be seen against a model identified before.
        prior: logarithm of its prior odds against another cause, in nats.
        usual: factor on the model error in its direction, as every arm has some of it unmodelled, such as friction near
            standstill and compliant gears.
        learned: whether it is a curve without a physical cause.
        within: open interval in which physics has the first coefficient.
        changes: field of ``LoopChange`` that its coefficient is, or all of them together; empty for ``loop_change``.
        nowhere: why it does not act in the loop; empty where it does.
        discriminating_motion: names of causes that are easily mistaken for this one, with the motion that distinguishes
            them; one of the two causes has to list it.
        source: reference of the equation.
    """

    name: ClassVar[str]
    domain: Domain = MOTOR_TORQUE
    prefix: str = ""
    theta_names: ClassVar[tuple[str, ...]] = ()
    theta_units: ClassVar[tuple[str, ...]] = ()
    coefficient_names: ClassVar[tuple[str, ...]] = ("gain",)
    coefficient_units: ClassVar[tuple[str, ...]] = ("N m",)
    absorbed_by_base: ClassVar[bool] = False
    prior: ClassVar[float] = 0.0
    usual: ClassVar[float] = 0.0
    learned: ClassVar[bool] = False
    within: ClassVar[tuple[float, float]] = (-np.inf, np.inf)
    changes: ClassVar[str] = ""
    nowhere: ClassVar[str] = ""
    discriminating_motion: ClassVar[tuple[tuple[str, str], ...]] = ()
    source: ClassVar[str] = ""

    @classmethod
    def seen_in(cls, prefix: str) -> Self:
        """The effect for the channels of a prefix, where a class serves several."""
        effect = cls()
        if effect.channel_prefix != prefix:
            effect.prefix, effect.domain = prefix, domain_of(prefix.partition("_")[0])
        return effect

    @property
    def channel_prefix(self) -> str:
        """First part of the names of the channels in which it is reported."""
        return self.prefix or self.domain.prefix

    @property
    def key(self) -> str:
        """Name and place, which distinguish the forms of one cause."""
        return f"{self.name}/{self.channel_prefix}"

    @property
    def theta_is_physical(self) -> bool:
        """Whether theta is a physical number with an uncertainty, not only a means to compute the coefficients."""
        return type(self).consistent_theta is Effect.consistent_theta

    @property
    def scanned(self) -> bool:
        """Whether theta is searched in the residual (``starts_from_residual``); a joint may have several."""
        return type(self).starts_from_residual is not Effect.starts_from_residual

    @property
    def at_motor(self) -> bool:
        """Whether it is a torque at the motor, not a delay of the positions or a motion behind the gear."""
        return self.channel_prefix == MOTOR_TORQUE.prefix

    def channel(self, joint: int) -> str:
        """Name of the channel it is reported in; of the whole arm for joint 0."""
        return f"{self.channel_prefix}_{joint}" if joint else self.channel_prefix

    def complete(self, theta: Theta) -> bool:
        """Whether ``theta`` has every parameter; one from a model file of an earlier version may lack some."""
        return len(theta) == len(self.theta_names)

    def joints(self, signals: Signals) -> Iterator[int]:
        """Joints (from 1; 0 for the whole arm) at which the effect may sit."""
        yield from range(1, signals.n + 1)

    def usable(self, signals: Signals, joint: int) -> bool:
        """Whether the needed signals exist and the joint moves enough to show the effect; a TCP needs the frames."""
        return self.domain != TCP_POSITION or signals.frames is not None

    def starts(self, signals: Signals, joint: int) -> list[Theta]:
        """Start values of theta within the physical bounds; one empty tuple for an effect without theta."""
        return [()]

    def starts_from_residual(self, signals: Signals, joint: int, residual: Array,
                             use: np.ndarray) -> tuple[list[Theta], int]:
        """Start values of theta that a residual suggests, and the number of candidates among them; if ``scanned``.

        Args:
            signals: at the rows of the residual, of ``N`` samples.
            joint: from 1.
            residual, use: of all channels of the domain ``(N, c)``, in their units, and the samples of it that are
                used.
        """
        starts = self.starts(signals, joint)
        return starts, len(starts)

    def bounds(self, signals: Signals, joint: int) -> list[tuple[float, float]]:
        """Physical bounds of each theta."""
        return []

    def bounds_near(self, signals: Signals, joint: int, theta: Theta) -> list[tuple[float, float]]:
        """Bounds within which theta is refined from a start; empty where it is not refined.

        By default the physical bounds; for a single parameter a factor of three, for a start of zero none.

        Args:
            signals, joint, theta: as in ``columns``, theta being the start.
        """
        bounds = self.bounds(signals, joint)
        if len(bounds) != len(theta):
            return []
        if len(bounds) == 1:
            if theta[0] == 0.0:
                return []
            (low, high), (near, far) = bounds[0], sorted((theta[0] / REACH, theta[0] * REACH))
            # A start of another model may lie far outside.
            return [(max(low, near), min(high, far))] if max(low, near) < min(high, far) else []
        return bounds

    @abstractmethod
    def columns(self, signals: Signals, joint: int, theta: Theta) -> Array:
        """Columns ``(N, c, m)`` that a unit of each coefficient adds to the channels of the domain.

        Args:
            signals: of ``N`` samples.
            joint: from 1; 0 for the whole arm.
            theta: nonlinear parameters, in ``theta_units``.

        Returns:
            Shape ``(N, c, m)``: N m (N) for motor torques, rad (m) for arm angles, m for the TCP's position, N and
            N m or m for sensors, per unit of the coefficient.
        """

    def like_the_model(self, signals: Signals, joint: int) -> Array | None:
        """Columns ``(N, c, k)`` of the model's own parameters that may cancel a part of this effect; None for none.

        By default None.
        """
        return None

    def plausible(self, coefficients: Array, theta: Theta, signals: Signals, joint: int) -> bool:
        """Whether the coefficients have the sign and size physics allows; by default, whether the first is ``within``.

        Args:
            coefficients: ``(m,)``, in ``coefficient_units``.
            theta, signals, joint: as in ``columns``.
        """
        return bool(self.within[0] < coefficients[0] < self.within[1])

    def spread(self, signals: Signals, joint: int) -> Array | None:
        """Prior covariance of the coefficients ``(m, m)``; None where only the size of their torque is known.

        Args:
            signals, joint: as in ``columns``.
        """
        return None

    def consistent_theta(self, coefficients: Array, theta: Theta) -> Theta:
        """Theta for which the columns are exact with these coefficients ``(m,)``; by default theta itself."""
        return theta

    def settled(self, coefficients: Callable[[Theta], Array | None], theta: Theta) -> Theta:
        """Theta for which the columns are exact with their own coefficients: a fixed point by iteration.

        Args:
            coefficients: those that come out with some theta ``(m,)``, None where physics does not allow them.
            theta: to begin with.
        """
        previous, step = theta, np.inf
        while (own := coefficients(theta)) is not None:
            previous, theta = theta, self.consistent_theta(own, theta)
            last, step = step, float(np.max(np.abs(np.subtract(theta, previous))))
            if step >= last or np.allclose(theta, previous, rtol=0.01):
                break
        return previous

    def parameters(self, coefficients: Array, std: Array, theta: Theta, theta_std: Theta) -> list[EffectParameter]:
        """The physical numbers to report; by default the coefficients and theta as they are.

        Args:
            coefficients, std: estimates ``(m,)``, in ``coefficient_units``, and their standard deviations.
            theta, theta_std: the nonlinear parameters, in ``theta_units``, and theirs.
        """
        # A recording may determine only the first coefficients of some causes.
        linear = zip(self.coefficient_names, coefficients, std, self.coefficient_units, strict=False)
        nonlinear = zip(self.theta_names, theta, theta_std, self.theta_units, strict=True)
        return [EffectParameter(name, float(value), float(s), unit) for name, value, s, unit in (*linear, *nonlinear)]

    def loop_change(self, coefficients: tuple[float, ...], theta: Theta) -> LoopChange:
        """The change of the loop: where the effect acts in the machine, or why it does not act.

        By default the change named by ``changes``; otherwise the motor provides its torque.

        Args:
            coefficients, theta: ``(m,)``, in ``coefficient_units``, and the nonlinear parameters, in ``theta_units``.
        """
        if self.changes:
            amount: Any = coefficients if len(self.coefficient_names) > 1 else coefficients[0]
            return LoopChange(**{self.changes: amount})
        if self.nowhere or self.domain != MOTOR_TORQUE:
            return LoopChange(nowhere=self.nowhere or "the effect does not say where in the machine it acts")
        return LoopChange(torque=True)

    def to_data(self) -> dict[str, Any]:
        """Further data of the effect for a model file, besides name, joint, channel and numbers."""
        return {}


class WholeArmEffect(Effect):
    """An effect that belongs to no joint."""

    def joints(self, signals: Signals) -> Iterator[int]:
        """The whole arm, or the sensor."""
        yield 0
