"""Where a scene plays: in a ``workshop`` with all that a real cell has against one, or on the kind ``bench``.

A workshop is a set of values that hold where a scene file does not say otherwise; each can be given in the file.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

WORKSHOP = "workshop"
BENCH = "bench"
WORLDS = (WORKSHOP, BENCH)

ARM: dict[str, Any] = {"kinematic_error": 3.0e-4, "zero_error": 3.5e-4, "twist_error": 3.5e-4}
"""An arm that nobody calibrated: joints elsewhere by 0.3 mm, zeros and axes off by 0.02°."""


def in_its_world(values: dict[str, Any], workshop: Mapping[str, Any]) -> dict[str, Any]:
    """The values of a scene with those of its world filled in, and the table ``world`` with the key ``base``.

    Args:
        values: as given; ``world`` is a name or a table.
        workshop: what the workshop of that kind of scene has, by table; empty where the kind has none.
    """
    world = values.get("world", {})
    if isinstance(world, str):
        world = {"base": world}
    if not isinstance(world, dict):
        return values
    usual = WORKSHOP if workshop and world.get("ideal") is not True else BENCH
    values = {**values, "world": {"base": usual, **world}}
    if values["world"]["base"] != WORKSHOP:
        return values
    for table, keys in workshop.items():
        given = values.get(table, {})
        if isinstance(given, dict):
            values[table] = {**keys, **given}
    return values
