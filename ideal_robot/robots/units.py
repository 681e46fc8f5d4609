"""Checks the units of a URDF by typical values: lengths, limits, speeds, masses and moments of inertia.

A URDF holds metres, radians, kilograms and newtons, but nothing in it says so, and exporters of drawings write
millimetres, degrees and grams. Each quantity is compared with that of arms of its reach (``class_of``); where it is
impossible, but fits in another common unit, it is converted with a note.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET

import numpy as np

from ideal_robot.robots.arm_class import BASE_SPEED, MASS, REACH, SLIDING_SPEED, WRIST_SPEED, class_of
from ideal_robot.robots.chain import TURNS, in_order

LONGEST_CHAIN = 20.0
"""Sum of the distances from joint to joint beyond which they are not in metres [m]; a KR 1000 has 5, a rail 10."""
SPANS = (0.15, 8.0)
"""Of that sum, for arms from desktop servos to the largest [m]."""
STRETCHED = 0.7
"""Reach over that sum, which holds the base and offsets that fold: 0.58 (TIAGo) to 0.82 (UR5, UR10), median 0.75 of
nine arms of KUKA, UR, Franka, PAL and manutec; an estimate, for classes a factor apart."""
WOUND = 13.0
"""Position limit beyond which it is not in radians [rad]: two turns, the most of any wrist, are 12.6."""
MOST_TURNED = 1000.0
"""Limit in degrees beyond which it stands for none."""
NEAR = 3.0
"""Factor from its class within which a converted quantity has to lie; single arms differ by it (``arm_class``)."""
FASTEST = {False: 30.0, True: 20.0}
"""Speed limit beyond which it is not in rad/s, or of a sliding joint not in m/s; the fastest wrist, a five-axis
LR Mate's, turns at 25 rad/s."""
IMPOSSIBLE_MASS = 10.0
"""Factor from their class beyond which masses are not in kg."""
SLENDER, ROUND = 0.004, 0.5
"""Bounds of the radius of gyration of an arm's median link over its reach. Estimates: of the same nine arms it is 0.05
(UR10e) to 0.17, single links 0.02 to 0.2; the next unit, kg mm², is a factor of a thousand away."""
FARTHEST = 30.0
"""Travel of a sliding joint [m]."""

_LENGTHS = {1e-3: "millimetres", 1e-2: "centimetres", 0.0254: "inches"}
_MASSES = {1e-3: "grams", 1e3: "tons", 0.45359237: "pounds"}
_INERTIAS = {1e-6: "kg mm²", 1e-9: "g mm²"}
"""As programs for drawings write them; units nearer to each other than links differ cannot be distinguished."""
_TURNING_SPEEDS = {math.pi / 180.0: "degrees a second"}
_SLIDING_SPEEDS = {1e-3: "millimetres a second"}


def in_si(text: str) -> tuple[str, tuple[str, ...]]:
    """The URDF of one moving chain in metres, radians and kilograms, and what was converted, in words.

    The same text where nothing was converted.
    """
    root = ET.fromstring(text)
    joints = in_order(root)
    if len(joints) < 2:
        return text, ()
    notes: list[str] = []
    size = STRETCHED * _lengths(root, joints, notes)
    _limits(joints, size, notes)
    _speeds(joints, size, notes)
    _masses(root, size, notes)
    return (ET.tostring(root, encoding="unicode"), tuple(notes)) if notes else (text, ())


def _lengths(root: ET.Element, joints: list[ET.Element], notes: list[str]) -> float:
    """Converts the lengths where they are not metres; the sum of the distances from joint to joint [m]."""
    total = sum(float(np.linalg.norm(_numbers(joint.find("origin"), "xyz"))) for joint in joints)
    if total <= LONGEST_CHAIN:
        return total
    factor = _nearest(total, math.sqrt(SPANS[0] * SPANS[1]), _LENGTHS, SPANS[1] / math.sqrt(SPANS[0] * SPANS[1]))
    if factor is None:
        return total
    for element in root.iter("origin"):
        _scale(element, "xyz", factor)
    for shape in ("box", "cylinder", "sphere"):
        for element in root.iter(shape):
            for key in ("size", "radius", "length"):
                _scale(element, key, factor)
    notes.append(f"the joints are {total:.4g} m apart together: lengths are {_LENGTHS[factor]}, times {factor:g}")
    return total * factor


def _limits(joints: list[ET.Element], size: float, notes: list[str]) -> None:
    """Converts position limits in degrees or millimetres; what no joint turns is no limit."""
    turning = {joint: _span(joint) for joint in joints if joint.get("type") == "revolute"}
    wound = [joint for joint, span in turning.items() if WOUND < span <= MOST_TURNED]
    # If most joints are in degrees, those with short ranges are, too.
    in_degrees = list(turning) if 2 * len(wound) > len(turning) else wound
    converted = [joint for joint in in_degrees if turning[joint] <= MOST_TURNED]
    for joint in converted:
        for key in ("lower", "upper"):
            _scale(joint.find("limit"), key, math.pi / 180.0)
    if converted:
        notes.append(f"limits of {_names(converted)} up to {max(turning[joint] for joint in converted):.4g} rad: they "
                     "are degrees, times 0.01745")
    endless = [joint for joint, span in turning.items() if MOST_TURNED < span < math.inf]
    _bound(endless, TURNS)
    if endless:
        notes.append(f"limits of {_names(endless)} stand for none: one turn to either side is used")
    far = [joint for joint in joints if joint.get("type") == "prismatic" and FARTHEST < _span(joint) < math.inf]
    written = [joint for joint in far if _span(joint) <= FARTHEST / 1e-3]
    for joint in written:
        for key in ("lower", "upper"):
            _scale(joint.find("limit"), key, 1e-3)
    if written:
        notes.append(f"limits of {_names(written)} are millimetres, times 0.001")
    boundless = [joint for joint in far if joint not in written]
    _bound(boundless, size)
    if boundless:
        notes.append(f"limits of {_names(boundless)} stand for none: the arm's reach, {size:.2g} m, is used to either "
                     "side")


def _bound(joints: list[ET.Element], size: float) -> None:
    """Gives joints a position limit of a size [rad, m] to either side, where they have any."""
    for joint in joints:
        limit = joint.find("limit")
        if limit is not None:
            limit.set("lower", f"{-size:.12g}")
            limit.set("upper", f"{size:.12g}")


def _speeds(joints: list[ET.Element], size: float, notes: list[str]) -> None:
    """Converts speed limits in degrees a second and the like."""
    by_unit: dict[tuple[float, str], list[ET.Element]] = {}
    for number, joint in enumerate(joints):
        limit = joint.find("limit")
        speed = float(limit.get("velocity", 0.0)) if limit is not None else 0.0
        slides = joint.get("type") == "prismatic"
        usual = SLIDING_SPEED if slides else class_of(BASE_SPEED if number < len(joints) - 3 else WRIST_SPEED, size)
        if not FASTEST[slides] < speed < math.inf:
            continue
        units = _SLIDING_SPEEDS if slides else _TURNING_SPEEDS
        factor = _nearest(speed, usual, units, NEAR)
        if factor is not None:
            _scale(limit, "velocity", factor)
            by_unit.setdefault((factor, units[factor]), []).append(joint)
    for (factor, unit), changed in by_unit.items():
        notes.append(f"speed limits of {_names(changed)} are {unit}, times {factor:.4g}")


def _masses(root: ET.Element, size: float, notes: list[str]) -> None:
    """Converts masses and moments of inertia of all links, one unit each."""
    inertials = [inertial for link in root.findall("link") if (inertial := link.find("inertial")) is not None]
    masses = np.array([float(_value(inertial, "mass", "value")) for inertial in inertials])
    if not masses.size or not masses.sum() > 0.0 or not REACH[0] / NEAR < size < NEAR * REACH[-1]:
        return
    usual, total = class_of(MASS, size), float(masses.sum())
    if not usual / IMPOSSIBLE_MASS <= total <= usual * IMPOSSIBLE_MASS:
        factor = _nearest(total, usual, _MASSES, NEAR)
        if factor is not None:
            for inertial in inertials:
                _scale(inertial.find("mass"), "value", factor)
            masses = masses * factor
            notes.append(f"the links weigh {total:.4g} kg: masses are {_MASSES[factor]}, times {factor:.4g}")
    trace = np.array([sum(float(_value(inertial, "inertia", key)) for key in ("ixx", "iyy", "izz"))
                      for inertial in inertials])
    known = (masses > 0.0) & (trace > 0.0)
    # The same number everywhere is a placeholder, whatever its unit.
    if 2 * len(np.unique(trace[known])) <= known.sum():
        return
    gyration = float(np.median(np.sqrt(0.5 * trace[known] / masses[known]))) / size
    if SLENDER <= gyration <= ROUND:
        return
    factor = next((unit for unit in _INERTIAS if SLENDER <= gyration * math.sqrt(unit) <= ROUND), None)
    if factor is not None:
        for inertial in inertials:
            for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"):
                _scale(inertial.find("inertia"), key, factor)
        notes.append(f"moments of inertia are {_INERTIAS[factor]}, times {factor:g}")


def _nearest(value: float, usual: float, units: dict[float, str], near: float) -> float | None:
    """The factor of the unit in which a value is nearest to the usual one; None where none is within a factor."""
    off = {factor: abs(math.log(value * factor / usual)) for factor in units}
    best = min(off, key=lambda factor: off[factor])
    return best if off[best] <= math.log(near) else None


def _span(joint: ET.Element) -> float:
    limit = joint.find("limit")
    return 0.0 if limit is None else max(abs(float(limit.get(key, 0.0))) for key in ("lower", "upper"))


def _numbers(element: ET.Element | None, key: str) -> list[float]:
    return [0.0] if element is None else [float(word) for word in element.get(key, "0").split()]


def _value(element: ET.Element, child: str, key: str) -> str:
    found = element.find(child)
    return "0" if found is None else found.get(key, "0")


def _scale(element: ET.Element | None, key: str, factor: float) -> None:
    if element is not None and key in element.attrib:
        element.set(key, " ".join(f"{float(word) * factor:.12g}" for word in element.attrib[key].split()))


def _names(joints: list[ET.Element]) -> str:
    return ", ".join(str(joint.get("name")) for joint in joints)
