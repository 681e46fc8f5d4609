"""Scene files: a small TOML file whose ``kind`` decides which further keys there are; all is checked beforehand."""

from __future__ import annotations

import os
from importlib import resources
from pathlib import Path
from typing import Any

from ideal_robot.bounded_values import read_toml
from ideal_robot.errors import InputError, did_you_mean
from scenes.kind import KINDS
from scenes.scene_files.scene import Scene, scene_of


def library() -> Path:
    """Folder of the shipped scenes."""
    return Path(str(resources.files("scenes"))) / "library"


def load_scene(name_or_path: str | Path) -> Scene:
    """Loads a shipped scene by name, or a scene file by path, and checks it.

    Raises:
        InputError: no such scene, two scenes of the same name, broken TOML, an unknown key, a value out of range.

    >>> scene = load_scene("line")
    >>> scene.kind, scene.robot, scene.changed(speed=0.4).speed
    ('line', 'kr6', 0.4)
    """
    path, values = scene_values(name_or_path)
    kind = values.get("kind")
    if not isinstance(kind, str) or kind not in KINDS:
        raise InputError(f"expected one of {', '.join(KINDS.names())}", file=path, field="kind", value=kind)
    return scene_of(KINDS.get(kind).scene, values, path).beside(path.absolute().parent)


def scene_values(name_or_path: str | Path) -> tuple[Path, dict[str, Any]]:
    """Where a scene's file is, and its keys, not yet checked.

    Raises:
        InputError: no such scene, two scenes of the same name, broken TOML.
    """
    path = _find(str(name_or_path))
    values = read_toml(path, "a scene file")
    values.setdefault("name", path.stem)
    return path, values


def _find(wanted: str) -> Path:
    """A path is taken if it looks like one; a name is looked up among the scene files here and in the library."""
    if wanted.endswith(".toml") or "/" in wanted:
        if not os.path.isfile(wanted):
            raise InputError("no such scene file", field="scene", value=wanted)
        return Path(wanted)
    found = []
    names = set()
    for path in [*sorted(Path.cwd().glob("*.toml")), *sorted(library().glob("*.toml"))]:
        try:
            values = read_toml(path, "a scene file")
        except InputError:
            # A broken neighbour must not stop other scenes; asked for by name, it is reported when parsed.
            values = {}
        is_scene = "kind" in values or path.parent == library() or path.stem == wanted
        if not is_scene:
            continue
        name = str(values.get("name", path.stem))
        names.add(name)
        if name == wanted:
            found.append(path)
    if len(found) > 1:
        raise InputError(f"two scenes of the name {wanted!r}: {found[0]} and {found[1]}; rename one or give a path",
                         field="scene")
    if not found:
        raise InputError(f"no scene of that name; {did_you_mean(wanted, names)}there are "
                         f"{', '.join(sorted(names)) or 'none'}, or give the path of a .toml file", field="scene",
                         value=wanted)
    return found[0]
