r"""Corrections for an RSI controller, computed from joint angles: of its axes, or of its tool's pose.

A controller with ``AXISCORR`` adds :math:`A - A_0` to its axes. One with ``POSCORR`` moves its tool and finds the axes
by itself. With the arm's flange :math:`F(q)` in its foot's frame, the base :math:`B` that the program works in and the
tool :math:`W` on the flange its pose is

.. math:: X(q) = B^{-1} F(q) W, \qquad W = F(q)^{-1} B\, X \text{ of the first packet (AIPos, RIst)},

and the correction from the pose :math:`X_0` at which RSI began is given in the base, :math:`(p - p_0,\ R R_0^T)`, or in
the tool, :math:`X_0^{-1} X`: millimetres, and KUKA's angles :math:`R = R_z(A) R_y(B) R_x(C)` in degrees. Increments
follow each other: places add up, rotations multiply.

If geometry or base differ from the controller's, its reported poses contradict its axes: see ``contradiction``.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.robots.robot import Robot
from ideal_robot.robots.size import reach
from ideal_robot.rsi.message import Axes, RobMessage, RsiError

_LEAST_GAIN = 1.0 / 30.0
"""Smallest singular value of the Jacobian, lengths in reaches, along a path that poses can lead: there 0.01°, by which
two geometries of an arm differ, are the 0.3° of a joint at which ``FollowingWatch`` says that it does not follow."""
_TURNED = np.pi / 2.0
"""Least rotation at which one of A, B and C may jump though the tool turns evenly [rad]."""
_BESIDE = 3.0
"""How far the pose of the measured axes may be beside the pose reported with them [mm]: arms that are calibrated for
absolute accuracy are one to two millimetres beside their nominal geometry."""
_BESIDE_TURNED = 0.3
"""The same of its orientation [deg]: a millimetre or two at the length of a forearm."""
_ITERATIONS = 20
_SOLVED = 1e-10
"""Residual of the inverse kinematics [m, rad]."""


class Corrections(Protocol):
    """Interface of the conversion between joint angles and corrections.

    Attributes:
        names: of the answer's attributes.
    """

    names: tuple[str, ...]

    def begin(self, held: Array, message: RobMessage) -> None:
        """Starts with the axes at the setpoint ``held (n,)`` [deg] and the first message; raises RsiError."""

    def of(self, q: Array) -> Array:
        """The whole correction ``(m,)`` from the start to joint angles ``q (n,)`` [rad]."""

    def joints(self, correction: Array) -> Array:
        """Joint angles ``(n,)`` [rad] of a whole correction ``(m,)``."""

    def between(self, before: Array, after: Array) -> Array:
        """The increment ``(m,)`` from one whole correction to another."""

    def behind(self, before: Array, increment: Array) -> Array:
        """The whole correction ``(m,)`` after an increment."""

    def unusable(self, q: Array, relative: bool) -> str | None:
        """Why joint angles ``q (n,)`` [rad] cannot be commanded as corrections; None where they can."""

    def contradiction(self, message: RobMessage) -> str | None:
        """Why a message contradicts these corrections, in words; None where it agrees."""


class AxisCorrections:
    """Corrections of the axes, one number per joint [deg].

    Args:
        axes: directions and zeros of the controller's axes.
        n: number of joints.
    """

    def __init__(self, axes: Axes, n: int) -> None:
        self.names = tuple(f"A{i + 1}" for i in range(n))
        self._axes, self._begin = axes, np.zeros(n)

    def begin(self, held: Array, message: RobMessage) -> None:
        """Starts with the axes at the setpoint ``held (n,)`` [deg] and the first message; see ``Corrections``."""
        del message
        self._begin = held.copy()

    def of(self, q: Array) -> Array:
        """The whole correction ``(m,)`` from the start to joint angles ``q (n,)`` [rad]; see ``Corrections``."""
        return np.asarray(self._axes.angles(q) - self._begin)

    def joints(self, correction: Array) -> Array:
        """Joint angles ``(n,)`` [rad] of a whole correction ``(m,)``; see ``Corrections``."""
        return self._axes.joints(self._begin + correction)

    def between(self, before: Array, after: Array) -> Array:
        """The increment ``(m,)`` from one whole correction to another; see ``Corrections``."""
        return np.asarray(after - before)

    def behind(self, before: Array, increment: Array) -> Array:
        """The whole correction ``(m,)`` after an increment; see ``Corrections``."""
        return np.asarray(before + increment)

    def unusable(self, q: Array, relative: bool) -> str | None:
        """Why joint angles ``q (n,)`` [rad] cannot be commanded as corrections; see ``Corrections``."""
        del q, relative
        return None

    def contradiction(self, message: RobMessage) -> str | None:
        """Why a message contradicts these corrections, in words; None where it agrees; see ``Corrections``."""
        del message
        return None


class PoseCorrections:
    """Corrections of the tool's pose: X, Y, Z [mm], A, B, C [deg].

    Args:
        robot: its geometry up to its tool's frame, and the table ``[rsi]``: ``reference``, the frame of the
            corrections, ``"base"`` (default) or ``"tool"``; ``base``, the program's base X, Y, Z [mm], A, B, C [deg] in
            the frame of the arm's foot (default: the foot).
        axes: directions and zeros of the controller's axes.

    Raises:
        InputError: an arm that has not six joints, a table that cannot be used.
    """

    names: tuple[str, ...] = ("X", "Y", "Z", "A", "B", "C")

    def __init__(self, robot: Robot, axes: Axes) -> None:
        if robot.n != len(self.names):
            raise InputError("corrections of the pose need an arm with six axes; correct the axes instead (AXISCORR "
                             "in place of POSCORR)", file=robot.urdf, field="joint", value=robot.n)
        table = robot.data.get("rsi", {})
        reference = table.get("reference", "base")
        if reference not in ("base", "tool"):
            raise InputError("expected base or tool", field="rsi.reference", value=reference)
        base = np.array(table.get("base", np.zeros(6)), dtype=float)
        if base.shape != (6,) or not np.isfinite(base).all():
            raise InputError("expected X, Y, Z [mm], A, B, C [deg]", field="rsi.base", value=table.get("base"))
        self._in_tool, self._axes = reference == "tool", axes
        self._base = _frame(base).inverse()
        self._model, self._frame, self._length = robot.pinocchio, robot.tool_id, reach(robot)
        self._data = self._model.createData()
        self._tool = self._from = pin.SE3.Identity()
        self._near, self._start = robot.home.copy(), pin.SE3.Identity()

    def begin(self, held: Array, message: RobMessage) -> None:
        """Starts with the axes at the setpoint ``held (n,)`` [deg] and the first message; see ``Corrections``."""
        if message.pose is None:
            raise RsiError("RIst is missing; add DEF_RIst to what the controller sends")
        self._tool = (self._base * self._flange(self._axes.joints(message.actual))).inverse() * _frame(message.pose)
        self._near = self._axes.joints(held)
        self._from = self._pose(self._near)
        self.starts(self._near)

    def of(self, q: Array) -> Array:
        """The whole correction ``(m,)`` from the start to joint angles ``q (n,)`` [rad]; see ``Corrections``."""
        self._near = q
        pose = self._pose(q)
        if self._in_tool:
            return _numbers(self._from.inverse() * pose)
        return _numbers(pin.SE3(pose.rotation @ self._from.rotation.T, pose.translation - self._from.translation))

    def joints(self, correction: Array) -> Array:
        """Joint angles ``(n,)`` [rad] of a correction, nearest to the last command; RsiError where there are none."""
        step = _frame(correction)
        wanted = self._from * step if self._in_tool else pin.SE3(
            step.rotation @ self._from.rotation, self._from.translation + step.translation)
        q = self._near.copy()
        for _ in range(_ITERATIONS):
            error = pin.log6(self._pose(q).actInv(wanted)).vector
            if np.max(np.abs(error)) < _SOLVED:
                return q
            J = self._tool.inverse().action @ pin.computeFrameJacobian(self._model, self._data, q, self._frame)
            q = q + np.linalg.solve(J, error)
        raise RsiError("the tool pose of the controller has no joint solution near the last command; check base, tool "
                       "and robot data")

    def between(self, before: Array, after: Array) -> Array:
        """The increment ``(m,)`` from one whole correction to another; see ``Corrections``."""
        a, b = _frame(before), _frame(after)
        if self._in_tool:
            return _numbers(a.inverse() * b)
        return _numbers(pin.SE3(b.rotation @ a.rotation.T, b.translation - a.translation))

    def behind(self, before: Array, increment: Array) -> Array:
        """The whole correction ``(m,)`` after an increment; see ``Corrections``."""
        a, step = _frame(before), _frame(increment)
        if self._in_tool:
            return _numbers(a * step)
        return _numbers(pin.SE3(step.rotation @ a.rotation, a.translation + step.translation))

    def unusable(self, q: Array, relative: bool) -> str | None:
        """Why angles ``q (n,)`` [rad] cannot be commanded: near a singularity, or an angle may jump; else None."""
        J = pin.computeFrameJacobian(self._model, self._data, q, self._frame)
        J[:3] /= self._length
        if float(np.linalg.svd(J, compute_uv=False)[-1]) < _LEAST_GAIN:
            return "the posture is too near a singularity for corrections of the pose"
        R = self._flange(q).rotation @ self._start.rotation.T
        if not relative and np.linalg.norm(pin.log3(R)) >= _TURNED:
            return ("the tool is turned by a quarter from where it began, where absolute A, B and C may jump; take "
                    "relative corrections")
        return None

    def starts(self, q: Array) -> None:
        """Resets the check ``unusable`` to a path that starts at ``q (n,)`` [rad]."""
        self._start = self._flange(q)

    def contradiction(self, message: RobMessage) -> str | None:
        """Why a message contradicts these corrections: its pose is not that of its axes; None where it agrees."""
        if message.pose is None:
            return None
        off = self._pose(self._axes.joints(message.actual)).actInv(_frame(message.pose))
        apart, turned = 1e3 * float(np.linalg.norm(off.translation)), np.degrees(float(np.linalg.norm(
            pin.log3(off.rotation))))
        if apart <= _BESIDE and turned <= _BESIDE_TURNED:
            return None
        return (f"the pose that the controller reports (RIst) is {apart:.2g} mm and {turned:.2g}° beside that of its "
                "axes (AIPos) in the URDF; check axis_sign, axis_zero and base in the robot's table [rsi], and the "
                "URDF's lengths")

    def _flange(self, q: Array) -> pin.SE3:
        pin.framesForwardKinematics(self._model, self._data, q)
        return self._data.oMf[self._frame].copy()

    def _pose(self, q: Array) -> pin.SE3:
        return self._base * self._flange(q) * self._tool


def _frame(numbers: Array) -> pin.SE3:
    """The frame at X, Y, Z [mm], turned by A, B, C [deg]."""
    a, b, c = np.radians(numbers[3:])
    return pin.SE3(pin.rpy.rpyToMatrix(c, b, a), 1e-3 * np.asarray(numbers[:3]))


def _numbers(frame: pin.SE3) -> Array:
    """X, Y, Z [mm], A, B, C [deg] of a frame ``(6,)``."""
    return np.concatenate([1e3 * frame.translation, np.degrees(pin.rpy.matrixToRpy(frame.rotation))[::-1]])


def corrections_of(robot: Robot, axes: Axes, pose: bool) -> Corrections:
    """The conversion for an arm's kind of corrections; raises InputError where it is not possible.

    Args:
        robot, axes: the arm, and directions and zeros of the controller's axes.
        pose: whether its tool's pose is corrected; else its axes.
    """
    return PoseCorrections(robot, axes) if pose else AxisCorrections(axes, robot.n)


def require_led(q_d: Array, robot: Robot, *, relative: bool, file: str) -> None:
    """Raises InputError for a path that corrections of the pose cannot follow.

    Args:
        q_d: desired positions at the cycles ``(N, n)`` [rad].
        robot, file: the arm, and where the path comes from.
        relative: whether corrections are increments.

    Raises:
        InputError: with the time of the first impossible row.
    """
    tried = PoseCorrections(robot, Axes.of(robot))
    tried.starts(q_d[0])
    for k, q in enumerate(q_d):
        if (why := tried.unusable(q, relative)) is not None:
            raise InputError(f"{why} (at {k * robot.t_ipo:.3f} s of the path); or correct the axes (AXISCORR)",
                             file=file, field="path")
