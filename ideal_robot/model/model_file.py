"""The model file: JSON with a schema version (docs/files.md). What stands in it is ``Model.to_dict``'s business."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

from ideal_robot.bounded_values import read_json
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
