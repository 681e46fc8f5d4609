"""Gear backlash in three forms: crossed with the load, crossed with the motion, and crossed over a finite time."""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects.base import MOTOR_TORQUE, EffectParameter, Theta
from ideal_robot.effects.elasticity import GearEffect
from ideal_robot.effects.loop_change import LoopChange
from ideal_robot.effects.signals import Signals
from ideal_robot.jit import jit

_SECONDS = (0.03, 0.05, 0.07, 0.09, 0.12, 0.16)
"""How long a gap takes to be crossed that is looked for [s]: shorter than that the band does not see, longer ones are
gaps beyond what a gear in use has."""
_SHIFTS = (0.0, -0.15, 0.15)
"""By how much the load may change sign elsewhere than the model has it, as a share of its spread."""


class Backlash(GearEffect):
    """Backlash by load: the arm lies on one side of the gap or the other, ``q_a = q - b tanh(tau_load/w)``.

    Unlike a soft gear's, its deflection does not grow with the load but jumps where the load changes sign. theta is
    ``w``, the load over which the gap is crossed; the coefficient is half the gap ``b``.
    """

    name = "backlash"
    theta_names = ("crossing load",)
    theta_units = ("N m",)
    coefficient_names = ("half gap",)
    coefficient_units = ("rad",)
    source = "M. Nordin, P.-O. Gutman, Automatica 38, 2002: dead zone model"
    slow = 5.0
    """A gap is crossed at once: what the position filter makes of that is not taken for load, up to half as far."""

    def usable(self, signals: Signals, joint: int) -> bool:
        """Whether the signals can show the effect: the load has to change sign; see ``Effect.usable``."""
        return super().usable(signals, joint) and _turns(signals.load[:, joint - 1])

    def starts(self, signals: Signals, joint: int) -> list[Theta]:
        """Start values of theta: fractions of the load; torques show gaps that are crossed slowly, too."""
        factors = (0.05, 0.15, 0.4) if self.domain == MOTOR_TORQUE else (0.05, 0.15)
        return [(_spread(signals, joint) * factor,) for factor in factors]

    def bounds(self, signals: Signals, joint: int) -> list[tuple[float, float]]:
        """Bounds of theta: the gap is crossed within the range of the load; see ``Effect.bounds``."""
        low, high = (0.02, 0.6) if self.domain == MOTOR_TORQUE else (0.01, 0.4)
        size = _spread(signals, joint)
        return [(low * size, high * size)]

    def bend(self, signals: Signals, joint: int, theta: Theta) -> Array:
        """Deflection of the gear for a unit coefficient ``(N,)`` [rad or m]; see ``GearEffect.bend``."""
        return np.asarray(np.tanh(self.load(signals, joint) / theta[0]))

    def plausible(self, coefficients: Array, theta: Theta, signals: Signals, joint: int) -> bool:
        """Whether the coefficients are possible: the load pushes the arm away; in torques the gap is small.

        See ``Effect.plausible``.
        """
        return bool(coefficients[0] > 0.0 and (self.domain != MOTOR_TORQUE or coefficients[0] < 0.02))

    def loop_change(self, coefficients: tuple[float, ...], theta: Theta) -> LoopChange:
        """The change of the loop: backlash that is crossed where the load changes sign; see ``Effect.loop_change``."""
        return LoopChange(half_gap=coefficients[0], gap_load=theta[0])


class BacklashByMotion(GearEffect):
    """Backlash by motion: at a reversal the motor crosses the gap before the arm moves; a play operator of half a gap.

    The coefficient is a share: one of a pure play.
    """

    name = Backlash.name
    theta_names = ("half gap",)
    theta_units = ("rad",)
    coefficient_names = ("share",)
    coefficient_units = ("1",)
    # The arm lags behind its motor: the share is positive.
    within = (0.0, np.inf)
    source = "M. Nordin, P.-O. Gutman, Automatica 38, 2002"

    def starts(self, signals: Signals, joint: int) -> list[Theta]:
        """Start values of theta: small fractions of the range that was driven; see ``Effect.starts``."""
        return [(signals.span(joint) * factor,) for factor in (2e-5, 1e-4, 5e-4, 2e-3)]

    def bounds(self, signals: Signals, joint: int) -> list[tuple[float, float]]:
        """Bounds of theta: a gap, not a range of motion; see ``Effect.bounds``."""
        return [(5e-6 * signals.span(joint), 0.01 * signals.span(joint))]

    def bend(self, signals: Signals, joint: int, theta: Theta) -> Array:
        """Deflection of the gear for a unit coefficient ``(N,)`` [rad or m]; see ``GearEffect.bend``."""
        q = np.ascontiguousarray(signals.q[:, joint - 1])
        return np.asarray(q - play(q, theta[0]))

    def loop_change(self, coefficients: tuple[float, ...], theta: Theta) -> LoopChange:
        """The change of the loop: backlash that is crossed at reversals; the coefficient is a share."""
        return LoopChange(half_gap=coefficients[0] * theta[0])


class BacklashInFlight(GearEffect):
    """Backlash in the motor torque: no load between the flanks, then all of it at once in the impact.

        M d²x/dt² = tau_load  while |x| < b,   q_a = q - x,

    ``M`` the inertia behind the gear and ``b`` half the gap: the load is missing from where it changes sign until the
    gap is crossed, and its impulse comes back in the impact. A crossing takes ``(12 b M/(d tau_load/dt))^(1/3)``, a
    tenth of a second for milliradians; ``Backlash`` is the limit of an instantaneous crossing. If a joint turns little,
    a fit cannot separate weight from a constant motor torque, so the load may change sign elsewhere than in the model:
    theta has this constant as well. The coefficient is one if the inertia is right.
    """

    name = Backlash.name
    theta_names = ("half gap", "load besides")
    theta_units = ("rad", "N m")
    coefficient_names = ("share",)
    coefficient_units = ("1",)
    # The inertia in the free motion is that behind the gear, within the model's accuracy.
    within = (0.4, 2.5)
    source = "M. Nordin, P.-O. Gutman, Automatica 38, 2002: free motion between the flanks"
    nowhere = "how long the gap takes to be crossed depends on the motion"
    slow = 5.0
    """The motor's own jumps at the impacts are not taken for load."""

    def usable(self, signals: Signals, joint: int) -> bool:
        """Whether the needed signals exist and the joint moves enough to show the effect; see ``Effect.usable``.

        There has to be an inertia behind the gear, and a load that changes sign for one of the starts.
        """
        if not super().usable(signals, joint) or len(signals.t) < 3 \
                or float(np.mean(signals.inertia_behind(joint))) <= 0.0:
            return False
        load = self._crossing_load(signals, joint)
        return any(_turns(load + shift) for _, shift in self.starts(signals, joint))

    def starts(self, signals: Signals, joint: int) -> list[Theta]:
        """Start values of theta within the physical bounds; see ``Effect.starts``.

        For each of several crossing times, the gap that the load crosses in that time. Each with several constant
        loads: zero, a small share of the load's variation to either side, and the one that cancels the constant torque.
        """
        load = self._crossing_load(signals, joint)
        size = float(np.std(load)) + 1e-12
        shifts = [share * size for share in _SHIFTS]
        if abs(_constant(signals, joint)) > 0.1 * size:
            shifts.append(-_constant(signals, joint))
        inertia = abs(float(np.mean(signals.inertia_behind(joint)))) + 1e-12
        # If none makes the load change sign, as for a joint at rest, all are kept as starts for another motion.
        turning = [shift for shift in shifts if _turns(load + shift)] or shifts
        rates = np.abs(signals.rate(load))
        starts: list[Theta] = []
        for shift in turning:
            crossings = np.flatnonzero(np.diff(np.sign(load + shift)) != 0)
            rate = float(np.sqrt(np.mean(rates[crossings] ** 2))) if len(crossings) else float(np.std(rates))
            gaps = [seconds**3 * rate / (12.0 * inertia) for seconds in _SECONDS]
            starts += [(gap, shift) for gap in sorted(set(np.clip(gaps, *self.bounds(signals, joint)[0]).tolist()))]
        return starts

    def bounds(self, signals: Signals, joint: int) -> list[tuple[float, float]]:
        """Physical bounds of each theta; see ``Effect.bounds``.

        Bounds of the gap [rad or m] and of the constant load, which is at most as large as the loads of the motion.
        """
        most = 3.0 * float(np.std(signals.load[:, joint - 1])) + 2.0 * abs(_constant(signals, joint)) + 1e-12
        return [(1e-5, 0.02), (-most, most)]

    def bend(self, signals: Signals, joint: int, theta: Theta) -> Array:
        """Deflection of the gear for a unit coefficient ``(N,)`` [rad or m]; see ``GearEffect.bend``."""
        load = self._crossing_load(signals, joint) + theta[1]
        return np.asarray(crossed(load / signals.inertia_behind(joint), signals.dt, theta[0]))

    def _crossing_load(self, signals: Signals, joint: int) -> Array:
        """Slow load with all of the constant torque ``(N,)`` [N m]: a fit knows their sum better than each."""
        return self.load(signals, joint) + _constant(signals, joint)

    def parameters(self, coefficients: Array, std: Array, theta: Theta, theta_std: Theta) -> list[EffectParameter]:
        """The numbers to report: half the gap, as far as the inertia behind the gear is right.

        See ``Effect.parameters``.
        """
        share, sigma = float(coefficients[0]), theta_std[0] if theta_std else 0.0
        return [EffectParameter("half gap", share * theta[0],
                                float(np.hypot(share * sigma, theta[0] * float(std[0]))), "rad")]


@jit()
def play(q: Array, half_gap: float) -> Array:
    """Play operator: the output follows ``q (N,)`` only when it is half a gap away from it.

    >>> play(np.array([0.0, 1.0, 2.0, 1.8, 1.0]), 0.25)
    array([0.  , 0.75, 1.75, 1.75, 1.25])
    """
    follower = np.empty(len(q))
    state = q[0]
    for k in range(len(q)):
        state = min(max(state, q[k] - half_gap), q[k] + half_gap)
        follower[k] = state
    return follower


@jit()
def crossed(acceleration: Array, dt: float, half_gap: float) -> Array:
    """Motor less arm angle ``(N,)`` [rad] in a gap: at a flank under load, in free flight, at rest after impact.

    The result is within plus and minus half a gap.

    Args:
        acceleration: of the motor relative to the unloaded arm, ``tau_load/M`` ``(N,)`` [rad/s²].
        dt: between samples [s].
        half_gap: half the play [rad].
    """
    twist = np.empty(len(acceleration))
    position, speed = (half_gap if acceleration[0] > 0.0 else -half_gap), 0.0
    for k in range(len(acceleration)):
        speed += acceleration[k] * dt
        position += speed * dt
        if position >= half_gap:
            position, speed = half_gap, min(speed, 0.0)
        elif position <= -half_gap:
            position, speed = -half_gap, max(speed, 0.0)
        twist[k] = position
    return twist


def _turns(load: Array) -> bool:
    return 0.02 < float(np.mean(load > 0.0)) < 0.98


def _spread(signals: Signals, joint: int) -> float:
    return float(np.std(signals.load[:, joint - 1])) + 1e-12


def _constant(signals: Signals, joint: int) -> float:
    """Constant torque that the model has beside load and friction [N m]; accelerations have no mean."""
    j = joint - 1
    return float(np.mean(signals.torque[:, j] - signals.friction[:, j] - signals.load[:, j]))
