"""A robot as its maker describes it: kinematics and nominal inertias (URDF) and drive data (one TOML file).

Nothing here is identified or from the simulator: all of it is in the data sheet.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ideal_robot.arrays import Array
from ideal_robot.bounded_values import read_text
from ideal_robot.errors import InputError
from ideal_robot.results import Summarised, listed, plain
from ideal_robot.robots import urdf_of
from ideal_robot.robots.chain import serial_arm
from ideal_robot.robots.joints import joint_motions, own_joints
from ideal_robot.robots.units import in_si
from ideal_robot.robots.urdf import model_of, read_drive_data

# Which kind of joint a Pinocchio model has where.

def prismatic_joints(model: pin.Model) -> NDArray[np.bool_]:
    """Which joints are prismatic ``(n,)``; each joint has one degree of freedom."""
    return np.array([model.joints[j].shortname().startswith("JointModelP") for j in own_joints(model)], dtype=bool)


def joint_units(unit: str, model: pin.Model) -> tuple[str, ...]:
    """A unit for each joint: as given for revolute ones, "mm" for "mrad", "N" for "N m" if prismatic ``(n,)``."""
    return tuple(sliding_unit(unit) if slides else unit for slides in prismatic_joints(model))


def sliding_unit(unit: str) -> str:
    """The unit of a prismatic joint that corresponds to ``unit`` of a revolute one."""
    for turning, along in (("(N m)", "N"), ("N m", "N"), ("kg m²", "kg"), ("rad", "m")):
        unit = unit.replace(turning, along)
    return unit


def unit_in_amperes(unit: str) -> str:
    """The unit that replaces one of torques, forces and inertias where the drive gain is unknown: with A for N m."""
    for of_torque, of_current in (("kg m²", "A s²"), ("kg m", "A s²/m"), ("kg", "A s²/m²"), ("N m", "A"), ("N", "A")):
        if of_torque in unit:
            return unit.replace(of_torque, of_current)
    return unit


TOOL_TIP = "ideal_robot_tool_tip"
"""Name of the frame at the end of a tool that a scene puts on."""


def _frozen(values: Any) -> Array:
    array = np.array(values, dtype=float)
    array.setflags(write=False)
    return array


def _drive_gain(torque_constant: Array, gear_ratio: Array) -> Array:
    """Joint-side torque per ampere ``(n,)`` [N m/A]; 1 where no torque constant is known, which 0 says."""
    return _frozen(np.where(torque_constant == 0.0, 1.0, torque_constant * gear_ratio))


@dataclass(frozen=True, repr=False)
class Robot(Summarised):
    """Kinematics, nominal rigid body and drive data of a serial arm with ``n`` joints.

    Attributes:
        name: key of the robot.
        urdf: path of the URDF.
        pinocchio: Pinocchio model with the URDF's (nominal, never identified) inertias.
        tool_frame: name of the frame that is the TCP.
        q_min, q_max: joint limits ``(n,)`` [rad or m].
        v_max, a_max: velocity and acceleration limits ``(n,)`` [rad/s, rad/s² or m/s, m/s²].
        gear_ratio: motor turns per joint turn ``(n,)``; 1 where unknown.
        rotor_inertia: rotor inertia reflected to the joint side ``(n,)`` [kg m²]; 0 where unknown.
        drive_gain: joint-side torque per ampere ``(n,)`` [N m/A]; 1 where unknown.
        tau_max: joint-side motor torque limit ``(n,)`` [N m]; inf where unknown.
        t_ipo, t_position, t_velocity: cycle times of interpolation, position and velocity loop [s].
        home: a posture for demos ``(n,)``.
        counted: the controller's joint angles, in logs and on its pendant, are this matrix times the URDF's ``(n, n)``;
            it is not diagonal where rods or the controller couple joints.
        data: the whole data file, for special readers.
        description: the URDF's text as used: the arm's joints move, all others are fixed.
        assumed: missing or implausible values of the URDF and their replacements, in words.
    """

    name: str
    urdf: Path
    pinocchio: pin.Model = field(repr=False, compare=False)
    tool_frame: str
    q_min: Array
    q_max: Array
    v_max: Array
    a_max: Array
    gear_ratio: Array
    rotor_inertia: Array
    drive_gain: Array
    tau_max: Array
    t_ipo: float
    t_position: float
    t_velocity: float
    home: Array
    counted: Array
    data: dict[str, Any] = field(repr=False, compare=False)
    description: str = field(repr=False, compare=False, default="")
    assumed: tuple[str, ...] = field(repr=False, compare=False, default=())

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.pinocchio.nv)

    @property
    def prismatic(self) -> NDArray[np.bool_]:
        """Which joints are prismatic ``(n,)``."""
        return prismatic_joints(self.pinocchio)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the URDF's joints that move on their own ``(n,)``."""
        return tuple(self.pinocchio.names[j] for j in own_joints(self.pinocchio))

    @property
    def following(self) -> tuple[str, ...]:
        """Couplings of joints to others, in words."""
        model, motions = self.pinocchio, joint_motions(self.pinocchio)
        return tuple(f"{model.names[i + 1]} = {motions.ratio[i]:.6g} {self.joint_names[motions.coordinate[i]]}"
                     + (f" {motions.offset[i]:+.6g}" if motions.offset[i] else "")
                     for i in np.flatnonzero(~motions.own).tolist())

    def units(self, unit: str) -> tuple[str, ...]:
        """A unit for each joint, e.g. "mrad": as it is for revolute ones, "mm" for prismatic ones ``(n,)``."""
        return joint_units(unit, self.pinocchio)

    @property
    def knows_drive_gains(self) -> bool:
        """Whether the drive gains [N m/A] of all joints are known."""
        return not self.unknown_drive_gain

    @property
    def without_gain(self) -> list[int]:
        """Joints, counted from 1, without a known drive gain [N m/A]."""
        return [int(j) + 1 for j in np.flatnonzero(self.drive_gain == 1.0)]

    @property
    def unknown_drive_gain(self) -> str:
        """Warning for torques computed from the arm's currents; empty where all drive gains are known."""
        unknown = self.without_gain
        if not unknown:
            return ""
        joints = "no drive gains are" if len(unknown) == self.n else (
            f"the drive gain of joint {', '.join(map(str, unknown))} is not")
        return (f"unknown-drive-gain: {joints} known (torque_constant of the robot's TOML, --robot); torques are in "
                "amperes there and so are all parameters")

    @property
    def urdf_hash(self) -> str:
        """SHA-256 of the URDF file, first 16 hex digits."""
        return hashlib.sha256(self.urdf.read_bytes()).hexdigest()[:16]

    @cached_property
    def tool_id(self) -> int:
        """Pinocchio's index of the TCP frame."""
        # A joint and a link may have the same name; the link's frame is that of the tool.
        called = [i for i, frame in enumerate(self.pinocchio.frames) if frame.name == self.tool_frame]
        return max(called, key=lambda i: self.pinocchio.frames[i].type == pin.FrameType.BODY)

    @property
    def tool_place(self) -> NDArray[np.float64]:
        """Place of the TCP in the last joint's frame ``(3,)`` [m]."""
        return np.array(self.pinocchio.frames[self.tool_id].placement.translation)

    @classmethod
    def load(cls, name_or_urdf: str | Path, data: str | Path | None = None) -> Robot:
        """Loads a shipped robot by name, or any serial URDF by path.

        Args:
            name_or_urdf: one of ``robots.SHIPPED``, or a path of a URDF file (meshes are not needed).
            data: path of the drive data (TOML). For a shipped robot, and for a URDF with a ``.toml`` of the
                same stem beside it, found by itself; otherwise optional, with neutral values.

        Raises:
            InputError: unknown name, missing or broken file, a joint that is not
                one-degree-of-freedom, a list whose length is not the joint count, a home beyond the joints' limits.

        >>> robot = Robot.load("kr6")
        >>> robot.n, robot.t_ipo
        (6, 0.012)
        """
        urdf, data_path = _locate(name_or_urdf, data)
        drive, values = read_drive_data(data_path)
        arm = serial_arm(read_text(urdf, "a URDF"), urdf, drive.tool_frame)
        description, converted = in_si(arm.text)
        model = model_of(description, urdf)

        def per_joint(key: str) -> Array:
            return _frozen(drive.per_joint(key, model.nv, data_path))

        home = per_joint("home")
        if "home" in drive.joints.model_fields_set:
            _check_within(home, model, data_path)
        else:
            home = _frozen(_inside(home, model))
        gear_ratio = per_joint("gear_ratio")
        return cls(
            name=drive.name or urdf.stem,
            urdf=urdf,
            pinocchio=model,
            tool_frame=_tool_frame(model, drive.tool_frame, data_path, arm.tool),
            q_min=_frozen(model.lowerPositionLimit),
            q_max=_frozen(model.upperPositionLimit),
            v_max=_frozen(np.where(model.velocityLimit > 0, model.velocityLimit, np.inf)),
            a_max=per_joint("a_max"),
            gear_ratio=gear_ratio,
            # The file gives rotor inertia and torque constant on the motor side, as data sheets do.
            rotor_inertia=_frozen(per_joint("rotor_inertia") * gear_ratio**2),
            drive_gain=_drive_gain(per_joint("torque_constant"), gear_ratio),
            tau_max=_frozen(np.where(model.effortLimit > 0, model.effortLimit, np.inf)),
            **{key: float(getattr(drive.controller, key)) for key in ("t_ipo", "t_position", "t_velocity")},
            home=home,
            counted=_frozen(drive.counted(model.nv, data_path)),
            data=values,
            description=description,
            assumed=(*arm.changed, *converted),
        )

    def summary(self) -> list[tuple[str, str]]:
        """Number of joints, reach and speed as rows of label and value."""
        cycle = f"cycle {1e3 * self.t_ipo:g} ms"
        return [("robot", f"{self.name!r}: {self.n} joints, tool frame {self.tool_frame}, {cycle}"),
                *(("followers", "; ".join(self.following)) for _ in self.following[:1]),
                ("from", listed(self.q_min)), ("to", listed(self.q_max, "rad or m")),
                ("speed", listed(self.v_max, "rad/s or m/s"))]

    def to_dict(self) -> dict[str, Any]:
        """Its data as plain values; unknown limits, which are infinite, as None."""
        return plain({
            "name": self.name, "urdf": self.urdf, "urdf_hash": self.urdf_hash, "joints": self.n,
            "assumed": list(self.assumed), "following": list(self.following),
            "tool_frame": self.tool_frame, "prismatic": self.prismatic, "q_min": self.q_min, "q_max": self.q_max,
            "v_max": self.v_max, "a_max": self.a_max, "tau_max": self.tau_max, "gear_ratio": self.gear_ratio,
            "rotor_inertia": self.rotor_inertia, "drive_gain": self.drive_gain, "home": self.home,
            "cycle_time_s": {"interpolation": self.t_ipo, "position": self.t_position, "velocity": self.t_velocity}})

    @property
    def tool_length(self) -> float:
        """Length of the tool that ``with_tool`` added [m]."""
        frame = self.pinocchio.frames[self.tool_id]
        if frame.name != TOOL_TIP:
            return 0.0
        flange = self.pinocchio.frames[frame.parentFrame]
        return float(np.linalg.norm(frame.placement.translation - flange.placement.translation))

    def with_tool(self, length: float, turn: float = 0.0) -> Robot:
        """The same arm with a straight tool on its tool frame.

        Args:
            length: of the TCP beyond the tool frame along the approach axis z [m].
            turn: rotation of the tool and its load about that axis [rad].
        """
        if length == 0.0 and turn == 0.0:
            return self
        frame = self.pinocchio.frames[self.tool_id]
        tip = frame.placement * pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, turn), np.array([0.0, 0.0, length]))
        model = self.pinocchio.copy()
        model.addFrame(pin.Frame(TOOL_TIP, frame.parentJoint, self.tool_id, tip, pin.FrameType.OP_FRAME))
        return replace(self, pinocchio=model, tool_frame=TOOL_TIP)

    def fk(self) -> Callable[[Array], pin.SE3]:
        """Returns a function from joint angles ``(n,)`` to the TCP pose in the base frame (copied)."""
        data = self.pinocchio.createData()
        tool = self.tool_id

        def pose(q: Array) -> pin.SE3:
            pin.framesForwardKinematics(self.pinocchio, data, q)
            return data.oMf[tool].copy()

        return pose

    def tool_places(self, q: Array) -> Array:
        """Positions of the TCP ``(N, 3)`` [m] at joint angles ``(N, n)`` [rad]."""
        pose = self.fk()
        return np.array([pose(row).translation for row in np.ascontiguousarray(q)])


def _locate(name_or_urdf: str | Path, data: str | Path | None) -> tuple[Path, Path | None]:
    urdf = urdf_of(name_or_urdf)
    if data is not None and not os.path.isfile(data):
        raise InputError("no such robot data file", field="robot", value=str(data))
    beside = urdf.with_suffix(".toml")
    return urdf, Path(data) if data else (beside if os.path.isfile(beside) else None)


def _check_within(home: Array, model: pin.Model, file: Path | None) -> None:
    low, high = model.lowerPositionLimit, model.upperPositionLimit
    outside = np.flatnonzero((low < high) & ((home < low - 1e-6) | (home > high + 1e-6)))
    if len(outside):
        j = outside[0]
        raise InputError(f"joint {j + 1} goes from {low[j]:.4g} to {high[j]:.4g} by the URDF: give a posture within "
                         "its limits [rad, m]", file=file, field="home", value=home.tolist())


def _inside(home: Array, model: pin.Model) -> Array:
    """A posture ``(n,)``; the middle of their range for joints that have it beyond their limits."""
    low, high = model.lowerPositionLimit, model.upperPositionLimit
    return np.where((low < high) & ((home < low) | (home > high)), 0.5 * (low + high), home)


def _tool_frame(model: pin.Model, wanted: str | None, file: Path | None, found: str | None) -> str:
    if wanted is not None:
        if not model.existFrame(wanted):
            raise InputError("no frame of that name in the URDF", file=file, field="tool_frame", value=wanted)
        return wanted
    # By default the end of the chain.
    if found is not None and model.existFrame(found):
        return found
    return str([frame.name for frame in model.frames if frame.type == pin.FrameType.BODY][-1])


# Common normals of neighbouring joint axes, as Denavit and Hartenberg use them.

def common_normals(robot: Robot) -> Array:
    """Common normal of each joint's axis and the next one, in the joint's own frame ``(n, 3)``.

    For parallel axes it points from one to the other; for the last joint towards the TCP.
    """
    n, model = robot.n, robot.pinocchio
    data, motions = model.createData(), joint_motions(model)
    pin.framesForwardKinematics(model, data, pin.neutral(model))
    frames = [data.oMi[j] for j in own_joints(model)]
    axes = [frame.rotation @ axis for frame, axis in zip(frames, motions.axis[motions.own], strict=True)]
    places = [*(frame.translation for frame in frames), data.oMf[robot.tool_id].translation]
    result = np.empty((n, 3))
    for j in range(n):
        z = axes[j] / np.linalg.norm(axes[j])
        across = np.cross(z, axes[j + 1]) if j + 1 < n else np.zeros(3)
        for candidate in (across, places[j + 1] - places[j], *np.eye(3)):
            flat = candidate - (candidate @ z) * z
            if np.linalg.norm(flat) > 1e-3:
                break
        result[j] = frames[j].rotation.T @ (flat / np.linalg.norm(flat))
    return result


# Postures spread over an arm's range, the same ones every time.

def spread_postures(q_min: Array, q_max: Array, count: int = 128) -> Array:
    """Halton points ``(count, n)`` between the limits; joints with larger ranges are limited to ±180°.

    Args:
        q_min, q_max: position limits ``(n,)`` [rad or m].
        count: number of postures.
    """
    from scipy.stats import qmc  # imported late, as loading a robot does not need it

    low, high = np.clip(q_min, -np.pi, np.pi), np.clip(q_max, -np.pi, np.pi)
    return np.asarray(low + qmc.Halton(len(low), scramble=False).random(count) * (high - low))
