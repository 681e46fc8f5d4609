"""Writes identified inertias into a URDF."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.dynamics import with_link_parameters


def urdf_with_inertials(urdf: str, kinematics: pin.Model, parameters: Array) -> str:
    """The URDF text with the links' inertials replaced by ``parameters (10 n,)``.

    A link that is fixed to a moving one is merged into it, so its own inertial is taken out. What does not move at all
    stays as it is.

    Args:
        urdf: text of the URDF.
        kinematics: Pinocchio model of the same URDF.
        parameters: ``(10 n,)``, see ``LINK_PARAMETERS``.
    """
    root = ET.fromstring(urdf)
    links = {link.get("name"): link for link in root.findall("link")}
    joints = list(root.findall("joint"))
    child_of = {joint.get("name"): joint.find("child").get("link") for joint in joints}  # type: ignore[union-attr]
    model = with_link_parameters(kinematics, parameters)
    for index in range(1, model.njoints):
        carrier = child_of[model.names[index]]
        for name in _fixed_to(carrier, joints):
            _remove_inertial(links[name])
        _remove_inertial(links[carrier])
        links[carrier].append(_inertial(model.inertias[index]))
    ET.indent(root)
    return '<?xml version="1.0"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def _fixed_to(link: str | None, joints: list[ET.Element]) -> list[str | None]:
    found: list[str | None] = []
    for joint in joints:
        parent, child = joint.find("parent"), joint.find("child")
        if joint.get("type") == "fixed" and parent is not None and child is not None and parent.get("link") == link:
            found += [child.get("link"), *_fixed_to(child.get("link"), joints)]
    return found


def _remove_inertial(link: ET.Element) -> None:
    for inertial in link.findall("inertial"):
        link.remove(inertial)


def _inertial(body: pin.Inertia) -> ET.Element:
    element = ET.Element("inertial")
    ET.SubElement(element, "origin", xyz=" ".join(f"{c:.12g}" for c in body.lever), rpy="0 0 0")
    ET.SubElement(element, "mass", value=f"{body.mass:.12g}")
    inertia = np.array(body.inertia)
    entries = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
    ET.SubElement(element, "inertia", {key: f"{inertia[i, j]:.12g}" for key, (i, j) in entries.items()})
    return element
