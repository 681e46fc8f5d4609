"""No correction: the desired position is commanded as it is."""

from __future__ import annotations

from ideal_robot.arrays import Array
from ideal_robot.feedforward.base import Feedforward


class PassThrough(Feedforward):
    """Commands ``q_c(k) = q_d(k)``; the industrial controller alone decides what becomes of it (n_d = 1)."""

    n_d = 1

    def __init__(self, t_ipo: float) -> None:
        self.t_ipo = t_ipo

    def init(self, q0: Array) -> None:
        """See ``Feedforward.init``."""
        return None

    def step(self, state: None, q_d: Array, tau_ext_d: Array | None = None) -> tuple[Array, None]:
        """See ``Feedforward.step``."""
        return q_d[0], None
