"""A real-time controller around a simulated arm, session after session: waits, follows commands, stops, returns."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from ideal_robot.arrays import Array, eased_way, held
from ideal_robot.errors import IdealRobotError
from ideal_robot.robots.interface import RobotState
from ideal_robot.row_log import RowLog
from ideal_robot.rsi.link import stamp_arrivals
from sim.arm.arm import SimulatedArm
from sim.devices.egm_controller import EgmController
from sim.devices.ros2_arm import Ros2Arm
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
    """A device that moves with the simulated arm."""

    def carry(self, t0: float, t1: float, host: float) -> None:
        """Notifies the device that the arm has moved from ``t0`` to ``t1`` [s].

        Args:
            t0: start of that motion, in the session [s].
            t1: end of that motion [s].
            host: this computer's time of ``t0`` [s].
        """
        ...


@dataclass
class Session:
    """Statistics of one session, from the first answer to the stop.

    Attributes:
        commands: commanded joint angles of every cycle ``(n,)`` [rad].
        answered, late: cycles with an answer in time, and without.
        held_up: cycles that began late because this program or the network was blocked.
        slipped: how often this program was so late that its clock was stopped meanwhile.
        ended: why it ended.
    """

    commands: RowLog = field(default_factory=RowLog)
    answered: int = 0
    late: int = 0
    held_up: int = 0
    slipped: int = 0
    ended: str = ""


class ServedArm:
    """The controller's side of RSI, serving one session after the other.

    Args:
        arm: the arm, at rest at its start.
        address: where the server (the follower) listens.
        relative: whether corrections are increments; then without an answer the last one is repeated (``HOLDON`` 1),
            otherwise the arm stays at its last command.
        unkind: simulated faults of network and clocks: the controller's runs half as slow as its devices' run fast.
        rng: draws the network's faults.
        carried: devices on the arm.
        sign: direction of the controller's axes against the URDF's, 1 or -1 ``(n,)``.

    Attributes:
        anew: called when the arm's time restarts for the next session.
    """

    anew: Callable[[], None] = staticmethod(lambda: None)
    _awaited = "answer"

    def __init__(self, arm: SimulatedArm, address: tuple[str, int], *, relative: bool, unkind: Unkindness,
                 rng: np.random.Generator, carried: tuple[Carried, ...], sign: Array) -> None:
        self.arm, self._unkind, self._rng, self._carried = arm, unkind, rng, carried
        self._wire = RsiController(arm, address, relative=relative, sign=sign.tolist())
        self._address, self._relative, self._sign = address, relative, sign
        self._T, self._host_T = arm.t_ipo, arm.t_ipo / (1.0 - 0.5 * unkind.drift)
        self._start = self._pose = arm.truth.q_m
        self._begin = self._command = sign * np.degrees(self._start)
        self._ipoc, self._stopped = IPOC, False
        self._due = time.perf_counter()

    def stop(self) -> None:
        """Ends ``sessions`` after the present cycle."""
        self._stopped = True

    def sessions(self, most: int, done: Callable[[Session], None]) -> None:
        """Serves session after session, ``most`` of them, 0 for no end; ``done`` is called before the arm returns."""
        count = 0
        with self._wired():
            while not self._stopped and (most == 0 or count < most):
                count += self._over(self._session(), done)

    @contextmanager
    def _wired(self) -> Iterator[None]:
        """Somebody can be answered within the block."""
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as self._link:
            stamp_arrivals(self._link)
            yield

    def _over(self, session: Session, done: Callable[[Session], None]) -> bool:
        """Brings the arm to rest and back after a session; whether it has moved."""
        if session.commands:
            self._brake(session)
            done(session)
            self._go_back(session.commands[-1])
        return bool(session.commands)

    def _session(self) -> Session:
        """Waits until somebody leads the arm, then moves it until nothing more is commanded."""
        session, silent, self._pose = Session(), 0, self._start
        self._command, self._step = self._begin, np.zeros_like(self._begin)
        self._state, self._due = RobotState(0.0, self._start, np.zeros(self.arm.robot.n)), time.perf_counter()
        while not self._stopped:
            session.held_up += self._held_up(session)
            if self._answered(session):
                session.answered, silent = session.answered + 1, 0
            elif session.commands:
                session.late, silent = session.late + 1, silent + 1
            if session.commands and (gone := self._gone()) is not None:
                session.ended = gone
                return session
            if silent * self._T > TIMEOUT:
                session.ended = f"no {self._awaited} for {1e3 * TIMEOUT:.0f} ms"
                return session
            if session.answered:
                try:
                    self._state = self.arm.cycle(self._pose)
                except IdealRobotError as error:
                    session.ended = f"the controller refuses: {error}"
                    return session
                session.commands.append(self._pose)
            self._carry(len(session.commands), session)
        session.ended = "stopped"
        return session

    def _answered(self, session: Session) -> bool:
        """Tells the state and takes the answer to it into ``_pose``; whether one came in time."""
        self._tick()
        self._send(self._wire.packet(self._state, self._begin, session.late, self._ipoc))
        correction = self._wire.answer(self._link, self._ipoc, self._until())
        if correction is not None and self._rng.random() < self._unkind.loss:
            correction = None
        before = self._command
        if correction is not None:
            self._command = (before if self._relative else self._begin) + correction
        elif session.commands and self._relative:
            self._command = before + self._step
        self._step, self._pose = self._command - before, self._sign * np.radians(self._command)
        return correction is not None

    def _tick(self) -> None:
        """The controller's time goes on, whether anybody leads its arm or not."""
        self._ipoc = (self._ipoc + round(1e3 * self._T)) % 2**32

    def _until(self) -> float:
        """Time until which an answer is used, by ``time.perf_counter`` [s]."""
        return max(self._due, time.perf_counter()) + ANSWER_WITHIN * self._host_T

    def _gone(self) -> str | None:
        """Why a session has ended; None where packets do not show it."""
        return None

    def _held_up(self, session: Session) -> bool:
        return bool(session.commands) and time.perf_counter() > self._due + _HELD_UP * self._T

    def _send(self, packet: bytes) -> None:
        u = self._unkind
        lost, twice, late = self._rng.random(3) < (u.loss, u.doubled, u.late_share)
        if late:
            # The whole controller is delayed by that time; packets in a cable do not overtake each other.
            time.sleep(u.late)
        for _ in range(0 if lost else 2 if twice else 1):
            try:
                self._link.sendto(packet, self._address)
            except OSError:
                return

    def _carry(self, k: int, session: Session | None = None) -> None:
        """The devices measure, and the cycle is waited out."""
        t0 = max(k - 1, 0) * self._T
        for device in self._carried:
            device.carry(t0, k * self._T if k else 0.0, self._due)
        self._due += self._host_T
        remaining = self._due - time.perf_counter()
        if remaining > 0:
            time.sleep(remaining)
        elif remaining < -_BEHIND:
            # This program was blocked: its clock is stopped meanwhile, as if the world had stopped.
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
        """Moves the arm back to its start, as a person would with the pendant; the next session begins there."""
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
        self._tick()
        self._state = self.arm.cycle(q)
        if session is not None:
            session.commands.append(q)
        self._carry(round(self.arm.t / self._T))


# A UR controller in real time around a simulated arm, client after client.

class ServedRtde(ServedArm):
    """A ``ServedArm`` with the interface RTDE; ``address`` is where it listens, from its creation on.

    A session begins with the first command of a client that commands the arm, and ends when it leaves, is silent, or
    commands what the controller refuses. Other clients receive the state all the time.
    """

    _awaited = "command"

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._controller = RtdeController(self.arm, address=self._address)

    @property
    def address(self) -> tuple[str, int]:
        """Host and port on which it listens."""
        return self._controller.address

    @contextmanager
    def _wired(self) -> Iterator[None]:
        with closing(self._controller):
            yield

    def _over(self, session: Session, done: Callable[[Session], None]) -> bool:
        self._controller.playing = False
        self._controller.let_go(session.ended)
        moved = bool(session.commands) and bool(np.abs(np.array(session.commands) - self._start).max() > 1e-6)
        if moved:
            super()._over(session, done)
        elif session.commands:
            self._reset()
        self._controller.playing = True
        return moved

    def stop(self) -> None:
        """Ends ``sessions`` after the present cycle."""
        super().stop()
        self._controller.stop()

    def _answered(self, session: Session) -> bool:
        controller = self._controller
        answered = controller.exchange(self._state, self._pose, self._until() if controller.led else 0.0)
        if not answered or (wanted := controller.commanded) is None:
            return False
        self._pose = wanted
        return True

    def _gone(self) -> str | None:
        return None if self._controller.led else self._controller.ended

    def _moved(self, q: Array, session: Session | None = None) -> None:
        self._controller.exchange(self._state, q, 0.0)
        super()._moved(q, session)


# Controllers of ABB and of ROS 2 in real time around a simulated arm, session after session.

class ServedEgm(ServedArm):
    """A ``ServedArm`` with the interface EGM; ``address`` is where the follower listens."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._egm, self._number = EgmController(self.arm, self._address), 0

    def stop(self) -> None:
        """Ends ``sessions`` after the present cycle."""
        super().stop()
        self._egm.stop()

    def _answered(self, session: Session) -> bool:
        self._number += 1
        self._send(self._egm.message(self._number, self._state, self._pose))
        wanted = self._egm.answer(self._link, self._until())
        if wanted is None or self._rng.random() < self._unkind.loss:
            return False
        self._pose = wanted
        return True


class ServedRos2(ServedArm):
    """A ``ServedArm`` with ROS 2's controllers, in a namespace; joint states are published all the time.

    Without a command the forward controller keeps the arm in place; a trajectory is continued to its end.

    Args:
        args, kwargs: see ``ServedArm``; there is no address.
        namespace: of the topics.
    """

    _awaited = "command"

    def __init__(self, *args: Any, namespace: str = "", **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._controllers = Ros2Arm(self.arm, namespace=namespace, delivered=self._delivered)

    @contextmanager
    def _wired(self) -> Iterator[None]:
        with closing(self._controllers):
            yield

    def _answered(self, session: Session) -> bool:
        controllers = self._controllers
        if not session.commands:
            controllers.rest(self._start)
        controllers.tell(self._state)
        heard = controllers.listen(self._until()) and not self._rng.random() < self._unkind.loss
        if heard or controllers.led:
            self._pose = controllers.reference()
        return heard or (bool(session.commands) and controllers.led)

    def _delivered(self, cycle: int) -> list[float]:
        """Delays with which a joint state goes out [s]."""
        u = self._unkind
        lost, twice, late = self._rng.random(3) < (u.loss, u.doubled, u.late_share)
        return [] if lost else [u.late if late else 0.0] * (2 if twice else 1)

    def _moved(self, q: Array, session: Session | None = None) -> None:
        super()._moved(q, session)
        self._controllers.tell(self._state)
        # The commanding client may have sent more; these commands are discarded.
        self._controllers.listen(time.perf_counter() + 1e-3)
