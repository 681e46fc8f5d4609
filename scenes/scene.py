"""Scene files: what a person writes to say which robot does what in which world.

A scene is a small TOML file. Its ``kind`` decides which module plays it, and that module says which further keys
there are. Everything is checked before anything moves.
"""

from __future__ import annotations

import importlib
import re
from importlib import resources
from pathlib import Path
from typing import Any, Self, TypeVar

import pydantic

from ideal_robot.bounded_values import checked, read_toml
from ideal_robot.errors import InputError

S = TypeVar("S", bound="Scene")

KINDS = {
    "line": "scenes.line.play",
    "path": "scenes.path.play",
    "force": "scenes.force.play",
    "clamped": "scenes.clamped.play",
}
"""Kind of scene → module with ``SceneModel``, ``METHODS``, ``run(scene, …)`` and ``compare(scene, …)``."""

NAME = re.compile(r"[^\W_](?:[\w .+()-]{0,78}[\w+()-])?")
"""What a scene may be called."""


class Scene(pydantic.BaseModel):
    """What every kind of scene has; the kinds add their own keys."""

    model_config = pydantic.ConfigDict(extra="forbid", frozen=True)

    name: str
    kind: str
    title: str
    description: str = ""
    robot: str = "kr6"
    seed: int = pydantic.Field(default=1, ge=0)
    model: str = "shipped"
    """Where the ideal robot's model comes from: ``shipped`` (identified beforehand on recordings of the robot's
    default world, ``make models``) or the path of a model file."""
    world: dict[str, Any] = pydantic.Field(default_factory=dict)
    _folder: Path | None = pydantic.PrivateAttr(default=None)

    @property
    def folder(self) -> Path | None:
        """Where the scene file lies, for files beside it; None for a scene made in memory."""
        return self._folder

    def beside(self, folder: Path | None) -> Self:
        """The same scene as if its file lay in ``folder``."""
        copy = self.model_copy()
        copy._folder = folder
        return copy

    @pydantic.field_validator("name")
    @classmethod
    def _names_a_folder(cls, name: str) -> str:
        """Output goes to a folder of this name, so it must not lead anywhere else."""
        if not NAME.fullmatch(name):
            raise ValueError("expected a name of up to 80 letters, digits and _ - + . ( ) or spaces that begins with a "
                             "letter or digit: output goes to a folder of that name")
        return name

    @pydantic.field_validator("title", "robot", "model")
    @classmethod
    def _one_line(cls, text: str) -> str:
        if len(text) > 500 or not text.isprintable():
            raise ValueError("expected one line of up to 500 printable characters")
        return text

    def changed(self, **changes: Any) -> Self:
        """A checked copy with some keys changed; nested tables are given as dictionaries and merged."""
        values = self.model_dump()
        for key, value in changes.items():
            both = isinstance(value, dict) and isinstance(values.get(key), dict)
            values[key] = {**values[key], **value} if both else value
        return _checked(type(self), values, Path(f"scene {self.name}")).beside(self.folder)


def module_of(scene: Scene) -> Any:
    """The module that plays scenes of this kind."""
    return importlib.import_module(KINDS[scene.kind])


def library() -> Path:
    """Folder of the shipped scenes."""
    return Path(str(resources.files("scenes"))) / "library"


def load_scene(name_or_path: str | Path) -> Scene:
    """Loads a shipped scene by name, or a scene file by path, and checks it.

    Raises:
        InputError: no such scene, two scenes of the same name, broken TOML, an unknown key, a value out of range.
    """
    path = _find(str(name_or_path))
    values = read_toml(path, "a scene file")
    values.setdefault("name", path.stem)
    kind = values.get("kind")
    if not isinstance(kind, str) or kind not in KINDS:
        raise InputError(f"expected one of {', '.join(KINDS)}", file=path, field="kind", value=kind)
    scene: Scene = _checked(importlib.import_module(KINDS[kind]).SceneModel, values, path)
    return scene.beside(path.absolute().parent)


def _find(wanted: str) -> Path:
    """A path wins if it looks like one; a name is looked up among the scene files here and in the library."""
    if wanted.endswith(".toml") or "/" in wanted:
        if not Path(wanted).is_file():
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
        raise InputError(f"no scene of that name; there are {', '.join(sorted(names)) or 'none'}, or give the path of "
                         "a .toml file", field="scene", value=wanted)
    return found[0]


def _checked(model: type[S], values: dict[str, Any], path: Path) -> S:
    checked(values, path)
    try:
        return model(**values)
    except pydantic.ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        if first["type"] == "extra_forbidden":
            allowed = ", ".join(_keys_at(model, first["loc"][:-1]))
            raise InputError(f"unknown key; allowed here are {allowed}", file=path, field=key) from error
        shown = first.get("input")
        raise InputError(first["msg"], file=path, field=key,
                         value=shown if isinstance(shown, (str, int, float)) else None) from error


def _keys_at(model: type[pydantic.BaseModel], location: tuple[Any, ...]) -> list[str]:
    fields = model.model_fields
    for part in location:
        annotation = fields[part].annotation if part in fields else None
        if isinstance(annotation, type) and issubclass(annotation, pydantic.BaseModel):
            fields = annotation.model_fields
    return sorted(fields)
