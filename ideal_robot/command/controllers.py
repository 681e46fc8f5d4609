"""Kinds of joint controllers: the terms of each, and the names of its coefficients.

The search starts from a kind; further functions of a controller (feedforward, compensation, gains that follow the
posture) are terms that the score adds.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Controller:
    """A kind of joint controller.

    Attributes:
        name: in the field's words.
        core: terms that it has at least.
        more: terms that it may have beside them.
        integrator: whether a reset time belongs to it.
        poles: start values [s] of the command's own poles in the search, of ``a_1``, ``a_2`` and ``a_i`` (see
            ``ideal_robot.command.law.Shape``); empty where it has none.
    """

    name: str
    core: tuple[str, ...]
    integrator: bool
    more: tuple[str, ...]
    poles: tuple[tuple[float, float, float], ...] = ()


_WITH_TORQUE = ("acceleration", "direction", "integrated_velocity", "gravity", "coriolis")
_ALONE = ("acceleration", "jerk", "direction", "integrated_direction", "integrated_velocity", "integrated_acceleration",
          "bodies", "bodies_rate", "gravity")
CONTROLLERS: tuple[Controller, ...] = (
    # e = q̇/k_v + H[τ]/(k_p k_v)
    Controller("P/PI cascade", ("velocity", "torque"), True, _WITH_TORQUE),
    # e = (τ - g)/K + (D/K) q̇; without gravity compensation it deflects under gravity.
    Controller("PD control", ("velocity", "torque"), False, _WITH_TORQUE),
    # e + (D/K) H[ė] = H[τ]/K
    Controller("PID control", ("torque",), True, _WITH_TORQUE, poles=((0.0, 0.0, 0.01), (0.0, 0.0, 0.04))),
    # e + 2ζ/ω ė + ë/ω² = (M⁻¹(s τ - h) - q̈)/ω²
    Controller("inverse dynamics", ("acceleration", "free_acceleration", "free_fall"), False, _WITH_TORQUE,
               poles=((0.03, 0.0, 0.0), (0.08, 0.0, 0.0), (0.06, 2e-3, 0.0))),
    # Rigid bodies, at least of a URDF, predict the integrator's torque.
    Controller("cascade or PID control", ("velocity", "bodies", "integrated_direction"), True, _ALONE),
    # Without torques and bodies.
    Controller("lag", ("velocity", "acceleration", "direction"), False, _ALONE),
)
"""Every kind; a new one is a line here."""
