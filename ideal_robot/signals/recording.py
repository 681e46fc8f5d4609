"""A recording of an arm: named columns over time, and their origin (file format in docs/files.md)."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError, did_you_mean, found_in
from ideal_robot.results import Figure, Summarised, over_time, plain
from ideal_robot.row_log import in_file, let_go
from ideal_robot.signals.bag import SUFFIXES, read_bag
from ideal_robot.signals.column_map import OF_JOINTS, given_map, listed_titles, recognised, with_reading
from ideal_robot.signals.table_file import read_table
from ideal_robot.whole_file import inert, whole_file

if TYPE_CHECKING:
    import pandas as pd

POSE, WRENCH = ("x", "y", "z", "qx", "qy", "qz", "qw"), ("fx", "fy", "fz", "mx", "my", "mz")
"""Columns of the measured TCP and of the wrench."""
_OF_THE_ARM = frozenset(("t", *POSE, *WRENCH, "cam_t"))
_OF_THE_LINE = ("line_x", "line_y", "line_z")
WRITTEN = (".parquet", ".csv")
"""Endings of files that recordings are written to."""
WRITTEN_ROWS = 65536
"""Rows that are written at a time."""


@dataclass(frozen=True, repr=False)
class Recording(Summarised):
    """Columns of equal length over time; joints are counted from 1 in the names.

    Attributes:
        columns: name → values ``(N,)``, copied and read-only. ``t`` [s]; ``q_c_i`` commanded, ``q_d_i`` desired,
            ``q_i`` motor angle on the joint side, ``qa_i`` arm angle [rad, or m for prismatic joints]; ``tau_i`` motor
            torque on the joint side [N m] or ``current_i`` [A]; ``x y z qx qy qz qw`` measured TCP [m];
            ``fx fy fz mx my mz`` wrench in the sensor frame [N, N m]; ``temp_i`` gear temperature [°C].
            Other columns are kept as they are; those of text are left out.
        meta: robot, cycle time, units, source and other entries of the file; ``left_out``: names of columns of text.
        source: the file it was read from, or a word for its origin.
    """

    columns: dict[str, Array]
    meta: dict[str, Any] = field(default_factory=dict)
    source: str = "memory"

    def __post_init__(self) -> None:
        if not isinstance(self.columns, dict):
            raise InputError("expected a dictionary of columns; make a recording of a DataFrame by "
                             "Recording.from_frame, of arrays by Recording.from_arrays, of a file by Recording.read",
                             file=self.source, field="columns", value=type(self.columns).__name__)
        if "t" not in self.columns:
            raise InputError("a recording needs the column t [s]; columns are "
                             + (", ".join(list(self.columns)[:12]) or "none"), file=self.source, field="t")
        columns = {name: _own(values, self.source, name) for name, values in self.columns.items()}
        length = len(columns["t"])
        for name, values in columns.items():
            if len(values) != length:
                raise InputError(f"column has {len(values)} values, t has {length}; all must be equally long",
                                 file=self.source, field=name)
        object.__setattr__(self, "columns", columns)

    @property
    def duration(self) -> float:
        """Time from the first sample to the last [s]; 0 where there is none."""
        return float(self.t[-1] - self.t[0]) if len(self.t) else 0.0

    def summary(self) -> list[tuple[str, str]]:
        """Duration, sampling and columns as rows of label and value."""
        names = ", ".join(list(self.columns)[:12]) + (", …" if len(self.columns) > 12 else "")
        return [("recording", f"{self.source!r}: {self.n} joints, {len(self.t)} samples, {self.duration:.4g} s"),
                ("columns", names)]

    def to_dict(self) -> dict[str, Any]:
        """The recording's properties as plain values, without the samples."""
        return plain({
            "source": self.source, "joints": self.n, "samples": len(self.t), "duration_s": self.duration,
            "columns": list(self.columns), "meta": self.meta, "hash": self.hash})

    def plot(self) -> Figure:
        """Motor angles and, where they were logged, torques or currents over time."""
        shown = [prefix for prefix in ("q", "tau", "current") if self.has(prefix)]
        panels = [(f"{prefix}_{i + 1}", [("recorded", self.columns[f"{prefix}_{i + 1}"])])
                  for i in range(self.n) for prefix in shown]
        if not panels:
            raise InputError("holds no joint positions q_1, q_2, … to draw", file=self.source, field="q_1")
        return over_time(self.t, panels, self.source)

    @property
    def n(self) -> int:
        """Number of joints: how many of ``q_1, q_2, …`` there are."""
        count = 0
        while f"q_{count + 1}" in self.columns:
            count += 1
        return count

    @property
    def t(self) -> Array:
        """Time ``(N,)`` [s]."""
        return self.columns["t"]

    def has(self, prefix: str) -> bool:
        """Whether all joints have a column ``prefix_i``."""
        return self.n > 0 and all(f"{prefix}_{i + 1}" in self.columns for i in range(self.n))

    def having(self, prefix: str) -> np.ndarray:
        """Which joints have a column ``prefix_i`` without gaps ``(n,)``."""
        names = [f"{prefix}_{i + 1}" for i in range(self.n)]
        return np.array([name in self.columns and bool(np.all(np.isfinite(self.columns[name]))) for name in names],
                        dtype=bool)

    def joints(self, prefix: str, rows: Any = slice(None)) -> Array:
        """Columns ``prefix_1 … prefix_n`` as ``(N, n)``, of all rows or of a NumPy index ``rows``.

        Raises InputError where one of them is missing.
        """
        for i in range(self.n):
            if f"{prefix}_{i + 1}" not in self.columns:
                raise InputError(f"column is missing; {prefix}_1 to {prefix}_{self.n} are needed", file=self.source,
                                 field=f"{prefix}_{i + 1}")
        columns = [self.columns[f"{prefix}_{i + 1}"] for i in range(self.n)]
        values = np.column_stack([column[rows] for column in columns])
        let_go(*columns)
        return values

    @property
    def hash(self) -> str:
        """SHA-256 over names and values of all columns, first 16 hex digits: equal for bit-for-bit equal recordings."""
        digest = hashlib.sha256()
        for name in sorted(self.columns):
            digest.update(name.encode())
            digest.update(np.ascontiguousarray(self.columns[name]).data)
            let_go(self.columns[name])
        return digest.hexdigest()[:16]

    @classmethod
    def from_arrays(cls, t: Array, *, meta: dict[str, Any] | None = None, source: str = "memory",
                    **columns: Array) -> Recording:
        """Builds a recording from arrays, which are copied.

        Args:
            t: times ``(N,)`` [s].
            meta: robot, cycle time, units.
            source: a word for its origin.
            columns: ``(N, n)`` ones become ``name_1 … name_n``. ``(N,)`` ones keep their name; of a quantity that
                every joint has (``q``, ``tau``, …) they are joint 1 of an arm with one joint.

        Raises:
            InputError: arrays of other shape, or of unequal length.

        >>> t = np.arange(3) * 0.004
        >>> sorted(Recording.from_arrays(t, q=np.zeros((3, 2)), tau=np.ones((3, 2))).columns)
        ['q_1', 'q_2', 't', 'tau_1', 'tau_2']
        """
        named: dict[str, Array] = {"t": np.array(t, dtype=float)}
        for name, column in columns.items():
            values = np.array(column, dtype=float)
            if values.ndim == 1:
                named[f"{name}_1" if name in OF_JOINTS else name] = values
            elif values.ndim == 2:
                named.update({f"{name}_{i + 1}": np.ascontiguousarray(values[:, i]) for i in range(values.shape[1])})
            else:
                raise InputError("expected values (N,) or (N, n)", file=source, field=name, value=values.shape)
        return cls(named, meta or {}, source)

    @classmethod
    def from_frame(cls, frame: pd.DataFrame, *, meta: dict[str, Any] | None = None, source: str = "memory"
                   ) -> Recording:
        """Builds a recording from a DataFrame, which is copied.

        Args:
            frame: columns as in the class's description, ``t`` [s] among them; others are kept.
            meta: robot, cycle time, units.
            source: a word for its origin.

        Raises:
            InputError: no DataFrame, no column ``t``, or one of the columns above that is not numeric.
        """
        import pandas as pd

        if not isinstance(frame, pd.DataFrame):
            raise InputError("expected a pandas DataFrame", field="frame", value=type(frame).__name__)
        columns, words = {}, []
        for name in frame.columns:
            try:
                columns[str(name)] = np.array(frame[name], dtype=float)
            except (TypeError, ValueError):
                words.append(str(name))
        return cls(columns, _without_words(meta or {}, words, source), source)

    def write(self, path: str | Path) -> Path:
        """Writes Parquet (with the metadata) or CSV, by the ending, whole or not at all; InputError for another one."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        path = Path(path)
        if path.suffix not in WRITTEN:
            raise InputError(f"recordings are written as {' or '.join(WRITTEN)}; give the file one of these endings",
                             file=path, field="path", value=path.suffix)
        names, meta = list(self.columns), {"ideal_robot": json.dumps(self.meta, default=str)}
        parts = [slice(first, first + WRITTEN_ROWS) for first in range(0, max(len(self.t), 1), WRITTEN_ROWS)]
        with whole_file(path) as partial:
            if path.suffix == ".csv":
                import pandas as pd

                titles = [inert(name) for name in names]
                for part in parts:
                    pd.DataFrame({name: self.columns[name][part] for name in names}).to_csv(
                        partial, index=False, header=titles if part.start == 0 else False, mode="a")
                    let_go(*self.columns.values())
            else:
                schema = pa.schema([(name, pa.from_numpy_dtype(self.columns[name].dtype)) for name in names],
                                   metadata=meta)
                with pq.ParquetWriter(partial, schema) as file:
                    for part in parts:
                        file.write_table(pa.table([_column(self.columns[name][part]) for name in names],
                                                  schema=schema), WRITTEN_ROWS)
                        let_go(*self.columns.values())
        return path

    @classmethod
    def read(cls, path: str | Path, *, columns: str | Path | None = None, topic: str | None = None,
             joints: Sequence[str] | None = None) -> Recording:
        """Reads a table (Parquet, CSV of any separator) or a bag (ROS 1, ROS 2, MCAP).

        Columns that other programs write are recognised by their titles; the mapping and omissions are in the metadata
        under ``reading``.

        Args:
            path: of the file, or of the folder of a ROS 2 bag.
            columns: a map of the table's columns (TOML, docs/files.md); by their titles if None.
            topic: of the joint states in a bag, or a part of the titles' path in a table.
            joints: names of the joints that are read, in their order; all if None.

        Raises:
            InputError: no such file, one that is not readable, a column of docs/files.md that is not numeric, or no
                such topic or joints.
        """
        path = Path(path)
        try:
            exists = path.is_file() or path.is_dir()
        except OSError:  # for instance a name that is too long
            exists = False
        if not exists:
            raise InputError("no such recording", file=path)
        if path.is_dir() or path.suffix.lower() in SUFFIXES:
            if columns is not None:
                raise InputError("maps the columns of a table, and this is a bag; choose with --topic and --joints",
                                 file=path, field="--columns")
            values, meta = read_bag(path, topic, joints)
        else:
            values, meta, words = read_table(path)
            titles = [*values, *words]
            meta = _without_words(meta, words, str(path))
            with found_in(path):
                mapped = given_map(Path(columns), list(values)) if columns is not None else recognised(
                    list(values), topic)
                values, meta = mapped.applied(values, meta)
            if "t" not in values or not any(name.startswith("q_") for name in values):
                missing = "t [s]" if "t" not in values else "q_1 [rad]"
                if "t" not in values or meta.get("reading"):
                    clock = ", and of a table without a clock its rate, t = {rate = 100}" * ("t" not in values)
                    raise InputError(f"a recording needs the column {missing}; columns are "
                                     f"{listed_titles(titles)}; map them with --columns map.toml"
                                     f"{clock} (docs/files.md)", file=path, field=missing.split()[0])
        if joints is not None:
            values, meta = of_joints(values, meta, joints, str(path))
        return cls(values, meta, str(path))


def of_joints(columns: dict[str, Array], meta: dict[str, Any], wanted: Sequence[str], source: str
              ) -> tuple[dict[str, Array], dict[str, Any]]:
    """The columns of some joints, renumbered in the order given; raises InputError for unknown joints.

    Args:
        columns, meta, source: of a recording, and where it comes from.
        wanted: names of joints, or their numbers in the file where it names none.
    """
    count = sum(1 for name in columns if re.fullmatch(r"q_\d+", name))
    names = [str(name) for name in meta.get("joints", ())] or [str(j + 1) for j in range(count)]
    for name in wanted:
        if name not in names:
            raise InputError(f"{did_you_mean(name, names)}joints of the file are {', '.join(names)}", file=source,
                             field="--joints", value=name)
    if len(set(wanted)) < len(wanted):
        raise InputError("names a joint twice", file=source, field="--joints", value=",".join(wanted))
    order = [names.index(name) + 1 for name in wanted]
    kept = {name: values for name, values in columns.items() if _number_of(name) is None}
    for name, values in columns.items():
        number = _number_of(name)
        if number in order:
            kept[f"{name.rpartition('_')[0]}_{order.index(number) + 1}"] = values
    others = [name for name in names if name not in wanted]
    said = [f"left-out: joints {', '.join(others)}"] * bool(others)
    # The order in which the user names the joints is used, whatever the URDF's names.
    return kept, with_reading({key: value for key, value in meta.items() if key != "joints"}, said)


def _number_of(name: str) -> int | None:
    """The joint's number in a column's name, counted from 1; None of a column that is of no joint."""
    kind, _, tail = name.rpartition("_")
    return int(tail) if tail.isdigit() and kind in (*OF_JOINTS, "qd", "qdd") else None


def is_known_column(name: str) -> bool:
    """Whether a column is known: listed in docs/files.md, or the derivative of one."""
    kind, _, tail = name.rpartition("_")
    return name in _OF_THE_ARM or (tail.isdigit() and kind in (*OF_JOINTS, "qd", "qdd", *_OF_THE_LINE))


def _without_words(meta: dict[str, Any], words: Sequence[str], source: str) -> dict[str, Any]:
    """Metadata that name the columns of text, which no recording holds; InputError where one should hold numbers."""
    for name in filter(is_known_column, words):
        raise InputError("column is not numeric" + ("; seconds are expected" if name == "t" else ""), file=source,
                         field=name)
    bare = {key: value for key, value in meta.items() if key != "left_out"}
    return {**bare, "left_out": list(words)} if words else bare


def _column(values: Array) -> Any:
    """An Arrow array of values ``(N,)``; what is not a number is none in the file, as data frames have it.

    Of buffers: Arrow's own conversion imports pandas, which takes as long as writing.
    """
    import pyarrow as pa

    if values.dtype.kind == "b":
        return pa.array(values)
    present = ~np.isnan(values)
    gaps = None if present.all() else pa.py_buffer(np.packbits(present, bitorder="little"))
    return pa.Array.from_buffers(pa.from_numpy_dtype(values.dtype), len(values),
                                 [gaps, pa.py_buffer(np.ascontiguousarray(values))])


def _own(values: Any, source: str, name: str) -> Array:
    """A read-only array of its own, so that neither the caller's can change it nor it the caller's."""
    if isinstance(values, np.ndarray) and not values.flags.writeable and values.ndim == 1 and (
            values.base is None or in_file(values)):
        return values
    array = np.array(values)
    if array.dtype.kind == "b" and (name == "t" or name.rpartition("_")[0] in OF_JOINTS):
        raise InputError("column holds true and false, expected numbers", file=source, field=name)
    if array.dtype.kind not in "fiub":
        try:
            array = array.astype(float)
        except (TypeError, ValueError) as error:
            raise InputError("column is not numeric", file=source, field=name) from error
    if array.ndim != 1:
        raise InputError("expected values (N,); one column a joint, or Recording.from_arrays for values (N, n)",
                         file=source, field=name, value=array.shape)
    array.setflags(write=False)
    return array


def recordings_of(given: Recording | Sequence[Recording], field: str) -> tuple[Recording, ...]:
    """One recording or several, as a tuple; raises InputError, with ``field``, for anything else."""
    if isinstance(given, Recording):
        return (given,)
    if not isinstance(given, (list, tuple)):
        raise InputError("expected a recording or a list of them; make one of a DataFrame by Recording.from_frame, "
                         "of arrays by Recording.from_arrays, of a file by Recording.read", field=field,
                         value=type(given).__name__)
    for i, entry in enumerate(given):
        expect(entry, Recording, f"{field}[{i}]", "make one by Recording.from_frame, from_arrays or read")
    return tuple(given)


def short_names(sources: Sequence[str]) -> list[str]:
    """Short distinct names of files: with their folders where two have the same name.

    Args:
        sources: files that recordings come from, see ``Recording.source``.
    """
    parts = [Path(source).parts or (source,) for source in sources]
    depths = [1] * len(parts)
    for i, own in enumerate(parts):
        while depths[i] < len(own) and any(other != own and other[-depths[i]:] == own[-depths[i]:] for other in parts):
            depths[i] += 1
    return ["/".join(own[-depth:]) for own, depth in zip(parts, depths, strict=True)]


def expect(given: Any, kind: type, field: str, remedy: str) -> None:
    """Raises InputError for an argument of another type.

    Args:
        given, kind: the argument, and the expected type.
        field, remedy: the argument's name, and the remedy.
    """
    if not isinstance(given, kind):
        article = "an" if kind.__name__[0] in "AEIOU" else "a"
        raise InputError(f"expected {article} {kind.__name__}; {remedy}", field=field, value=type(given).__name__)
