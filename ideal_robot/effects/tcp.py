"""Effects behind the gear as they show at the tool, through the Jacobian."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ideal_robot.effects.base import TCP_POSITION, Effect, EffectParameter, Signals
from ideal_robot.effects.thermal_drift import warming_bounds, warming_starts
from ideal_robot.interface import Array


class AtTool(Effect):
    """An effect on an arm angle, seen at the TCP: ``delta x = J_j delta q_j``.

    Args:
        inner: the effect on the angle.
    """

    domain = TCP_POSITION

    def __init__(self, inner: Effect) -> None:
        self._inner = inner
        # A wrapper has the names of what it wraps; they are class attributes there.
        for key in ("name", "theta_names", "theta_units", "coefficient_names", "coefficient_units", "source"):
            setattr(self, key, getattr(inner, key))

    def usable(self, signals: Signals, joint: int) -> bool:
        """As the angle's effect, and the frames have to be at hand."""
        return signals.frames is not None and self._inner.usable(signals, joint)

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
    """Errors of one joint's Denavit–Hartenberg parameters: shifts along and turns about its axis and its normal.

        delta x = da x_j + dd z_j + dalpha x_j × (x - p_j) + dtheta z_j × (x - p_j)
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
        return np.stack([x, z, np.cross(x, lever), np.cross(z, lever)], axis=2)


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
        end = frames.position[:, joint] if joint < signals.n else frames.tool
        return np.asarray(((end - frames.position[:, joint - 1]) * warm[:, None])[:, :, None])
