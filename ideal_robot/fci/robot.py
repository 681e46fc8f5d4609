"""An arm behind Franka's Control Interface (FCI), as one more implementation of ``RobotInterface``.

The controller is the clock: a state comes every millisecond, and its own time, not that of its arrival, is the
recording's. Every millisecond is answered by ``ideal_robot.fci.milliseconds``, from the commands of a longer cycle.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.fci.milliseconds import AXES, PERIOD, FciError, FciState, Here, Process, Wanted
from ideal_robot.interfaces import LinkSettings
from ideal_robot.robots.address import Address
from ideal_robot.robots.interface import LinkCounts, LinkedRobot, RobotState
from ideal_robot.robots.robot import Robot
from ideal_robot.tolerances import ROUNDING

_TAKES = 4e-3
"""Time that a computer with other work takes for a command at most, but for a few [s]."""
_HORIZON = 0.1
"""How far commands that are expected reach ahead [s]: longer than a computer usually stands still."""
_LONGEST_QUEUE = 100.0
"""Longest queue that can be asked for [ms]."""
_WRENCH = ("fx", "fy", "fz", "mx", "my", "mz")


@dataclass
class FciCounts(LinkCounts):
    """Statistics of the link: ``late`` is the number of milliseconds without an answer.

    Attributes:
        replaced: cycles in which an expected command was used, as the real one came late or never.
    """

    replaced: int = 0


class FciRobot(LinkedRobot):
    """A ``RobotInterface`` to a Franka arm.

    Args:
        robot: seven joints, limits, and a cycle of whole milliseconds.
        host: address of the controller.
        cartesian: whether the controller's Cartesian impedance holds the commanded joints, not its joint impedance.
        queue: delay after which a command is executed [s]; None: 4 ms, rounded up to whole cycles, so that the arm's
            command law has a dead time of whole cycles.
        waits: whether the controller, a simulated one, waits for each answer: then this process gives them, between two
            commands that it computes. Else a process of its own does.
        bridge: how long states may be missing [s].
        answers_within: time in which the arm's loop answers a command, for the watch over following [s].

    Raises:
        InputError: an arm without seven joints, a cycle or a queue that is no whole number of milliseconds.
    """

    lost_link, packets = FciError, "states"

    def __init__(self, robot: Robot, host: str, *, cartesian: bool = False, queue: float | None = None,
                 waits: bool = False, bridge: float = 0.1, answers_within: float = 0.3) -> None:
        steps = round(robot.t_ipo / PERIOD)
        if robot.n != AXES:
            raise InputError(f"FCI moves arms with {AXES} joints", field="robot", value=f"{robot.name}: {robot.n}")
        if steps < 1 or not math.isclose(steps * PERIOD, robot.t_ipo):
            raise InputError("FCI has a cycle of 1 ms; expected whole milliseconds", field="--cycle", value=robot.t_ipo)
        if queue is None:
            queue = math.ceil(_TAKES / robot.t_ipo - ROUNDING) * robot.t_ipo
        if queue < 0.0 or not math.isclose(round(queue / PERIOD) * PERIOD, queue):
            raise InputError("expected whole milliseconds", field="queue", value=queue)
        super().__init__(robot, bridge, answers_within)
        self.counts = FciCounts()
        self.horizon = max(math.ceil(_HORIZON / robot.t_ipo), 2)
        self.host, self._queue, self._waits = host, round(queue / PERIOD), waits
        self._wanted_of = Wanted(host, cartesian, 0.0, steps, self._queue, 2.0 * self._room,
                                 np.where(np.isfinite(robot.v_max), robot.v_max, 1.0))
        self._arm: Here | Process | None = None
        self._first = self._cycle = self._late = 0
        self._begun = False

    def connect(self, patience: float = 60.0) -> RobotState:
        """Connects to the controller; the motion itself begins with the first command.

        Returns the state at rest, ``t = 0``. ``commanded`` is then the controller's setpoint.

        Raises:
            FciError: no controller within ``patience`` [s], or an arm that cannot be commanded now.
        """
        self._arm = (Here if self._waits else Process)(self._wanted_of._replace(patience=patience))
        self._cycle, self._late, self._begun = 0, 0, False
        state = self._arm.rest
        self._first, self.arrived = state.tick, time.perf_counter()
        self._at_rest(state.q_d, state.q)
        return self._state(state)

    @property
    def meta(self) -> dict[str, float]:
        """Delay after which a command is executed [ms], for the recording's metadata."""
        return {"fci_queue_ms": float(self._queue)}

    def _stands_now(self) -> Array | None:
        if self._arm is None or self._begun:
            return None
        now, self.arrived = self._arm.look().q, time.perf_counter()
        return now

    def _handed_over(self, q_c: Array) -> None:
        assert self._arm is not None
        self._begun = True
        self._arm.command(self._cycle, self._with_ahead(q_c))

    def _received(self) -> RobotState:
        """See ``LinkedRobot.receive``: waits for the cycle's end.

        Raises FciError where the controller has stopped the arm, or was not heard for too long.
        """
        if self._arm is None or not self._begun:
            raise FciError("send a command before waiting for its state")
        *older, report = self._arm.reports()
        self.arrived = time.perf_counter()
        since, self._cycle = report.cycle - self._cycle, report.cycle
        self._bridged(since, len(older))
        self.counts.late = report.unanswered
        self.counts.replaced += len(older) + report.late - self._late
        self._late = report.late
        self.unanswered = tuple(self._state(one.state) for one in older)
        return self._state(report.state)

    def close(self) -> None:
        """Ends the motion at the last command, if the controller has not, and closes the connection."""
        if self._arm is not None:
            self._arm.end()
            self._arm = None

    def _state(self, state: FciState) -> RobotState:
        """Torque is measured at the link side, gravity included where the arm measures it so."""
        return RobotState((state.tick - self._first) * PERIOD, self._looked_at(state.q), state.tau, {
            "q_set": state.q_d, "tau_ext": state.tau_ext, "mode": state.mode, "success_rate": state.success,
            **dict(zip(_WRENCH, state.wrench.tolist(), strict=True))})


def opened(address: Address, robot: Robot, settings: LinkSettings) -> FciRobot:
    """The link to the controller at ``franka://host?queue=4&waits=0``, not yet connected; raises InputError.

    ``queue`` is in milliseconds.

    Args:
        address, robot, settings: see ``ideal_robot.interfaces``.
    """
    address.knows("impedance", "queue", "waits")
    queue = address.number("queue", -1.0, 0.0, _LONGEST_QUEUE) if "queue" in address.options else None
    impedance = address.options.get("impedance", "joint")
    if impedance not in ("joint", "cartesian"):
        raise InputError("expected joint or cartesian", field=f"{address.option} ?impedance", value=impedance[:40])
    if address.port is not None:
        raise InputError("the ports of FCI are fixed; give the host alone", field=address.option, value=address.port)
    return FciRobot(robot, address.at(0)[0], cartesian=impedance == "cartesian",
                    queue=None if queue is None else PERIOD * queue,
                    waits=bool(address.number("waits", 0, 0, 1)), **settings.given())
