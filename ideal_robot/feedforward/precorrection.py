"""Nonlinear precorrection as [G] has it: inverse dynamics, then the inverted controller, at the interpolation cycle.

    τ_d = M(q_d) q̈_d + c + g + τ_f(q̇_d)                                            [G] (8)
    u_d(k) = (τ_d(k) - τ_d(k-1) + u_d(k-1)) / (1 + k_I)                              [G] (18)
    Δq(k) = (u_d(k) + k_D Δq(k-1)/T - k_1 q̇_d(k) - k_2 q̈_d(k)) / (k_P + k_D/T)      [G] (19)
    q_c(k) = q_d(k) + Δq(k)                                                          [G] (20)

At rest τ_d is constant, so u_d and with it Δq fade to zero: the static accuracy is the controller's own. What [G]
leaves out — delay, command low-pass, interpolation, elastic gears — is :mod:`ideal_robot.feedforward.ideal`'s.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ideal_robot.controller_model import ControllerModel
from ideal_robot.errors import InputError
from ideal_robot.feedforward.base import Feedforward
from ideal_robot.interface import Array
from ideal_robot.model import Model
from ideal_robot.robot import Robot


@dataclass(frozen=True)
class PrecorrectionState:
    """What one cycle hands to the next: last desired position, last ``τ_d``, ``u_d``, ``Δq``, each ``(n,)``."""

    q_d: Array
    tau: Array
    u: Array
    correction: Array


class Precorrection(Feedforward):
    """Nonlinear precorrection, [G] (8), (9), (16)–(20).

    Velocity and acceleration of the desired path are central differences, so one position ahead is enough.

    Args:
        model: identified model with a controller.
        robot: cycle time and limits.
        lead: cycles by which the path is looked at ahead of time. 0 is [G]; more undoes that much of the delay of the
            standard path planner and the interpolation, which [G] 5.2.1 calls inevitable.

    Raises:
        InputError: the model has no controller.
    """

    def __init__(self, model: Model, robot: Robot, *, lead: int = 0) -> None:
        if model.controller is None:
            raise InputError("the model holds no controller; identify it from recordings with commands (q_c_i)",
                             field="controller")
        if lead < 0:
            raise InputError("cannot be negative", field="lead", value=lead)
        self.t_ipo, self.lead, self.n_d = robot.t_ipo, lead, lead + 2
        self._torque = model.torque_function()
        self._controller = at_cycle(model.controller, robot.t_ipo)
        self._range = robot.q_min, robot.q_max

    def init(self, q0: Array) -> PrecorrectionState:
        q0 = np.array(q0, dtype=float)
        rest = np.zeros(len(q0))
        return PrecorrectionState(q0, self._torque(q0, rest, rest), rest, rest)

    def step(self, state: PrecorrectionState, q_d: Array, tau_ext_d: Array | None = None
             ) -> tuple[Array, PrecorrectionState]:
        T, gains = self.t_ipo, self._controller
        now = q_d[min(self.lead, len(q_d) - 1)]
        ahead = q_d[self.lead + 1] if len(q_d) > self.lead + 1 else 2 * now - state.q_d
        qd = (ahead - state.q_d) / (2 * T)
        qdd = (ahead - 2 * now + state.q_d) / T**2
        tau = self._torque(now, qd, qdd)
        if tau_ext_d is not None:
            tau = tau - tau_ext_d[min(self.lead, len(tau_ext_d) - 1)]
        u = (tau - state.tau + state.u) / (1 + gains.k_i)
        correction = ((u + gains.k_d * state.correction / T - gains.k_1 * qd - gains.k_2 * qdd)
                      / (gains.k_p + gains.k_d / T))
        q_c = np.clip(now + correction, *self._range)
        return q_c, PrecorrectionState(np.array(now), tau, u, correction)


def at_cycle(controller: ControllerModel, t_cycle: float) -> ControllerModel:
    """The same controller for another cycle: the integral gain of (17) is a share per cycle, the others are rates."""
    values = {**vars(controller), "k_i": controller.k_i * t_cycle / controller.t_cycle, "t_cycle": t_cycle}
    return ControllerModel(**values)
