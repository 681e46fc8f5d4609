"""Terms of joint controllers, in which the command law is linear.

With ``r`` the controller's input and ``e = r - q``, each controller that is linear between command, angle and torque
obeys ``A(s) e = Σ c_k x_k``; a term is an ``x_k`` of the motion, and A the command's own poles
(``ideal_robot.command.law.Shape``). Terms behind the integrator pass ``H = s / (s + 1/T)``: a controller with reset
time T needs that input for its output. The P/PI cascade is ``e = q̇/k_v + H[τ]/(k_p k_v)``, a PD controller that
compensates gravity ``e = (τ - g)/K + (D/K) q̇``, a PID controller ``e + (D/K) H[ė] = H[τ]/K``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.command.motion import Motion


@dataclass(frozen=True)
class Term:
    """One term of the law.

    Attributes:
        name: its key in a model file.
        of: values ``(N, n)`` of all joints for a motion.
        integrated: whether it passes the integrator's filter.
        torque, bodies: whether it needs the motors' torque, and the arm's bodies.
        same: the term without an integrator that it is the same as where there is none.
        moves: whether it is of the motion alone and passes no integrator: a gain of a position loop. The others stand
            for a torque.
        yields: whether its coefficient is a compliance, which is positive.
    """

    name: str
    of: Callable[[Motion], Array]
    integrated: bool = False
    torque: bool = False
    bodies: bool = False
    same: str = ""
    moves: bool = False
    yields: bool = False


TERMS: dict[str, Term] = {term.name: term for term in (
    Term("offset", lambda m: np.ones_like(m.q)),
    Term("velocity", lambda m: m.qd, moves=True),
    Term("acceleration", lambda m: m.qdd, moves=True),
    Term("jerk", lambda m: m.qddd, moves=True),
    Term("direction", lambda m: m.direction),
    Term("integrated_velocity", lambda m: m.qd, integrated=True, same="velocity"),
    Term("integrated_acceleration", lambda m: m.qdd, integrated=True, same="acceleration"),
    Term("integrated_direction", lambda m: m.direction, integrated=True, same="direction"),
    Term("torque", lambda m: m.torque, integrated=True, torque=True, yields=True),  # type: ignore[arg-type, return-value]
    Term("torque_rate", lambda m: m.torque_rate, integrated=True, torque=True),
    Term("gravity", lambda m: m.gravity, integrated=True, bodies=True),
    Term("coriolis", lambda m: m.coriolis, integrated=True, bodies=True),
    Term("bodies", lambda m: m.body, integrated=True, bodies=True, yields=True),
    Term("bodies_rate", lambda m: m.body_rate, integrated=True, bodies=True),
    Term("free_acceleration", lambda m: m.free_acceleration[0], integrated=True, torque=True, bodies=True),
    Term("free_fall", lambda m: m.free_acceleration[1], integrated=True, torque=True, bodies=True),
)}
"""Every term by its name; a new one is a line here."""
