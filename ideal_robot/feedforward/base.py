"""The interface of all corrections of the command: desired positions over a horizon in, one command out."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, NamedTuple

import numpy as np

from ideal_robot.arrays import Array, held
from ideal_robot.errors import InputError
from ideal_robot.loop.loop import CommandPath
from ideal_robot.robots.interface import RobotState
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import expect

SETTLE = 0.4
"""Time over which an arm at rest takes up its gears' deflection and its own geometry at the start [s]: less than the
0.6 s that it rests before a path."""


FASTEST = 1.5
"""Speed of a command at most, over the arm's limit: one that takes the loop's lag off runs ahead while the path
accelerates, for a moment faster than the arm may move. What is faster than that is no correction of a path."""


class CommandLimits(NamedTuple):
    """Lowest and highest command of each joint, and largest step from one to the next, ``(n,)`` each [rad]."""

    low: Array
    high: Array
    step: Array

    @classmethod
    def of(cls, arm: Robot | CommandPath) -> CommandLimits:
        """Limits of commands by the positions, speeds and cycle of an arm."""
        return cls(arm.q_min, arm.q_max, FASTEST * arm.v_max * arm.t_ipo)

    def within(self, commands: Array) -> Array:
        """Commands ``(…, n)`` [rad] between the lowest and the highest."""
        return np.clip(commands, self.low, self.high)


class Feedforward(ABC):
    """Turns desired joint positions over a horizon into the position commanded now ([L] 2.2).

    State is passed explicitly: ``init`` makes it, ``step`` returns the next one, the object itself never changes.

    Attributes:
        n_d: number of desired positions the law wants, current one included.
        t_ipo: the cycle it was made for [s].
        extends: whether a horizon of fewer rows will do: the path is then continued.
    """

    n_d: int
    t_ipo: float
    extends: bool = False

    @abstractmethod
    def init(self, q0: Array) -> Any:
        """State for an arm at rest at ``q0 (n,)`` [rad]."""

    @abstractmethod
    def step(self, state: Any, q_d: Array, tau_ext_d: Array | None = None) -> tuple[Array, Any]:
        """The command of one interpolation cycle.

        Args:
            state: state from the last ``step`` or ``init``.
            q_d: desired arm positions ``q_d(k) … q_d(k + n_d - 1)``, shape ``(n_d, n)`` [rad]; row 0 is where the
                *arm* shall be at the instant at which this command is handed over.
            tau_ext_d: expected joint torques of contact over the same horizon ``(n_d, n)`` [N m], positive where they
                act on the arm; None for none ([L] 2.2).

        Returns:
            ``q_c (n,)`` [rad] and the next state.
        """

    def observe(self, state: Any, measured: RobotState) -> Any:
        """The next state, given the controller's report at the end of a cycle; by default unchanged."""
        return state

    @property
    def observes(self) -> bool:
        """Whether the controller's reports change the commands, so that each command has to wait for one."""
        return type(self).observe is not Feedforward.observe

    def along(self, q_d: Array) -> Array:
        """Commands ``(N, n)`` [rad] of a whole path ``q_d (N, n)`` [rad] that is known beforehand and ends at rest."""
        state, q_c = self.init(q_d[0]), np.empty_like(q_d)
        ahead = held(q_d, after=self.n_d)
        for k in range(len(q_d)):
            q_c[k], state = self.step(state, ahead[k : k + self.n_d])
        return q_c


def tried(feedforward: Feedforward, q: Array, t_ipo: float) -> Feedforward:
    """The feedforward after one step at rest, so that its compiled code is loaded beforehand.

    Args:
        feedforward: the feedforward, perhaps of another package.
        q, t_ipo: joint angles at rest ``(n,)`` [rad], and the cycle of the commands [s].

    Raises:
        InputError: it is none, was made for another cycle, or does not command each joint.
    """
    expect(feedforward, Feedforward, "feedforward", "make one by ideal_robot.feedforward(key, model, robot)")
    if abs(feedforward.t_ipo - t_ipo) > 1e-9:
        raise InputError(f"the feedforward is made for a cycle of {feedforward.t_ipo:g} s, the arm has {t_ipo:g} s; "
                         "make it for a robot of that cycle (t_ipo)", field="feedforward", value=feedforward.t_ipo)
    match feedforward.step(feedforward.init(q), np.tile(q, (feedforward.n_d, 1))):
        case q_c, _ if np.shape(q_c) == q.shape:
            return feedforward
    raise InputError(f"step has to return a command of shape {q.shape} and the next state", field="feedforward",
                     value=type(feedforward).__name__)


# No correction: the desired position is commanded as it is.

class PassThrough(Feedforward):
    """Commands ``q_c(k) = q_d(k)`` unchanged, without any correction (n_d = 1)."""

    n_d = 1

    def __init__(self, t_ipo: float) -> None:
        self.t_ipo = t_ipo

    def init(self, q0: Array) -> None:
        """State for an arm at rest at ``q0 (n,)`` [rad]; see ``Feedforward.init``."""
        return None

    def step(self, state: None, q_d: Array, tau_ext_d: Array | None = None) -> tuple[Array, None]:
        """The command of one interpolation cycle; see ``Feedforward.step``."""
        return q_d[0], None
