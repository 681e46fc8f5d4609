"""A UR controller's side of RTDE around a simulated arm: for tests, and to try a client without a robot.

Written from Universal Robots' public description of the protocol alone, without the code of the client's side. The
controller runs the program of docs/rsi.md: it commands the values of the input registers to its arm, every cycle. As a
real one it serves several clients at a time; the one that writes the program's registers commands the arm.
"""

from __future__ import annotations

import selectors
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterable
from contextlib import suppress

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.errors import IdealRobotError
from ideal_robot.robots.interface import RobotState
from sim.arm.arm import SimulatedArm
from sim.devices.rtde_client import CODES, ClientError, Inputs, RtdeClient, RtdeFaults, count, output_type

_PROTECTIVE = 1 << 2 | 1 << 10  # safety status bits: protective stop, stopped due to safety
_MOST = 8
"""Clients at a time."""
_AGREES = 10.0
"""Time in which a client has to say what it wants [s]."""
_LOOK = 0.05
"""How often it is looked whether the end has come [s]."""


class RtdeController:
    """Listens from its creation on, and serves clients while it runs; raises ``OSError`` where it cannot listen.

    Args:
        arm: the arm; it has to have six joints.
        faults: see ``RtdeFaults``.
        register: first of the input registers its program reads.
        timeout: time to wait for a command in each cycle of ``run`` [s], during which simulated time does not advance.
        address: where to listen; port 0 for any free one.

    Attributes:
        address: where it listens.
        commands: commands to the arm in each cycle of ``run``.
        inputs: every value it was given by name, the last one each.
        ended: why connections were closed, that of the commanding client and others.
        playing: whether the program runs.
    """

    def __init__(self, arm: SimulatedArm, faults: RtdeFaults | None = None, *, register: int = 24, timeout: float = 5.0,
                 address: tuple[str, int] = ("127.0.0.1", 0)) -> None:
        self.arm, self.faults, self.register, self.timeout = arm, faults or RtdeFaults(), register, timeout
        self.commands: list[Array] = []
        self.inputs: Inputs = {}
        self.ended, self.playing = "", True
        self._listener = socket.create_server(address)
        self._listener.setblocking(False)
        self.address: tuple[str, int] = self._listener.getsockname()[:2]
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._listener, selectors.EVENT_READ)
        self._clients: dict[RtdeClient, float] = {}
        self._stopped = threading.Event()
        self._cycle, self._answered = 0, False

    @property
    def led(self) -> bool:
        """Whether a client is connected that writes the program's registers."""
        return self._leader is not None

    @property
    def commanded(self) -> Array | None:
        """Joint angles ``(n,)`` that the program commands [rad]; None while it waits for its first number."""
        if self.inputs.get(f"input_int_register_{self.register}", (0,))[0] <= 0:
            return None
        angles = (f"input_double_register_{self.register + i}" for i in range(6))
        return np.array([self.inputs.get(name, (np.nan,))[0] for name in angles])

    def stop(self) -> None:
        """Ends ``run`` from another thread."""
        self._stopped.set()

    def close(self) -> None:
        """Closes all connections and stops listening."""
        for client in list(self._clients):
            self._leave(client)
        self._selector.close()
        self._listener.close()

    def run(self) -> None:
        """Simulates cycles from a client's start until the last one has left or ``stop`` is called."""
        held = self.arm.truth.q_m.copy()
        state, begun = RobotState(self.arm.t, held, np.zeros(6)), False
        while not self._stopped.is_set():
            if not any(client.started for client in self._clients):
                if begun and not self._clients:
                    break
                self._listen(time.perf_counter() + _LOOK, lambda: False)
                continue
            begun, k = True, self._cycle
            if k == self.faults.disconnects:
                break
            answered = self.exchange(state, held, time.perf_counter() + (self.timeout if self.led else self.arm.t_ipo))
            stopped = self.faults.protective_stop is not None and k >= self.faults.protective_stop
            if (answered or self.speed(k) < 1.0) and self.commanded is not None and not (
                    stopped or k in self.faults.pauses):
                # servoj's own time runs as slowly as the slider says, so commands are reached later.
                held = held + self.speed(k) * (self.commanded - held)
            self.commands.append(held)
            try:
                state = self.arm.cycle(held)
            except IdealRobotError as error:
                self.ended = f"the controller refuses: {error}"
                break
        self.close()

    def speed(self, k: int) -> float:
        """The slider's speed in cycle ``k``."""
        return next((speed for begin, speed in sorted(self.faults.speed.items(), reverse=True) if begin <= k), 1.0)

    def exchange(self, state: RobotState, held: Array, end: float) -> bool:
        """Sends every client the state; returns whether the commanding client has written since the last call.

        Args:
            state: of the arm.
            held: commanded joint angles ``(n,)`` [rad].
            end: time until which to wait for an answer, by ``time.perf_counter`` [s]; without a commanding client only
                ``run`` waits.
        """
        self._answered = False
        self._listen(0.0, lambda: True)
        # A late answer to an earlier cycle stays in the registers; the answer to this cycle is awaited all the same.
        late, self._answered = self._answered, False
        k, self._cycle = self._cycle, self._cycle + 1
        if k in self.faults.skips:
            return False
        for client in [client for client in self._clients if client.started and client.outputs]:
            # A slower client gets every second package, or every third …
            if k % max(round(1.0 / (client.rate * self.arm.t_ipo)), 1) == 0:
                self._served(client, lambda client=client: client.tell(  # type: ignore[misc]
                    self._told(client.outputs, state, held, k)))
        self._listen(end, lambda: self._answered)
        return late or self._answered

    def let_go(self, reason: str) -> None:
        """Closes the connection of the commanding client; its program starts anew."""
        if self._leader is not None:
            self._leave(self._leader, reason)

    @property
    def _leader(self) -> RtdeClient | None:
        return next((peer for peer in self._clients if f"input_int_register_{self.register}" in peer.writes), None)

    def _listen(self, end: float, enough: Callable[[], bool]) -> None:
        """Serves clients until it is enough, or ``end``; at least once what is there."""
        while not self._stopped.is_set():
            remaining = max(end - time.perf_counter(), 0.0)
            for key, _ in self._selector.select(min(remaining, _LOOK)):
                if key.data is None:
                    self._accept()
                elif key.data in self._clients:
                    self._served(key.data, lambda client=key.data: self._write(client))  # type: ignore[misc]
            for client, since in list(self._clients.items()):
                if not (client.started or client.writes) and time.perf_counter() - since > _AGREES:
                    self._leave(client, f"the client was let go: it asked for nothing in {_AGREES:.0f} s")
            if remaining == 0.0 or enough():
                return

    def _accept(self) -> None:
        with suppress(OSError):
            link, _ = self._listener.accept()
            if len(self._clients) >= _MOST:
                link.close()
                return
            client = RtdeClient(link, self.faults, self._taken)
            self._clients[client] = time.perf_counter()
            self._selector.register(link, selectors.EVENT_READ, client)

    def _taken(self, asks: RtdeClient, name: str) -> bool:
        return any(name in client.writes for client in self._clients if client is not asks)

    def _write(self, client: RtdeClient) -> None:
        """Takes over what a client has written."""
        for values in client.read():
            self.inputs.update(values)
            self._answered = self._answered or f"input_int_register_{self.register}" in values

    def _served(self, client: RtdeClient, deed: Callable[[], None]) -> None:
        try:
            deed()
        except ClientError as error:
            self._leave(client, str(error))

    def _leave(self, client: RtdeClient, reason: str = "") -> None:
        if client is self._leader or not self.ended:
            self.ended = reason
        self._clients.pop(client)
        for name in client.writes:
            self.inputs.pop(name, None)
        self._selector.unregister(client.link)
        client.close()

    def _told(self, names: tuple[str, ...], state: RobotState, held: Array, k: int) -> bytes:
        """Values of a data package; zeros for what this arm does not have."""
        stop, end, stands = self.faults.protective_stop, self.faults.program_ends, self.faults.clock_stands
        playing = self.playing and self.faults.program_begins <= k and (end is None or k < end)
        paused = k in self.faults.pauses
        model = self.arm.robot.pinocchio
        places = model.createData()
        pin.forwardKinematics(model, places, state.q)
        tool = places.oMi[model.nv].rotation
        values: dict[str, Iterable[float]] = {
            "timestamp": (100.0 + (k if stands is None else min(k, stands)) * self.arm.t_ipo,), "target_q": held,
            "actual_q": state.q, "actual_current": state.tau / self.arm.robot.drive_gain, "robot_mode": (7,),
            "safety_mode": (1,), "safety_status": (1,), "runtime_state": (4 if paused else 2 if playing else 1,),
            "speed_scaling": (1.0,), "target_speed_fraction": (self.speed(k),), "payload": (1.5,),
            "payload_cog": (0.0, 0.01, 0.05),
            "actual_tool_accelerometer": -tool.T @ np.array(self.faults.mounted),
            "robot_status_bits": (3 if playing else 1,),
            "safety_status_bits": (_PROTECTIVE if stop is not None and k >= stop else 1,), **self.inputs}
        payload = b""
        for name in names:
            kind = output_type(name) or "DOUBLE"
            payload += struct.pack(">" + CODES[kind], *values.get(name, (0,) * count(kind)))
        return payload
