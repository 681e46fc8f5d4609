"""Effects of drive and logger: motor inertias, errors of the measured torque, and delayed signals."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

import numpy as np
from scipy import ndimage, signal

from ideal_robot.arrays import Array
from ideal_robot.effects.base import ARM_POSITION, TCP_POSITION, Effect, EffectParameter, Theta, WholeArmEffect
from ideal_robot.effects.signals import Signals

HOLD = 5e-4
"""What a torque is early by in every drive, at most [s]: it is held over a cycle of the loop, a millisecond or less,
and acts half a cycle after its stamp in the mean."""


_OFFSET = 0.3
"""What a current sensor is off by, over the dry friction of its joint."""
_GAIN = 0.15
"""What the gain of a drive is off by."""


class CurrentOffset(Effect):
    """Constant torque that the model does not have: ``tau = o``."""

    name = "current_offset"
    coefficient_names = ("offset",)
    absorbed_by_base = True
    changes = "offset"
    source = "[J] section 3: offset of the current sensors"

    def spread(self, signals: Signals, joint: int) -> Array | None:
        """Prior covariance of the coefficients: the offset of a torque is at most a part of the gear's dry friction."""
        return None if signals.dry is None else np.diag((_OFFSET * signals.dry[joint - 1 : joint]) ** 2 + 1e-12)

    def columns(self, signals: Signals, joint: int, theta: Theta) -> Array:
        """Columns of shape ``(N, n, 1)``: ones; see ``Effect.columns``."""
        return signals.on_joint(joint, np.ones_like(signals.t))


class EncoderOffset(Effect):
    """Zero error of the arm-side encoder: ``q_a = q + o``."""

    name = "encoder_offset"
    domain = ARM_POSITION
    coefficient_names = ("offset",)
    coefficient_units = ("rad",)
    absorbed_by_base = True
    nowhere = "it is a matter of the measurement, the arm moves as before"
    discriminating_motion = (("backlash", "a motion on which the gear's load changes its sign: play turns with it"),)
    source = "a constant"

    def columns(self, signals: Signals, joint: int, theta: Theta) -> Array:
        """Columns of shape ``(N, n, 1)``; see ``Effect.columns``."""
        return signals.on_joint(joint, np.ones_like(signals.t))


class DriveGain(Effect):
    """Relative error of a drive's gain: ``tau = g tau_model``, a scaled torque of the joint.

    Inertia and gravity couple the joints, so that the gain of one drive differs from any change of inertias.
    """

    name = "drive_gain"
    coefficient_names = ("relative error of the gain",)
    coefficient_units = ("1",)
    # A gain is positive and within a factor of three; most are right to 10 %.
    within = (-0.7, 2.0)
    absorbed_by_base = True
    changes = "gain"
    source = "[J] (15): drive gains"

    def spread(self, signals: Signals, joint: int) -> Array | None:
        """Prior covariance: magnets differ by some per cent, and lose more with temperature and age."""
        return np.diag([_GAIN**2])

    def columns(self, signals: Signals, joint: int, theta: Theta) -> Array:
        """Columns of shape ``(N, n, 1)``; see ``Effect.columns``."""
        return signals.on_joint(joint, signals.torque[:, joint - 1])


class RotorInertia(Effect):
    """Missing inertia of rotor, brake or coupling times the squared gear ratio: ``tau = I_a qdd``."""

    name = "rotor_inertia"
    coefficient_names = ("change of rotor inertia",)
    coefficient_units = ("kg m²",)
    absorbed_by_base = True
    changes = "rotor_inertia"
    source = "[J] (1): I_a"

    def columns(self, signals: Signals, joint: int, theta: Theta) -> Array:
        """Columns of shape ``(N, n, 1)``; see ``Effect.columns``."""
        return signals.on_joint(joint, signals.qdd[:, joint - 1])


class AxisCoupling(Effect):
    """Coupled axes of a wrist: inertia and friction of a motor that turns at ``qd_j + r qd_i``, ``r = ±1``.

        tau_j = I qdd_i + F_v qd_i + F_c sign(qd_j + r qd_i)      (and, where the shaft transmits it back,
        tau_i = I qdd_j + F_v qd_j + r F_c sign(qd_j + r qd_i)) .

    theta is the partner axis ``i``, the sense ``r`` and the number of joints with the torque: both (2) or only ``j``
    (1).
    """

    name = "axis_coupling"
    theta_names = ("partner axis", "sense", "joints that feel it")
    theta_units = ("", "", "")
    coefficient_names = ("inertia", "viscous friction", "Coulomb friction")
    coefficient_units = ("kg m²", "N m s/rad", "N m")
    discriminating_motion = (("thermal_drift", "the same motion again after an hour's rest: only warming comes back"),)
    source = "J. Swevers et al., IEEE CSM 27(5), 2007; M. Gautier, wrist of the Stäubli RX 90"

    def starts(self, signals: Signals, joint: int) -> list[Theta]:
        """Start values of theta within the physical bounds; see ``Effect.starts``.

        Each partner axis at most two joints away, in both senses, acts on this joint alone. A partner with a lower
        number is tried on both joints, too: such a coupling is named after the higher-numbered joint.
        """
        return [(float(i), sense, sides) for i in range(1, signals.n + 1) if i != joint and abs(i - joint) <= 2
                for sense in (1.0, -1.0) for sides in ((1.0, 2.0) if joint > i else (1.0,))]

    def usable(self, signals: Signals, joint: int) -> bool:
        """Whether the signals can show the effect: there has to be another axis; see ``Effect.usable``."""
        return signals.n > 1

    def columns(self, signals: Signals, joint: int, theta: Theta) -> Array:
        """Columns of shape ``(N, n, 3)``; see ``Effect.columns``."""
        j, i, sense = joint - 1, int(theta[0]) - 1, theta[1]
        together = signals.direction(signals.qd[:, j] + sense * signals.qd[:, i], joint)
        result = signals.on_joint(joint, signals.qdd[:, i], signals.qd[:, i], together)
        if theta[2] > 1.5:
            result[:, i] = np.column_stack([signals.qdd[:, j], signals.qd[:, j], sense * together])
        return result

    def plausible(self, coefficients: Array, theta: Theta, signals: Signals, joint: int) -> bool:
        """Whether the coefficients are possible: inertia and friction of the shaft are not negative.

        See ``Effect.plausible``.

        Small terms may be estimated below zero, down to a fifth of the largest.
        """
        i, sense = int(theta[0]) - 1, theta[1]
        sizes = np.array([np.std(signals.qdd[:, i]), np.std(signals.qd[:, i]), 1.0])
        parts = coefficients * sizes * np.array([sense, sense, 1.0])
        return bool(-np.min(parts) < 0.2 * np.max(parts))

    def parameters(self, coefficients: Array, std: Array, theta: Theta, theta_std: Theta) -> list[EffectParameter]:
        """The numbers to report: the three coefficients and the partner, which is a choice and has no deviation.

        See ``Effect.parameters``.
        """
        return super().parameters(coefficients, std, theta, (0.0,) * 3)


class DeadTime(Effect):
    """A signal is recorded late by ``delta``; the motion itself does not change.

    A delay beyond ``longest`` [s] is implausible; one in the open interval ``held`` [s] is normal, as a drive keeps its
    torque over a cycle (zero-order hold).
    """

    name = "dead_time"
    coefficient_names = ("delay",)
    coefficient_units = ("s",)
    source = "first-order expansion of a pure delay"
    nowhere = "only the record is late: the arm moves as it did"
    longest: ClassVar[float] = 0.06
    held: ClassVar[tuple[float, float]] = (0.0, 0.0)

    def plausible(self, coefficients: Array, theta: Theta, signals: Signals, joint: int) -> bool:
        """Whether the coefficients are possible: milliseconds, and more than a drive's own hold.

        See ``Effect.plausible``.
        """
        low, high = self.held
        return bool(abs(coefficients[0]) < self.longest and not low < coefficients[0] < high)


class LateTorque(DeadTime):
    """Delay of one joint's recorded torque: ``tau_j(t) = tau_model,j(t - delta)``.

    To first order ``-delta d tau_model/dt``, so it is easily mistaken for a soft gear, whose torque is proportional to
    the *second* derivative of the load. The column is the chord ``(tau_model(t - theta) - tau_model(t))/theta``, exact
    where theta has become ``delta``. Negative: the torque is early, i.e. the position is late.
    """

    prior = -3.0  # Clocks are usually common to all joints.
    usual = 1.0

    theta_names = ("chord",)
    theta_units = ("s",)
    discriminating_motion: ClassVar[tuple[tuple[str, str], ...]] = (
        ("joint_elasticity", "the same path at half and at double speed: a delay grows with the torque's rate, a soft "
                             "gear with its second derivative"),
        ("presliding_hysteresis", "long strokes with few reversals at high speed: hysteresis shows after reversals "
                                  "only, a delay everywhere"),
    )
    held = (-HOLD, 0.0)
    _shortest = 5e-5

    def starts(self, signals: Signals, joint: int) -> list[Theta]:
        """Start values of theta: a tangent at zero, and chords to either side; see ``Effect.starts``."""
        return [(delay,) for delay in (1e-3, -1e-3, 8e-3, -8e-3)]

    def bounds(self, signals: Signals, joint: int) -> list[tuple[float, float]]:
        """Bounds of theta: the longest delay to either side; see ``Effect.bounds``."""
        return [(-self.longest, self.longest)]

    def columns(self, signals: Signals, joint: int, theta: Theta) -> Array:
        """Columns of shape ``(N, n, 1)``; see ``Effect.columns``."""
        torque = signals.torque[:, joint - 1]
        return signals.on_joint(joint, (delayed(torque, theta[0], signals.dt) - torque) / theta[0])

    def consistent_theta(self, coefficients: Array, theta: Theta) -> Theta:
        """Theta for which the columns are exact: a chord as long as the delay; see ``Effect.consistent_theta``."""
        delay = float(np.clip(coefficients[0], -self.longest, self.longest))
        return (float(np.copysign(max(abs(delay), self._shortest), delay)),)

    def parameters(self, coefficients: Array, std: Array, theta: Theta, theta_std: Theta) -> list[EffectParameter]:
        """The numbers to report: only the delay; the chord is a means of computation; see ``Effect.parameters``."""
        return [EffectParameter(self.coefficient_names[0], float(coefficients[0]), float(std[0]), "s")]


class CommonDelay(WholeArmEffect, LateTorque):
    """Common delay of all recorded torques: ``tau(t) = tau_model(t - delta)``.

    The logger's clock or bus, an average over its interval, a filter of higher order all act as a delay below their
    corner frequency. One number for the whole arm (joint 0), tried before any joint has a delay of its own; negative
    where the positions are late.
    """

    prior = 0.0
    name = "common_delay"
    discriminating_motion: ClassVar[tuple[tuple[str, str], ...]] = (
        ("torque_filter", "the same path as fast as the arm allows: a filter weakens what is quick, a delay does not"),
    )

    def usable(self, signals: Signals, joint: int) -> bool:
        """Whether the signals can show it: with one joint it would equal that joint's delay; see ``Effect.usable``."""
        return signals.n > 1

    def columns(self, signals: Signals, joint: int, theta: Theta) -> Array:
        """Columns of shape ``(N, n, 1)``; see ``Effect.columns``."""
        late = np.column_stack([delayed(torque, theta[0], signals.dt) for torque in signals.torque.T])
        return np.asarray((late - signals.torque)[:, :, None] / theta[0])


class TorqueFilter(CommonDelay):
    """Common first-order lag of all recorded torques: ``T dtau/dt + tau = tau_model``.

    The column is ``(tau(T) - tau_model)/T`` with theta as ``T``. It is exact once theta equals the coefficient, the
    time constant.
    """

    prior = -2.0  # Every lag is a delay that also damps fast signals, so the simpler delay is more likely.
    name = "torque_filter"
    coefficient_names = ("time constant",)
    held = (-np.inf, 0.0)
    discriminating_motion = ()
    source = "lag of first order"

    def starts(self, signals: Signals, joint: int) -> list[Theta]:
        """Start values of theta: a short and a long one; see ``Effect.starts``."""
        return [(1e-3,), (8e-3,)]

    def bounds(self, signals: Signals, joint: int) -> list[tuple[float, float]]:
        """Bounds of theta: from no filter to the longest; see ``Effect.bounds``."""
        return [(0.0, self.longest)]

    def columns(self, signals: Signals, joint: int, theta: Theta) -> Array:
        """Columns of shape ``(N, n, 1)``; starts in the steady state; see ``Effect.columns``."""
        b, a = signal.bilinear([1.0], [theta[0], 1.0], 1.0 / signals.dt)
        settled = signal.lfilter_zi(b, a)[:, None] * signals.torque[:1]
        late, _ = signal.lfilter(b, a, signals.torque, axis=0, zi=settled)
        return np.asarray((late - signals.torque)[:, :, None] / theta[0])

    def consistent_theta(self, coefficients: Array, theta: Theta) -> Theta:
        """Theta for which the columns are exact: the time constant; see ``Effect.consistent_theta``."""
        return (float(np.clip(coefficients[0], self._shortest, self.longest)),)


class LatePosition(DeadTime):
    """Delay of one joint's recorded position by ``delta``: all torques are computed from an old angle.

    ``delta tau = delta (dtau/dq_j qd_j + dtau/dqd_j qdd_j + dtau/dqdd_j d(qdd_j)/dt)`` on all joints, from differences
    of the rigid body.
    """

    prior = -3.0  # Clocks are usually common to all joints.
    usual = 1.0

    prefix = "q"
    held = (0.0, HOLD)

    def usable(self, signals: Signals, joint: int) -> bool:
        """Whether the signals can show it: with one joint it would equal a negative torque delay."""
        return signals.n > 1 and signals.rigid is not None

    def columns(self, signals: Signals, joint: int, theta: Theta) -> Array:
        """Columns of shape ``(N, n, 1)``; see ``Effect.columns``."""
        if signals.derivatives is None or len(signals.t) < 3:
            return np.zeros((len(signals.t), signals.n, 1))
        j = joint - 1
        column = signals.derivatives.along(joint, signals.qd[:, j], signals.qdd[:, j], signals.rate(signals.qdd[:, j]))
        column[:, j] += signals.rate(signals.torque[:, j] - signals.load[:, j])
        return np.asarray(column[:, :, None])


class LateMeasurement(DeadTime):
    """Delay of an arm angle, of all of them, or of the TCP by ``delta``: to first order ``-delta qd``.

    The channel of a common delay of all arm angles is ``qa_all``.
    """

    domain = ARM_POSITION
    longest = 0.1

    def joints(self, signals: Signals) -> Iterator[int]:
        """Joints with the effect: each joint, and the whole arm where it has more than one; see ``Effect.joints``."""
        if self.channel_prefix == ARM_POSITION.prefix:
            yield from super().joints(signals)
        elif signals.n > 1 or self.domain == TCP_POSITION:
            yield 0

    def columns(self, signals: Signals, joint: int, theta: Theta) -> Array:
        """Columns of shape ``(N, n, 1)``, at the TCP ``(N, 3, 1)``; see ``Effect.columns``."""
        if joint > 0:
            return signals.on_joint(joint, -signals.qd[:, joint - 1])
        if self.domain != TCP_POSITION:
            return np.asarray(-signals.qd[:, :, None])
        if signals.frames is None:
            return np.zeros((len(signals.t), 3, 1))
        return np.asarray(-np.einsum("kij,kj->ki", signals.frames.jacobian, signals.qd)[:, :, None])


def delayed(values: Array, delay: float, dt: float) -> Array:
    """A signal ``(N,)`` delayed by ``delay`` [s], by cubic splines; beyond its ends it is constant.

    Args:
        values: the signal, in any unit.
        delay, dt: the delay, and the time between samples [s].
    """
    return np.asarray(ndimage.shift(values, delay / dt, order=3, mode="nearest"))
