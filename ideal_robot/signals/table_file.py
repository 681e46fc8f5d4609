"""Tables on disk, Parquet and CSV, read within bounds: what a file claims to hold is checked before it is unpacked."""

from __future__ import annotations

import csv
import json
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError

if TYPE_CHECKING:
    import pandas as pd

MAX_VALUES = 400_000_000
"""Most numbers in a table (3.2 GB): four hours of 50 columns at 500 Hz."""
MAX_COLUMNS = 5_000
"""Most columns."""
MAX_METADATA = 20_000_000
"""Longest metadata [bytes]."""


def read_table(path: Path) -> tuple[dict[str, Array], dict[str, Any]]:
    """Columns ``(N,)`` by name, and the metadata, of a Parquet file, or of a CSV file by its ending.

    Args:
        path: of a plain file.

    Raises:
        InputError: not readable, larger than the bounds, a column twice or not of numbers, metadata that is no table.
    """
    meta: dict[str, Any] = {}
    try:
        if path.suffix == ".csv":
            frame = _csv(path)
        else:
            frame, meta = _parquet(path)
    except InputError:
        raise
    except Exception as error:  # pandas and Arrow raise many kinds for a damaged file
        shown = " ".join(str(error).split())[:300]
        raise InputError(f"not a readable recording ({type(error).__name__}: {shown}); expected Parquet, CSV, a ROS 2 "
                         "bag or MCAP", file=path) from error
    columns = {}
    for name in frame.columns:
        if frame[name].dtype.kind not in "fiubO":
            raise InputError("column is not numeric", file=path, field=_shown(name))
        try:
            columns[str(name)] = np.array(frame[name], dtype=float)
        except (TypeError, ValueError, OverflowError) as error:
            raise InputError("column is not numeric", file=path, field=_shown(name)) from error
    return columns, meta


def _parquet(path: Path) -> tuple[pd.DataFrame, dict[str, Any]]:
    import pyarrow as pa
    import pyarrow.parquet as pq

    with pq.ParquetFile(path) as file:
        schema = file.schema_arrow
        _check_size(file.metadata.num_rows, schema.names, path)
        for field in schema:
            if pa.types.is_nested(field.type):
                raise InputError("column is not numeric", file=path, field=_shown(field.name))
        raw = (schema.metadata or {}).get(b"ideal_robot")
        frame = file.read().to_pandas()
    return frame, {} if raw is None else _metadata(raw, path)


def _metadata(raw: bytes, path: Path) -> dict[str, Any]:
    try:
        if len(raw) > MAX_METADATA:
            raise ValueError("too long")
        meta = json.loads(raw)
    except (ValueError, RecursionError) as error:
        raise InputError(f"not readable ({type(error).__name__}); write the recording again", file=path,
                         field="metadata ideal_robot") from error
    if not isinstance(meta, dict):
        raise InputError("expected a table (a JSON object)", file=path, field="metadata ideal_robot",
                         value=_shown(meta))
    return meta


def _csv(path: Path) -> pd.DataFrame:
    import pandas as pd

    with path.open(encoding="utf-8-sig", newline="") as text:
        names = next(csv.reader([text.readline(10_000_000)]), [])
    _check_size(path.stat().st_size // max(2 * len(names), 1), names, path)
    with warnings.catch_warnings():
        # Rows of more values than there are names, which pandas would cut.
        warnings.simplefilter("error", pd.errors.ParserWarning)
        return pd.read_csv(path, index_col=False, low_memory=False)


def _check_size(rows: int, names: list[str], path: Path) -> None:
    if len(names) > MAX_COLUMNS:
        raise InputError(f"has {len(names)} columns; at most {MAX_COLUMNS} are read", file=path)
    if rows * max(len(names), 1) > MAX_VALUES:
        raise InputError(f"holds {rows} × {len(names)} values; at most {MAX_VALUES} are read: cut it into pieces",
                         file=path)
    twice = {name for name in names if names.count(name) > 1} if len(set(names)) < len(names) else set()
    if twice:
        raise InputError("the column stands in the file twice", file=path, field=_shown(min(twice)))


def _shown(value: object) -> str:
    text = str(value)
    return text if len(text) <= 60 else text[:57] + "…"
