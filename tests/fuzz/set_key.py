"""A scene or model with one of its values set to something extreme: whether a reader asks for type, size and range."""

from __future__ import annotations

import json
import re
from typing import Any

import numpy as np

EXTREMES = ('""', "0", "-1", "1e-12", "1e-320", "1e308", "-1e308", "inf", "nan", "1000000",
            "9223372036854775807", "360",
            f'"{"x" * 3000}"', "[]", "[1.0]", "[0.0, 0.0, 0.0]", "[1e308, 1e308, 1e308]", "[[0.0, 0.0]]",
            "[[0.0, 0.0], [0.0, 0.0]]", "{}", "{a = 1}", '"ü\\u202e"', "true", "false", "1979-05-27", '"/dev/zero"',
            '"../../etc/passwd"')
"""What keys of scenes are set to."""
VALUES = (None, True, "", "x" * 3000, [], {}, -1, 0, 1e-320, 1e308, -1e308, 10**400, [1], [[1, 2]], {"a": 1},
          float("nan"), float("inf"))
"""What values of models are set to."""


def with_key(text: bytes, kind: str, rng: np.random.Generator) -> bytes:
    """A scene's text with one key, of the world too, set to one of ``EXTREMES``.

    Args:
        text: of a scene whose tables have no tables of their own.
        kind: of the scene.
        rng: draws key and value.
    """
    from scenes.schema import scene_keys, world_keys

    keys = [key for key in (*scene_keys(kind), *world_keys()) if key.name != "kind"]
    key = keys[int(rng.integers(len(keys)))]
    line = f"{key.name} = {EXTREMES[int(rng.integers(len(EXTREMES)))]}\n"
    top, *tables = re.split(r"(?m)^(?=\[)", text.decode())
    places = [i for i, table in enumerate(tables) if table.startswith(f"[{key.table}]")]
    written = re.compile(rf"(?m)^{re.escape(key.name)} = .*\n")
    if not key.table:
        top = line + written.sub("", top)
    elif places:
        tables[places[0]] = written.sub("", tables[places[0]]) + line
    else:
        tables.append(f"[{key.table}]\n{line}")
    return "".join([top, *tables]).encode()


def with_value(text: bytes, rng: np.random.Generator) -> bytes:
    """A JSON file with one value, list or table of it set to one of ``VALUES``, or taken away.

    Args:
        text: of a JSON object.
        rng: draws the place, a level down at a time, and the value.
    """
    whole = json.loads(text)
    inside: Any = whole
    while True:
        keys = list(inside) if isinstance(inside, dict) else list(range(len(inside)))
        key = keys[int(rng.integers(len(keys)))]
        if not (isinstance(inside[key], (dict, list)) and inside[key] and rng.random() < 0.7):
            break
        inside = inside[key]
    which = int(rng.integers(len(VALUES) + 1))
    if which == len(VALUES):
        del inside[key]
    else:
        inside[key] = VALUES[which]
    return json.dumps(whole).encode()
