"""Makes a serial arm of a public URDF: other joints, such as grippers, are fixed, missing limits are added."""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError, found_in
from ideal_robot.robots.urdf import check_text

TURNS = 2.0 * math.pi
"""Limit of a joint without one [rad]: one turn to either side, as the cables of most arms allow."""
_FINGER = re.compile(r"finger|jaw|knuckle|claw|thumb", re.IGNORECASE)
_GRIPPER = re.compile(rf"gripper|{_FINGER.pattern}", re.IGNORECASE)
"""What links of grippers are called, and their joints; a last joint of the arm may carry a link called gripper."""
_FLANGE = ("tool0", "tcp", "flange")
"""Frames that a tool is put on, the ROS-Industrial name of the one whose z axis leads away from the arm first."""
_SENSOR = re.compile(r"camera|optical|sensor|depth|imu|lidar|laser|light|cable|marker", re.IGNORECASE)
"""What is fixed beside a tool and none."""
_END = re.compile(r"tool|end_?eff|eef|(^|_)ee(_|$)|gripper_cent", re.IGNORECASE)
"""What links at the end of an arm are called besides."""
_SLENDER = 3
"""A branch with fewer moving joints than this beside another one is a finger, not an arm."""

_ASIDE = math.sin(math.radians(10.0))
"""Part of a tool's z axis along the last joint's axis at least: a torch may be bent, but not across or backwards."""
_SHORT = 1e-3
"""Distance of the tool from the joint before the last one along the last axis that tells nothing of its sense [m]."""


@dataclass(frozen=True)
class SerialArm:
    """A URDF with one moving chain.

    Attributes:
        text: of the URDF; the very text that was read where nothing had to be changed.
        tool: link at the chain's end.
        changed: changes of the joints, in words.
    """

    text: str
    tool: str | None
    changed: tuple[str, ...]


def serial_arm(text: str, file: str | Path | None = None, tool: str | None = None) -> SerialArm:
    """The chain of joints from base to tool; every other joint is fixed, at zero or at its nearest limit.

    A joint that is coupled to another one of the chain stays so (``ideal_robot.robots.joints``).

    Raises InputError for no URDF, and for couplings to missing joints or in a circle.

    Args:
        text, file: of the URDF, and where it comes from, for messages.
        tool: link that the chain leads to; by default the longest chain, up to the fork of a gripper; the first of
            several equally long ones.
    """
    check_text(text, file)
    with found_in(file):
        return _chain_in(text, tool)


def _chain_in(text: str, tool: str | None) -> SerialArm:
    root = ET.fromstring(text)
    joints = {str(child.get("link")): joint for joint in root.findall("joint")
              if (child := joint.find("child")) is not None}
    tree = _Tree(joints)
    if not tree.sound:
        return SerialArm(text, None, ())
    before = ET.tostring(root)
    end, chosen = (tool, []) if tool in joints else tree.end()
    chain = tree.path(end)
    while chain and tool not in joints and (not tree.moves(chain[-1]) or _closes_a_gripper(tree, chain)):
        chain.pop()
    link = _tool_link(tree, [_link(joint, "child") for joint in chain]) if tool not in joints else tool
    changed = chosen + _following(tree, chain)
    changed += _held(joints, {id(joint) for joint in chain}) + _limited(chain)
    if tool not in joints:
        link = _facing_away(root, tree, chain, link, changed)
    same = ET.tostring(root) == before
    return SerialArm(text if same else ET.tostring(root, encoding="unicode"), link, tuple(changed))


class _Tree:
    """Links and joints of a URDF; ``joints`` by the link that each carries."""

    def __init__(self, joints: dict[str, ET.Element]) -> None:
        self.joints = joints
        self.named = {str(joint.get("name")): joint for joint in joints.values()}
        self.children: dict[str, list[str]] = {}
        for link, joint in joints.items():
            self.children.setdefault(_link(joint, "parent"), []).append(link)
        roots = [link for link in self.children if link not in joints]
        self.root = roots[0] if len(roots) == 1 else ""
        self._depth: dict[str, int] = {}
        # Loops and several roots are left to Pinocchio, which reports them itself.
        self.sound = bool(self.root) and self._measure()

    def _measure(self) -> bool:
        """Moving joints on the longest way from each link outwards; whether every link is reached."""
        order = self._behind(self.root)
        for link in reversed(order):
            self._depth[link] = max((self._own(child) + self._depth[child] for child in self.children.get(link, ())),
                                    default=0)
        return len(order) == len(self.joints) + 1

    def _own(self, link: str) -> int:
        return int(drives(self.joints[link]))

    def moves(self, joint: ET.Element) -> bool:
        """Whether a joint is one of the arm's: it drives, or follows one that does, and is no gripper's."""
        followed = self.followed(joint)
        return joint.get("type") != "fixed" and not _of_gripper(joint) and followed is not None and drives(
            followed.joint)

    def followed(self, joint: ET.Element) -> _Followed | None:
        """What a joint follows in the end: its angle is ratio times that joint's plus offset; itself where nothing.

        None where it follows no joint of the URDF, or joints follow each other in a circle.
        """
        found, seen = _Followed(joint, 1.0, 0.0), {id(joint)}
        while (mimic := found.joint.find("mimic")) is not None and found.joint.get("type") != "fixed":
            other = self.named.get(str(mimic.get("joint")))
            if other is None or id(other) in seen:
                return None
            seen.add(id(other))
            ratio, offset = (float(mimic.get(key, usual)) for key, usual in (("multiplier", 1.0), ("offset", 0.0)))
            found = _Followed(other, found.ratio * ratio, found.ratio * offset + found.offset)
        return found

    def end(self) -> tuple[str, list[str]]:
        """The link at which the longest moving chain ends, before the fingers of a gripper; what was chosen."""
        link, chosen = self.root, list[str]()
        while True:
            ways = sorted(((self._own(child) + self._depth[child], child) for child in self.children.get(link, ())),
                          key=lambda way: -way[0])
            moving = [way for way in ways if way[0] > 0]
            if not moving:
                return self._end_of_followers(link), chosen
            if len(moving) > 1 and moving[0][0] < _SLENDER:
                return link, chosen
            if alike := [child for length, child in moving[1:] if length == moving[0][0]]:
                chosen.append(f"of the arms that begin at {link} that of {moving[0][1]} is used, with as many joints "
                              f"as that of {', '.join(alike)[:80]}: name the link at the end of another as "
                              "tool_frame in the robot's TOML to use it")
            link = moving[0][1]

    def _end_of_followers(self, link: str) -> str:
        """The last of the links that only followers move on from a link: a wrist that rods keep level, not the rods."""
        best, most = link, (False, 0)
        for end in self._behind(link):
            path = self.path(end)[len(self.path(link)):]
            moved = sum(map(self.moves, path))
            # If several branches follow, the one with a tool is preferred.
            rank = (any(_named_for_tools(one) for one in self.fixed_beyond(end)), moved)
            if moved and self.moves(path[-1]) and rank > most:
                best, most = end, rank
        return best

    def _behind(self, link: str, carries: Callable[[ET.Element], bool] = lambda joint: True) -> list[str]:
        """A link and all those that it carries by joints of a kind, the nearest first."""
        links, index = [link], 0
        while index < len(links):
            links.extend(child for child in self.children.get(links[index], ()) if carries(self.joints[child]))
            index += 1
        return links

    def path(self, link: str) -> list[ET.Element]:
        """Joints from the root to a link, in order."""
        joints = []
        while link in self.joints:
            joints.append(self.joints[link])
            link = _link(self.joints[link], "parent")
        return joints[::-1]

    def fixed_beyond(self, link: str) -> list[str]:
        """The link and those that are rigidly fixed to it, the nearest first."""
        return self._behind(link, lambda joint: joint.get("type") == "fixed")


class _Followed(NamedTuple):
    """A joint that another one follows: that one's angle is ratio times this one's plus offset."""

    joint: ET.Element
    ratio: float
    offset: float


def _closes_a_gripper(tree: _Tree, chain: list[ET.Element]) -> bool:
    """Whether the last joint of a chain closes a gripper, whatever it is called: another one beside it follows it.

    One behind it, too, where there is an arm before them: a finger's second link. What slides behind what slides is a
    telescope.
    """
    last = chain[-1]
    if not drives(last):
        followed = tree.followed(last)
        root = last if followed is None else followed.joint
        before = [joint for joint in chain if drives(joint)]
        return (before[-1:] == [root] and len(before) > _SLENDER
                and not (root.get("type") == last.get("type") == "prismatic"))
    inside = {id(joint) for joint in chain}
    follows = any(id(joint) not in inside and joint.find("mimic") is not None and joint.get("type") != "fixed"
                  and (followed := tree.followed(joint)) is not None and followed.joint is last
                  for joint in tree.joints.values())
    return follows and any(map(drives, chain[:-1]))


def _following(tree: _Tree, chain: list[ET.Element]) -> list[str]:
    """Makes the joints of the chain that move together follow the first of them, with ratio and offset; in words.

    What all of them follow in the URDF may stand beside the chain, or behind them in it.
    """
    changed = list[str]()
    leaders: dict[int, _Followed] = {}
    for joint in chain:
        mimic, name = joint.find("mimic"), str(joint.get("name"))
        if joint.get("type") == "fixed":
            continue
        if (followed := tree.followed(joint)) is None:
            raise InputError("follows no joint of the URDF, or itself", field=f"{name}.mimic.joint",
                             value=None if mimic is None else str(mimic.get("joint"))[:40])
        root, ratio, offset = followed
        if mimic is not None and (ratio == 0.0 or root.get("type") == "fixed" or _of_gripper(root)):
            changed.append(f"joint {name} is held: it follows {root.get('name')}, which does not move it")
            _hold(joint, offset)
            continue
        if id(root) not in leaders:
            # q' = ratio q + offset, so the leader is at (q' - offset) / ratio.
            leaders[id(root)] = _Followed(joint, 1.0 / ratio, -offset / ratio)
            if mimic is not None:
                joint.remove(mimic)
                changed.append(f"joint {name} moves on its own: what it follows in the URDF, {root.get('name')}, is "
                               "not before it in the chain")
            continue
        leader, of_root, at_zero = leaders[id(root)]
        if mimic is None:
            mimic = ET.SubElement(joint, "mimic")
        mimic.attrib.update(joint=str(leader.get("name")), multiplier=f"{ratio * of_root:.12g}",
                            offset=f"{ratio * at_zero + offset:.12g}")
    return changed


def in_order(root: ET.Element) -> list[ET.Element]:
    """The moving joints of a URDF's longest chain from its root on; none of a URDF without one root."""
    tree = _Tree({str(child.get("link")): joint for joint in root.findall("joint")
                  if (child := joint.find("child")) is not None})
    if not tree.sound:
        return []
    moving = [[joint for joint in tree.path(link) if joint.get("type") != "fixed"] for link in tree.joints]
    return max(moving, key=len, default=[])


def drives(joint: ET.Element) -> bool:
    """Whether a joint of a URDF moves on its own and does not belong to a gripper."""
    return joint.get("type") != "fixed" and joint.find("mimic") is None and not _of_gripper(joint)


def _of_gripper(joint: ET.Element) -> bool:
    """Whether a joint of a URDF is a gripper's by what it, or what it carries, is called."""
    return bool(_GRIPPER.search(str(joint.get("name"))) or _FINGER.search(_link(joint, "child")))


def _link(joint: ET.Element, end: str) -> str:
    """The link at one end of a joint, ``parent`` or ``child``."""
    element = joint.find(end)
    return "" if element is None else str(element.get("link"))


def _tool_link(tree: _Tree, chain: list[str]) -> str | None:
    """A frame for tools at the end of a chain of links; None where none is called so."""
    moved = [link for link in chain if tree.moves(tree.joints[link])]
    if not moved:
        return None
    near = tree.fixed_beyond(moved[-1])
    for wanted in _FLANGE:
        for link in near:
            if wanted in link.lower():
                return link
    tools = [link for link in reversed(near) if not _FINGER.search(link) and not _SENSOR.search(link)]
    return next((link for link in tools if _END.search(link)), tools[0] if tools else near[0])


def _facing_away(root: ET.Element, tree: _Tree, chain: list[ET.Element], link: str | None, changed: list[str]
                 ) -> str | None:
    """The tool link, or a frame added to it whose z axis leads away from the arm where the link's own does not.

    A tool lies along the last joint's axis, or beside it where that joint bends the wrist, and points from there; URDFs
    of before the frame ``tool0`` have x along it. Where no joint can tilt the tool, as of a SCARA, it points down. A
    frame is added to ``root``, and told in ``changed``.
    """
    moving = [joint for joint in chain if tree.moves(joint)]
    if link is None or len(moving) < 2:
        return link
    if not _tilts(tree, tree.path(link), moving):
        place = _placed(tree.path(link))
        down = place.rotation.T @ np.array([0.0, 0.0, -1.0])
        if down[2] > _ASIDE:
            return link
        changed.append(f"the tool points down, which is not the z axis of {link}: no joint can tilt it")
        return _turned(root, link, down)
    if moving[-1].get("type") == "prismatic":
        return link
    beyond = _placed(tree.path(link), moving[-1])
    back = _placed(tree.path(_link(moving[-1], "child")), moving[-2])
    along = _axis(moving[-1])
    # The last joint only rotates about its axis: displacements along it do not depend on its angle.
    length = float(along @ (beyond.translation + back.rotation.T @ back.translation))
    carried = beyond.translation
    if link == _link(moving[-1], "child") and np.linalg.norm(carried) < _SHORT:
        # The tool has no frame: its place is the centre of mass of the last link.
        carried = _carried(root, tree, link)
    beside = carried - along * (along @ carried)
    aside = float(np.linalg.norm(beside))
    ways = []
    if abs(length) >= _SHORT:
        ways.append((abs(length), math.copysign(1.0, length) * along, "points along the last joint's axis"))
    if aside >= max(_SHORT, abs(length)):
        ways.append((aside, beside / aside, "points away from the last joint, which bends the wrist"))
    away = [(beyond.rotation.T @ way, says) for _, way, says in sorted(ways, key=lambda way: -way[0])]
    if not away or any(way[2] > _ASIDE for way, _ in away):
        return link
    way, says = away[0]
    changed.append(f"the tool {says}, which is not the z axis of {link}: give another link as tool_frame in the "
                   "robot's TOML if it does not")
    return _turned(root, link, way)


def _tilts(tree: _Tree, path: list[ET.Element], moving: list[ET.Element]) -> bool:
    """Whether a joint turns the tool about another axis than the vertical, in the posture of all joints at zero.

    With all that follows it: rods keep a palletizer's wrist level.
    """
    turned: dict[str, Array] = {}
    for joint in moving:
        if joint.get("type") != "prismatic":
            root, ratio, _ = tree.followed(joint) or _Followed(joint, 1.0, 0.0)
            name = str(root.get("name"))
            about = ratio * _placed(path[: path.index(joint) + 1]).rotation @ _axis(joint)
            turned[name] = turned.get(name, np.zeros(3)) + about
    return any(float(np.linalg.norm(about[:2])) > math.sin(math.radians(1.0)) for about in turned.values())


def _named_for_tools(link: str) -> bool:
    """Whether a link is called like one that a tool is put on."""
    return not _FINGER.search(link) and (any(wanted in link.lower() for wanted in _FLANGE) or bool(_END.search(link)))


def _carried(root: ET.Element, tree: _Tree, link: str) -> Array:
    """The middle of what a link carries: its centre of mass and the places of what is put on it, in its frame [m]."""
    element = next((one for one in root.findall("link") if one.get("name") == link), None)
    inertial = None if element is None else element.find("inertial")
    places = [] if inertial is None else [_origin(inertial).translation]
    places += [_origin(tree.joints[child]).translation for child in tree.children.get(link, ())]
    return np.mean(places, axis=0) if places else np.zeros(3)


def _turned(root: ET.Element, link: str, way: Array) -> str:
    """Adds a frame to a link whose z axis has a direction in the link's frame; its name."""
    rpy = pin.rpy.matrixToRpy(pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), way).matrix())
    name = f"{link}_away"
    joint = ET.SubElement(root, "joint", {"name": f"{name}_joint", "type": "fixed"})
    ET.SubElement(joint, "parent", {"link": link})
    ET.SubElement(joint, "child", {"link": name})
    ET.SubElement(joint, "origin", {"xyz": "0 0 0", "rpy": " ".join(f"{v:.12g}" for v in rpy)})
    ET.SubElement(root, "link", {"name": name})
    return name


def _placed(path: list[ET.Element], behind: ET.Element | None = None) -> pin.SE3:
    """The place of a path's last link in the frame of a joint on it, the root's for None; all joints at zero."""
    place = pin.SE3.Identity()
    for joint in path[0 if behind is None else path.index(behind) + 1:]:
        place = place * _origin(joint)
    return place


def _origin(element: ET.Element) -> pin.SE3:
    """The place that an element's ``origin`` says."""
    origin = element.find("origin")
    xyz, rpy = (np.zeros(3) if origin is None else np.array([float(v) for v in origin.get(key, "0 0 0").split()])
                for key in ("xyz", "rpy"))
    return pin.SE3(pin.rpy.rpyToMatrix(rpy), xyz)


def _axis(joint: ET.Element) -> Array:
    """The direction of a joint's axis ``(3,)``; zeros where it has none."""
    axis = joint.find("axis")
    written = np.array([float(v) for v in ("1 0 0" if axis is None else axis.get("xyz", "1 0 0")).split()])
    return np.asarray(written / max(float(np.linalg.norm(written)), 1e-9))


def _held(joints: dict[str, ET.Element], chain: set[int]) -> list[str]:
    """Makes every moving joint beside the chain a fixed one, where it stands at rest."""
    changed = []
    for joint in joints.values():
        if joint.get("type") in ("revolute", "continuous", "prismatic") and id(joint) not in chain:
            changed.append(f"joint {joint.get('name')} is held: it is not one of the arm's")
            _hold(joint)
    return changed


def _hold(joint: ET.Element, position: float = 0.0) -> None:
    """Fixes a joint at a position, or at the limit next to it."""
    limit, origin = joint.find("limit"), joint.find("origin")
    if limit is not None and joint.get("type") != "continuous":
        position = min(max(position, float(limit.get("lower", 0.0))), float(limit.get("upper", 0.0)))
    if position != 0.0:
        direction = _axis(joint)
        if origin is None:
            origin = ET.SubElement(joint, "origin")
        xyz, rpy = (np.array([float(v) for v in origin.get(key, "0 0 0").split()]) for key in ("xyz", "rpy"))
        rotation = pin.rpy.rpyToMatrix(rpy)
        if joint.get("type") == "prismatic":
            xyz = xyz + rotation @ (position * direction)
        else:
            rpy = pin.rpy.matrixToRpy(rotation @ pin.exp3(position * direction))
        origin.set("xyz", " ".join(f"{v:.12g}" for v in xyz))
        origin.set("rpy", " ".join(f"{v:.12g}" for v in rpy))
    for name in ("mimic", "limit", "axis"):
        for element in joint.findall(name):
            joint.remove(element)
    joint.set("type", "fixed")


def _limited(chain: list[ET.Element]) -> list[str]:
    """Gives joints of the arm that turn without end the limits of one turn to either side."""
    changed = []
    for joint in chain:
        if joint.get("type") != "continuous":
            continue
        joint.set("type", "revolute")
        limit = joint.find("limit")
        if limit is None:
            limit = ET.SubElement(joint, "limit", {"effort": "0", "velocity": "0"})
        limit.set("lower", f"{-TURNS:.12g}")
        limit.set("upper", f"{TURNS:.12g}")
        changed.append(f"joint {joint.get('name')} turns without end in the URDF: one turn to either side is used")
    return changed
