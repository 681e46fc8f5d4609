"""Effects behind the gear as they show at the tool, through the Jacobian."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects.arm.transmission_error import TransmissionError
from ideal_robot.effects.base import TCP_POSITION, Effect, EffectParameter, Signals
from ideal_robot.effects.torque.thermal_drift import warming_bounds, warming_starts

_LEVER = 1e-4
"""A turn about an axis this close to the TCP [m] does not move it."""


class AtTool(Effect):
    """An effect on an arm angle, seen at the TCP: ``delta x = J_j delta q_j``.

    Args:
        inner: the effect on the angle.
    """

    domain = TCP_POSITION

    def __init__(self, inner: Effect) -> None:
        self._inner = inner
        self._by_load = inner.channel(1).startswith("qa_load")
        # A wrapper has the names of what it wraps; they are class attributes there.
        for key in ("name", "theta_names", "theta_units", "coefficient_names", "coefficient_units", "source"):
            setattr(self, key, getattr(inner, key))

    def acts_on(self, channel: str) -> bool:
        """Whether a fitted effect of this name in ``channel`` is this one: some have several forms."""
        return channel.startswith("tcp_load") if self._by_load else \
            channel.startswith("tcp") and not channel.startswith("tcp_load")

    def channel(self, joint: int) -> str:
        """TCP; a gap crossed by the load has a name of its own, as for the arm's angle."""
        return f"tcp_load_{joint}" if self._by_load else f"tcp_{joint}"

    def usable(self, signals: Signals, joint: int) -> bool:
        """As the angle's effect; frames have to be at hand, and a gear between motor and what was measured."""
        return _shows_gears(signals, joint) and self._inner.usable(signals, joint)

    def starts(self, signals: Signals, joint: int) -> list[tuple[float, ...]]:
        """As the angle's effect."""
        return self._inner.starts(signals, joint)

    def bounds(self, signals: Signals, joint: int) -> list[tuple[float, float]]:
        """As the angle's effect."""
        return self._inner.bounds(signals, joint)

    def columns(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> Array:
        """Shape ``(N, 3, m)``."""
        inner = self._inner.columns(signals, joint, theta)[:, joint - 1]
        if signals.frames is None:
            return np.zeros((len(signals.t), 3, inner.shape[1]))
        return np.asarray(signals.frames.jacobian[:, :, joint - 1, None] * inner[:, None, :])

    def plausible(self, coefficients: Array, theta: tuple[float, ...], signals: Signals, joint: int) -> bool:
        """As the angle's effect."""
        return self._inner.plausible(coefficients, theta, signals, joint)

    def parameters(self, coefficients: Array, std: Array, theta: tuple[float, ...],
                   theta_std: tuple[float, ...]) -> list[EffectParameter]:
        """As the angle's effect."""
        return self._inner.parameters(coefficients, std, theta, theta_std)


def _shows_gears(signals: Signals, joint: int) -> bool:
    """Whether the TCP moves with a joint whose gear is between motor and what was measured."""
    if signals.frames is None or not np.any(signals.load[:, joint - 1] != 0.0):
        return False
    return bool(np.max(np.abs(signals.frames.jacobian[:, :, joint - 1])) > _LEVER)


class ToolTransmissionError(TransmissionError):
    """A gear that does not turn evenly, seen at the TCP: ``delta x = J_j (a cos(k q_j) + b sin(k q_j))``."""

    domain = TCP_POSITION

    def usable(self, signals: Signals, joint: int) -> bool:
        """As all gear effects: frames at hand, and a gear between motor and what was measured."""
        return _shows_gears(signals, joint)

    def seen(self, signals: Signals, joint: int, residual: Array,
             use: np.ndarray) -> tuple[Array, np.ndarray]:
        """Residual of the TCP ``(N, 3)`` along the joint's motion, so that its spectrum is that of the angle."""
        if signals.frames is None:
            return np.zeros(len(residual)), use[:, 0]
        lever = signals.frames.jacobian[:, :, joint - 1]
        return np.asarray(np.einsum("ki,ki->k", lever, residual)), np.all(use, axis=1)

    def columns(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> Array:
        """Shape ``(N, 3, 2)``."""
        if signals.frames is None:
            return np.zeros((len(signals.t), 3, 2))
        phase = theta[0] * signals.q[:, joint - 1]
        wave = np.column_stack([np.cos(phase), np.sin(phase)])
        return np.asarray(signals.frames.jacobian[:, :, joint - 1, None] * wave[:, None, :])


class ToolDeadTime(Effect):
    """The TCP measurement is late: ``x(t) = x_kin(t - delta)``, to first order ``-delta J qd``; of the whole arm."""

    name = "dead_time"
    domain = TCP_POSITION
    coefficient_names = ("delay",)
    coefficient_units = ("s",)
    source = "first-order expansion of a pure delay"

    def joints(self, signals: Signals) -> Iterator[int]:
        """The whole arm."""
        yield 0

    def usable(self, signals: Signals, joint: int) -> bool:
        """The frames have to be at hand."""
        return signals.frames is not None

    def columns(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> Array:
        """Shape ``(N, 3, 1)``."""
        if signals.frames is None:
            return np.zeros((len(signals.t), 3, 1))
        return np.asarray(-np.einsum("kij,kj->ki", signals.frames.jacobian, signals.qd)[:, :, None])

    def plausible(self, coefficients: Array, theta: tuple[float, ...], signals: Signals, joint: int) -> bool:
        """Milliseconds, not tenths of a second."""
        return bool(abs(coefficients[0]) < 0.1)


class KinematicError(Effect):
    """Errors of one joint's Denavit–Hartenberg parameters: shifts along and turns about its axis and the common normal.

        delta x = da x_j + dd z_j + dalpha x_j × (x - p_j) + dtheta z_j × (x - p_j)

    ``x_j`` is the common normal of the joint's axis and the next one; it turns with the joint. ``d`` and ``theta`` of
    the first joint are left out: they are where the measuring device stands.
    """

    name = "kinematic_error"
    domain = TCP_POSITION
    coefficient_names = ("a", "d", "alpha", "theta")
    coefficient_units = ("m", "m", "rad", "rad")
    source = "J. Denavit, R. S. Hartenberg 1955; first-order kinematic calibration"

    def usable(self, signals: Signals, joint: int) -> bool:
        """The frames have to be at hand."""
        return signals.frames is not None

    def columns(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> Array:
        """Shape ``(N, 3, 4)``."""
        frames = signals.frames
        if frames is None:
            return np.zeros((len(signals.t), 3, 4))
        x, z = frames.normal[:, joint - 1], frames.axis[:, joint - 1]
        lever = frames.tool - frames.position[:, joint - 1]
        columns = np.stack([x, z, np.cross(x, lever), np.cross(z, lever)], axis=2)
        if joint == 1:
            columns[:, :, [1, 3]] = 0.0
        columns[:, :, np.max(np.abs(columns), axis=(0, 1)) < _LEVER] = 0.0
        return columns

    def parameters(self, coefficients: Array, std: Array, theta: tuple[float, ...],
                   theta_std: tuple[float, ...]) -> list[EffectParameter]:
        """Those that can be seen at all."""
        every = super().parameters(coefficients, std, theta, theta_std)
        return [parameter for parameter in every if parameter.value != 0.0]


class ThermalGrowth(Effect):
    """The link behind a joint grows with warmth: ``delta x = e w (p_(j+1) - p_j)``, ``w`` as in ``thermal_drift``."""

    name = "thermal_growth"
    domain = TCP_POSITION
    theta_names = ("T",)
    theta_units = ("s",)
    coefficient_names = ("strain",)
    coefficient_units = ("1",)
    source = "linear expansion, 12e-6/K for steel, 24e-6/K for aluminium"

    def usable(self, signals: Signals, joint: int) -> bool:
        """The frames have to be at hand."""
        return signals.frames is not None

    def starts(self, signals: Signals, joint: int) -> list[tuple[float, ...]]:
        """By temperature if it varies; by time with constants from a tenth of the recording to three of it."""
        return warming_starts(signals, joint)

    def bounds(self, signals: Signals, joint: int) -> list[tuple[float, float]]:
        """As ``thermal_drift``."""
        return warming_bounds(signals)

    def columns(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> Array:
        """Shape ``(N, 3, 1)``."""
        frames = signals.frames
        if frames is None:
            return np.zeros((len(signals.t), 3, 1))
        if theta[0] > 0.0 or signals.temperature is None:
            warm = 1.0 - np.exp(-signals.t / max(theta[0], 1e-9))
        else:
            warm = signals.temperature[:, joint - 1] - signals.temperature[0, joint - 1]
        end = frames.tool
        if joint < signals.n:
            end, axis = frames.position[:, joint], frames.axis[:, joint]
            if np.allclose(frames.jacobian[:, :, joint], axis, atol=1e-9):
                # Behind the link a joint slides: its way is no length of the link.
                end = end - axis * signals.q[:, joint, None]
        return np.asarray(((end - frames.position[:, joint - 1]) * warm[:, None])[:, :, None])
