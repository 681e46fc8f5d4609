"""A recording of an arm: named columns over time, and where they came from (design of the file in docs/files.md)."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.signals.ros_bag import SUFFIXES, read_joint_states
from ideal_robot.whole_file import whole_file


@dataclass(frozen=True)
class Recording:
    """Columns of equal length over time; joints are counted from 1 in the names.

    Attributes:
        columns: name → values ``(N,)``, read-only. ``t`` [s]; ``q_c_i`` commanded, ``q_d_i`` desired, ``q_i`` motor
            angle on the joint side, ``qa_i`` arm angle [rad, or m for prismatic joints]; ``tau_i`` motor torque on
            the joint side [N m] or ``current_i`` [A]; ``x y z qx qy qz qw`` measured TCP [m];
            ``fx fy fz mx my mz`` wrench in the sensor frame [N, N m]; ``temp_i`` gear temperature [°C].
            Other columns are kept as they are.
        meta: robot, cycle time, units, source and what else the file carried.
        source: the file it was read from, or a word for where it was made.
    """

    columns: dict[str, Array]
    meta: dict[str, Any] = field(default_factory=dict)
    source: str = "memory"

    def __post_init__(self) -> None:
        if "t" not in self.columns:
            raise InputError("a recording needs the column t [s]", file=self.source, field="t")
        length = len(self.columns["t"])
        for name, values in self.columns.items():
            if len(values) != length:
                raise InputError(f"column has {len(values)} values, t has {length}", file=self.source, field=name)
            values.setflags(write=False)

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

    def joints(self, prefix: str) -> Array:
        """Columns ``prefix_1 … prefix_n`` side by side, shape ``(N, n)``.

        Raises:
            InputError: one of them is missing.
        """
        for i in range(self.n):
            if f"{prefix}_{i + 1}" not in self.columns:
                raise InputError(f"column is missing; {prefix}_1 to {prefix}_{self.n} are needed", file=self.source,
                                 field=f"{prefix}_{i + 1}")
        return np.column_stack([self.columns[f"{prefix}_{i + 1}"] for i in range(self.n)])

    @property
    def hash(self) -> str:
        """SHA-256 over names and values of all columns, first 16 hex digits: equal for bit-for-bit equal recordings."""
        digest = hashlib.sha256()
        for name in sorted(self.columns):
            digest.update(name.encode())
            digest.update(np.ascontiguousarray(self.columns[name]).tobytes())
        return digest.hexdigest()[:16]

    @classmethod
    def from_arrays(cls, t: Array, *, meta: dict[str, Any] | None = None, source: str = "memory",
                    **columns: Array) -> Recording:
        """Builds a recording from arrays: ``(N, n)`` ones become ``name_1 … name_n``, ``(N,)`` ones keep their name."""
        named: dict[str, Array] = {"t": np.array(t, dtype=float)}
        for name, values in columns.items():
            values = np.array(values, dtype=float)
            if values.ndim == 1:
                named[name] = values
            else:
                named.update({f"{name}_{i + 1}": np.ascontiguousarray(values[:, i]) for i in range(values.shape[1])})
        return cls(named, meta or {}, source)

    def write(self, path: str | Path) -> Path:
        """Writes Parquet (with the metadata) or, for the ending ``.csv``, CSV. Nothing is left half-written."""
        path = Path(path)
        frame = pd.DataFrame(self.columns)
        with whole_file(path) as partial:
            if path.suffix == ".csv":
                frame.to_csv(partial, index=False)
            else:
                table = pa.Table.from_pandas(frame, preserve_index=False)
                table = table.replace_schema_metadata({"ideal_robot": json.dumps(self.meta, default=str)})
                pq.write_table(table, partial)
        return path

    @classmethod
    def read(cls, path: str | Path) -> Recording:
        """Reads Parquet, CSV, or joint states from a ROS 2 bag or MCAP file.

        Raises:
            InputError: no such file, not readable, or a column that is not numeric.
        """
        path = Path(path)
        if not path.exists():
            raise InputError("no such recording", file=path)
        if path.is_dir() or path.suffix in SUFFIXES:
            columns, meta = read_joint_states(path)
            return cls(columns, meta, str(path))
        meta = {}
        try:
            if path.suffix == ".csv":
                frame = pd.read_csv(path)
            else:
                table = pq.read_table(path)
                raw = (table.schema.metadata or {}).get(b"ideal_robot")
                meta = json.loads(raw) if raw else {}
                frame = table.to_pandas()
        except Exception as error:
            raise InputError(f"not a readable recording ({error}); expected Parquet, CSV, a ROS 2 bag or MCAP",
                             file=path) from error
        columns = {}
        for name in frame.columns:
            try:
                columns[str(name)] = np.array(frame[name], dtype=float)
            except (TypeError, ValueError) as error:
                raise InputError("column is not numeric", file=path, field=str(name)) from error
        return cls(columns, meta, str(path))
