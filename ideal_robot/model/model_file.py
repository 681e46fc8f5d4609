"""The model file: JSON with a schema version (docs/files.md). What stands in it is ``Model.to_dict``'s business."""

from __future__ import annotations

import json
import os
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.bounded_values import read_json
from ideal_robot.dynamics import with_link_parameters
from ideal_robot.errors import InputError
from ideal_robot.whole_file import write_text

SCHEMA = 1
"""Version of the model file; readers accept any up to their own."""


def write_values(path: Path, values: dict[str, Any]) -> Path:
    """Writes plain values; nothing is left half-written."""
    # One line per entry: still to be read by people, and the covariance does not fill thousands of lines.
    lines = [f"{json.dumps(key)}: {json.dumps(value, allow_nan=False)}" for key, value in values.items()]
    return write_text(path, "{" + ",\n ".join(lines) + "}\n")


def read_values(path: Path) -> dict[str, Any]:
    """The plain values of a model file of this or an earlier version.

    Raises:
        InputError: no such file, not a model file, or one of a later schema.
    """
    if not os.path.isfile(path):
        raise InputError("no such model file", file=path)
    values = read_json(path, "a model file")
    if not isinstance(values, dict) or type(values.get("schema")) is not int:
        raise InputError("not a model file; expected JSON with a schema number", file=path, field="schema")
    if values["schema"] > SCHEMA:
        raise InputError(f"written by a later version; this one reads up to schema {SCHEMA}", file=path, field="schema",
                         value=values["schema"])
    return values


# Writes identified inertias into a URDF.

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
