r"""An arm behind Franka's Control Interface (FCI), as one more implementation of ``RobotInterface``.

``pylibfranka`` speaks the wire. The controller is the clock: a state comes every millisecond, and its own time, not
that of its arrival, is the recording's. Where the interpolation cycle ``T`` is longer, the command of each millisecond
is a quadratic B-spline through the commands, whose speed is continuous and whose acceleration is that of the commands,

.. math:: q(s) = \tfrac12 \left[(1 - s)^2 q_{k-2} + (1 + 2 s - 2 s^2)\, q_{k-1} + s^2 q_k\right], \qquad 0 < s \le 1 ,

half a cycle behind them.
"""

from __future__ import annotations

import math
import time
from contextlib import suppress
from typing import Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.deadline import Deadline
from ideal_robot.errors import IdealRobotError, InputError
from ideal_robot.interfaces import LinkSettings
from ideal_robot.robots.address import Address
from ideal_robot.robots.interface import LinkedRobot, RobotState
from ideal_robot.robots.robot import Robot

_AXES, _PERIOD = 7, 1e-3
_AGAIN = 0.2
"""Time between two attempts to connect [s]."""
_SAID = {
    "communication_constraints_violation": "answers came too late or were lost: a computer with less to do, real-time "
                                           "priority, a cable of its own",
    "joint_motion_generator_position_limits_violation": "a command beyond the joint limits",
    "joint_motion_generator_velocity_limits_violation": "a command faster than the joints may be",
    "joint_motion_generator_velocity_discontinuity": "the commands' speed leaps: a smoother or slower path",
    "joint_motion_generator_acceleration_discontinuity": "the commands' acceleration leaps: a smoother or slower path",
    "joint_position_motion_generator_start_pose_invalid": "the first command is not where the arm stands",
    "joint_position_limits_violation": "a joint is beyond its limits: guide it back by hand",
    "joint_velocity_violation": "a joint is faster than it may be",
    "joint_reflex": "a collision was detected: external torque of a joint above its threshold",
    "cartesian_reflex": "a collision was detected: external force above its threshold",
    "self_collision_avoidance_violation": "the arm came too near to itself",
    "tau_j_range_violation": "a torque sensor is beyond its range: less load or acceleration",
    "power_limit_violation": "the motors take too much power: a slower path",
    "instability_detected": "the arm oscillates: check the load that is set",
    "User Stop pressed": "the user stop is pressed: release it",
}
"""What the controller's reflexes say, and what helps; others are said by their names."""
_SILENT = "UDP receive: Timeout"
"""What the library says where no state comes: nobody knows then what the arm does."""
_MODES = {"UserStopped": "the user stop is pressed: release it", "Guiding": "the arm is being guided by hand",
          "Reflex": "the arm has stopped by a reflex: recover it in Desk",
          "Other": "brakes are closed, or FCI is not active"}
_WRENCH = ("fx", "fy", "fz", "mx", "my", "mz")


class FciError(IdealRobotError):
    """The controller is not there, does not let itself be led, or has stopped the arm."""


class FciRobot(LinkedRobot):
    """A ``RobotInterface`` to a Franka arm.

    Where answers were missed the controller extrapolates; the next commands lead from the setpoint that it reports back
    to what is wanted.

    Args:
        robot: seven joints, limits, and a cycle of whole milliseconds.
        host: address of the controller.
        cartesian: whether the controller's Cartesian impedance holds the commanded joints, not its joint impedance.
        bridge: how long states may be missing [s].
        answers_within: time in which the arm's loop answers a command, for the watch over following [s].

    Raises:
        InputError: an arm without seven joints, a cycle that is no whole number of milliseconds.
    """

    lost_link, packets = FciError, "states"

    def __init__(self, robot: Robot, host: str, *, cartesian: bool = False, bridge: float = 0.1,
                 answers_within: float = 0.3) -> None:
        self._steps = round(robot.t_ipo / _PERIOD)
        if robot.n != _AXES:
            raise InputError(f"FCI moves arms with {_AXES} joints", field="robot", value=f"{robot.name}: {robot.n}")
        if self._steps < 1 or not math.isclose(self._steps * _PERIOD, robot.t_ipo):
            raise InputError("FCI has a cycle of 1 ms; expected whole milliseconds", field="--cycle", value=robot.t_ipo)
        super().__init__(robot, bridge, answers_within)
        self.host, self._cartesian = host, cartesian
        self._franka: Any = None
        self._control: Any = None
        self._stopped = False
        self._ticks = self._cycle_began = 0
        self._knots = np.full((3, _AXES), np.nan)

    def connect(self, patience: float = 60.0) -> RobotState:
        """Reaches the controller; the motion itself begins with the first command, which has to come soon.

        Returns the state at rest, ``t = 0``. ``commanded`` is then where the controller holds the arm.

        Raises:
            FciError: no controller within ``patience`` [s], or an arm that cannot be led now.
        """
        import pylibfranka

        self._library, deadline, self._stopped = pylibfranka, Deadline.within(patience), False
        while self._franka is None:
            try:
                self._franka = pylibfranka.Robot(self.host, pylibfranka.RealtimeConfig.kIgnore)
            except (pylibfranka.FrankaException, RuntimeError) as error:
                if deadline.left < _AGAIN:
                    raise FciError(f"no controller at {self.host} ({_line(error)}); check address, cable, and that FCI "
                                   "is activated in Desk") from error
                time.sleep(_AGAIN)
        state = self._asked(self._franka.read_once)
        if state.robot_mode.name in _MODES:
            raise FciError(f"the arm cannot be led: {_MODES[state.robot_mode.name]}")
        if state.current_errors:
            raise FciError(f"the arm has stopped: {said(str(state.current_errors))}; recover it in Desk")
        self._first = self._ticks = self._cycle_began = round(state.time.to_sec() / _PERIOD)
        self._at_rest(np.array(state.q_d), np.array(state.q))
        self._knots[:] = self.commanded
        return self._state(state)

    def send(self, q_c: Array) -> None:
        """See ``LinkedRobot.send``; the first command begins the motion."""
        if self._franka is not None and self._control is None:
            self._start()
        super().send(q_c)

    def _handed_over(self, q_c: Array) -> None:
        self._knots = np.vstack([self._knots[1:], q_c])
        self._write()

    def _received(self) -> RobotState:
        """See ``LinkedRobot.receive``: answers the milliseconds in between and waits for the cycle's end.

        Raises FciError where the controller has stopped the arm, or was not heard for too long.
        """
        if self._control is None:
            raise FciError("hand over a command first")
        while True:
            before, state = self._ticks, self._read()
            self.counts.late += max(self._ticks - before - 1, 0)
            if (since := (self._ticks - self._cycle_began) // self._steps) > 0:
                break
            self._write()
        self._bridged(since)
        self._cycle_began += since * self._steps
        self.gone_on = since - 1
        if since > 1:
            # Of a cycle without a command the controller holds or extrapolates the last one, and reports which.
            self._wire_speed = np.array(state.dq_d) * self.t_ipo
            self.commanded = np.array(state.q_d)
            self._knots[:] = self.commanded
        return self._state(state)

    def close(self) -> None:
        """Ends the motion where the arm is commanded, unless the controller has, and the connection."""
        # A controller that has ended the motion by itself answers no command any more.
        if self._control is not None and not self._stopped:
            command = self._library.JointPositions(self.commanded.tolist())
            command.motion_finished = True
            with suppress(self._library.FrankaException, RuntimeError):
                self._control.writeOnce(command)
        self._control = self._franka = None

    def _start(self) -> None:
        """Begins the motion, from where the controller holds the arm."""
        mode = self._library.ControllerMode
        self._control = self._asked(lambda: self._franka.start_joint_position_control(
            mode.CartesianImpedance if self._cartesian else mode.JointImpedance))
        self._read()
        self._cycle_began = self._ticks

    def _read(self) -> Any:
        """The next state; raises FciError where the controller has stopped the arm."""
        state, _ = self._asked(self._control.readOnce)
        self.arrived = time.perf_counter()
        self._ticks = round(state.time.to_sec() / _PERIOD)
        return state

    def _write(self) -> None:
        """Commands the coming millisecond."""
        s = min((self._ticks - self._cycle_began + 1) / self._steps, 1.0)
        first, middle, last = self._knots
        q = last if self._steps == 1 else 0.5 * ((1 - s)**2 * first + (1 + 2 * s - 2 * s**2) * middle + s**2 * last)
        self._asked(lambda: self._control.writeOnce(self._library.JointPositions(q.tolist())))

    def _asked(self, call: Any) -> Any:
        """What a call of the library gives; its errors in the field's words."""
        try:
            return call()
        except (self._library.FrankaException, RuntimeError) as error:
            self._stopped = True
            if _SILENT in _line(error):
                raise FciError("the controller is silent; check cable and power, and that FCI is activated in Desk "
                               f"({_line(error)})") from error
            raise FciError(f"the controller has stopped the arm: {said(_line(error))}") from error

    def _state(self, state: Any) -> RobotState:
        """Torque is measured at the link side, gravity included where the arm measures it so."""
        measured = self._looked_at(np.array(state.q))
        wrench = dict(zip(_WRENCH, state.K_F_ext_hat_K, strict=True))
        return RobotState((self._ticks - self._first) * _PERIOD, measured, np.array(state.tau_J), {
            "q_set": np.array(state.q_d), "tau_ext": np.array(state.tau_ext_hat_filtered),
            "mode": float(state.robot_mode.value), "success_rate": float(state.control_command_success_rate), **wrench})


def said(errors: str) -> str:
    """The controller's errors in words, with what helps; as they are where none is known.

    >>> said('["joint_reflex"]')
    'a collision was detected: external torque of a joint above its threshold (joint_reflex)'
    """
    known = [f"{text} ({name})" for name, text in _SAID.items() if name in errors]
    return "; ".join(known) or errors


def _line(error: BaseException) -> str:
    """An error of the library on one line."""
    return " ".join(str(error).split())


def opened(address: Address, robot: Robot, settings: LinkSettings) -> FciRobot:
    """The link to the controller at ``franka://host?impedance=cartesian``, not yet connected; raises InputError.

    Args:
        address, robot, settings: see ``ideal_robot.interfaces``.
    """
    address.knows("impedance")
    impedance = address.options.get("impedance", "joint")
    if impedance not in ("joint", "cartesian"):
        raise InputError("expected joint or cartesian", field=f"{address.option} ?impedance", value=impedance[:40])
    if address.port is not None:
        raise InputError("the ports of FCI are fixed; give the host alone", field=address.option, value=address.port)
    return FciRobot(robot, address.at(0)[0], cartesian=impedance == "cartesian", **settings.given())
