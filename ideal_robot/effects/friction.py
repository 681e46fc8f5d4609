"""Effects of friction: terms that the model lacks, and the influences of load, temperature and reversals.

The laws are those of ``ideal_robot.friction``, the same objects that identification fits.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects.base import Effect, EffectParameter, Theta, WholeArmEffect
from ideal_robot.effects.loop_change import LoopChange
from ideal_robot.effects.signals import Signals
from ideal_robot.friction import laws
from ideal_robot.friction.presliding import dahl

_TURNS = 0.3
"""Change of friction at one end of the speeds, over that at the other, up to which it may have the other sign."""
_SPEED_OR_DISTANCE = ("reversals at very different accelerations: presliding follows the distance since the reversal, "
                      "friction laws the speed")


class LawTerm(Effect):
    """A term of a friction law that the model lacks, or has in another size.

    Attributes:
        law: the law.
        term: index of the term among its columns.
        standstill: end of theta's range, -1 or 1, at which the term acts only near standstill; 0 if none.
    """

    law: ClassVar[type[laws.FrictionModel]]
    term: ClassVar[int]
    standstill: ClassVar[int] = 0

    def columns(self, signals: Signals, joint: int, theta: Theta) -> Array:
        """Columns of shape ``(N, n, 1)``; see ``Effect.columns``."""
        return signals.on_joint(joint, self.friction(signals.qd[:, joint - 1], signals.sliding_direction(joint), theta))

    def friction(self, qd: Array, direction: Array, theta: Theta) -> Array:
        """The term ``(N,)`` with a unit coefficient.

        Args:
            qd, direction: velocities ``(N,)`` [rad/s], and of sliding ``(N,)``, -1 to 1.
            theta: shape of the law, in ``theta_units``.
        """
        return self.law.columns(qd, direction, np.array(theta))[self.term]

    def loop_change(self, coefficients: tuple[float, ...], theta: Theta) -> LoopChange:
        """The change of the loop: friction over speed; see ``Effect.loop_change``."""
        return LoopChange(friction_curve=True)


class Viscous(LawTerm):
    """Viscous friction beyond the model's, positive or negative: ``tau = a_1 qd`` ([G] (1))."""

    name = "viscous"
    law, term = laws.ViscousCoulomb, 0
    coefficient_names = ("change of viscous friction",)
    coefficient_units = ("N m s/rad",)
    absorbed_by_base = True
    source = "[G] (1)"


class Coulomb(LawTerm):
    """Dry friction beyond the model's, positive or negative: ``tau = a_2 sign(qd)`` ([G] (1))."""

    name = "coulomb"
    law, term = laws.ViscousCoulomb, 1
    coefficient_names = ("change of Coulomb friction",)
    absorbed_by_base = True
    source = "[G] (1)"


class Degressive(LawTerm):
    """Degressive friction ``tau = a_3 arctan(a_4 qd)`` ([G] (3)); a small ``a_4`` is close to ``qd^(1/3)`` of [G] (2).

    Physically the rise is upwards, ``a_3 > 0``: with a falling characteristic it is the Stribeck effect.
    """

    name = "degressive"
    law, term = laws.Arctan, 2
    theta_names = ("a_4",)
    theta_units = ("s/rad",)
    coefficient_names = ("a_3",)
    # The coefficient is positive: the friction curve rises and then flattens.
    within = (0.0, np.inf)
    standstill = 1
    discriminating_motion = (("viscous", "constant-velocity runs over the whole range of speeds"),)
    source = "[G] (2), (3)"

    def starts(self, signals: Signals, joint: int) -> list[Theta]:
        """Start values of theta: knee speeds from the recording's top speed down to a fortieth of it."""
        top = _top_speed(signals, joint)
        return [(factor / top,) for factor in (2.0, 4.0, 8.0, 16.0, 40.0)]

    def bounds(self, signals: Signals, joint: int) -> list[tuple[float, float]]:
        """Bounds of theta: the knee lies inside the range of driven speeds; see ``Effect.bounds``."""
        top = _top_speed(signals, joint)
        return [(1.5 / top, 80.0 / top)]


class Stribeck(LawTerm):
    """Stribeck friction ``tau = a_3 sign(qd) exp(-a_4 |qd|)`` with ``a_3 > 0`` ([G] (4), for both directions).

    theta is ``v_s = 1 / a_4``, the speed at which the excess has fallen to 37 %.
    """

    name = "stribeck"
    law, term = laws.Stribeck, 2
    theta_names = ("v_s",)
    theta_units = ("rad/s",)
    coefficient_names = ("excess at standstill",)
    # Friction is larger, not smaller, near standstill.
    within = (0.0, np.inf)
    standstill = -1
    discriminating_motion = (
        ("degressive", "constant-velocity runs at ten speeds, the slowest below 1 % of the highest"),
    )
    source = "[G] (4)"

    def starts(self, signals: Signals, joint: int) -> list[Theta]:
        """Start values of theta: from a fiftieth of the top speed to a third of it; see ``Effect.starts``."""
        top = _top_speed(signals, joint)
        return [(top * factor,) for factor in (0.02, 0.05, 0.1, 0.2, 0.35)]

    def bounds(self, signals: Signals, joint: int) -> list[tuple[float, float]]:
        """Bounds of theta: the decay ends within the range of driven speeds; see ``Effect.bounds``."""
        top = _top_speed(signals, joint)
        return [(0.01 * top, 0.5 * top)]

    def friction(self, qd: Array, direction: Array, theta: Theta) -> Array:
        """The friction term with a unit coefficient: in units of ``v_s`` the law's ``a_4`` is one.

        See ``LawTerm.friction``.
        """
        return self.law.columns(qd / theta[0], direction, np.ones(1))[self.term]


class BellStribeck(Stribeck):
    """Bell-shaped Stribeck friction ``tau = a_3 sign(qd) exp(-(qd/v_s)²)``: flat at standstill, steepest near ``v_s``.

    Which of the two forms a gear has is a matter of its lubricant and its surfaces: exponents from a half to two and
    more are published. If the wrong one of the two is fitted, the residual near standstill looks like ``degressive``.
    """

    law = laws.BellStribeck
    prefix = "tau_bell"
    source = "B. Armstrong-Hélouvry, P. Dupont, C. Canudas de Wit, Automatica 30(7), 1994, (5): exponent 2"

    @property
    def at_motor(self) -> bool:
        """Whether the effect is a torque at the motor; see ``Effect.at_motor``."""
        return True


class AsymmetricFriction(LawTerm):
    """Direction-dependent friction ``tau = d_v |qd| + d_c sign(qd)^2``: half the differences of both directions.

    With ``Fv+, Fv-`` for the two directions ``d_v = (Fv+ - Fv-)/2``, and likewise ``d_c``; while the joint moves
    ``d_c`` cannot be distinguished from a constant offset, so only the viscous part is evidence where an offset is
    fitted too.
    """

    name = "asymmetric_friction"
    law = laws.Asymmetric
    coefficient_names = ("half difference of viscous friction",)
    coefficient_units = ("N m s/rad",)
    source = "A. Janot, M. Gautier, M. Brunot, data set EMPS: friction of a worn ball screw"

    def friction(self, qd: Array, direction: Array, theta: Theta) -> Array:
        """The friction term with a unit coefficient: it adds in one direction what it subtracts in the other.

        See ``LawTerm.friction``.
        """
        forward, _, backward, _ = self.law.columns(qd, direction, np.array(theta))
        return forward - backward


class LoadDependentFriction(Effect):
    """Load-dependent friction ``tau = mu |tau_load - I qdd| sign(qd)`` with ``mu > 0``: the load presses the teeth.

    theta is the inertia ``I`` that the model assigns to the links but that is on the motor's side of the gear: motions
    determine only the sum, while the gear's load depends on the division.
    """

    name = "load_dependent_friction"
    theta_names = ("inertia before the gear",)
    theta_units = ("kg m²",)
    coefficient_names = ("friction per load",)
    coefficient_units = ("1",)
    # Friction rises with the load, by less than the load itself.
    within = (0.0, 1.0)
    changes = "friction_per_load"
    discriminating_motion: ClassVar[tuple[tuple[str, str], ...]] = (
        ("coulomb", "the same strokes at postures of high and of low gravity load"),
    )
    source = "P. Hamon, M. Gautier, P. Garrec, IROS 2010: dry friction depending on load"

    def usable(self, signals: Signals, joint: int) -> bool:
        """Whether the signals can show the effect: the load has to vary, or the effect is Coulomb friction."""
        load = np.abs(signals.borne(joint))
        return bool(np.std(load) > 0.05 * (np.mean(load) + 1e-12))

    def starts(self, signals: Signals, joint: int) -> list[Theta]:
        """Start values of theta: a tenth, half and most of the load's inertia; see ``Effect.starts``."""
        largest = _inertia_of_load(signals, joint)
        return [(share * largest,) for share in (0.1, 0.5, 0.9)]

    def bounds(self, signals: Signals, joint: int) -> list[tuple[float, float]]:
        """Bounds of theta: from none to all of the load's inertia; see ``Effect.bounds``."""
        largest = _inertia_of_load(signals, joint)
        return [(1e-3 * largest, largest)]

    def bounds_near(self, signals: Signals, joint: int, theta: Theta) -> list[tuple[float, float]]:
        """Bounds of theta near a start: the full bounds, as all values are of one scale; see ``Effect.bounds_near``."""
        return self.bounds(signals, joint)

    def columns(self, signals: Signals, joint: int, theta: Theta) -> Array:
        """Columns of shape ``(N, n, 1)``; see ``Effect.columns``."""
        carried, direction = self.carried(signals, joint, theta), signals.sliding_direction(joint)
        return signals.on_joint(joint, laws.FrictionModel.by_load(carried, direction))

    def carried(self, signals: Signals, joint: int, theta: Theta) -> Array:
        """Load of the teeth ``(N,)`` [N m]: load and possible weight, without the inertia on the motor's side.

        Args:
            signals, joint, theta: as in ``columns``, theta being the inertia [kg m²].
        """
        # Files of earlier versions have no theta.
        before = theta[0] if theta else 0.0
        return np.asarray(signals.borne(joint) - before * signals.qdd[:, joint - 1])


class LoadDirectionFriction(LoadDependentFriction):
    """Friction by load while driving only: ``tau = mu/2 (|tau_c| s + tau_c |s|)``, ``tau_c = tau_load - I qdd``.

    With ``s = sign(qd)`` and ``mu > 0`` that is ``mu tau_c`` where the motor drives (``tau_c qd > 0``), and zero where
    the load drives. Losses in both senses are ``load_dependent_friction``; a gear may have both. theta is as there.

    Half of it is proportional to the load itself. If the model's parameters or a gain absorb that half, only the other
    one is seen, which is ``load_dependent_friction`` of half the size. Masses that are known, or seen in other joints,
    distinguish the two.
    """

    name = "load_direction_friction"
    coefficient_names = ("friction per load driven",)
    changes = "friction_per_driven_load"
    discriminating_motion = (
        ("load_dependent_friction", "strokes against and with gravity, of all joints or with masses known from before"),
        ("coulomb", "the same strokes at postures of high and of low gravity load"),
        ("drive_gain", "slow strokes up and down: a gain shows in both alike"),
    )
    source = ("P. Hamon, M. Gautier, P. Garrec, IROS 2010: dry friction depending on load, "
              "other where the load drives than where the motor does")

    def columns(self, signals: Signals, joint: int, theta: Theta) -> Array:
        """Columns of shape ``(N, n, 1)``; see ``Effect.columns``."""
        carried, direction = self.carried(signals, joint, theta), signals.sliding_direction(joint)
        both = laws.FrictionModel.by_load(carried, direction)
        return signals.on_joint(joint, 0.5 * (both + carried * np.abs(direction)))


class PreslidingHysteresis(Effect):
    """Presliding hysteresis ``tau = F (z - sign(qd))``, Dahl's ``z``: friction lags a reversal by a distance ``sigma``.

    The column is the difference to Coulomb friction, so that the coefficient is the part of dry friction that has
    hysteresis; fitted jointly with Coulomb friction itself.
    """

    usual = 1.0
    name = "presliding_hysteresis"
    theta_names = ("sigma",)
    theta_units = ("rad",)
    coefficient_names = ("hysteretic friction",)
    # Friction opposes motion.
    within = (0.0, np.inf)
    discriminating_motion = (
        ("degressive", _SPEED_OR_DISTANCE),
        ("stribeck", _SPEED_OR_DISTANCE),
        ("backlash", "reversals at postures with and without load on the gear"),
    )
    source = "Swevers et al. 2000, cited in [G]; the state of P. R. Dahl 1968"

    def starts(self, signals: Signals, joint: int) -> list[Theta]:
        """Start values of theta: fractions of the joint's driven range; see ``Effect.starts``."""
        return [(signals.span(joint) * factor,) for factor in (0.002, 0.006, 0.02, 0.06)]

    def bounds(self, signals: Signals, joint: int) -> list[tuple[float, float]]:
        """Physical bounds of each theta; see ``Effect.bounds``.

        The distance is far below the joint's driven range; otherwise the effect would be a spring.
        """
        return [(0.0005 * signals.span(joint), 0.15 * signals.span(joint))]

    def columns(self, signals: Signals, joint: int, theta: Theta) -> Array:
        """Columns of shape ``(N, n, 1)``; see ``Effect.columns``."""
        z = dahl(np.ascontiguousarray(signals.q[:, joint - 1]), theta[0])
        return signals.on_joint(joint, z - signals.sliding_direction(joint))

    def loop_change(self, coefficients: tuple[float, ...], theta: Theta) -> LoopChange:
        """The change of the loop: friction builds up over the displacement; see ``Effect.loop_change``."""
        return LoopChange(presliding=theta[0])


class WarmingEffect(Effect):
    """An effect in proportion to warming ``w``: the temperature above the start's [K], or ``w = 1 - exp(-t/T)``.

    The latter is the warm-up of a first-order body. theta is ``T``; ``T = 0`` means that the measured temperature is
    used.
    """

    theta_names = ("T",)
    theta_units = ("s",)

    def starts(self, signals: Signals, joint: int) -> list[Theta]:
        """Start values of theta: time constants of a tenth to three times the recording; temperature if it varies."""
        span = float(signals.t[-1] - signals.t[0])
        starts: list[Theta] = [(span * factor,) for factor in (0.1, 0.3, 1.0, 3.0)]
        if signals.temperature is not None and float(np.ptp(signals.temperature[:, joint - 1])) > 0.5:
            starts.append((0.0,))
        return starts

    def bounds(self, signals: Signals, joint: int) -> list[tuple[float, float]]:
        """Physical bounds of each theta; see ``Effect.bounds``.

        Faster than a twentieth of the recording is not warming; slower than four times its length is a straight line.
        """
        span = float(signals.t[-1] - signals.t[0])
        return [(0.05 * span, 4.0 * span)]

    def warmth(self, signals: Signals, joint: int, theta: Theta) -> Array:
        """The warming ``w (N,)`` [1 or K]; zero for a temperature that was not measured.

        Args:
            signals, joint, theta: as in ``columns``, theta being ``T`` [s].
        """
        if theta[0] > 0.0:
            return signals.over_time(lambda t: 1.0 - np.exp(-t / theta[0]))
        if signals.temperature is None:
            return np.zeros_like(signals.t)
        return np.asarray(signals.temperature[:, joint - 1] - signals.temperature[0, joint - 1])


class ThermalDrift(WarmingEffect):
    """Change of viscous and dry friction with the gear's temperature: ``tau = w (d_v qd + d_c sign(qd))``."""

    name = "thermal_drift"
    coefficient_names = ("change of viscous friction", "change of Coulomb friction")
    coefficient_units = ("N m s/rad", "N m")
    source = "[G] Figs 3, 12"
    nowhere = ("how warm a gear is when a path begins does not follow from the time since a "
               "recording began; method adapted follows friction while the arm works")

    def columns(self, signals: Signals, joint: int, theta: Theta) -> Array:
        """Columns of shape ``(N, n, 2)``; see ``Effect.columns``."""
        warm = self.warmth(signals, joint, theta)
        friction = laws.ViscousCoulomb.columns(signals.qd[:, joint - 1], signals.sliding_direction(joint), np.empty(0))
        return signals.on_joint(joint, *(warm * column for column in friction))

    def plausible(self, coefficients: Array, theta: Theta, signals: Signals, joint: int) -> bool:
        """Whether the coefficients are possible: a gear that warms up loses friction at all speeds ([G] Fig. 12).

        See ``Effect.plausible``.

        A change of sign over speed is another friction curve, not another temperature.
        """
        top = signals.top_speed(joint)
        slow, fast = float(coefficients[1]), float(coefficients[1] + coefficients[0] * top)
        return slow * fast > -_TURNS * max(slow**2, fast**2)

    def parameters(self, coefficients: Array, std: Array, theta: Theta, theta_std: Theta) -> list[EffectParameter]:
        """The numbers to report: changes per kelvin where temperature was used; see ``Effect.parameters``."""
        if theta[0] > 0.0:
            return super().parameters(coefficients, std, theta, theta_std)
        units = ("N m s/(rad K)", "N m/K")
        return [EffectParameter(name, float(value), float(s), unit) for name, unit, value, s in
                zip(self.coefficient_names, units, coefficients, std, strict=True)]


class Warmth(WholeArmEffect):
    """Temperature of all gears differs from the identification: ``tau = d F_j z_j + f (tau_f,j - F_j z_j)``.

    Oil and seals of all joints change together: dry friction by one share, the speed-dependent part by another.
    Differences of single joints belong to their own friction.
    """

    name = "warmth"
    coefficient_names = ("change of dry friction", "change of friction that rises with speed")
    coefficient_units = ("1", "1")
    absorbed_by_base = True
    prior = 1.0  # Arms are often colder than in the identification.
    source = "[G] Figs 3, 12"

    def usable(self, signals: Signals, joint: int) -> bool:
        """Whether the signals can show the effect: the model has to have friction; see ``Effect.usable``."""
        return signals.dry is not None and bool(np.any(signals.dry > 0.0))

    def columns(self, signals: Signals, joint: int, theta: Theta) -> Array:
        """Columns of shape ``(N, n, 2)``; see ``Effect.columns``."""
        if signals.dry is None:
            return np.zeros((len(signals.t), signals.n, 2))
        dry = signals.dry * np.column_stack([signals.sliding_direction(j + 1) for j in range(signals.n)])
        return np.stack([dry, signals.friction - dry], axis=2)

    def spread(self, signals: Signals, joint: int) -> Array | None:
        """Prior covariance: over 20 K dry friction differs by 10 to 20 %, the rest by half ([G] Fig. 12)."""
        return np.diag([0.3**2, 1.0])

    def plausible(self, coefficients: Array, theta: Theta, signals: Signals, joint: int) -> bool:
        """Whether the coefficients are possible: total friction still brakes at all speeds.

        See ``Effect.plausible``.
        """
        return bool(-1.0 < coefficients[0] < 2.0 and -1.0 < coefficients[1] < 5.0)

    def loop_change(self, coefficients: tuple[float, ...], theta: Theta) -> LoopChange:
        """The change of the loop: friction of all joints; see ``Effect.loop_change``."""
        return LoopChange(friction_shares=(coefficients[0], coefficients[1]))


def _top_speed(signals: Signals, joint: int) -> float:
    return signals.top_speed(joint) + 1e-12


def _inertia_of_load(signals: Signals, joint: int) -> float:
    """Slope of the load over the joint's acceleration [kg m²]."""
    qdd = signals.qdd[:, joint - 1] - np.mean(signals.qdd[:, joint - 1])
    return max(float(qdd @ signals.load[:, joint - 1] / (qdd @ qdd + 1e-12)), 1e-9)
