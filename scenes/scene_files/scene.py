"""The keys that scenes of every kind have: which robot does what in which world."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from copy import deepcopy
from functools import cache
from pathlib import Path
from typing import Annotated, Any, ClassVar, Self, TypeVar, get_args, get_origin

import numpy as np
import pinocchio as pin
import pydantic

from ideal_robot.arrays import Array
from ideal_robot.bounded_values import checked
from ideal_robot.errors import IdealRobotError, InputError, found_in
from ideal_robot.robots import SHIPPED as SHIPPED_ARMS
from ideal_robot.robots.collisions import Obstacle

# The world of a scene: ``workshop`` with an uncalibrated arm and a worn line, ``bench`` with few errors, or ``cell``
# with all effects that real arms and pictures have.
#
# Each is a set of values that hold where a scene file does not say otherwise; each value can be given in the file.

WORKSHOP = "workshop"
BENCH = "bench"
CELL = "cell"
WORLDS = (WORKSHOP, BENCH, CELL)

ARM: dict[str, Any] = {"kinematic_error": 3.0e-4, "zero_error": 3.5e-4, "twist_error": 3.5e-4}
"""An arm that nobody calibrated: joints elsewhere by 0.3 mm, zeros and axes off by 0.02°."""


S = TypeVar("S", bound="Scene")

NAME = re.compile(r"[^\W_](?:[\w .+()-]{0,78}[\w+()-])?")
"""What a scene may be called."""


SHIPPED = "shipped"
OWN = "own"
"""What a scene's ``model`` may be besides a path."""


class Table(pydantic.BaseModel):
    """A table of a scene file: no unknown keys, no changes, numbers and truth values as TOML has them."""

    model_config = pydantic.ConfigDict(extra="forbid", frozen=True)

    @pydantic.field_validator("*", mode="before")
    @classmethod
    def _as_it_is_written(cls, value: Any, info: pydantic.ValidationInfo) -> Any:
        """Refuses ``true`` and ``"5"`` for a number, ``"no"`` for a truth value: pydantic would make one of them."""
        annotation: Any = cls.model_fields[str(info.field_name)].annotation
        leaves = _leaves(annotation)
        if leaves <= {int, float, type(None)} and any(isinstance(entry, bool | str) for entry in _values(value)):
            raise ValueError("expected a number, without quotes")
        if leaves == {bool} and not isinstance(value, bool | np.bool_):
            raise ValueError("expected true or false, without quotes")
        return value


@cache
def _leaves(annotation: Any) -> frozenset[Any]:
    """Types that an annotation is made of, without tuples, unions and what is asked besides."""
    parts = get_args(annotation)[:1] if get_origin(annotation) is Annotated else get_args(annotation)
    if parts:
        return frozenset().union(*map(_leaves, parts))
    return frozenset() if annotation is ... else frozenset([annotation])


def _values(value: Any) -> Iterator[Any]:
    """Values of nested lists."""
    if isinstance(value, list | tuple):
        for entry in value:
            yield from _values(entry)
    else:
        yield value


def _from_to(times: tuple[float, ...]) -> tuple[float, ...]:
    if times and (len(times) != 2 or not 0.0 <= times[0] <= times[1]):
        raise ValueError("expected two times from 0 on [s], from and to, or none")
    return times


Span = Annotated[tuple[float, ...], pydantic.AfterValidator(_from_to)]
"""When something happens: from and to [s]; never if empty."""


class Box(Table):
    """A box that stands in the cell; planned motions avoid it."""

    middle: tuple[float, float, float]
    """In the base frame [m]."""
    size: tuple[pydantic.PositiveFloat, pydantic.PositiveFloat, pydantic.PositiveFloat]
    """Along its x, y and z [m]."""
    heading_deg: float = 0.0
    """Direction of its x axis from the base's."""


class Scene(Table):
    """The keys of every kind of scene; the kinds add their own."""

    name: str
    kind: str
    title: str
    description: str = ""
    robot: str = "kr6"
    """A shipped robot, or the path of a URDF as seen from the scene file's folder."""
    seed: int = pydantic.Field(default=1, ge=0)
    model: str = SHIPPED
    """Where the ideal robot's model comes from: ``shipped`` (identified beforehand on recordings of the robot's
    default world, ``make models``), ``own`` (identified on recordings of the very arm of the scene, ``ideal-robot
    prepare``) or the path of a model file as seen from the scene file's folder."""
    max_duration: float = pydantic.Field(default=120.0, gt=0.0, le=7200.0)
    """Longest motion along the path [s]; a scene that asks for more, by too low a speed for instance, is refused before
    anything moves."""
    world: dict[str, Any] = pydantic.Field(default_factory=dict)
    workshop: ClassVar[dict[str, dict[str, Any]]] = {}
    """What the world ``workshop`` of this kind of scene has, by table; a kind without one plays on the bench."""
    cell: ClassVar[dict[str, dict[str, Any]]] = {}
    """What the world ``cell`` has beyond the workshop, by table, besides its arm."""
    worlds: ClassVar[tuple[str, ...]] = WORLDS
    """Where scenes of this kind can play."""
    _folder: Path | None = pydantic.PrivateAttr(default=None)
    _source: Path | None = pydantic.PrivateAttr(default=None)
    _given: dict[str, Any] | None = pydantic.PrivateAttr(default=None)

    @pydantic.model_validator(mode="before")
    @classmethod
    def _in_its_world(cls, values: Any) -> Any:
        """Fills in the values of the scene's world, and makes ``world``, a name or a table, one with ``base``."""
        world = values.get("world", {}) if isinstance(values, dict) else None
        if isinstance(world, str):
            world = {"base": world}
        if not isinstance(world, dict):
            return values
        usual = WORKSHOP if cls.workshop and world.get("ideal") is not True else BENCH
        values = {**values, "world": {"base": usual, **world}}
        if values["world"]["base"] in (WORKSHOP, CELL):
            for table, keys in cls.usual(values["world"]["base"]).items():
                settings = values.get(table, {})
                if isinstance(settings, dict):
                    values[table] = {**keys, **settings}
        return values

    @pydantic.field_validator("world")
    @classmethod
    def _is_a_world(cls, world: dict[str, Any]) -> dict[str, Any]:
        if world.get("base") not in cls.worlds:
            raise ValueError(f"expected {' or '.join(map(repr, cls.worlds))}, or a table with one of them as base")
        return world

    @classmethod
    def usual(cls, base: str) -> dict[str, dict[str, Any]]:
        """Default tables of this kind of scene in the world ``base``, by table."""
        if base == BENCH:
            return {}
        more = cls.cell if base == CELL else {}
        tables = [*cls.workshop, *(table for table in more if table not in cls.workshop)]
        return {table: {**cls.workshop.get(table, {}), **more.get(table, {})} for table in tables}

    def __eq__(self, other: object) -> bool:
        """The same kind of scene with the same values, whichever of them were given."""
        return type(other) is type(self) and isinstance(other, Scene) and self.folder == other.folder \
            and self.model_dump() == other.model_dump()

    def __hash__(self) -> int:
        return hash((type(self), self.folder, self.model_dump_json()))

    @property
    def arm_world(self) -> dict[str, Any]:
        """The table ``world`` of the arm's settings, as ``World.from_table`` takes it."""
        own = {key: value for key, value in self.world.items() if key != "base"}
        return {"cell": True, **own} if self.world.get("base") == CELL and own.get("ideal") is not True else own

    @property
    def folder(self) -> Path | None:
        """Folder of the scene file, for files beside it; None for a scene made in memory."""
        return self._folder

    @property
    def source(self) -> str:
        """Name of the scene in error messages: its file, or its name where it was made in memory."""
        return f"scene {self.name}" if self._source is None else str(self._source)

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

    def check_duration(self, lasts: float) -> None:
        """Raises InputError for a motion along the path that lasts longer [s] than ``max_duration``."""
        if not lasts <= self.max_duration:
            raise InputError(f"the motion would last {lasts:.3g} s, the scene allows {self.max_duration:g} s: move "
                             "faster, or give the scene a larger max_duration", file=self.source,
                             field="max_duration", value=self.max_duration)

    def played(self) -> dict[str, Any]:
        """Entries of every ``--json`` about the run: scene, robot, seed, world, arm, and the model's source."""
        return {"scene": self.name, "robot": self.robot, "seed": self.seed, "world": self.world.get("base", BENCH),
                "individual": self.world.get("individual", 1), "model": self.model}

    def changed(self, **changes: Any) -> Self:
        """A checked copy with some keys changed; nested tables are given as dictionaries and merged.

        Keys that were not given follow the world: ``changed(world="bench")`` removes all defaults of the workshop.
        """
        values = self.model_dump() if self._given is None else deepcopy(self._given)
        for key, value in changes.items():
            if key == "world":
                before = values.get("world", {})
                values[key] = {"base": before} if isinstance(before, str) else before
                value = {"base": value} if isinstance(value, str) else value
            both = isinstance(value, dict) and isinstance(values.get(key), dict)
            values[key] = {**values[key], **value} if both else value
        return scene_of(type(self), values, Path(self.source)).beside(self.folder)


def scene_in_file(model: type[S], values: dict[str, Any], path: Path) -> S:
    """Makes the scene of a file; relative paths in it start from the file's folder.

    Args:
        model, values, path: as for ``scene_of``, whose errors it raises.
    """
    names = {"robot": SHIPPED_ARMS, "model": (SHIPPED, OWN)}
    places = {key: str(path.parent / values[key]) for key, known in names.items()
              if isinstance(values.get(key), str) and values[key] not in known}
    return scene_of(model, {**values, **places}, path).beside(path.absolute().parent)


def scene_of(model: type[S], values: dict[str, Any], path: Path) -> S:
    """Makes the scene that these values describe.

    Args:
        model, values, path: as for ``validated``, whose errors it raises.
    """
    scene = validated(model, values, path)
    scene._given = deepcopy(values)
    scene._source = path
    return scene


M = TypeVar("M", bound=pydantic.BaseModel)


def validated(model: type[M], values: dict[str, Any], path: Path) -> M:
    """Makes a checked object from the values of a file.

    Args:
        model, values: its class, and keys as in the file.
        path: of the file, for messages.

    Raises:
        InputError: an unknown key, a missing one, a value out of range.
    """
    checked(values, path)
    try:
        with found_in(path):
            return model(**values)
    except pydantic.ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        if first["type"] == "extra_forbidden":
            allowed = ", ".join(_keys_at(model, first["loc"][:-1]))
            raise InputError(f"unknown key; allowed here are {allowed}", file=path, field=key) from error
        shown = first.get("input")
        if first["type"] == "tuple_type" and isinstance(shown, dict):
            raise InputError(f"expected a list of tables: write [[{key}]] in place of [{key}]", file=path,
                             field=key) from error
        raise InputError(first["msg"].removeprefix("Value error, "), file=path, field=key,
                         value=shown if isinstance(shown, (str, int, float)) else None) from error


def _keys_at(model: type[pydantic.BaseModel], location: tuple[Any, ...]) -> list[str]:
    fields = model.model_fields
    for part in location:
        annotation = fields[part].annotation if part in fields else None
        if isinstance(annotation, type) and issubclass(annotation, pydantic.BaseModel):
            fields = annotation.model_fields
    return sorted(fields)


def boxes_of(scene: Scene) -> tuple[Box, ...]:
    """The boxes in a scene's cell; none for a clamped arm."""
    return getattr(scene, "box", ())


def obstacles(boxes: Sequence[Box]) -> list[Obstacle]:
    """The boxes of a scene as obstacles, numbered from 1."""
    return [Obstacle(f"box {i}", pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, math.radians(box.heading_deg)),
                                         np.array(box.middle)), box.size) for i, box in enumerate(boxes, 1)]


def box_edges(boxes: Sequence[Box]) -> dict[str, Array]:
    """Edges of a scene's boxes by name, each a polyline ``(16, 3)`` [m]."""
    return {box.name: box.edges() for box in obstacles(boxes)}


class SceneError(IdealRobotError):
    """Root of this package's errors during a run; bad input is ``ideal_robot.errors.InputError``."""


def chosen(scene: S, *, speed: float | None = None, seed: int | None = None, individual: int | None = None,
           n_d: int | None = None, world: str | None = None) -> S:
    """The scene with options in place of its own values; InputError for options that its kind does not have.

    Args:
        scene: to change.
        speed: along the path [m/s]; the scene's own if None.
        seed: of all that is drawn; the scene's own if None.
        individual: which arm of the type is simulated, with the model from its own identification motions unless the
            scene names a model file; the scene's own arm and model if None.
        n_d: desired positions that the feedforward is given ([L] 2.2); the scene's own if None.
        world: world of the scene, ``workshop``, ``bench`` or ``cell``; where its file says if None.
    """
    changes: dict[str, Any] = {}
    if speed is not None:
        if "speed" not in type(scene).model_fields:
            raise InputError(f"scenes of kind {scene.kind!r} have no speed", field="--speed", value=speed)
        if not (math.isfinite(speed) and speed > 0):
            raise InputError("expected a positive number [m/s]", field="--speed", value=speed)
        changes["speed"] = speed
    if seed is not None:
        changes["seed"] = seed
    if world is not None:
        allowed = type(scene).worlds
        if world not in allowed:
            raise InputError(f"scenes of kind {scene.kind!r} play in {' or '.join(allowed)}", field="--world",
                             value=world)
        changes["world"] = {"base": world}
    if individual is not None:
        changes["world"] = {**changes.get("world", {}), "individual": individual}
        if scene.model == SHIPPED:
            changes["model"] = OWN
    if n_d is not None:
        if "n_d" not in type(scene).model_fields:
            raise InputError(f"scenes of kind {scene.kind!r} have no horizon setting", field="--n-d", value=n_d)
        if n_d < 1:
            raise InputError("expected a whole number from 1 up", field="--n-d", value=n_d)
        changes["n_d"] = n_d
    return scene.changed(**changes) if changes else scene
