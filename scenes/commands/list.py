"""``ideal-robot list``: what there is to choose from."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer


class What(StrEnum):
    """What can be listed."""

    SCENES = "scenes"
    ROBOTS = "robots"
    METHODS = "methods"
    EFFECTS = "effects"
    DETECTORS = "detectors"
    KEYS = "keys"


def command(
    what: Annotated[What, typer.Argument(help="scenes, robots, methods, effects, detectors, or keys of scene files.")],
    kind: Annotated[str, typer.Option(help="With keys: of which kind of scene.")] = "line",
    json: Annotated[Path | None, typer.Option(help="Write the list as JSON to this file; with keys, the JSON Schema.",
                                              )] = None,
) -> None:
    """Lists the scenes, robots, methods, effects and detectors there are, those of other packages included.

    Example: `ideal-robot list scenes`
    """
    from scenes.catalogue import catalogue
    from scenes.commands.common import show_table
    from scenes.report.page import write_json
    from scenes.schema import json_schema

    columns, rows = catalogue(what.value, kind)
    show_table(what.value, columns, rows)
    if json is not None:
        write_json(json, json_schema(kind) if what is What.KEYS
                   else {what.value: [dict(zip(columns, row, strict=True)) for row in rows]})
