"""A real arm behind UR's RTDE, as one more implementation of ``RobotInterface``.

The controller's program reads the commanded angles from input registers and passes them to ``servoj`` every cycle
(program in docs/rsi.md). The controller is the clock: a data package comes every cycle, a command goes back.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.deadline import Deadline
from ideal_robot.errors import InputError
from ideal_robot.interfaces import LinkSettings
from ideal_robot.robots.address import Address
from ideal_robot.robots.interface import LinkedRobot, RobotState
from ideal_robot.robots.robot import Robot
from ideal_robot.rtde.wire import Recipe, RtdeConnection, RtdeError, Values

_OUTPUTS = {"timestamp": "DOUBLE", "actual_q": "VECTOR6D", "target_q": "VECTOR6D", "actual_current": "VECTOR6D",
            "runtime_state": "UINT32", "safety_status_bits": "UINT32"}
_OPTIONAL = {"speed_scaling": "DOUBLE", "target_speed_fraction": "DOUBLE", "payload": "DOUBLE",
             "payload_cog": "VECTOR3D", "actual_tool_accelerometer": "VECTOR3D"}
"""What is read where the controller knows it."""
AXES = 6  # number of values in a VECTOR6D
_MANY = 2.0**31  # largest number of cycles between two packages, as a time stamp may have any value
_LARGEST = 1e9
"""No number is as large, in seconds, radians or ampere."""
_PLAYING = 2
"""``runtime_state`` of a running program."""
_PAUSED = {3: "is being paused", 4: "is paused", 5: "is being resumed"}
"""``runtime_state`` of a program that goes on after a while."""
_LOOK = 1e-3
"""Time within which what waits is read before the first command [s]."""
_STANDS = 1e-3
"""Speed below which the override holds the arm."""
_G, _FALLS = 9.81, 1.0
"""Gravity, and by how much an accelerometer at rest may be beside it [m/s²]."""
_TILTED = np.radians(15.0)
"""Angle between gravity as measured and the URDF's beyond which the arm is mounted otherwise: the accelerometer is
good to some degrees, and its frame is the flange's."""
_SAFETY = {2: "protective stop", 4: "safeguard stop", 5: "emergency stop (system)", 6: "emergency stop (robot)",
           7: "emergency stop", 8: "violation", 9: "fault", 10: "stopped by safety"}
"""Bits of ``safety_status_bits`` with which the controller stops the arm by itself."""


class RtdeRobot(LinkedRobot):
    """A ``RobotInterface`` to an arm whose controller speaks RTDE.

    In a missed cycle ``servoj`` keeps the arm in place. ``speed`` is the speed slider times the scaling of the
    controller's own limiter; the link waits for a paused program (``paused``).

    Args:
        robot: six joints, limits, cycle time, drive gains.
        host: address of the controller.
        port: TCP port.
        register: first of the six input double registers for the command; the counter of commands goes into the input
            integer register of the same number.
        timeout: longest wait for the next data package or an answer; older packages are ignored [s].
        bridge: how long data packages may be missing [s].
        answers_within: time in which the arm's loop answers a command, for the watch over following [s].

    Raises:
        InputError: an arm without six joints, a register that is none.

    Attributes:
        version: the controller's version, once connected.
        payload: mass [kg] and its centre in the flange's frame [m] as the controller knows them, ``(4,)``; NaN where
            they are not reported.
        gravity: its direction in the base by the tool's accelerometer at rest ``(3,)``, up to its sign; NaN where it
            is not measured.
    """

    lost_link, packets = RtdeError, "data packages"

    def __init__(self, robot: Robot, host: str = "127.0.0.1", *, port: int = 30004, register: int = 24,
                 timeout: float = 1.0, bridge: float = 0.1, answers_within: float = 0.5) -> None:
        if robot.n != AXES:
            raise InputError(f"RTDE moves arms with {AXES} joints", field="robot", value=f"{robot.name}: {robot.n}")
        if not 0 <= register <= 48 - AXES:
            raise InputError(f"expected 0 to {48 - AXES}", field="register", value=register)
        super().__init__(robot, bridge, answers_within)
        self.host, self.port = host, port
        self.version: tuple[int, int, int, int] | None = None
        self.payload, self.gravity = np.full(4, np.nan), np.full(3, np.nan)
        self._inputs = {**{f"input_double_register_{register + i}": "DOUBLE" for i in range(AXES)},
                        f"input_int_register_{register}": "INT32"}
        self._timeout = timeout
        self._connection: RtdeConnection | None = None
        self._number = 0

    def connect(self, patience: float = 60.0) -> RobotState:
        """Agrees on the exchanged fields; the controller's program must run or be started within ``patience`` [s].

        Returns the state at rest, ``t = 0``. ``commanded`` is then the controller's setpoint.

        Raises:
            RtdeError: no controller, another protocol, fields it does not know, an arm stopped by its safety system, a
                program that is not started.
        """
        self._connection = link = RtdeConnection(self.host, self.port, self._timeout)
        self.version = link.agree()
        self._outputs: Recipe = link.outputs(_OUTPUTS, 1.0 / self.t_ipo, _OPTIONAL)
        self._recipe = link.inputs(self._inputs)
        link.start()
        started, playing = Deadline.within(patience), False
        while not playing:
            data = self._next(Deadline.within(self._timeout))
            playing = self._playing(data)
            if not playing and started.passed:
                raise RtdeError(f"the controller's program was not started within {patience:.3g} s")
            self.commanded = self._wanted = np.array(data["target_q"])
            # Old values in the registers must not become the arm's first target.
            link.send(self._recipe.packed(*self.commanded.tolist(), 0))
        data = self._next(Deadline.within(self._timeout))
        self._begun = self._last = data["timestamp"][0]
        self._at_rest(self.commanded, np.array(data["actual_q"]))
        self._loaded(data)
        return self._state(data)

    @property
    def meta(self) -> dict[str, Any]:
        """The controller's payload and mounting of the arm, for the recording's metadata."""
        told: dict[str, Any] = {}
        if np.isfinite(self.payload).all():
            told.update(payload_kg=float(self.payload[0]), payload_centre_m=self.payload[1:].tolist())
        if np.isfinite(self.gravity).all():
            told["gravity_direction"] = self.gravity.round(3).tolist()
        return told

    def _stands_now(self) -> Array | None:
        if self._connection is None:
            return None
        waiting = self._connection.every(self._outputs, Deadline.within(_LOOK), quiet=True)
        if not waiting:
            return None
        data, self.arrived = waiting[-1]
        return np.array(data["actual_q"])

    def _handed_over(self, q_c: Array) -> None:
        if self._connection is None:
            raise RtdeError("the connection is closed")
        self._number = self._number % (2**31 - 1) + 1
        self._connection.send(self._recipe.packed(*q_c.tolist(), self._number))

    def _received(self) -> RobotState:
        """See ``LinkedRobot.receive``: waits for the next data package.

        Raises RtdeError for silence, a broken connection, an arm stopped by its safety system, a program that ended,
        more missed than can be bridged.
        """
        deadline = Deadline.within(self._timeout)
        while (since := self._since(data := self._next(deadline))) <= 0:
            self.counts.outdated += 1
            # Half of the patience, so that a stall of this computer is not attributed to the controller.
            if deadline.left < 0.5 * self._timeout:
                raise RtdeError(f"the controller's time stamps do not go on ({data['timestamp'][0]:.3f} s after "
                                f"{self._last:.3f} s); its clock was reset: start again, from rest")
        self._bridged(since)
        self._last += since * self.t_ipo
        state = int(data["runtime_state"][0])
        if state not in (_PLAYING, *_PAUSED):
            raise RtdeError("the controller's program does not run any more")
        told = self._state(data)
        self.paused = (f"the controller's program {_PAUSED[state]}" if state != _PLAYING else
                       "the controller's speed is at zero" if self.speed < _STANDS else None)
        return told

    def close(self) -> None:
        """Ends the connection; the watchdog of the controller's program stops the arm."""
        if self._connection is not None:
            self._connection.pause()
            self._connection.close()
            self._connection = None

    def _loaded(self, data: Values) -> None:
        """Notes payload and gravity, and where it acts along another line than the URDF's."""
        if "payload" in data and "payload_cog" in data:
            self.payload = np.array([*data["payload"], *data["payload_cog"]])
        felt = np.array(data.get("actual_tool_accelerometer", (0.0, 0.0, 0.0)))
        if abs(float(np.linalg.norm(felt)) - _G) > _FALLS:
            return
        model = self.robot.pinocchio
        places = model.createData()
        pin.forwardKinematics(model, places, np.array(data["actual_q"]))
        # In UR's own URDFs the last joint's frame is the flange's, whatever tool is attached.
        self.gravity = np.asarray(places.oMi[AXES].rotation @ felt / np.linalg.norm(felt))
        expected = np.array(model.gravity.linear)
        angle = float(np.arccos(np.clip(np.abs(self.gravity @ expected) / np.linalg.norm(expected), 0.0, 1.0)))
        if angle > _TILTED:
            self.notes = (f"by the tool's accelerometer gravity acts {np.degrees(angle):.0f}° from the URDF's; mount "
                          "the URDF as the arm is (a fixed joint from the world to the base), unless the frame of its "
                          "last joint is not the flange's",)

    def _next(self, deadline: Deadline) -> Values:
        """The newest data package, if the arm is not stopped and all numbers are numbers."""
        if self._connection is None:
            raise RtdeError("connect to the controller before sending a command")
        data, self.arrived = self._connection.newest(self._outputs, deadline)
        bits = int(data["safety_status_bits"][0])
        stopped = [name for bit, name in _SAFETY.items() if bits >> bit & 1]
        if stopped:
            raise RtdeError(f"the controller has stopped the arm: {', '.join(stopped)}"
                            + (f"; it says: {self._connection.texts[-1]}" if self._connection.texts else ""))
        if not all(abs(value) < _LARGEST for values in data.values() for value in values):
            raise RtdeError("the controller reports impossible times, positions or currents")
        return data

    def _since(self, data: Values) -> int:
        """Cycles since the last package that counted; many where the clock has jumped."""
        return round(min(max((data["timestamp"][0] - self._last) / self.t_ipo, -_MANY), _MANY))

    @staticmethod
    def _playing(data: Values) -> bool:
        return data["runtime_state"][0] == _PLAYING

    def _state(self, data: Values) -> RobotState:
        """The state of a packet: angles, and currents as torques by the drive gain; keeps the speed that it reports."""
        measured = self._looked_at(np.array(data["actual_q"]))
        current = np.array(data["actual_current"])
        self.speed = float(np.prod([data.get(name, (1.0,))[0] for name in ("speed_scaling", "target_speed_fraction")]))
        return RobotState(self._last - self._begun, measured, current * self.robot.drive_gain,
                          {"current": current, "speed_scale": self.speed})


PORT = 30004
"""On which UR's controllers listen."""


def opened(address: Address, robot: Robot, settings: LinkSettings) -> RtdeRobot:
    """The link to the controller at ``rtde://host:port``, not yet connected; raises InputError.

    Args:
        address, robot, settings: see ``ideal_robot.interfaces``.
    """
    address.knows()
    host, port = address.at(PORT)
    return RtdeRobot(robot, host, port=port, **settings.given())
