"""Play in the gear: the motor turns back a little before the arm does."""

from __future__ import annotations

import numba
import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects.base import ARM_POSITION, Effect, EffectParameter, Signals
from ideal_robot.effects.torque.joint_elasticity import JointElasticity


@numba.njit(cache=True)
def play(q: Array, half_gap: float) -> Array:
    """Play operator: the output follows ``q (N,)`` only when it is half a gap away from it."""
    follower = np.empty(len(q))
    state = q[0]
    for k in range(len(q)):
        state = min(max(state, q[k] - half_gap), q[k] + half_gap)
        follower[k] = state
    return follower


class Backlash(JointElasticity):
    """Seen in the motor torque: the arm lies on one side of the gap or the other, ``q_a = q - b tanh(tau_load/w)``.

    As a soft gear, but what it bends by does not grow with the load: it jumps where the load changes sign. theta is
    ``w``, the load over which it crosses; the coefficient is half the gap ``b``.
    """

    name = "backlash"
    theta_names = ("crossing load",)
    theta_units = ("N m",)
    coefficient_names = ("half gap",)
    coefficient_units = ("rad",)
    source = "M. Nordin, P.-O. Gutman, Automatica 38, 2002: dead zone model"

    def usable(self, signals: Signals, joint: int) -> bool:
        """The load has to change sign."""
        load = signals.load[:, joint - 1]
        return signals.rigid is not None and 0.02 < float(np.mean(load > 0.0)) < 0.98

    def starts(self, signals: Signals, joint: int) -> list[tuple[float, ...]]:
        """Fractions of the load."""
        size = float(np.std(signals.load[:, joint - 1])) + 1e-12
        return [(size * factor,) for factor in (0.05, 0.15, 0.4)]

    def bounds(self, signals: Signals, joint: int) -> list[tuple[float, float]]:
        """Sharper than the load itself."""
        size = float(np.std(signals.load[:, joint - 1])) + 1e-12
        return [(0.02 * size, 0.6 * size)]

    def bend(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> Array:
        """What a unit coefficient bends the gear by ``(N,)``."""
        return np.asarray(np.tanh(self.slow_load(signals, joint) / theta[0]))

    def plausible(self, coefficients: Array, theta: tuple[float, ...], signals: Signals, joint: int) -> bool:
        """A gap, not a range of motion."""
        return bool(0.0 < coefficients[0] < 0.02)

    def parameters(self, coefficients: Array, std: Array, theta: tuple[float, ...],
                   theta_std: tuple[float, ...]) -> list[EffectParameter]:
        """Half the gap and the crossing load."""
        return Effect.parameters(self, coefficients, std, theta, theta_std)


class ArmBacklashByLoad(Effect):
    """Seen in the arm's position, load deciding: ``q_a - q = -b tanh(tau_load/w)``."""

    name = "backlash"
    domain = ARM_POSITION
    theta_names = ("crossing load",)
    theta_units = ("N m",)
    coefficient_names = ("half gap",)
    coefficient_units = ("rad",)
    source = "M. Nordin, P.-O. Gutman, Automatica 38, 2002: dead zone model"

    def usable(self, signals: Signals, joint: int) -> bool:
        """The load has to change sign."""
        return 0.02 < float(np.mean(signals.load[:, joint - 1] > 0.0)) < 0.98

    def starts(self, signals: Signals, joint: int) -> list[tuple[float, ...]]:
        """Fractions of the load."""
        size = float(np.std(signals.load[:, joint - 1])) + 1e-12
        return [(size * factor,) for factor in (0.05, 0.15)]

    def bounds(self, signals: Signals, joint: int) -> list[tuple[float, float]]:
        """Much sharper than the load itself."""
        size = float(np.std(signals.load[:, joint - 1])) + 1e-12
        return [(0.01 * size, 0.4 * size)]

    def acts_on(self, channel: str) -> bool:
        """Reported with its own channel name, to be told from the play of motion."""
        return channel.startswith("qa_load")

    def channel(self, joint: int) -> str:
        """Arm angle, gap crossed by the load."""
        return f"qa_load_{joint}"

    def columns(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> Array:
        """Shape ``(N, n, 1)``."""
        return signals.on_joint(joint, -np.tanh(signals.load[:, joint - 1] / theta[0]))

    def plausible(self, coefficients: Array, theta: tuple[float, ...], signals: Signals, joint: int) -> bool:
        """The load pushes the arm away, not towards itself."""
        return bool(coefficients[0] > 0.0)


class ArmBacklash(Effect):
    """Seen in the arm's position: ``q_a - q`` follows the play operator of half a gap."""

    name = "backlash"
    domain = ARM_POSITION
    theta_names = ("half gap",)
    theta_units = ("rad",)
    coefficient_names = ("share",)
    coefficient_units = ("1",)
    source = "M. Nordin, P.-O. Gutman, Automatica 38, 2002"

    def acts_on(self, channel: str) -> bool:
        """Not the gap that the load crosses."""
        return super().acts_on(channel) and not channel.startswith("qa_load")

    def starts(self, signals: Signals, joint: int) -> list[tuple[float, ...]]:
        """Small fractions of the range that was driven."""
        span = float(np.ptp(signals.q[:, joint - 1])) + 1e-12
        return [(span * factor,) for factor in (2e-5, 1e-4, 5e-4, 2e-3)]

    def bounds(self, signals: Signals, joint: int) -> list[tuple[float, float]]:
        """A gap, not a range of motion."""
        span = float(np.ptp(signals.q[:, joint - 1])) + 1e-12
        return [(5e-6 * span, 0.01 * span)]

    def columns(self, signals: Signals, joint: int, theta: tuple[float, ...]) -> Array:
        """Shape ``(N, n, 1)``: scaled by the gap so that the coefficient of a pure play is one."""
        q = np.ascontiguousarray(signals.q[:, joint - 1])
        return signals.on_joint(joint, play(q, theta[0]) - q)

    def plausible(self, coefficients: Array, theta: tuple[float, ...], signals: Signals, joint: int) -> bool:
        """The arm lags."""
        return bool(coefficients[0] > 0.0)
