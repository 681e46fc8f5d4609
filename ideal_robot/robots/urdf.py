"""Makes Pinocchio's model from a URDF's text, after checks that Pinocchio omits or only warns of."""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pinocchio as pin
import pydantic

from ideal_robot.arrays import Array
from ideal_robot.bounded_values import URDF_BYTES, URDF_DEPTH, URDF_ELEMENTS, URDF_JOINTS, kept_words, read_toml
from ideal_robot.errors import InputError
from ideal_robot.robots.joints import joint_motions, own_joints

FEWEST = 4
"""Joints of an arm."""
SLOWEST = 1e-4
"""Least speed limit of a joint [rad/s or m/s]."""
_NUMBERS = ("xyz", "rpy", "mass", "multiplier", "offset", "lower", "upper", "effort", "velocity", "ixx", "ixy",
            "ixz", "iyy", "iyz", "izz")
_LARGEST = 1e9
"""Largest magnitude of a number, except of limits, which may be infinite."""

_XACRO = ("{http://www.ros.org/wiki/xacro}", "{http://ros.org/wiki/xacro}")
"""What stands before the names of xacro's commands."""
_BELOW_ZERO = re.compile(r"""(\b(?:effort|velocity)\s*=\s*)(["'])\s*-[^"'<]*\2""")
"""A limit below zero of efforts or speeds, in a text that ``check_text`` has passed."""


def model_of(text: str, file: str | Path | None = None) -> pin.Model:
    """The kinematics and nominal inertias of a URDF, as ``ideal_robot.robots.chain.serial_arm`` leaves it.

    Nothing that the text names (meshes, entities) is opened.

    Raises:
        InputError: broken XML, entities, numbers that are none, loops, no or too many moving joints, joints of other
            kinds than revolute with limits and prismatic, xacro commands, bodies and speed limits that no arm has.
    """
    check_text(text, file)
    check_joints(ET.fromstring(text), file)
    model = _built(text, file)
    if model.nv < 1:
        raise InputError("the URDF has no moving joint", file=file)
    URDF_JOINTS.check(model.nv, file)
    if model.nq != model.nv:
        raise InputError("only revolute (with limits) and prismatic joints are supported", file=file)
    _keep_followers_limits(model, ET.fromstring(text))
    for j in range(1, model.njoints):
        if model.joints[j].nv > 1:
            raise InputError("only joints of one degree of freedom are supported", file=file, field=model.names[j])
        inertia = model.inertias[j]
        numbers = np.concatenate([model.jointPlacements[j].homogeneous.ravel(), inertia.inertia.ravel(),
                                  inertia.lever, [inertia.mass]])
        if not np.all(np.isfinite(numbers)):
            raise InputError("place or inertia is not finite", file=file, field=model.names[j])
        # For an arm such links are replaced by typical ones, with a note (``ideal_robot.robots.size``).
        if model.nv < FEWEST and (inertia.mass < 0.0 or (np.diag(inertia.inertia) < -1e-12).any()):
            raise InputError("a body of negative mass or moment of inertia", file=file, field=model.names[j],
                             value=[inertia.mass, *np.diag(inertia.inertia).tolist()])
    for k, j in enumerate(own_joints(model)):
        if not (model.velocityLimit[k] <= 0.0 or model.velocityLimit[k] >= SLOWEST):
            raise InputError(f"a speed limit below {SLOWEST:g} rad/s or m/s; 0 stands for none", file=file,
                             field=model.names[j], value=float(model.velocityLimit[k]))
        if not model.lowerPositionLimit[k] <= model.upperPositionLimit[k]:
            raise InputError("the lower limit lies above the upper one, with those of the joints coupled to it",
                             file=file, field=model.names[j])
    return model


def _keep_followers_limits(model: pin.Model, root: ET.Element) -> None:
    """Narrows the limits of position and speed to what the joints that follow allow, where these have any."""
    motions, limits = joint_motions(model), {joint.get("name"): joint.find("limit") for joint in root.findall("joint")}
    low, high, speed = (np.array(values) for values in (model.lowerPositionLimit, model.upperPositionLimit,
                                                        model.velocityLimit))
    for i in np.flatnonzero(~motions.own).tolist():
        limit, k, ratio = limits[model.names[i + 1]], motions.coordinate[i], motions.ratio[i]
        if limit is None:
            continue
        ends = sorted((float(limit.get(key, 0.0)) - motions.offset[i]) / ratio for key in ("lower", "upper"))
        if ends[0] < ends[1]:
            low[k], high[k] = max(low[k], ends[0]), min(high[k], ends[1])
        if (fastest := float(limit.get("velocity", 0.0)) / abs(ratio)) > 0.0:
            speed[k] = fastest if speed[k] <= 0.0 else min(speed[k], fastest)
    model.lowerPositionLimit, model.upperPositionLimit, model.velocityLimit = low, high, speed


def without_meshes(text: str) -> str:
    """The same URDF with primitive shapes only, so that a viewer opens no other files."""
    root = ET.fromstring(text)
    for link in root.findall("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            if shape.find("./geometry/mesh") is not None:
                link.remove(shape)
    for element in root.iter("material"):
        for texture in element.findall("texture"):
            element.remove(texture)
    return ET.tostring(root, encoding="unicode")


def check_text(text: str, file: str | Path | None) -> None:
    """Raises InputError for a text that is not a URDF, or is too large.

    The causes are broken XML, entities, malformed numbers, xacro commands.
    """
    URDF_BYTES.check(len(text), file, "is this a URDF?")
    if "<!ENTITY" in text or "\0" in text:
        raise InputError("declares entities or holds null characters; they are not read", file=file)
    reader: Any = ET.XMLPullParser(events=("start", "end"))
    depth, count = 0, 0
    try:
        for start in range(0, len(text), 20_000):
            reader.feed(text[start : start + 20_000])
            for event, element in reader.read_events():
                if event == "end":
                    depth -= 1
                    continue
                depth, count = depth + 1, count + 1
                URDF_DEPTH.check(depth, file)
                URDF_ELEMENTS.check(count, file)
                if count == 1 and element.tag != "robot":
                    raise InputError("not a URDF: the root element is not <robot>", file=file, value=element.tag[:40])
                _check_element(element, file)
                _check_numbers(element, file)
        reader.close()
    except (ET.ParseError, ValueError) as error:
        raise InputError(f"not a readable URDF ({error})", file=file) from error
    if count == 0:
        raise InputError("not a URDF: it is empty", file=file)


def _check_element(element: ET.Element, file: str | Path | None) -> None:
    """Raises InputError for xacro commands and masses without a value, which Pinocchio reads without a word."""
    command = element.tag.rpartition("}")[2] if element.tag.startswith(_XACRO) else None
    # A property that is defined but not used changes nothing.
    used = next((name for name, value in element.attrib.items() if "${" in value), None)
    if (command is not None and command != "property") or (command is None and used is not None):
        raise InputError("holds xacro commands, which are not executed; write the URDF by `xacro FILE`", file=file,
                         field=(command or f"{element.tag}.{used}")[:40])
    if element.tag == "mass" and "value" not in element.attrib:
        raise InputError("expected a number of kg, or no inertial at all", file=file, field="mass.value")


def check_joints(root: ET.Element, file: str | Path | None) -> None:
    """Raises InputError for moving joints whose axis has no direction."""
    for joint in root.findall("joint"):
        name, axis = str(joint.get("name"))[:40], joint.find("axis")
        if joint.get("type") == "fixed":
            continue
        # Pinocchio uses x for a missing axis, and none for an axis without a direction.
        written = "1 0 0" if axis is None else axis.get("xyz", "")
        if not 1e-3 <= math.hypot(*map(float, written.split())) <= 1e3:
            raise InputError("an axis needs a direction, e.g. 0 0 1", file=file, field=name, value=written[:40])


def _check_numbers(element: ET.Element, file: str | Path | None) -> None:
    keys = (*_NUMBERS, "value") if element.tag == "mass" else _NUMBERS
    for key in keys:
        if key not in element.attrib:
            continue
        written = element.attrib[key]
        try:
            numbers = [float(word) for word in written.split()]
        except ValueError as error:
            raise InputError("expected numbers", file=file, field=f"{element.tag}.{key}",
                             value=written[:40]) from error
        count = 3 if key in ("xyz", "rpy") else 1
        if len(numbers) != count:
            raise InputError(f"expected {count} number{'s' * (count > 1)}", file=file, field=f"{element.tag}.{key}",
                             value=written[:40])
        limit = math.inf if element.tag == "limit" else _LARGEST
        if any(math.isnan(number) or abs(number) > limit for number in numbers):
            raise InputError("an impossible number for an arm", file=file, field=f"{element.tag}.{key}",
                             value=written[:40])


def _built(text: str, file: str | Path | None) -> pin.Model:
    """Pinocchio's model; what its URDF library writes to standard error meanwhile goes into our one line.

    An effort or a speed limit below zero stands for none, as 0 does: descriptions for planners say -1.
    """
    text = _BELOW_ZERO.sub(r'\g<1>"0"', text)
    with kept_words() as stream:
        try:
            return pin.buildModelFromXML(text, mimic=True)
        except Exception as error:  # the binding raises exceptions of many types
            stream.seek(0)
            reason = re.search(r"Error:\s*([^\n]*)", stream.read().decode(errors="replace"))
            shown = reason.group(1) if reason else " ".join(str(error).split())
            raise InputError(f"not a readable URDF ({shown[:200]})", file=file) from error


LEAST = 1e-12
"""Least size of any unit: what is smaller divides to infinity somewhere."""


def _none_or_size(value: float) -> float:
    if 0.0 < value < LEAST:
        raise ValueError(f"expected 0, for none, or at least {LEAST:g}")
    return value


# The drive data file of a robot (TOML), checked: types, lengths and ranges of its values. The ranges are wide:
# impossible values, 1e9 of any unit or a cycle of more than a second, are typing errors.
Number = Annotated[float, pydantic.Field(strict=True, allow_inf_nan=False)]
Size = Annotated[float, pydantic.Field(strict=True, ge=LEAST, le=1e9)]
NoneOrSize = Annotated[float, pydantic.Field(strict=True, ge=0, le=1e9), pydantic.AfterValidator(_none_or_size)]
Cycle = Annotated[float, pydantic.Field(strict=True, ge=1e-5, le=1.0)]
Text = Annotated[str, pydantic.Field(strict=True, min_length=1, max_length=100)]


class _Table(pydantic.BaseModel):
    # Further keys are kept, as other readers (RSI, users' programs) have their own tables here.
    model_config = pydantic.ConfigDict(extra="allow", frozen=True)


class Joints(_Table):
    """The table ``[joints]``: one number for all joints or a list; on the motor side, as in data sheets."""

    gear_ratio: Size | list[Size] = 1.0
    rotor_inertia: NoneOrSize | list[NoneOrSize] = 0.0
    torque_constant: NoneOrSize | list[NoneOrSize] = 0.0
    a_max: Size | list[Size] = float("inf")
    home: Number | list[Number] = 0.0


class Controller(_Table):
    """Cycle times [s]."""

    t_ipo: Cycle = 0.012
    t_position: Cycle = 0.002
    t_velocity: Cycle = 0.0005


class Coupled(_Table):
    """A joint whose controller angle contains a share of another joint's; joints are counted from 1."""

    joint: Annotated[int, pydantic.Field(strict=True, ge=1)]
    by: Annotated[int, pydantic.Field(strict=True, ge=1)]
    share: Annotated[float, pydantic.Field(strict=True, ge=-100.0, le=100.0)]


class DriveData(_Table):
    """Data that a URDF does not have; every key is optional."""

    name: Text | None = None
    tool_frame: Text | None = None
    joints: Joints = Joints()
    controller: Controller = Controller()
    coupled: list[Coupled] = []

    def counted(self, n: int, file: Path | None) -> Array:
        """The matrix ``(n, n)`` from the URDF's joint angles to the controller's.

        Raises InputError for a joint that the arm does not have, or that is coupled to itself.

        Args:
            n, file: the number of joints, and for the message.
        """
        matrix = np.eye(n)
        for i, entry in enumerate(self.coupled):
            for key, joint in (("joint", entry.joint), ("by", entry.by)):
                if joint > n:
                    raise InputError(f"the arm has {n} joints", file=file, field=f"coupled.{i}.{key}", value=joint)
            if entry.joint == entry.by:
                raise InputError("expected another joint than its own", file=file, field=f"coupled.{i}.by",
                                 value=entry.by)
            matrix[entry.joint - 1, entry.by - 1] += entry.share
        if abs(np.linalg.det(matrix)) < 1e-6:
            raise InputError("the controller's angles do not determine the joints': check the shares", file=file,
                             field="coupled")
        return matrix

    def per_joint(self, key: str, n: int, file: Path | None) -> Array:
        """The value of a key of ``[joints]`` for every joint ``(n,)``; raises InputError for a list of another length.

        Args:
            key, n, file: of the table, the number of joints, and for the message.
        """
        value = getattr(self.joints, key)
        array = np.full(n, float(value)) if isinstance(value, (int, float)) else np.array(value, dtype=float)
        if array.shape != (n,):
            raise InputError(f"expected {n} numbers, one per joint, got {len(array)}", file=file,
                             field=f"joints.{key}")
        return array


def read_drive_data(path: Path | None) -> tuple[DriveData, dict[str, Any]]:
    """The checked data of a file and its whole content; neutral values without a file.

    Raises InputError for a file that is not readable, or a value of another type or out of range.
    """
    if path is None:
        return DriveData(), {}
    values = read_toml(path, "a robot data file")
    try:
        return DriveData(**values), values
    except pydantic.ValidationError as error:
        # One number or a list: the error of a list's number is the most deeply nested one.
        first = max(error.errors(), key=lambda entry: len(entry["loc"]))
        key = ".".join(part for part in first["loc"] if isinstance(part, str) and "[" not in part)
        shown = first.get("input")
        raise InputError(first["msg"].removeprefix("Value error, "), file=path,
                         field=key.removesuffix(".float").removesuffix(".constrained-float"),
                         value=shown if isinstance(shown, (str, int, float)) else None) from error
