"""The model file: JSON with a schema version (docs/files.md)."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ideal_robot.dynamics import BaseParameters
from ideal_robot.effects import FittedEffect
from ideal_robot.errors import InputError
from ideal_robot.friction import PerJointFriction
from ideal_robot.model.controller_model import ControllerModel

if TYPE_CHECKING:
    from ideal_robot.model.model import Model


def model_to_dict(model: Model, schema: int) -> dict[str, Any]:
    """The model as plain values; non-finite numbers become None."""
    content: dict[str, Any] = {
        "schema": schema,
        "robot": {"name": model.robot_name, "urdf_hash": model.urdf_hash, "joints": model.n, "urdf": model.urdf},
        "parameters": [
            {"name": p.name, "joint": p.joint, "value": p.value, "std": p.std, "std_percent": p.std_percent,
             "unit": p.unit, "meaning": p.meaning} for p in model.parameters
        ],
        "base": {
            "full_names": model.base.full_names, "full_units": model.base.full_units,
            "independent": model.base.independent, "gravitational": model.base.gravitational,
            "grouping": model.base.grouping, "values": model.base_values,
        },
        "friction": model.friction.to_dict(),
        "covariance": model.covariance,
        "consistent": model.consistent,
        "noise_std": model.noise_std,
        "controller": None if model.controller is None else model.controller.to_dict(),
        "stiffness": model.stiffness,
        "damping": model.damping,
        "effects": [effect.to_dict() for effect in model.effects],
        "provenance": model.provenance,
    }
    plain: dict[str, Any] = _plain(content)
    return plain


def model_from_file(path: Path, schema: int) -> Model:
    """Reads a model file.

    Raises:
        InputError: no such file, not a model file, or one of a later schema.
    """
    from ideal_robot.model.model import Model

    if not path.is_file():
        raise InputError("no such model file", file=path)
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise InputError(f"not a readable model file ({error})", file=path) from error
    if not isinstance(values, dict) or not isinstance(values.get("schema"), int):
        raise InputError("not a model file; expected JSON with a schema number", file=path, field="schema")
    if values["schema"] > schema:
        raise InputError(f"written by a later version; this one reads up to schema {schema}", file=path, field="schema",
                         value=values["schema"])
    try:
        base = values["base"]
        grouping = np.array(base["grouping"], dtype=float)
        return Model(
            robot_name=values["robot"]["name"], urdf=values["robot"]["urdf"], urdf_hash=values["robot"]["urdf_hash"],
            base=BaseParameters(tuple(base["full_names"]), tuple(base["full_units"]), tuple(base["independent"]),
                                grouping, tuple(base["gravitational"])),
            base_values=np.array(base["values"], dtype=float),
            friction=PerJointFriction.from_dict(values["friction"]),
            covariance=np.array(values["covariance"], dtype=float),
            consistent=np.array(values["consistent"], dtype=float),
            noise_std=np.array(values["noise_std"], dtype=float),
            controller=ControllerModel.from_dict(values["controller"]) if values.get("controller") else None,
            stiffness=_optional(values.get("stiffness")), damping=_optional(values.get("damping")),
            effects=tuple(FittedEffect.from_dict(entry) for entry in values.get("effects", [])),
            provenance=dict(values.get("provenance", {})),
        )
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"not a complete model file ({type(error).__name__}: {error})", file=path) from error


def _optional(values: list[float] | None) -> np.ndarray | None:
    return None if values is None else np.array([np.nan if v is None else v for v in values], dtype=float)


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, float):
        return float(f"{value:.12g}") if math.isfinite(value) else None
    return str(value) if isinstance(value, Path) else value
