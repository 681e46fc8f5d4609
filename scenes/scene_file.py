"""Scene files: a small TOML file whose ``kind`` decides which further keys there are; all is checked beforehand."""

from __future__ import annotations

import os
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ideal_robot.bounded_values import read_toml
from ideal_robot.errors import InputError, did_you_mean

if TYPE_CHECKING:
    from scenes.scene_files.scene import Scene


def library() -> Path:
    """Folder of the shipped scenes."""
    return Path(str(resources.files("scenes"))) / "library"


def as_typed(scene: Any) -> str:
    """A scene's name for the command line: its own where it is a shipped one, else its file."""
    return str(scene.name if Path(scene.source).parent == library() else scene.source)


def load_scene(name_or_path: str | Path) -> Scene:
    """Loads a shipped scene by name, or a scene file by path, and checks it.

    Raises:
        InputError: no such scene, two scenes of the same name, broken TOML, an unknown key, a value out of range.

    >>> scene = load_scene("line")
    >>> scene.kind, scene.robot, scene.changed(speed=0.4).speed
    ('line', 'kr6', 0.4)
    """
    path, values = scene_values(name_or_path)
    # The modules of the kinds are large, and loaded only when a scene is.
    from scenes.kind import KINDS
    from scenes.scene_files.scene import scene_in_file

    kind = values.get("kind")
    if not isinstance(kind, str) or kind not in KINDS:
        raise InputError(f"expected one of {', '.join(KINDS.names())}", file=path, field="kind", value=kind)
    return scene_in_file(KINDS.get(kind).scene, values, path)


def scene_values(name_or_path: str | Path) -> tuple[Path, dict[str, Any]]:
    """File and keys of a scene, not yet checked; InputError as of ``find_scene``, or for broken TOML."""
    path = find_scene(str(name_or_path))
    values = read_toml(path, "a scene file")
    values.setdefault("name", path.stem)
    return path, values


def find_scene(wanted: str) -> Path:
    """The file of a scene: of a path as given; of a name in the working folder or in the library.

    Raises:
        InputError: no such scene, two scenes of the same name.
    """
    if wanted.endswith(".toml") or "/" in wanted:
        if not os.path.isfile(wanted):
            raise InputError("no such scene file", field="scene", value=wanted)
        return Path(wanted)
    # A shipped scene is named as its file.
    every = [*((_name(path, wanted), path) for path in sorted(Path.cwd().glob("*.toml"))),
             *((path.stem, path) for path in sorted(library().glob("*.toml")))]
    matches = [path for name, path in every if name == wanted]
    if len(matches) > 1:
        raise InputError(f"two scenes of the name {wanted!r}: {matches[0]} and {matches[1]}; rename one or give a path",
                         field="scene")
    if not matches:
        names = {name for name, _ in every if name is not None}
        raise InputError(f"no scene of that name; {did_you_mean(wanted, names)}there are "
                         f"{', '.join(sorted(names)) or 'none'}, or give the path of a .toml file", field="scene",
                         value=wanted)
    return matches[0]


def _name(path: Path, wanted: str) -> str | None:
    """What a TOML file that lies about says a scene is called; None where it is another file."""
    try:
        values = read_toml(path, "a scene file")
    except InputError:
        # A broken file beside it must not stop other scenes; if it is named, it is reported when parsed.
        values = {}
    return str(values.get("name", path.stem)) if "kind" in values or path.stem == wanted else None
