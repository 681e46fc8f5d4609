"""A controller in real time around a simulated arm, session after session: waits, is led, stops, goes back."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from ideal_robot.arrays import Array, eased_way, held
from ideal_robot.errors import IdealRobotError
from ideal_robot.robots.interface import RobotState
from ideal_robot.rsi.link import stamp_arrivals
from sim.arm.arm import SimulatedArm
from sim.devices.rsi_controller import IPOC, RsiController
from sim.devices.rtde_controller import RtdeController
from sim.devices.stream_server import Unkindness

ANSWER_WITHIN = 0.75
"""Share of the cycle within which an answer counts; the rest is this program's own, to move the arm."""
TIMEOUT = 0.1
"""Time without an answer after which the controller stops the arm and ends the session [s]."""
_HELD_UP = 0.25
"""Share of the cycle by which a cycle begins late that counts as held up."""
_STANDING = 0.4
"""Rest after a stop [s]."""
_BETWEEN = 1.5
"""Silence at the start before the next session [s]: longer than who leads an arm waits for a packet, as a controller
that has ended RSI moves by nobody's corrections before a person starts it again."""
_BEHIND = 0.5
"""How far it may be behind its clock; it makes good what is less, packet after packet, as behind a network that stood
still [s]."""
_SHARE = 0.25
"""Of the limits of speed and acceleration that going back takes."""


class Carried(Protocol):
    """A device on the arm."""

    def carry(self, t0: float, t1: float, host: float) -> None:
        """The arm has moved.

        Args:
            t0: since when, of the session [s].
            t1: until when [s].
            host: this computer's time of ``t0`` [s].
        """
        ...


@dataclass
class Session:
    """What happened from the first answer to the stop.

    Attributes:
        commands: commanded joint angles of every cycle ``(n,)`` [rad].
        answered: cycles with an answer in time.
        late: cycles without.
        held_up: cycles that began late because this program was not let run, or the network stood still.
        slipped: how often this program itself fell so far behind that its clock had to stand still.
        ended: why it ended.
    """

    commands: list[Array] = field(default_factory=list)
    answered: int = 0
    late: int = 0
    held_up: int = 0
    slipped: int = 0
    ended: str = ""


class ServedArm:
    """The controller's side of RSI, for ever.

    Args:
        arm: the arm, at rest at its start.
        address: where the server (the follower) listens.
        relative: whether corrections add up; without an answer the last is then taken again (``HOLDON`` 1), otherwise
            the arm is held where it was commanded.
        unkind: what the network does to packets and answers, and clocks: the controller's runs half as slow as its
            devices' run fast.
        rng: draws what the network does.
        carried: devices on the arm.
        sign: how the controller counts its axes against the URDF ``(n,)``.

    Attributes:
        anew: called when the arm's time has begun anew, for a next session.
    """

    anew: Callable[[], None] = staticmethod(lambda: None)

    def __init__(self, arm: SimulatedArm, address: tuple[str, int], *, relative: bool, unkind: Unkindness,
                 rng: np.random.Generator, carried: tuple[Carried, ...], sign: Array) -> None:
        self.arm, self._unkind, self._rng, self._carried = arm, unkind, rng, carried
        self._wire = RsiController(arm, address, relative=relative, sign=sign.tolist())
        self._address, self._relative, self._sign = address, relative, sign
        self._T, self._host_T = arm.t_ipo, arm.t_ipo / (1.0 - 0.5 * unkind.drift)
        self._start = arm.truth.q_m
        self._ipoc, self._stopped = IPOC, False
        self._due = time.perf_counter()

    def stop(self) -> None:
        """Ends ``sessions`` after the present cycle."""
        self._stopped = True

    def sessions(self, most: int, done: Callable[[Session], None]) -> None:
        """Session after session.

        Args:
            most: sessions after which it ends; 0 for no end.
            done: called behind each, before the arm goes back.
        """
        count = 0
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
            stamp_arrivals(link)
            while not self._stopped and (most == 0 or count < most):
                session = self._session(link)
                if session.commands:
                    self._brake(session)
                    done(session)
                    self._go_back(session.commands[-1])
                    count += 1

    def _session(self, link: socket.socket) -> Session:
        """Waits for answers, then moves the arm by them until they stop coming."""
        session = Session()
        begin = self._sign * np.degrees(self._start)
        command, step, silent = begin.copy(), np.zeros_like(begin), 0
        state = RobotState(0.0, self._start, np.zeros(self.arm.robot.n))
        self._due = time.perf_counter()
        k = 0
        while not self._stopped:
            session.held_up += self._held_up(session)
            self._ipoc = (self._ipoc + round(1e3 * self._T)) % 2**32
            self._send(link, self._wire.packet(state, begin, session.late, self._ipoc))
            correction = self._wire.answer(link, self._ipoc,
                                           max(self._due, time.perf_counter()) + ANSWER_WITHIN * self._host_T)
            if correction is not None and self._rng.random() < self._unkind.loss:
                correction = None
            before = command
            if correction is not None:
                command = (command if self._relative else begin) + correction
                session.answered, silent = session.answered + 1, 0
            elif session.commands:
                session.late, silent = session.late + 1, silent + 1
                command = command + step if self._relative else command
                if silent * self._T > TIMEOUT:
                    session.ended = f"no answer for {1e3 * TIMEOUT:.0f} ms"
                    return session
            step = command - before
            if correction is not None or session.commands:
                try:
                    state = self.arm.cycle(self._sign * np.radians(command))
                except IdealRobotError as error:
                    session.ended = f"the controller refuses: {error}"
                    return session
                session.commands.append(self._sign * np.radians(command))
            k = len(session.commands)
            self._carry(k, session)
        session.ended = "stopped"
        return session

    def _held_up(self, session: Session) -> bool:
        return bool(session.commands) and time.perf_counter() > self._due + _HELD_UP * self._T

    def _send(self, link: socket.socket, packet: bytes) -> None:
        u = self._unkind
        lost, twice, late = self._rng.random(3) < (u.loss, u.doubled, u.late_share)
        if late:
            # The whole controller stands still for that long; nothing overtakes in a cable.
            time.sleep(u.late)
        for _ in range(0 if lost else 2 if twice else 1):
            try:
                link.sendto(packet, self._address)
            except OSError:
                return

    def _carry(self, k: int, session: Session | None = None) -> None:
        """The devices measure, and the cycle is waited out."""
        t0 = max(k - 1, 0) * self._T
        for device in self._carried:
            device.carry(t0, k * self._T if k else 0.0, self._due)
        self._due += self._host_T
        left = self._due - time.perf_counter()
        if left > 0:
            time.sleep(left)
        elif left < -_BEHIND:
            # This program was not let run: its clock stands still with it, as the world does.
            self._due = time.perf_counter()
            if session is not None and session.commands:
                session.slipped += 1

    def _brake(self, session: Session) -> None:
        """The controller's own ramp, from whatever speed was commanded last; at a joint's end it stands."""
        q = session.commands[-1]
        v = (q - session.commands[-2]) / self._T if len(session.commands) > 1 else np.zeros_like(q)
        fall = np.max(np.abs(v) / self.arm.robot.a_max)
        cycles = max(int(np.ceil(fall / self._T)), 1)
        for i in range(cycles):
            q = np.clip(q + v * (1.0 - (i + 1) / cycles) * self._T, self.arm.robot.q_min, self.arm.robot.q_max)
            self._moved(q, session)
        for _ in range(round(_STANDING / self._T)):
            self._moved(q, session)

    def _go_back(self, q: Array) -> None:
        """As a person would with the pendant: back to the start, where the next session begins."""
        limits = _SHARE * self.arm.robot.v_max, _SHARE * self.arm.robot.a_max
        for row in held(eased_way(q, self._start, limits, self._T), after=round(_BETWEEN / self._T)):
            if self._stopped:
                return
            self._moved(row)
        self._reset()

    def _reset(self) -> None:
        self.arm.reset(self._start)
        self.anew()

    def _moved(self, q: Array, session: Session | None = None) -> None:
        self.arm.cycle(q)
        if session is not None:
            session.commands.append(q)
        self._carry(round(self.arm.t / self._T))


# A UR controller in real time around a simulated arm, client after client.

class ServedRtde(ServedArm):
    """As ``ServedArm``, behind RTDE: ``address`` is where it listens, from the beginning.

    A session begins with the first command of a client that leads the arm, and ends when it leaves, is silent, or
    commands what the controller refuses. Other clients are told the state all the time.
    """

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._controller = RtdeController(self.arm, address=self._address)
        self._state = RobotState(0.0, self._start, np.zeros(self.arm.robot.n))

    @property
    def address(self) -> tuple[str, int]:
        """Where it listens."""
        return self._controller.address

    def sessions(self, most: int, done: Callable[[Session], None]) -> None:
        """See ``ServedArm.sessions``."""
        count = 0
        try:
            while not self._stopped and (most == 0 or count < most):
                session = self._led()
                self._controller.playing = False
                self._controller.let_go(session.ended)
                if self._moved_by(session.commands):
                    self._brake(session)
                    done(session)
                    self._go_back(session.commands[-1])
                    count += 1
                elif session.commands:
                    self._reset()
                self._controller.playing = True
        finally:
            self._controller.close()

    def stop(self) -> None:
        """Ends ``sessions`` after the present cycle."""
        super().stop()
        self._controller.stop()

    def _led(self) -> Session:
        """Waits for a client's command, then moves the arm by its commands until they stop coming."""
        session, pose, silent = Session(), self._start, 0
        self._state, self._due = RobotState(0.0, self._start, np.zeros(self.arm.robot.n)), time.perf_counter()
        while not self._stopped:
            session.held_up += self._held_up(session)
            end = max(self._due, time.perf_counter()) + ANSWER_WITHIN * self._host_T
            answered = self._controller.exchange(self._state, pose, end if self._controller.led else 0.0)
            wanted = self._controller.commanded
            if answered and wanted is not None:
                pose, silent = wanted, 0
                session.answered += 1
            elif session.commands:
                silent += 1
                session.late += 1
            if session.commands and not self._controller.led:
                session.ended = self._controller.ended
                return session
            if silent * self._T > TIMEOUT:
                session.ended = f"no command for {1e3 * TIMEOUT:.0f} ms"
                return session
            if session.answered:
                try:
                    self._state = self.arm.cycle(pose)
                except IdealRobotError as error:
                    session.ended = f"the controller refuses: {error}"
                    return session
                session.commands.append(pose)
            self._carry(len(session.commands), session)
        session.ended = "stopped"
        return session

    def _moved(self, q: Array, session: Session | None = None) -> None:
        self._controller.exchange(self._state, q, 0.0)
        super()._moved(q, session)

    def _moved_by(self, commands: list[Array]) -> bool:
        return bool(commands) and bool(np.abs(np.array(commands) - self._start).max() > 1e-6)
