"""Every key of every kind of scene: for the documentation, for editors (JSON Schema), and for a commented first file.

What a key means is the sentence that stands under it in the scene's class; it is read from the source, so that no
second list can differ from the first. ``python -m scenes.schema docs`` writes the pages anew.
"""

from __future__ import annotations

import ast
import dataclasses
import inspect
import itertools
import json
import re
import textwrap
from collections.abc import Iterable, Iterator
from functools import cache
from typing import Any, get_args

import pydantic

from ideal_robot.effects.registry import library
from ideal_robot.feedforward.registry import method, methods, settings
from ideal_robot.interfaces import INTERFACES, ArmInterface
from ideal_robot.robots import SHIPPED
from ideal_robot.robots.robot import Robot
from scenes.kind import KINDS
from scenes.scene_file import library as scene_folder
from scenes.scene_file import load_scene
from scenes.scene_files.scene import WORLDS
from sensing.camera.detector import DETECTORS
from sim.arm.world import World


@dataclasses.dataclass(frozen=True)
class Key:
    """One key of a scene file, with its meaning.

    Attributes:
        table: the table that it belongs to, e.g. ``camera``; empty for the top.
        name: the key.
        default: as it is written in TOML; None where it must be given or nothing is the default.
        required: whether it must be given.
        allowed: type and limits, for people.
        meaning: one sentence; empty where name and unit say it.
        many: whether the table may occur several times (``[[feature]]``).
    """

    table: str
    name: str
    default: str | None
    required: bool
    allowed: str
    meaning: str
    many: bool = False


def scene_keys(kind: str) -> tuple[Key, ...]:
    """All keys of a kind of scene, tables after the keys at the top."""
    scene = KINDS.get(kind).scene
    # The defaults of a ``workshop`` apply where a file has no value.
    usual = {(table, name): _toml(value) for table, keys in scene.workshop.items() for name, value in keys.items()}
    keys = tuple(dataclasses.replace(key, default=usual.get((key.table, key.name), key.default))
                 for key in _keys(scene, "", False))
    return tuple(sorted(keys, key=lambda key: bool(key.table)))


def world_keys() -> tuple[Key, ...]:
    """All keys of the table ``world``; their defaults are the robot's (``World.default``)."""
    meanings: dict[str, str] = {}
    section = (inspect.getdoc(World) or "").partition("Attributes:")[2]
    for names, text in re.findall(r"^ {4}([a-z_, ]+):((?:.|\n(?! {4}\S))*)", section, flags=re.M):
        meanings |= {name.strip(): " ".join(text.split()) for name in names.split(",")}
    fields = [field for field in dataclasses.fields(World) if field.name not in ("robot", "extra_torque")]
    for field in fields:
        # A field that is described with another field has the explanation of that one.
        explained = next((text for text in meanings.values() if f"``{field.name}``" in text), "")
        meanings.setdefault(field.name, explained)
    base = Key("world", "base", None, False, " or ".join(WORLDS), "World that the scene runs in; "
               "`world = \"bench\"` is short for a table with that alone. In the workshop, the default of line and "
               "force scenes, the defaults of their tables above hold; on the bench nothing is displaced in height, "
               "worn or lost. The cell is the workshop with pictures and an arm as cells have them.")
    spread = Key("world", "spread", None, False, "a table of numbers from 0 to 3",
                 "Standard deviations of keys that nobody measured, of their logarithms; the individual draws them.")
    return base, spread, *(Key("world", field.name, None, False, _plain_type(str(field.type)), meanings[field.name])
                   for field in fields)


def json_schema(kind: str) -> dict[str, Any]:
    """The JSON Schema of a kind of scene, with descriptions, for editors."""
    schema = KINDS.get(kind).scene.model_json_schema()
    meanings = {(key.table, key.name): key.meaning for key in scene_keys(kind)}
    schema["$schema"] = "https://json-schema.org/draft/2020-12/schema"
    schema["title"] = f"scene of kind {kind}"
    for name, entry in schema["properties"].items():
        if meanings.get(("", name)):
            entry["description"] = meanings["", name]
    for model in _tables(KINDS.get(kind).scene):
        sentences = _sentences(model)
        for name, entry in schema["$defs"].get(model.__name__, {}).get("properties", {}).items():
            if sentences.get(name):
                entry["description"] = sentences[name]
    return schema


def commented_scene(name: str, kind: str, example: str) -> str:
    """A scene file to start from: a shipped example, then every other key with its default as a comment.

    Args:
        name: of the new scene, for its title.
        kind, example: text of a shipped scene of that kind.
    """
    text = re.sub(r'^title = .*$', f"title = {json.dumps(name, ensure_ascii=False)}", example, flags=re.M)
    lines = ["# Play it: ideal-robot run FILE. Every key of such a scene is here; one behind # has the value shown.",
             text.rstrip()]
    present = set(re.findall(r"^([a-z_]+) *=", text, flags=re.M))
    top = [key for key in scene_keys(kind) if not key.table and key.name not in present | {"name", "kind", "world"}]
    rest = [key for key in scene_keys(kind) if key.table]
    tables = list(dict.fromkeys((key.table, key.many) for key in rest))
    if top:
        # A key after a table's header would belong to that table, so these keys come before the first one.
        head, mark, tail = lines[1].partition("\n[")
        lines[1] = "\n".join([head.rstrip(), *(_comment(key) for key in top)]) + ("\n" + mark + tail if mark else "")
    for table, many in tables:
        header = f"[[{table}]]" if many else f"[{table}]"
        missing = [key for key in rest if key.table == table and not _stands(lines[1], header, key.name)]
        if not missing:
            continue
        comments = [_comment(key) for key in missing]
        if re.search(rf"^{re.escape(header)}", lines[1], flags=re.M):
            head, line, tail = re.split(rf"^({re.escape(header)}.*)$", lines[1], maxsplit=1, flags=re.M)
            lines[1] = head + "\n".join([line, *comments]) + tail
        else:
            lines += ["", f"# {header}", *comments]
    lines += ["", "# The simulated world; defaults belong to the robot (docs: World).", "# [world]"]
    lines += [_comment(key) for key in world_keys()]
    return "\n".join(lines) + "\n"


def keys_pages() -> dict[str, str]:
    """Documentation pages of all keys in Markdown, by path: one per kind of scene, one of the world."""
    about = {kind: (inspect.getdoc(KINDS.get(kind).scene) or "").partition("\n")[0] for kind in KINDS.names()}
    told: dict[str, str] = {}
    pages = {f"scene_keys/{kind}.md":
             f"# Keys of {kind} scenes\n\n{about[kind]}\n\n{_tables_of(scene_keys(kind), told, kind)}"
             for kind in sorted(about, key=["line", "path"].__contains__, reverse=True)}
    pages["scene_keys/world.md"] = ("# Keys of the simulated world\n\nThe table `[world]` of every kind of scene. "
                                    f"Defaults are the robot's.\n\n{_tables_of(world_keys(), {}, 'world')}")
    return pages


def _tables_of(keys: tuple[Key, ...], told: dict[str, str], page: str) -> str:
    """A section for each table of the file; one that another page has in the same form is a link to it.

    Args:
        keys: of the page.
        told: sections of the pages before, and which of them has each; those of this one are added.
        page: this one's name.
    """
    sections, elsewhere = [], []
    for (table, many), of_table in itertools.groupby(keys, key=lambda key: (key.table, key.many)):
        header = f"[[{table}]]" if many else f"[{table}]"
        section = "\n\n".join([f"## `{header}`" if table else "## At the top", "\n".join(_rows(of_table))])
        if told.setdefault(section, page) == page:
            sections.append(section)
        else:
            elsewhere.append(f"{f'`{header}`' if table else 'The top'} as in [{told[section]}]({told[section]}.md)")
    if elsewhere:
        sections += ["## The same elsewhere", f"{', '.join(elsewhere)}."]
    return "\n\n".join(sections) + "\n"


def _rows(keys: Iterable[Key]) -> Iterator[str]:
    """Rows of a table; keys that share default, limits and sentence share one, and a column of nothing is left out."""
    rows = []
    for (value, meaning), group in itertools.groupby(keys, key=lambda key: (_value(key), key.meaning)):
        cells = (", ".join(f"`{key.name}`" for key in group), value, meaning)
        rows.append([cell.replace("|", "\\|") for cell in cells])
    titles = ["key", "default: allowed", "meaning"]
    columns = [column for column in zip(titles, *rows, strict=True) if any(column[1:])]
    for i, row in enumerate(zip(*columns, strict=True)):
        yield f"| {' | '.join(row)} |"
        if i == 0:
            yield "| --- " * len(columns) + "|"


def _value(key: Key) -> str:
    """A key's default, and what is allowed."""
    default = "**required**" if key.required else f"`{key.default}`" if key.default is not None else ""
    return f"{default}: {key.allowed}" if default else key.allowed


def _keys(model: type[pydantic.BaseModel], table: str, many: bool) -> Iterator[Key]:
    sentences = _sentences(model)
    for name, field in model.model_fields.items():
        inner, several = _table_of(field.annotation)
        if inner is not None:
            yield from _keys(inner, f"{table}.{name}" if table else name, several)
            continue
        default = None if field.is_required() else _toml(field.get_default(call_default_factory=True))
        yield Key(table, name, default, field.is_required(), _allowed(field), sentences.get(name, ""), many)


def _table_of(annotation: Any) -> tuple[type[pydantic.BaseModel] | None, bool]:
    """The class of a nested table, and whether there may be several of it."""
    if isinstance(annotation, type) and issubclass(annotation, pydantic.BaseModel):
        return annotation, False
    for part in get_args(annotation):
        if isinstance(part, type) and issubclass(part, pydantic.BaseModel):
            return part, "tuple" in str(annotation)
    return None, False


def _tables(model: type[pydantic.BaseModel]) -> Iterator[type[pydantic.BaseModel]]:
    for field in model.model_fields.values():
        inner, _ = _table_of(field.annotation)
        if inner is not None:
            yield inner
            yield from _tables(inner)


@cache
def _sentences(model: type[pydantic.BaseModel]) -> dict[str, str]:
    """The sentence under each field in the class and those it inherits from."""
    sentences: dict[str, str] = {}
    for owner in reversed(model.__mro__):
        if not (isinstance(owner, type) and issubclass(owner, pydantic.BaseModel)) or owner is pydantic.BaseModel:
            continue
        body = ast.parse(textwrap.dedent(inspect.getsource(owner))).body[0]
        statements = body.body if isinstance(body, ast.ClassDef) else []
        for statement, following in itertools.pairwise(statements):
            if (isinstance(statement, ast.AnnAssign) and isinstance(statement.target, ast.Name)
                    and isinstance(following, ast.Expr) and isinstance(following.value, ast.Constant)):
                sentences[statement.target.id] = " ".join(str(following.value.value).split())
    return sentences


def _allowed(field: Any) -> str:
    kind = _plain_type(str(field.annotation))
    limits = {"gt": "above", "ge": "from", "lt": "below", "le": "to"}
    bounds = [f"{limits[name]} {getattr(rule, name):g}" for rule in field.metadata for name in limits
              if getattr(rule, name, None) is not None]
    return ", ".join([kind, *bounds])


def _plain_type(text: str) -> str:
    text = re.sub(r"typing\.|<class '|'>|scenes\.[\w.]+\.", "", text)
    text = re.sub(r"Literal\[(.*?)\]", lambda match: " or ".join(match[1].split(", ")), text)
    words = {"Annotated[float, Gt(gt=0)]": "positive number", "float": "number", "int": "whole number", "str": "text",
             "bool": "true or false", "None": "nothing", "PerJoint": "number or one per joint",
             "dict[text, Any]": "table", "pathlib.Path": "path"}
    for word, plain in words.items():
        text = re.sub(rf"\b{re.escape(word)}(?!\w)", plain, text)
    text = re.sub(r"tuple\[(.*?)\]", lambda match: _list_of(match[1].split(", ")), text)
    return text.replace(" | nothing", "").replace(" | ", " or ")


def _list_of(parts: list[str]) -> str:
    """What a list holds: ``3 numbers``, or its entries one by one."""
    alike = set(parts) in ({"number"}, {"positive number"})
    return f"{len(parts)} {parts[0]}s" if alike else f"list ({', '.join(parts)})"


def _toml(value: Any) -> str | None:
    if value is None:
        return None
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, (int, float, str)):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, (tuple, list)):
        return "[" + ", ".join(_toml(entry) or "" for entry in value) + "]"
    return "{}" if isinstance(value, dict) else None


def _stands(text: str, header: str, name: str) -> bool:
    """Whether a key is given under a table's header."""
    _, separator, rest = text.partition(f"\n{header}")
    return bool(separator) and re.search(rf"^{name} *=", re.split(r"^\[", rest[1:], maxsplit=1, flags=re.M)[0],
                                         flags=re.M) is not None


def _comment(key: Key) -> str:
    comment = f"  # {key.meaning}" if key.meaning else ""
    value = key.default if key.default is not None else f"…  ({key.allowed})"
    return f"# {key.name} = {value}{comment}"


def catalogue(what: str, kind: str = "line") -> tuple[list[str], list[list[Any]]]:
    """Titles and rows of a list of ``ideal-robot list``.

    Args:
        what: ``scenes``, ``robots``, ``methods``, ``effects``, ``detectors``, ``interfaces`` or ``keys``.
        kind: of scene, with ``keys``.

    Raises:
        InputError: no such kind.
    """
    if what == "scenes":
        scenes = [load_scene(path) for path in sorted(scene_folder().glob("*.toml"))]
        return ["scene", "kind", "robot", "title"], [[s.name, s.kind, s.robot, s.title] for s in scenes]
    if what == "robots":
        arms = [Robot.load(name) for name in SHIPPED]
        return ["robot", "joints", "cycle [ms]", "URDF"], [[arm.name, arm.n, 1e3 * arm.t_ipo, arm.urdf.name]
                                                           for arm in arms]
    if what == "methods":
        return ["method", "needs", "what it does"], [[key, method(key).needs.name.lower(), method(key).description]
                                                     for key in (*methods(), *settings())]
    if what == "effects":
        return ["effect", "acts on", "what it is"], [
            [effect.name, effect.key.partition("/")[2], (type(effect).__doc__ or "").strip().partition("\n")[0]]
            for effect in library()]
    if what == "detectors":
        return ["detector", "how it works"], [[name, (detector.__doc__ or "").strip().partition("\n")[0]]
                                              for name, detector in DETECTORS]
    if what == "interfaces":
        return ["interface", "address", "library", "cycle", "reports", "tried against"], [
            [each.title, each.example, _library(each), each.cycles, each.reports, each.tried] for _, each in INTERFACES]
    return ["table", "key", "default", "allowed", "meaning"], [
        [key.table, key.name, "required" if key.required else key.default, key.allowed, key.meaning]
        for key in scene_keys(kind)]


def _library(interface: ArmInterface) -> str:
    """What speaks an interface's wire, and how it is installed where it is not there."""
    if not interface.package:
        return "own"
    return interface.package if interface.installed else f"pip install 'ideal-robot[{interface.extra}]'"
