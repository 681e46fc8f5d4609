r"""Continues a task where its arm stopped: the path's time waits for a paused arm, and restarts slowly.

The place p on the path, in cycles, advances by a share r of a cycle in each cycle of the controller. While the arm
stands still r is 0 and the commands move to the arm (``Guard.waiting``). Then p returns to the path's place at the arm,
and from rest

.. math:: r \le \frac{v_{try}}{|dq/dp| / T} \text{ until the arm has followed}, \qquad
          \dot r \le \min_j \frac{\eta\, a_{max,j}}{|dq_j/dp| / T}, \qquad r \le 1

first along the old plan, then along a new plan in each of the path's cycles. At the end p is again at whole cycles.
Sensor data are in the path's time (``LiveArm.t``); those from the stop are not used.
"""

from __future__ import annotations

from collections import deque
from typing import Protocol

import numpy as np

from ideal_robot.arrays import Array, eased, interpolated
from ideal_robot.execution.command_governor import CommandGovernor
from ideal_robot.execution.guard import LATELY, PROVED, SHARE, accelerations, probed, probing_speed
from ideal_robot.robots.interface import RobotState
from ideal_robot.robots.robot import Robot
from ideal_robot.tolerances import SLOWEST_RATE
from scenes.online.live_arm import LiveArm

_ALIGNS = 0.02
"""Share of its speed by which a path is slower until its places lie at whole cycles again: at 1 rad/s and 12 ms that is
1.7 rad/s²."""
_WHOLE, _FINE = 1e-9, 16
"""Part of a cycle that is none, and places into which one is divided where an arm is looked for."""


class Paced(Protocol):
    """Interface of what is paced, see ``scenes.online.task.Task``."""

    n_d: int

    def command(self, t: float, q_d: Array) -> Array:
        """Commanded joint angles ``(n,)`` [rad] of a horizon ``(n_d, n)`` [rad] at ``t`` [s]; see ``Task.command``."""

    def passed(self, t: float, q: Array, q_d: Array) -> None:
        """Notes the end of a controller cycle; one cycle of the path may have several; see ``Task.passed``."""

    def stood(self, t: float) -> None:
        """Notes that the arm stood still and continues at ``t`` [s]; see ``Task.stood``."""


class Pacing:
    """Controls the pace of one task on a connected arm.

    Args:
        arm: the connected arm.
        limits: limits of the commands.
        task: the task.

    Attributes:
        active: whether the path goes on otherwise than by a cycle in each cycle.
        measured: state at the end of the last cycle that was paced; None before the first.
        governor: of the commands that are handed over here.
        now: the last of them ``(n,)`` [rad].
        horizon: desired positions from the last paced cycle on ``(n_d, n)`` [rad].
    """

    def __init__(self, arm: LiveArm, limits: Robot, task: Paced) -> None:
        self._arm, self._limits, self._task, self._T = arm, limits, task, arm.t_ipo
        self._a_max = accelerations(limits)
        self._small, self._try = probed(self._a_max, self._T), probing_speed(self._a_max, self._T)
        self._rows: deque[Array] = deque(maxlen=round(LATELY / self._T))
        self.active = False
        self.measured: RobotState | None = None
        self.governor = CommandGovernor(limits, arm.link.commanded, t_ipo=arm.t_ipo)
        self._p = self._far = self._r = 0.0
        self._number = 0
        self._off: Array | None = None
        self.now = self._begun = arm.link.commanded
        self._since, self._lasts = 0, self._T
        self.horizon = np.tile(self.now, (task.n_d, 1))

    def desired(self, k: int, q_d: Array) -> None:
        """Desired positions of cycle k of the path ``(n,)`` [rad]; call it for one cycle after the other."""
        self._rows.append(q_d)
        self._number = k

    def at(self, t: float) -> float:
        """Time of the path at the arm's place at ``t`` [s]; it lags ``t`` where the arm is paced."""
        return max(self._p * self._T, t) if self.active else t

    @property
    def needed(self) -> bool:
        """Whether the arm stands still, or the path does not yet have its full pace."""
        return self.active or self._stands

    @property
    def _stands(self) -> bool:
        return self._arm.guard.held is not None and self._arm.guard.reason is None

    def reach(self, k: int, planned: Array, t: float) -> Array | None:
        """Moves the arm on until cycle k of the path begins.

        Args:
            k: number of a cycle.
            planned: desired positions from the cycle before it on ``(m, n)`` [rad].
            t: of the path [s].

        Returns None when it is there, or where the arm stands for good what is desired there ``(n,)`` [rad].
        """
        rows = np.vstack([*list(self._rows)[:-1], planned])
        first = float(self._number - len(self._rows) + 1)
        if not self.active:
            self._p = self._far = float(k)
        stood = False
        while self._p < k - _WHOLE or self._stands:
            if self._stands:
                stood = True
                place = self._wait(rows, first, t)
                if self._arm.guard.reason is not None:
                    self.active, self._arm.pace = False, 1.0
                    return self._at(rows, first, place)
                continue
            self._go_on(rows, first, t)
        if stood:
            self._task.stood(self._p * self._T)
        if abs(self._p - k) < _WHOLE and self._r >= 1.0:
            self._p, self.active = float(k), False
            self._arm.pace = 1.0
        return None

    def _wait(self, rows: Array, first: float, t: float) -> float:
        """Leads the commands to the arm and waits; the place on the path where it stands."""
        self.active, self._arm.pace = True, 0.0
        guard, place = self._arm.guard, self._p
        for q_c in guard.waiting():
            self.measured = self._arm.cycle(q_c)
            place = self._nearest(rows, first, q_c)
            # The feedforward is run to rest there; its commands are not used yet.
            self.horizon = np.tile(self._at(rows, first, place), (self._task.n_d, 1))
            self._task.command(t, self.horizon)
            self._task.passed(self._far * self._T, self.measured.q, self.horizon)
            self.now = q_c
        self._p, self._r = place, 0.0
        self._begun, self._off = self._at(rows, first, place), None
        self.governor = CommandGovernor(self._limits, self.now, t_ipo=self._T)
        return place

    def _go_on(self, rows: Array, first: float, t: float) -> None:
        """One cycle of the controller along the path."""
        places, rate = self._ahead(rows, first)
        self.horizon = interpolated(places[:-1] - first, np.arange(float(len(rows))), rows)
        wanted = self._task.command(t, self.horizon)
        if self._off is None:
            # The feedforward's rest differs a little from the commands at which the arm stopped.
            self._off, self._since = self.now - wanted, 0
            self._lasts = max(float(np.max(np.abs(self._off))) / (0.5 * self._try), self._T)
        self._since += 1
        share = min(self._since * self._T / self._lasts, 1.0)
        self.now = self.governor.allowed(wanted + self._off * (1.0 - float(eased(np.array([share]))[0])))
        self._p, self._r = float(places[1]), rate
        self._arm.pace = max(self._p - self._far, 0.0)
        self._far = max(self._far, self._p)
        self.measured = self._arm.cycle(self.now)
        self._task.passed(self._far * self._T, self.measured.q, self.horizon)

    def _ahead(self, rows: Array, first: float) -> tuple[Array, float]:
        """Places of this and the coming cycles ``(n_d + 1,)``, and the pace from this one to the next."""
        p, r = self._p, self._r
        places, rates = [p], []
        for _ in range(self._task.n_d):
            here = self._at(rows, first, p)
            step = np.abs(self._at(rows, first, p + 1.0) - here)
            fastest = float(np.max(step))
            with np.errstate(divide="ignore"):
                change = SHARE * float(np.min(np.where(step > _WHOLE, self._a_max * self._T**2 / step, np.inf)))
            r = min(r + change, 1.0)
            if np.max(np.abs(here - self._begun)) < PROVED * self._small:
                r = min(r, self._try * self._T / max(fastest, 1e-12))
            r = max(r, SLOWEST_RATE)
            part = p - np.floor(p + _WHOLE)
            rates.append(r if r < 1.0 else 1.0 - min(max(part, 0.0), _ALIGNS))
            p += rates[-1]
            places.append(p)
        return np.array(places), 1.0 if r >= 1.0 and rates[0] >= 1.0 - _ALIGNS else rates[0]

    def _at(self, rows: Array, first: float, place: float) -> Array:
        """What is desired at a place on the path ``(n,)`` [rad]."""
        i = float(np.clip(place - first, 0.0, len(rows) - 1.0))
        low = min(int(i), len(rows) - 2)
        return np.asarray(rows[low] + (i - low) * (rows[low + 1] - rows[low]))

    def _nearest(self, rows: Array, first: float, q: Array) -> float:
        """The place, not beyond where the path has come, that is nearest to joint angles ``(n,)`` [rad]."""
        count = max(int((self._far - first) * _FINE), 0) + 1
        places = first + np.arange(count) / _FINE
        some = interpolated(places - first, np.arange(float(len(rows))), rows)
        return float(places[int(np.argmin(np.max(np.abs(some - q), axis=1)))])
