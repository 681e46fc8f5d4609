"""Tables on disk, Parquet and CSV, read within bounds: what a file claims to hold is checked before it is unpacked."""

from __future__ import annotations

import csv
import json
import warnings
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.row_log import ColumnStore

if TYPE_CHECKING:
    import pandas as pd

MAX_VALUES = 400_000_000
"""Most numbers in a table (3.2 GB): four hours of 50 columns at 500 Hz."""
AT_ONCE = 20_000_000
"""Values of a table that is read at once into memory; of a larger one ..."""
PIECE = 65_536
"""... so many rows at a time."""
MAX_COLUMNS = 5_000
"""Most columns."""
MAX_METADATA = 20_000_000
"""Longest metadata [bytes]."""


def read_table(path: Path) -> tuple[dict[str, Array], dict[str, Any]]:
    """Columns ``(N,)`` by name, and the metadata, of a Parquet file, or of a CSV file by its ending.

    Of large tables the columns lie in a file without a name, read-only, and are filled piece by piece.

    Args:
        path: of a plain file.

    Raises:
        InputError: not readable, larger than the bounds, a column twice or not of numbers, metadata that is no table.
    """
    try:
        return _csv(path) if path.suffix == ".csv" else _parquet(path)
    except InputError:
        raise
    except Exception as error:  # pandas and Arrow raise many kinds for a damaged file
        shown = " ".join(str(error).split())[:300]
        raise InputError(f"not a readable recording ({type(error).__name__}: {shown}); expected Parquet, CSV, a ROS 2 "
                         "bag or MCAP", file=path) from error


def _parquet(path: Path) -> tuple[dict[str, Array], dict[str, Any]]:
    import pyarrow as pa
    import pyarrow.parquet as pq

    with pq.ParquetFile(path) as file:
        schema = file.schema_arrow
        rows = file.metadata.num_rows
        _check_size(rows, schema.names, path)
        for field in schema:
            if pa.types.is_nested(field.type):
                raise InputError("column is not numeric", file=path, field=_shown(field.name))
        raw = (schema.metadata or {}).get(b"ideal_robot")
        if rows * len(schema.names) <= AT_ONCE:
            columns = _whole(file.read().to_pandas(), path)
        else:
            columns = _filled((batch.to_pandas() for batch in file.iter_batches(PIECE)), rows, path)
    return columns, {} if raw is None else _metadata(raw, path)


def _csv(path: Path) -> tuple[dict[str, Array], dict[str, Any]]:
    import pandas as pd

    with path.open(encoding="utf-8-sig", newline="") as text:
        names = next(csv.reader([text.readline(10_000_000)]), [])
    _check_size(path.stat().st_size // max(2 * len(names), 1), names, path)
    with warnings.catch_warnings():
        # Rows of more values than there are names, which pandas would cut.
        warnings.simplefilter("error", pd.errors.ParserWarning)
        # No value takes less than two bytes.
        if path.stat().st_size <= 2 * AT_ONCE:
            return _whole(pd.read_csv(path, index_col=False, low_memory=False), path), {}
        with pd.read_csv(path, index_col=False, low_memory=False, chunksize=PIECE) as pieces:
            return _filled(pieces, _lines(path), path), {}


def _whole(frame: pd.DataFrame, path: Path) -> dict[str, Array]:
    return {str(name): _numbers(frame, name, path) for name in frame.columns}


def _filled(frames: Iterable[pd.DataFrame], most: int, path: Path) -> dict[str, Array]:
    """Columns of tables one below the other, of ``most`` rows together at most."""
    store: ColumnStore | None = None
    count = 0
    for frame in frames:
        store = store or ColumnStore([str(name) for name in frame.columns], most)
        for name in frame.columns:
            store.fill(str(name), count, _numbers(frame, name, path))
        count += len(frame)
        store.release()
    return {} if store is None else {name: values[:count] for name, values in store.finished().items()}


def _numbers(frame: pd.DataFrame, name: Any, path: Path) -> Array:
    if frame[name].dtype.kind not in "fiubO":
        raise InputError("column is not numeric", file=path, field=_shown(name))
    try:
        return np.array(frame[name], dtype=float)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError("column is not numeric", file=path, field=_shown(name)) from error


def _lines(path: Path) -> int:
    """Lines of a text file, the last one included."""
    with path.open("rb") as file:
        return 1 + sum(block.count(b"\n") + block.count(b"\r") for block in iter(lambda: file.read(1 << 20), b""))


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


# Joint states out of ROS 2 bags and MCAP files, through ``rosbags``; no ROS needed.

SUFFIXES = (".mcap", ".db3", ".bag")
_TYPE = "sensor_msgs/msg/JointState"


def read_joint_states(path: Path) -> tuple[dict[str, Array], dict[str, Any]]:
    """Columns ``t``, ``q_i`` and, where given, ``qd_i`` and ``tau_i`` (effort) of the ``JointState`` messages in a bag.

    Time is that of the messages' headers, of the log where these are empty, and starts at zero. Joints are numbered in
    the order of the first message; their names stand in the metadata under ``joints``. The topic is ``/joint_states``,
    or the only one of its type.

    Args:
        path: folder of a ROS 2 bag, or a single ``.mcap``, ``.db3`` or ROS 1 ``.bag`` file.

    Raises:
        InputError: not a bag, no joint states in it, or messages that name other joints.
    """
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.LATEST)) as reader:
            connections = [c for c in reader.connections if c.msgtype == _TYPE]
            topics = sorted({c.topic for c in connections})
            if not topics:
                found = ", ".join(sorted({c.msgtype for c in reader.connections})) or "nothing"
                raise InputError(f"no {_TYPE} messages; the bag holds {found}", file=path)
            topic = "/joint_states" if "/joint_states" in topics else topics[0]
            if len(topics) > 1 and topic != "/joint_states":
                raise InputError(f"several topics of joint states ({', '.join(topics)}) and none is /joint_states",
                                 file=path)
            messages = [(stamp, reader.deserialize(raw, connection.msgtype))
                        for connection, stamp, raw in reader.messages([c for c in connections if c.topic == topic])]
    except InputError:
        raise
    except Exception as error:  # a damaged bag can fail anywhere in the reader
        raise InputError(f"not a readable bag ({error})", file=path) from error
    return _columns(messages, path, topic)


def _columns(messages: list[tuple[int, Any]], path: Path, topic: str) -> tuple[dict[str, Array], dict[str, Any]]:
    if not messages:
        raise InputError(f"no messages on {topic}; record them while the arm moves", file=path)
    names = list(messages[0][1].name)
    if len(set(names)) < len(names):
        raise InputError(f"joints of the same name ({', '.join(names)})", file=path, field="name")
    order = {name: i for i, name in enumerate(names)}
    stamps = np.array([m.header.stamp.sec * 1_000_000_000 + m.header.stamp.nanosec for _, m in messages])
    if not np.any(stamps):
        stamps = np.array([stamp for stamp, _ in messages])
    columns: dict[str, Array] = {"t": (stamps - stamps[0]) * 1e-9}
    for key, attribute in (("q", "position"), ("qd", "velocity"), ("tau", "effort")):
        if len(getattr(messages[0][1], attribute)) != len(names):
            continue
        values = np.full((len(messages), len(names)), np.nan)
        for k, (_, message) in enumerate(messages):
            given = getattr(message, attribute)
            if len(given) != len(names) or set(message.name) != set(names):
                raise InputError(f"message {k + 1} on {topic} names other joints than the first "
                                 f"({', '.join(message.name)})", file=path, field=attribute)
            values[k, [order[name] for name in message.name]] = given
        columns.update({f"{key}_{i + 1}": np.ascontiguousarray(values[:, i]) for i in range(len(names))})
    return columns, {"joints": names, "topic": topic, "stamp_0": int(stamps[0])}
