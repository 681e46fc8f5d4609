"""A UR controller's side of RTDE around a simulated arm: for tests, and to try a client without a robot.

Written from Universal Robots' public description of the protocol alone, without the code of the client's side. The
controller runs the program of docs/rsi.md: it hands what it finds in the input registers to its arm, every cycle.
"""

from __future__ import annotations

import socket
import struct
import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.robots.interface import RobotState
from sim.arm.arm import SimulatedArm

_KNOWN = {"timestamp": "DOUBLE", "target_q": "VECTOR6D", "actual_q": "VECTOR6D", "actual_qd": "VECTOR6D",
          "target_qd": "VECTOR6D", "actual_current": "VECTOR6D", "actual_TCP_pose": "VECTOR6D", "robot_mode": "INT32",
          "safety_mode": "INT32", "runtime_state": "UINT32", "safety_status_bits": "UINT32", "speed_scaling": "DOUBLE"}
_CODES = {"DOUBLE": "d", "INT32": "i", "UINT32": "I", "VECTOR6D": "6d"}
_PROTECTIVE = 1 << 2 | 1 << 10


@dataclass
class RtdeFaults:
    """What the controller shall do that it should not, by the number of the cycle.

    Attributes:
        protocols: versions of the protocol it knows.
        unknown: fields it does not know.
        in_use: input fields another client writes.
        skips: cycles whose data package is left out.
        protective_stop: cycle from which the arm is stopped by its safety system.
        program_ends: cycle from which the program does not run any more.
        disconnects: cycle at which it closes the connection.
        says: text it sends at the start.
    """

    protocols: tuple[int, ...] = (1, 2)
    unknown: tuple[str, ...] = ()
    in_use: tuple[str, ...] = ()
    skips: tuple[int, ...] = ()
    protective_stop: int | None = None
    program_ends: int | None = None
    disconnects: int | None = None
    says: str = ""


@dataclass
class RtdeController:
    """Listens on this computer, serves one client and moves the arm by the input registers.

    Attributes:
        arm: the arm; it has to have six joints.
        faults: see ``RtdeFaults``.
        register: first of the input registers its program reads.
        timeout: how long a command is waited for in each cycle [s]; the simulated time stands still meanwhile.
        port: TCP port; 0 for any free one, see ``address``.
        after: called behind each cycle with how many there were, e.g. to wait for the next one; None: at once.
        commands: what the arm was commanded in each cycle.
        inputs: every value it was given by name, the last one each.
    """

    arm: SimulatedArm
    faults: RtdeFaults = field(default_factory=RtdeFaults)
    register: int = 24
    timeout: float = 5.0
    port: int = 0
    after: Callable[[int], None] | None = None
    commands: list[Array] = field(default_factory=list)
    inputs: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._listener = socket.create_server(("127.0.0.1", self.port))
        self._listener.settimeout(0.05)
        self._stopped = threading.Event()
        self._waiting = b""
        self._outputs: list[str] = []
        self._recipes: dict[int, list[str]] = {}

    @property
    def address(self) -> tuple[str, int]:
        """Where it listens."""
        host, port = self._listener.getsockname()
        return str(host), int(port)

    def stop(self) -> None:
        """Ends ``run`` from another thread."""
        self._stopped.set()

    def run(self) -> None:
        """Serves one client until it leaves or ``stop`` is called."""
        client = None
        while client is None and not self._stopped.is_set():
            try:
                client, _ = self._listener.accept()
            except TimeoutError:
                continue
        self._listener.close()
        if client is None:
            return
        with client:
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            try:
                if self._agreed(client):
                    self._play(client)
            except ConnectionError:
                return

    def _agreed(self, client: socket.socket) -> bool:
        """Answers what the client asks for until it starts; False if it leaves before."""
        while (asked := self._package(client, self.timeout)) is not None:
            letter, payload = asked
            if letter == "V":
                known = struct.unpack(">H", payload)[0] in self.faults.protocols
                self._send(client, "V", b"\1" if known else b"\0")
            elif letter == "v":
                self._send(client, "v", struct.pack(">4I", 5, 11, 0, 0))
            elif letter == "O":
                self._outputs = _names(payload[8:])
                types = ["NOT_FOUND" if name in self.faults.unknown else _KNOWN.get(name, "NOT_FOUND")
                         for name in self._outputs]
                self._send(client, "O", b"\1" + ",".join(types).encode())
            elif letter == "I":
                self._answer_inputs(client, _names(payload))
            elif letter == "S":
                if self.faults.says:
                    text = self.faults.says.encode()
                    self._send(client, "M", bytes((len(text),)) + text + b"\4RTDE\3")
                self._send(client, "S", b"\1")
                return True
        return False

    def _answer_inputs(self, client: socket.socket, names: list[str]) -> None:
        types = ["IN_USE" if name in self.faults.in_use else "INT32" if name.startswith("input_int_register_")
                 else "DOUBLE" if name.startswith("input_double_register_") else "NOT_FOUND" for name in names]
        sound = set(types) <= {"INT32", "DOUBLE"}
        number = len(self._recipes) + 1 if sound else 0
        if sound:
            self._recipes[number] = names
        self._send(client, "I", bytes((number,)) + ",".join(types).encode())

    def _play(self, client: socket.socket) -> None:
        """A data package every cycle; the command that answers it moves the arm."""
        held = self.arm.truth.q_m.copy()
        state, k = RobotState(self.arm.t, held, np.zeros(6)), 0
        begun = 100.0
        while not self._stopped.is_set() and k != self.faults.disconnects:
            skipped = k in self.faults.skips
            if not skipped:
                self._send(client, "U", b"\1" + self._told(state, held, begun + k * self.arm.t_ipo, k))
                self._commanded(client)
            stopped = self.faults.protective_stop is not None and k >= self.faults.protective_stop
            if self.inputs.get(f"input_int_register_{self.register}", 0) > 0 and not stopped and not skipped:
                held = np.array([self.inputs[f"input_double_register_{self.register + i}"] for i in range(6)])
            self.commands.append(held)
            state, k = self.arm.cycle(held), k + 1
            if self.after is not None:
                self.after(k)

    def _told(self, state: RobotState, held: Array, t: float, k: int) -> bytes:
        stop, end = self.faults.protective_stop, self.faults.program_ends
        values: dict[str, Iterable[float]] = {
            "timestamp": (t,), "target_q": held, "actual_q": state.q,
            "actual_current": state.tau / self.arm.robot.drive_gain, "robot_mode": (7,), "safety_mode": (1,),
            "runtime_state": (1 if end is not None and k >= end else 2,), "speed_scaling": (1.0,),
            "safety_status_bits": (_PROTECTIVE if stop is not None and k >= stop else 1,)}
        return b"".join(struct.pack(">" + _CODES[_KNOWN[name]], *values.get(name, np.zeros(6)))
                        for name in self._outputs)

    def _commanded(self, client: socket.socket) -> None:
        """Takes the client's next data package, if one comes."""
        while True:
            found = self._package(client, self.timeout)
            if found is None:
                return
            if found[0] == "P":
                raise ConnectionError("the client has paused")
            if found[0] != "U":
                continue
            names = self._recipes[found[1][0]]
            codes = ">" + "".join("i" if name.startswith("input_int") else "d" for name in names)
            self.inputs.update(zip(names, struct.unpack(codes, found[1][1:]), strict=True))
            return

    def _package(self, client: socket.socket, timeout: float) -> tuple[str, bytes] | None:
        """Letter and payload of the next package; None if the client says nothing, or the end has come."""
        end = time.perf_counter() + timeout
        while True:
            if len(self._waiting) >= 3:
                size, letter = struct.unpack_from(">HB", self._waiting)
                if len(self._waiting) >= size:
                    payload, self._waiting = self._waiting[3:size], self._waiting[size:]
                    return chr(letter), payload
            client.settimeout(0.05)
            try:
                piece = client.recv(4096)
            except TimeoutError:
                if self._stopped.is_set() or time.perf_counter() > end:
                    return None
                continue
            if not piece:
                raise ConnectionError("the client has left")
            self._waiting += piece

    def _send(self, client: socket.socket, letter: str, payload: bytes) -> None:
        client.sendall(struct.pack(">HB", 3 + len(payload), ord(letter)) + payload)


def _names(payload: bytes) -> list[str]:
    """Field names of a recipe; some clients end the list with a comma."""
    return payload.decode().rstrip(",").split(",")
