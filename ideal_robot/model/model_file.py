"""The model file: JSON with a schema version (docs/files.md), and the check of its consistency.

Its content is defined by ``Model.to_dict``.
"""

from __future__ import annotations

import json
import os
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.bounded_values import MAX_NUMBER, read_json
from ideal_robot.command.law import require_law
from ideal_robot.dynamics import BaseParameters, with_link_parameters
from ideal_robot.dynamics.base_parameters import FOLLOWING
from ideal_robot.effects import SENSOR
from ideal_robot.errors import InputError
from ideal_robot.model.cascade import SPREAD, per_joint
from ideal_robot.model.parametrisation import ControllerModel
from ideal_robot.whole_file import write_text

SCHEMA = 1
"""Version of the model file; readers accept any up to their own."""


def write_values(path: Path, values: dict[str, Any]) -> Path:
    """Writes plain values as a model file, whole or not at all."""
    # One line per entry, so that people can read it and the covariance does not fill thousands of lines.
    lines = [f"{json.dumps(key)}: {json.dumps(value, allow_nan=False)}" for key, value in values.items()]
    return write_text(path, "{" + ",\n ".join(lines) + "}\n")


def read_values(path: Path) -> dict[str, Any]:
    """The plain values of a model file of this or an earlier version; raises InputError for anything else."""
    if not os.path.isfile(path):
        raise InputError("no such model file", file=path)
    values = read_json(path, "a model file")
    if not isinstance(values, dict) or type(values.get("schema")) is not int:
        raise InputError("not a model file; expected JSON with a schema number", file=path, field="schema")
    if values["schema"] > SCHEMA:
        raise InputError(f"written by a later version; this one reads up to schema {SCHEMA}", file=path, field="schema",
                         value=values["schema"])
    return values


def urdf_with_inertials(urdf: str, kinematics: pin.Model, parameters: Array) -> str:
    """The URDF text with the links' inertials replaced.

    A link that is fixed to a moving one is merged into it, so its own inertial is removed. Links that do not move are
    unchanged.

    Args:
        urdf, kinematics: text of the URDF, and its Pinocchio model.
        parameters: ``(10 b,)`` of ``b`` links, see ``LINK_PARAMETERS``.
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
    links: list[str | None] = []
    for joint in joints:
        parent, child = joint.find("parent"), joint.find("child")
        if joint.get("type") == "fixed" and parent is not None and child is not None and parent.get("link") == link:
            links += [child.get("link"), *_fixed_to(child.get("link"), joints)]
    return links


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


"""Full parameters a joint: ten of its link, its rotor inertia, its torque offset."""
_ROUNDED = 1e-3
"""Of correlations, what rounding may have made of them in the inverse of badly conditioned equations."""
_SLOWEST_FILTER = 0.1
"""Of commands, each stage's time constant [s]: path planners smooth over less, and what is inverted grows with it."""


def require_consistent(model: Any, file: Path | str | None = None) -> None:
    """Raises InputError for a ``Model`` whose parts do not fit together.

    The message has the file, the key, the expected and the found value. ``Model`` itself calls this, so its type is not
    named.
    """
    _texts(model, file)
    n, b = int(model.kinematics.nv), len(model.base.independent)
    friction, base, gears = model.friction, model.base, model.gears
    p = base.layout.size
    if friction.n != n:
        raise InputError(f"expected the laws of {n} joints, got {friction.n}", file=file, field="friction")
    for j, law in enumerate(friction.laws):
        if not (np.all(np.isfinite(law.coefficients)) and np.all(np.isfinite(law.shape))):
            raise InputError("expected finite numbers", file=file, field=f"friction.{j}")
    count = b + sum(law.coefficients.size + law.shape.size for law in friction.laws)
    for key, array, shape, finite in (
        ("base.values", model.base_values, (b,), True), ("base.grouping", base.grouping, (b, p), True),
        ("covariance", model.covariance, (count, count), False), ("consistent", model.consistent, (p,), True),
        ("noise_std", model.noise_std, (n,), False), ("stiffness", gears and gears.stiffness, (n,), False),
        ("damping", gears and gears.damping, (n,), False),
    ):
        if array is not None:
            _array(array, shape, key, file, finite=finite)
    _covariance(model.covariance, file)
    _base(base, n, file)
    if gears is not None and np.any(gears.stiffness <= 0):
        raise InputError("expected positive numbers", file=file, field="stiffness")
    if gears is not None and np.any(gears.known_damping < 0):
        raise InputError("expected numbers that are not negative", file=file, field="damping")
    if model.controller is not None:
        require_controller(model.controller, n, file)
    if model.command is not None:
        require_law(model.command, n, file)
    _effects(model, n, file)


def _texts(model: Any, file: Path | str | None) -> None:
    for key in ("name", "urdf", "urdf_hash"):
        text = getattr(model.arm, key)
        if not isinstance(text, str):
            raise InputError("expected a text", file=file, field=f"robot.{key}")
    if not model.arm.name.isprintable() or len(model.arm.name) > 200:
        raise InputError("expected one printable line", file=file, field="robot.name", value=model.arm.name[:40])


def _base(base: BaseParameters, n: int, file: Path | str | None) -> None:
    b, p = len(base.independent), base.layout.size
    for key, names, length in (("base.full_names", base.full_names, p), ("base.full_units", base.full_units, p),
                               ("base.gravitational", base.gravitational, b)):
        if len(names) != length:
            raise InputError(f"expected {length} entries, got {len(names)}", file=file, field=key)
    if not all(isinstance(name, str) for name in (*base.full_names, *base.full_units)):
        raise InputError("expected texts", file=file, field="base.full_names")
    if not all(isinstance(g, bool) for g in base.gravitational):
        raise InputError("expected truth values", file=file, field="base.gravitational")
    if not all(isinstance(i, int) and 0 <= i < p for i in base.independent) or len(set(base.independent)) != b:
        raise InputError(f"expected different numbers from 0 to {p - 1}", file=file, field="base.independent")
    for i in base.independent:
        joint = base.full_names[i].rpartition("_")[2].rstrip(FOLLOWING)
        if not (joint.isascii() and joint.isdigit() and 1 <= int(joint) <= n):
            raise InputError("expected names such as Izz_3", file=file, field="base.full_names",
                             value=base.full_names[i][:40])


def _array(array: np.ndarray, shape: tuple[int, ...], key: str, file: Path | str | None, *, finite: bool) -> None:
    if array.shape != shape:
        raise InputError(f"expected {' × '.join(map(str, shape))} numbers, got {' × '.join(map(str, array.shape))}",
                         file=file, field=key)
    if finite and not np.all(np.isfinite(array)):
        raise InputError("expected finite numbers", file=file, field=key)


def _covariance(covariance: np.ndarray, file: Path | str | None) -> None:
    """Refuses what is no covariance; parameters with infinite entries are not known, and say nothing."""
    known = np.isfinite(covariance).all(axis=0) & np.isfinite(covariance).all(axis=1)
    C = covariance[np.ix_(known, known)]
    if (np.diag(C) < 0.0).any():
        i = int(np.flatnonzero(known)[np.argmin(np.diag(C))])
        raise InputError("a variance is not negative", file=file, field=f"covariance.{i}.{i}",
                         value=float(covariance[i, i]))
    sigma = np.where(np.diag(C) > 0.0, np.sqrt(np.diag(C)), 1.0)
    R = C / np.outer(sigma, sigma)
    if not np.allclose(R, R.T, atol=_ROUNDED) or (R.size and np.linalg.eigvalsh(R)[0] < -_ROUNDED):
        raise InputError("expected a symmetric matrix without negative eigenvalues", file=file, field="covariance")


def require_controller(controller: ControllerModel, n: int, file: Path | str | None = None) -> None:
    """Raises InputError for impossible numbers of a controller in a model file; names the key and the expected range.

    Args:
        controller, n: of the joints, and how many there are.
        file: the file that it comes from.
    """
    known = ("k_p", "k_d", "k_1", "k_2", "k_i", "filter_time")
    further = [key for key in ("compensation", "v_compensation", "scheduled_at", "bodies", "acceleration")
               if getattr(controller, key) is not None]
    for key in (*known, *further):
        array = getattr(controller, key)
        if not isinstance(array, np.ndarray):
            raise InputError(f"expected {n} numbers", file=file, field=f"controller.{key}")
        _array(array, (n,), f"controller.{key}", file, finite=True)
        if np.any(np.abs(array) > MAX_NUMBER):
            raise InputError(f"expected numbers up to {MAX_NUMBER:g}", file=file, field=f"controller.{key}",
                             value=float(np.max(np.abs(array))))
    if np.any(controller.filter_time < 0) or np.any(controller.filter_time > _SLOWEST_FILTER):
        raise InputError(f"expected times of 0 to {_SLOWEST_FILTER} s", file=file, field="controller.filter_time",
                         value=controller.filter_time.tolist())
    for key, low, high in (("t_cycle", 1e-5, 1.0), ("delay", 0.0, 10.0), ("filter_order", 1, 10),
                           ("schedule", 0.0, 2.0), ("integrated", 0.0, 1.0), ("rate_filter", 0.0, _SLOWEST_FILTER)):
        value = getattr(controller, key)
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not low <= value <= high:
            raise InputError(f"expected a number from {low:g} to {high:g}", file=file, field=f"controller.{key}",
                             value=value if isinstance(value, (int, float, str)) else None)
    if not isinstance(controller.coupled, bool):
        raise InputError("expected true or false", file=file, field="controller.coupled")
    if (controller.schedule or controller.coupled) and controller.scheduled_at is None:
        raise InputError(f"expected {n} numbers beside schedule or coupled", file=file,
                         field="controller.scheduled_at")
    if (controller.compensation is None) != (controller.v_compensation is None):
        raise InputError(f"expected {n} numbers beside those of compensation", file=file,
                         field="controller.v_compensation")
    for key in ("v_compensation", "scheduled_at"):
        array = getattr(controller, key)
        if array is not None and np.any(array <= 0.0):
            raise InputError("expected positive numbers", file=file, field=f"controller.{key}", value=array.tolist())
    if not isinstance(controller.filter_order, int):
        raise InputError("expected a whole number", file=file, field="controller.filter_order")
    for key in ("std", "spread"):
        if not isinstance(getattr(controller, key), dict):
            raise InputError("expected a table", file=file, field=f"controller.{key}")
    for name, widths in controller.spread.items():
        if name not in SPREAD:
            raise InputError(f"unknown key; allowed here are {', '.join(SPREAD)}", file=file,
                             field=f"controller.spread.{name}")
        per_joint(widths, n, file, f"controller.spread.{name}")


def _effects(model: Any, n: int, file: Path | str | None) -> None:
    for i, fitted in enumerate(model.effects):
        key = f"effects.{i}"
        if not 0 <= fitted.joint <= n:
            raise InputError(f"expected a joint from 1 to {n}, or 0 for the whole arm", file=file,
                             field=f"{key}.joint", value=fitted.joint)
        if not np.all(np.isfinite((*fitted.coefficients, *fitted.theta))):
            raise InputError("expected finite numbers", file=file, field=f"{key}.coefficients")
        try:
            effect = fitted.effect
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise InputError(f"not a complete effect ({type(error).__name__}: {error})", file=file,
                             field=f"{key}.data") from error
        if effect.learned:
            continue
        most = len(effect.coefficient_names)
        # A recording may determine only the first coefficients of a sensor's effect.
        least = 1 if effect.domain == SENSOR else most
        if not effect.complete(fitted.theta) or not least <= len(fitted.coefficients) <= most:
            raise InputError(f"expected {'up to ' if least < most else ''}{most} coefficients and "
                             f"{len(effect.theta_names)} nonlinear parameters", file=file, field=key)
