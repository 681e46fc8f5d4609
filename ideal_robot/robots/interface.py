"""The manufacturer's positional interface, and nothing else of the controller."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from ideal_robot.arrays import Array


@dataclass(frozen=True, slots=True)
class RobotState:
    """What the controller tells at one interpolation cycle.

    Attributes:
        t: controller time at which ``q`` and ``tau`` were valid [s].
        q: motor angles on the joint side, shape ``(n,)`` [rad]. Not the arm angles: gears are elastic ([L] 2.1).
        tau: motor torque on the joint side, measured current times drive gain, shape ``(n,)`` [N m].
    """

    t: float
    q: Array
    tau: Array


class RobotInterface(Protocol):
    """A position-controlled arm: one command in, one state out, per interpolation cycle.

    A simulated arm is one implementation, a real arm behind KUKA RSI another.
    """

    t_ipo: float
    """Interpolation cycle [s]: 12 ms for a KRC1 ([G] 5.2.1), 4 ms on newer controllers."""

    def cycle(self, q_c: Array) -> RobotState:
        """Hands over the commanded joint angles ``q_c (n,)`` [rad] and waits one interpolation cycle.

        Returns the state at the end of the cycle.
        """
        ...
