"""Recognises columns of other programs' tables: time, positions, torques, and their units.

A title is read word by word: a quantity (``position``, ``effort``, ``strom``), its role (``actual``, ``target``), a
joint (its name or number) and perhaps a unit. So UR's record script, PlotJuggler, ``rostopic echo -p``, libfranka's
log, KUKA's trace and EtherCAT drives are read alike. A map of the user's own names the columns instead (``--columns``).
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.bounded_values import read_toml
from ideal_robot.errors import InputError, did_you_mean

OF_JOINTS = ("q_c", "q_d", "q", "qa", "tau", "current", "temp")
"""Quantities that every joint has."""
SINGLE = ("t", "x", "y", "z", "qx", "qy", "qz", "qw", "fx", "fy", "fz", "mx", "my", "mz", "cam_t")
"""Quantities that the arm has once: time, pose of the TCP, wrench, stamp of the camera."""

_QUANTITIES = {
    "q": "position positions pos angle angles q theta istposition sollposition istwinkel sollwinkel winkel lage",
    "qd": "velocity velocities vel speed qd dq qdot geschwindigkeit drehzahl",
    "tau": "effort efforts torque torques tau tq moment drehmoment trq motortorque",
    "current": "current currents strom motorstrom",
    "temp": "temperature temperatures temp temperatur",
}
_WORDS = {word: quantity for quantity, words in _QUANTITIES.items() for word in words.split()}
"""The quantity that a word of a title names."""
_MEASURED = frozenset(("actual", "act", "measured", "meas", "msr", "ist", "feedback", "state", "value", "wert"))
_COMMANDED = frozenset(("target", "command", "commanded", "commands", "cmd", "reference", "references", "ref",
                        "setpoint", "soll", "sollwert", "sollposition", "sollwinkel", "desired", "des", "cmptd",
                        "computed"))
_AXIS = frozenset(("axis", "act"))
"""KUKA's words for positions: ``$AXIS_ACT``."""
_KRL_ANGLE = re.compile(r"\$AXIS\w*\[A?\d+\]", re.IGNORECASE)
"""Axes that turn among KRL's variables, which are degrees by KUKA's manual; external ones may slide."""
_OTHERS = frozenset(("tcp", "tool", "cartesian", "pose", "ee", "ext", "external", "error", "err", "deviation", "limit",
                     "max", "min", "gravity", "coriolis", "mass", "mode", "status", "voltage", "output", "estimated",
                     "pid", "raw", "window", "acceleration", "acc"))
"""Words of titles that hold something else than a joint's motion or drive, whatever the other words are."""
_JOINT = frozenset(("joint", "axis", "jnt", "j", "gelenk", "achse"))
"""Words that name a joint in titles that name no quantity: its position is meant."""
_LEARNED = {"observation.state": "q", "action": "q_c"}
"""Lists in tables for learning (LeRobot) that do not name their quantity: what was measured, and what was commanded."""
_TIME = ("t", "time", "times", "timestamp", "stamp", "zeit", "elapsed", "sec", "secs", "seconds", "zeitstempel")
"""Words of a title of times, the surest first."""
_BESIDE_TIME = frozenset(("header", "field", "robot", "controller", "relative", "since", "start", "ros", "log"))
_FACTORS = {"deg": math.pi / 180.0, "degree": math.pi / 180.0, "degrees": math.pi / 180.0, "grad": math.pi / 180.0,
            "°": math.pi / 180.0, "mm": 1e-3, "ms": 1e-3, "msec": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9, "ma": 1e-3,
            "rad": 1.0, "m": 1.0, "s": 1.0, "sec": 1.0, "a": 1.0, "nm": 1.0, "n m": 1.0, "rad/s": 1.0, "°c": 1.0,
            "deg/s": math.pi / 180.0, "°/s": math.pi / 180.0, "%": 1.0, "‰": 1.0}
"""Units that titles carry, over those of docs/files.md; shares of a rated torque stay as they are."""
_ANGLES = ("", "rad", "deg", "degree", "degrees", "grad", "°", "m", "mm")
"""Units of positions of joints, one of them none."""
_UNIT = re.compile(r"\s*[\[(]\s*([^\[\]()0-9]+?)\s*[\])]\s*$")
_PARTS = re.compile(r"[A-Z]?[a-zµ°]+|[A-Z]+(?![a-z])|\d+")
_EPOCH = ((1e17, 1e-9, "nanoseconds"), (1e14, 1e-6, "microseconds"), (1e11, 1e-3, "milliseconds"), (1e8, 1.0, ""))
"""Least number that a clock of that unit shows in our decades, the unit [s] and its name."""
_LISTED = 40
"""Titles that a message names."""


@dataclass(frozen=True)
class Source:
    """Source of a column, with a factor.

    Attributes:
        title: of the column in the file.
        factor: factor by which its values are multiplied.
    """

    title: str
    factor: float = 1.0


@dataclass(frozen=True)
class ColumnMap:
    """Mapping from a table's columns to those of docs/files.md.

    Attributes:
        of: our name → where it comes from.
        joints: names of the joints, in the order of their numbers; empty where the titles have only numbers.
        given: whether the user gave it.
        rate: of the samples [Hz], of a table without a clock.
    """

    of: dict[str, Source]
    joints: tuple[str, ...] = ()
    given: bool = field(default=False, compare=False)
    rate: float | None = None

    def applied(self, columns: Mapping[str, Array], meta: dict[str, Any]) -> tuple[dict[str, Array], dict[str, Any]]:
        """Columns ``(N,)`` with this project's names and units, others unchanged, and metadata with the mapping."""
        taken = {source.title for source in self.of.values()}
        result: dict[str, Array] = {}
        said: list[str] = []
        for name, source in self.of.items():
            values = columns[source.title]
            result[name] = values if source.factor == 1.0 else np.asarray(values, dtype=float) * source.factor
        if self.rate is not None:
            result["t"] = np.arange(len(next(iter(columns.values()), ()))) / self.rate
            said.append(f"clock: samples are counted at {self.rate:g} Hz")
        clock = result.get("t", columns.get("t"))
        t, unit = (None, "") if clock is None else _from_epoch(clock)
        # A column named t is in seconds with any origin, unless it has epoch milliseconds.
        if t is not None and t is not clock and ("t" in result or unit):
            result["t"] = t
            said.append(f"epoch-stamps: times count from the first stamp{unit and f', from {unit}'}")
        result.update({name: values for name, values in columns.items() if name not in taken and name not in result})
        renamed = {name: source for name, source in self.of.items() if name != source.title or source.factor != 1.0}
        if renamed:
            said.insert(0, "columns: " + ", ".join(_told(renamed)))
        names = {"joints": list(self.joints)} if self.joints else {}
        return result, with_reading({**meta, **names}, said)


def with_reading(meta: dict[str, Any], said: Sequence[str]) -> dict[str, Any]:
    """Metadata with further notes of a reader under ``reading``: sentences ``name: what was done``."""
    return {**meta, "reading": [*meta.get("reading", ()), *said]} if said else meta


def recognised(titles: Sequence[str], topic: str | None = None) -> ColumnMap:
    """The mapping that the columns' titles suggest; empty where they have this project's names, or no known ones.

    Args:
        titles: of the table's columns.
        topic: part of the titles' path to select one of several groups of joints.

    Raises:
        InputError: several groups of joints have positions, and no ``topic`` says which.
    """
    own = {title for title in titles if _is_ours(title)}
    found: dict[str, Source] = {}
    if "t" not in own and (time := _time(titles)):
        found["t"] = time
    joints: tuple[str, ...] = ()
    if "q_1" not in own:
        times = {source.title for source in found.values()}
        others = [title for title in titles if title not in own | times]
        groups = _groups(others, _joint_column)
        if not any("q" in group for group in groups.values()):
            groups = _groups(others, _bare_joint)
        prefixes = _with_positions(groups, topic)
        if prefixes:
            joints = _joint_columns(groups, prefixes[0], found)
    return ColumnMap(found, joints)


def given_map(path: Path, titles: Sequence[str]) -> ColumnMap:
    """The mapping in a user's TOML file; raises InputError for missing columns or impossible entries.

    A key is one of docs/files.md without the joint's number: its value is a title, a list of titles (one a joint), or a
    pattern with the joint's number in braces, ``{0}`` counted from 0 and ``{1}`` from 1; or a table with ``column`` or
    ``columns``, ``factor`` (a number or one a joint) and ``unit``. ``joints`` lists the joints' names. ``t`` of a table
    without a clock is a table with its ``rate`` [Hz].
    """
    of: dict[str, Source] = {}
    joints: tuple[str, ...] = ()
    rate: float | None = None
    known = set(titles)
    for key, value in read_toml(path, "a map of columns").items():
        if key == "joints":
            joints = tuple(str(name) for name in _listed(value, path, key))
            continue
        if key not in (*OF_JOINTS, *SINGLE, "qd"):
            raise InputError(f"{did_you_mean(key, (*OF_JOINTS, *SINGLE))}expected joints or one of "
                             f"{', '.join((*SINGLE[:1], *OF_JOINTS, *SINGLE[1:]))}", file=path, field=key)
        table = value if isinstance(value, dict) else {"columns": value}
        if key == "t" and "rate" in table:
            rate = _rate(table, path)
            continue
        if odd := sorted(set(table) - {"column", "columns", "factor", "unit"}):
            raise InputError("expected columns (or column), factor, unit", file=path, field=f"{key}.{odd[0]}")
        named = _titles(table.get("columns", table.get("column")), known, path, key)
        factors = _factors(table, len(named), path, key)
        if key in SINGLE and len(named) != 1:
            raise InputError(f"expected the title of one column, not {len(named)}", file=path, field=key)
        names = [key] if key in SINGLE else [f"{key}_{j + 1}" for j in range(len(named))]
        of.update({name: Source(title, factor) for name, title, factor in zip(names, named, factors, strict=True)})
    # Recognisable columns need not be named: a clock, and joints of a table with a given rate.
    if "t" not in (*of, *known) and rate is None and (time := _time(titles)):
        of["t"] = time
    if "q_1" not in (*of, *known) and not any(name.rpartition("_")[0] in OF_JOINTS for name in of):
        found = recognised(titles)
        of, joints = {**found.of, **of}, joints or found.joints
    for wanted in ("t", "q_1"):
        if wanted not in of and wanted not in known and (wanted != "t" or rate is None):
            raise InputError(f"maps no column to {wanted.partition('_')[0]}; the table's columns are "
                             f"{listed_titles(titles)}", file=path, field=wanted.partition("_")[0])
    return ColumnMap(of, joints, given=True, rate=rate)


def _rate(table: Mapping[str, Any], path: Path) -> float:
    """The rate of the samples of a table without a clock [Hz]."""
    rate = table["rate"]
    if len(table) > 1 or isinstance(rate, bool) or not isinstance(rate, (int, float)) or not 0.0 < rate < math.inf:
        raise InputError("expected the samples' rate alone, a number above 0 [Hz]", file=path, field="t.rate",
                         value=rate)
    return float(rate)


def listed_titles(titles: Sequence[str]) -> str:
    """Titles for a message: numbered ones as one pattern of a map, and only the first of many."""
    runs: dict[str, list[int]] = {}
    for title in titles:
        for number in re.finditer(r"\d+", title):
            runs.setdefault(_pattern(title, number), []).append(int(number[0]))
    counted = {pattern: numbers for pattern, numbers in runs.items()
               if len(numbers) > 2 and numbers == list(range(numbers[0], numbers[0] + len(numbers))) and numbers[0] < 2}
    shown: dict[str, None] = {}
    for title in titles:
        pattern = next((found for number in re.finditer(r"\d+", title)
                        if (found := _pattern(title, number)) in counted), None)
        shown[title if pattern is None else
              f"{pattern.replace('{}', f'{{{counted[pattern][0]}}}')} ({len(counted[pattern])})"] = None
    return _listed_first(list(shown))


def _pattern(title: str, number: re.Match[str]) -> str:
    """A title with a place in the stead of one of its numbers."""
    return f"{title[: number.start()]}{{}}{title[number.end():]}"


def _listed_first(titles: Sequence[str]) -> str:
    return (", ".join(titles[:_LISTED]) + (f" and {len(titles) - _LISTED} more" if len(titles) > _LISTED else "")
            or "none")


def _is_ours(title: str) -> bool:
    kind, _, tail = title.rpartition("_")
    return title in SINGLE or (tail.isdigit() and kind in (*OF_JOINTS, "qd", "qdd"))


def _told(renamed: Mapping[str, Source]) -> list[str]:
    """Our names and theirs, those of all joints in one."""
    rows: dict[str, list[tuple[str, Source]]] = {}
    for name, source in renamed.items():
        kind, _, number = name.rpartition("_")
        rows.setdefault(kind if number.isdigit() else name, []).append((name, source))
    told = []
    for pairs in rows.values():
        (first, source), (last, other) = pairs[0], pairs[-1]
        factor = "" if source.factor == 1.0 else f" × {source.factor:.6g}"
        told.append(f"{first} from {source.title!r}{factor}" if first == last else
                    f"{first} to {last} from {source.title!r} to {other.title!r}{factor}")
    return told


def _words(title: str) -> tuple[list[str], str]:
    """The words of a title in small letters, and its unit."""
    unit = ""
    if (match := _UNIT.search(title)) and match[1].lower() in _FACTORS:
        unit, title = match[1].lower(), title[: match.start()]
    words = [word.lower() for word in _PARTS.findall(title)]
    if not unit and len(words) > 1 and words[-1] in ("deg", "degrees", "rad", "s", "ms", "us", "ns", "nm", "mm"):
        unit = words.pop()
    return words, unit


def _time(titles: Sequence[str]) -> Source | None:
    """The column of times: by the surest word, of titles that say nothing else."""
    best: tuple[int, int, Source] | None = None
    for place, title in enumerate(titles):
        words, unit = _words(title)
        kinds = [_TIME.index(word) for word in words if word in _TIME]
        if not kinds or any(word not in _TIME and word not in _BESIDE_TIME for word in words):
            # The stamp of a message: its topic is the part before.
            if not (words[-2:] == ["header", "stamp"] or words[-1:] == ["timestamp"]):
                continue
            kinds = [len(_TIME)]
        rank = (min(kinds), place, Source(title, _FACTORS.get(unit, 1.0)))
        best = rank if best is None or rank[:2] < best[:2] else best
    return None if best is None else best[2]


def _from_epoch(t: Array) -> tuple[Array, str]:
    """Times that a clock since 1970 shows, counted from the first in seconds, and their unit; or as they are."""
    first = float(t[0]) if len(t) else 0.0
    for least, factor, unit in _EPOCH:
        if np.isfinite(first) and first >= least:
            return (np.asarray(t, dtype=float) - first) * factor, unit
    return t, ""


Group = dict[str, dict[str, Source]]
"""Of each quantity the joints' columns by their names."""


def _groups(titles: Sequence[str], of: Callable[[str], _Told | None]) -> dict[str, Group]:
    """Columns of joints, which ``of`` finds, by the path that stands before the joint's name, then by quantity.

    Beside joints that are named by their number alone, a title with a further word is of something else.
    """
    groups: dict[str, Group] = {}
    ranks: dict[tuple[str, str, str], int] = {}
    for title in titles:
        told = of(title)
        if told is None:
            continue
        quantity, prefix, name, rank, source = told
        # An actual value is preferred to one without a role.
        if rank < ranks.get((prefix, quantity, name), 9):
            ranks[prefix, quantity, name] = rank
            groups.setdefault(prefix, {}).setdefault(quantity, {})[name] = source
    for group in groups.values():
        for columns in group.values():
            if any(name.isdigit() for name in columns):
                for name in [name for name in columns if not name.isdigit()]:
                    del columns[name]
    return groups


_Told = tuple[str, str, str, int, Source]
"""Quantity, path, joint, rank of its role (0: said to be measured) and source of a title."""


def _bare_joint(title: str) -> _Told | None:
    """What a title is of that names a joint by its number and nothing else, or of a joint; None for another one."""
    words, unit = _words(title)
    if told := _joint_column(title):
        return told
    if not _JOINT & set(words) or not any(word.isdigit() for word in words) or set(words) & (
            _OTHERS | _COMMANDED | set(_WORDS)) or unit not in _ANGLES:
        return None
    path, name = re.match(r"^(.*[/.])?([^/.]*)$", _UNIT.sub("", title)).groups(default="")  # type: ignore[union-attr]
    prefix = "/".join(part for part in re.split(r"[/.]", path) if part)
    return "q", prefix, name, 1, Source(title, _FACTORS.get(unit, 1.0))


def _joint_column(title: str) -> _Told | None:
    """What a title is of that names a quantity of a joint; None for another one."""
    if (match := re.fullmatch(r"(.*)_(\d+)", title)) and match[1] in _LEARNED:
        return _LEARNED[match[1]], "observation", match[2], 0, Source(title)
    words, unit = _words(title)
    if _OTHERS & set(words):
        return None
    kinds = [word for word in words if word in _WORDS and word != "q"] or [word for word in words if word == "q"]
    if not kinds and set(words) >= _AXIS:
        kinds = ["axis"]
    if not kinds:
        return None
    quantity = _WORDS.get(kinds[-1], "q")
    if not unit and _KRL_ANGLE.search(title) and quantity == "q":
        unit = "deg"
    # libfranka names desired positions q_d; elsewhere d may be a joint's name.
    led = _COMMANDED | ({"d"} if "d" in words[words.index(kinds[-1]):] else set())
    commanded, measured = bool(led & set(words)), bool(_MEASURED & set(words))
    if commanded:
        if quantity != "q":
            return None
        quantity = "q_c"
    bare = _UNIT.sub("", title) if unit and title[-1] in ")]" else title
    path, leaf = re.match(r"^(.*[/.])?([^/.]*)$", bare.rstrip("/.")).groups(default="")  # type: ignore[union-attr]
    drop = {kinds[-1], "axis", *_MEASURED, *led, unit}
    name = _without(leaf, drop)
    if not name and path:
        # In .../joint_a1/position the joint is the part before.
        path, name = re.match(r"^(.*[/.])?([^/.]*)$", path.rstrip("/.")).groups(default="")  # type: ignore[union-attr]
        name = _without(name, drop - {"state"})
    if not name:
        return None
    prefix = "/".join(part for part in re.split(r"[/.]", path) if part and part.lower() not in drop)
    return quantity, prefix, name, 0 if measured else 1, Source(title, _FACTORS.get(unit, 1.0))


def _without(text: str, drop: set[str]) -> str:
    """A title's part without the words that say quantity and role."""
    kept = [part for part in _PARTS.findall(text) if part.lower() not in drop]
    return "_".join(kept)


def _with_positions(groups: Mapping[str, Group], topic: str | None) -> list[str]:
    """The path of the joints that are read, alone in a list; empty for none."""
    having = [prefix for prefix, group in groups.items() if "q" in group]
    if topic is not None:
        wanted = topic.strip("/").replace(".", "/")
        having = [prefix for prefix in having if wanted in prefix]
        if not having:
            raise InputError(f"no column of positions has it in its title; groups are "
                             f"{', '.join(sorted(groups)) or 'none'}", field="--topic", value=topic)
    driven = [prefix for prefix in having if {"tau", "current"} & set(groups[prefix])]
    having = driven or having
    if len(having) > 1:
        raise InputError(f"several groups of joints have positions ({', '.join(sorted(having))}); name one with "
                         "--topic, or map the columns with --columns", field="columns")
    return having


def _joint_columns(groups: Mapping[str, Group], prefix: str, found: dict[str, Source]) -> tuple[str, ...]:
    """Adds the columns of a group's joints; returns the joints' names, none where they are numbers alone."""
    group = dict(groups[prefix])
    # A controller's reference is in a group of its own.
    for other in groups.values():
        if "q_c" in other and "q_c" not in group and set(other["q_c"]) >= set(group["q"]):
            group["q_c"] = other["q_c"]
    names = list(group["q"])
    numbers = _numbers(names)
    if numbers is not None:
        names = [name for _, name in sorted(zip(numbers, names, strict=True))]
    for quantity, columns in group.items():
        by_name = columns if set(columns) >= set(names) else _by_number(columns, names)
        if by_name is None:
            continue
        found.update({f"{quantity}_{j + 1}": by_name[name] for j, name in enumerate(names)})
    return () if numbers is not None else tuple(names)


def _by_number(columns: Mapping[str, Source], names: Sequence[str]) -> dict[str, Source] | None:
    """Columns by the positions' joint names, where both have only numbers: ``tau_J_0`` beside ``q_0``."""
    numbers = _numbers(list(columns))
    if numbers is None or _numbers(names) is None or len(columns) != len(names):
        return None
    order = [name for _, name in sorted(zip(numbers, columns, strict=True))]
    return {name: columns[other] for name, other in zip(names, order, strict=True)}


def _numbers(names: Sequence[str]) -> list[int] | None:
    """The joints' numbers where names are one text and numbers that count from 0 or 1; else None."""
    found = [re.fullmatch(r"(\D*)(\d+)(\D*)", name) for name in names]
    matches = [match for match in found if match is not None]
    if len(matches) < len(names) or len({(match[1], match[3]) for match in matches}) != 1:
        return None
    numbers = [int(match[2]) for match in matches]
    return numbers if sorted(numbers) in (list(range(len(names))), list(range(1, len(names) + 1))) else None


def _listed(value: Any, path: Path, key: str) -> list[Any]:
    if not isinstance(value, list) or not value:
        raise InputError("expected a list", file=path, field=key)
    return value


def _titles(value: Any, known: set[str], path: Path, key: str) -> list[str]:
    """Titles that an entry of the map names, each in the table."""
    if isinstance(value, str) and (match := re.search(r"\{([01])\}", value)):
        start = int(match[1])
        titles: list[str] = []
        while (title := value.replace(match[0], str(start + len(titles)))) in known:
            titles.append(title)
        if not titles:
            raise InputError(f"no column {value.replace(match[0], match[1])!r}; columns are "
                             f"{listed_titles(sorted(known))}", file=path, field=key)
        return titles
    titles = [value] if isinstance(value, str) else [str(title) for title in _listed(value, path, key)]
    for title in titles:
        if title not in known:
            raise InputError(f"no column {title!r}; {did_you_mean(title, known)}columns are "
                             f"{listed_titles(sorted(known))}", file=path, field=key)
    return titles


def _factors(table: Mapping[str, Any], count: int, path: Path, key: str) -> list[float]:
    """Factor of each of an entry's columns: its own times that of its unit."""
    value, unit = table.get("factor", 1.0), str(table.get("unit", "")).lower()
    if unit and unit not in _FACTORS:
        raise InputError(f"expected one of {', '.join(_FACTORS)}; else give a factor", file=path, field=f"{key}.unit",
                         value=unit)
    values = value if isinstance(value, list) else [value] * count
    if len(values) != count or any(isinstance(one, bool) or not isinstance(one, (int, float)) or one == 0
                                   for one in values):
        raise InputError(f"expected a number other than 0, or {count} of them", file=path, field=f"{key}.factor")
    return [float(one) * _FACTORS.get(unit, 1.0) for one in values]
