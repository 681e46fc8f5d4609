"""One client of a simulated UR controller: answers its requests, and closes the connection on an error."""

from __future__ import annotations

import math
import re
import socket
import struct
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import islice

_HEADER = struct.Struct(">HB")
_PIECE = 1 << 16  # bytes per read
_UNREAD = 1 << 17
"""What may wait for a client that does not read [bytes]; a thousand data packages of the usual fields."""
_RECIPES = 255
"""Numbers of recipes are one byte, and 0 is none."""
_DATA = 4096
"""Longest data package [bytes]."""

Inputs = dict[str, tuple[float, ...]]
"""Values that a client has written, by name."""


class ClientError(Exception):
    """The client's connection is closed for the reason in the text."""


@dataclass
class RtdeFaults:
    """Faults of the simulated controller, by the number of the cycle.

    Attributes:
        protocols: versions of the protocol it knows.
        unknown: fields it does not know.
        in_use: input fields another client writes.
        skips: cycles whose data package is left out.
        protective_stop: cycle from which the arm is stopped by its safety system.
        speed: speed of the slider, by the cycle from which it applies; the first one is 1.
        pauses: cycles in which the program is paused.
        mounted: gravity in the frame of the arm's base (3) [m/s²].
        program_begins, program_ends: cycles from which the program runs, and does not any more.
        clock_stands: cycle from which the time stamps do not advance.
        disconnects: cycle at which it closes the connection.
        says: text it sends at the start.
    """

    protocols: tuple[int, ...] = (2,)
    unknown: tuple[str, ...] = ()
    in_use: tuple[str, ...] = ()
    skips: tuple[int, ...] = ()
    protective_stop: int | None = None
    speed: Mapping[int, float] = field(default_factory=dict)
    pauses: range = range(0)
    mounted: tuple[float, float, float] = (0.0, 0.0, -9.81)
    program_begins: int = 0
    program_ends: int | None = None
    clock_stands: int | None = None
    disconnects: int | None = None
    says: str = ""


class RtdeClient:
    """A connection of a client.

    Args:
        link: accepted from the listener.
        faults: faults of the controller.
        taken: whether another client writes a field.

    Attributes:
        started: whether it gets data packages.
        outputs: names of the fields it gets.
        rate: rate at which it requests them [Hz].
        writes: names of the fields it may write.
    """

    def __init__(self, link: socket.socket, faults: RtdeFaults, taken: Callable[[RtdeClient, str], bool]) -> None:
        link.setblocking(False)
        link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.link, self._faults, self._taken = link, faults, taken
        self.started = False
        self.outputs: tuple[str, ...] = ()
        self.rate = math.inf
        self.writes: set[str] = set()
        self._recipes: list[tuple[dict[str, str], struct.Struct]] = []
        self._waiting, self._unsent = b"", b""

    def read(self) -> list[Inputs]:
        """Answers the client's requests, and returns the inputs that it wrote, one per data package.

        Raises ``ClientError`` where the client has disconnected, or sends what the protocol forbids.
        """
        try:
            piece = self.link.recv(_PIECE)
        except BlockingIOError:
            return []
        except OSError as error:
            raise ClientError("the client has left") from error
        if not piece:
            raise ClientError("the client has left")
        self._waiting += piece
        try:
            written = [self._answer(letter, payload) for letter, payload in self._packages()]
        except (struct.error, UnicodeDecodeError) as error:
            raise ClientError(f"the client was let go: a package that cannot be read ({error})") from error
        return [inputs for inputs in written if inputs is not None]

    def tell(self, payload: bytes) -> None:
        """Sends a data package with the values of ``outputs``."""
        self._send("U", b"\1" + payload)

    def close(self) -> None:
        """Ends the connection."""
        self.link.close()

    def _packages(self) -> Iterator[tuple[str, bytes]]:
        while len(self._waiting) >= _HEADER.size:
            size, letter = _HEADER.unpack_from(self._waiting)
            if size < _HEADER.size:
                raise ClientError(f"the client was let go: a package of {size} bytes")
            if len(self._waiting) < size:
                return
            payload, self._waiting = self._waiting[_HEADER.size : size], self._waiting[size:]
            yield chr(letter), payload

    def _answer(self, letter: str, payload: bytes) -> Inputs | None:
        """Answers a package; returns the values if it is a data package."""
        if letter == "U":
            return self._written(payload)
        if letter == "V":
            self._send("V", b"\1" if struct.unpack(">H", payload)[0] in self._faults.protocols else b"\0")
        elif letter == "v":
            self._send("v", struct.pack(">4I", 5, 11, 0, 0))
        elif letter == "O":
            self._asks_outputs(payload)
        elif letter == "I":
            self._asks_inputs(payload)
        elif letter in "SP":
            self.started = letter == "S"
            if self.started and self._faults.says:
                text = self._faults.says.encode()
                self._send("M", bytes((len(text),)) + text + b"\4RTDE\3")
            self._send(letter, b"\1")
        elif letter != "M":
            raise ClientError(f"the client was let go: a package of kind {letter!a}")
        return None

    def _asks_outputs(self, payload: bytes) -> None:
        rate, = struct.unpack_from(">d", payload)
        if not 0.0 < rate < math.inf:
            raise ClientError(f"the client was let go: it asks for {rate} packages a second")
        types = {name: output_type(name) or "NOT_FOUND" for name in _names(payload[8:])}
        types.update(dict.fromkeys(set(types) & set(self._faults.unknown), "NOT_FOUND"))
        if set(types.values()) <= set(CODES):
            _layout(types)
            self.outputs, self.rate = tuple(types), rate
        self._send("O", b"\1" + ",".join(types.values()).encode())

    def _asks_inputs(self, payload: bytes) -> None:
        names = _names(payload)
        types = {name: "IN_USE" if name in self._faults.in_use or self._taken(self, name)
                 else _type(name, _INPUTS, ("input",)) or "NOT_FOUND" for name in names}
        sound = set(types.values()) <= set(CODES)
        if sound:
            self._recipes.append((types, _layout(types)))
            self.writes.update(names)
        if len(self._recipes) > _RECIPES:
            raise ClientError(f"the client was let go: more than {_RECIPES} recipes")
        self._send("I", bytes((len(self._recipes) if sound else 0,)) + ",".join(types.values()).encode())

    def _written(self, payload: bytes) -> Inputs:
        if not payload or not 0 < payload[0] <= len(self._recipes):
            raise ClientError("the client was let go: a data package of a recipe that was not agreed on")
        types, layout = self._recipes[payload[0] - 1]
        values = iter(layout.unpack(payload[1:]))
        return {name: tuple(islice(values, count(kind))) for name, kind in types.items()}

    def _send(self, letter: str, payload: bytes) -> None:
        self._unsent += _HEADER.pack(_HEADER.size + len(payload), ord(letter)) + payload
        try:
            self._unsent = self._unsent[self.link.send(self._unsent) :]
        except BlockingIOError:
            pass
        except OSError as error:
            raise ClientError("the client has left") from error
        if len(self._unsent) > _UNREAD:
            raise ClientError("the client was let go: it does not read what it is sent")


def _names(payload: bytes) -> list[str]:
    """Field names of a recipe; some clients end the list with a comma."""
    names = payload.decode("ascii").rstrip(",").split(",")
    if len(set(names)) < len(names):
        raise ClientError("the client was let go: a field stands in its recipe twice")
    return names


def _layout(types: dict[str, str]) -> struct.Struct:
    layout = struct.Struct(">" + "".join(CODES[kind] for kind in types.values()))
    if layout.size > _DATA:
        raise ClientError(f"the client was let go: a recipe of {layout.size} bytes")
    return layout


# Fields of Universal Robots' Real-Time Data Exchange and their types, as its public description lists them.

CODES = {"BOOL": "?", "UINT8": "B", "UINT32": "I", "UINT64": "Q", "INT32": "i", "DOUBLE": "d", "VECTOR3D": "3d",
         "VECTOR6D": "6d", "VECTOR6INT32": "6i", "VECTOR6UINT32": "6I"}
"""How a value of a type stands in a data package."""
_OUTPUTS = {
    "UINT8": "tool_output_mode tool_digital_output0_mode tool_digital_output1_mode",
    "UINT32": "runtime_state robot_status_bits safety_status_bits analog_io_types tool_mode tool_analog_input_types "
              "output_bit_registers0_to_31 output_bit_registers32_to_63 input_bit_registers0_to_31 "
              "input_bit_registers32_to_63 script_control_line",
    "UINT64": "actual_digital_input_bits actual_digital_output_bits",
    "INT32": "robot_mode safety_mode safety_status tool_output_voltage",
    "DOUBLE": "timestamp actual_execution_time speed_scaling target_speed_fraction actual_momentum actual_main_voltage "
              "actual_robot_voltage actual_robot_current standard_analog_input0 standard_analog_input1 "
              "standard_analog_output0 standard_analog_output1 io_current tool_analog_input0 tool_analog_input1 "
              "tool_output_current tool_temperature tcp_force_scalar payload",
    "VECTOR3D": "actual_tool_accelerometer elbow_position elbow_velocity payload_cog",
    "VECTOR6D": "target_q target_qd target_qdd target_current target_moment actual_q actual_qd actual_current "
                "actual_current_window actual_current_as_torque joint_control_output actual_TCP_pose actual_TCP_speed "
                "actual_TCP_force target_TCP_pose target_TCP_speed joint_temperatures actual_joint_voltage "
                "payload_inertia ft_raw_wrench",
    "VECTOR6INT32": "joint_mode"}
_INPUTS = {
    "UINT8": "standard_digital_output_mask standard_digital_output configurable_digital_output_mask "
             "configurable_digital_output tool_digital_output_mask tool_digital_output standard_analog_output_mask "
             "standard_analog_output_type",
    "UINT32": "speed_slider_mask input_bit_registers0_to_31 input_bit_registers32_to_63",
    "DOUBLE": "speed_slider_fraction standard_analog_output_0 standard_analog_output_1",
    "VECTOR6D": "external_force_torque"}
_REGISTER = re.compile(r"(?P<way>input|output)_(?P<kind>bit|int|double)_register_(?P<number>[0-9]{1,3})")
# Index ranges of UR's registers.
_REGISTERS = {"bit": ("BOOL", range(64, 128)), "int": ("INT32", range(48)), "double": ("DOUBLE", range(48))}


def count(kind: str) -> int:
    """Number of values of an RTDE type."""
    return int(CODES[kind][:-1] or 1)


def output_type(name: str) -> str | None:
    """Type of a field that a controller can report, its inputs included; None if it has no such field."""
    return _type(name, _OUTPUTS, ("output", "input"))


def _type(name: str, fields: dict[str, str], ways: tuple[str, ...]) -> str | None:
    match = _REGISTER.fullmatch(name)
    if match is not None:
        kind, numbers = _REGISTERS[match["kind"]]
        return kind if match["way"] in ways and int(match["number"]) in numbers else None
    return next((kind for kind, names in fields.items() if name in names.split()), None)
