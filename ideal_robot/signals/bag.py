"""Joint states out of ROS 2 bags and MCAP files, through ``rosbags``; no ROS needed.

``rosbags`` unpacks what a bag claims to hold as a whole; how much that is, is counted before, piece by piece.
"""

from __future__ import annotations

import sqlite3
import struct
from array import array
from bz2 import BZ2Decompressor
from collections.abc import Iterable, Iterator
from contextlib import closing
from itertools import chain
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import IO, Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.bounded_values import (
    BAG_MESSAGE,
    BAG_UNFOLDING,
    BAG_WORDS,
    TABLE_COLUMNS,
    TABLE_VALUES,
    check_unfolding,
)
from ideal_robot.errors import InputError

SUFFIXES = (".mcap", ".db3", ".bag")
_TYPE = "sensor_msgs/msg/JointState"
_WORDS = "metadata.yaml"
_PIECE = 1 << 20  # bytes that are read and unfolded at a time
_MCAP = b"\x89MCAP0\r\n"
_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _CHUNK_INDEX = 3, 4, 5, 6, 8  # op codes of MCAP's specification
_IN_CHUNK = {_SCHEMA: 14, _CHANNEL: 16, _MESSAGE: 22}
"""Records that a chunk may hold, and their least lengths [bytes]."""


def read_joint_states(path: Path) -> tuple[dict[str, Array], dict[str, Any]]:
    """Columns ``t``, ``q_i`` and, where given, ``qd_i`` and ``tau_i`` (effort) of the ``JointState`` messages in a bag.

    It is the folder of a ROS 2 bag, or a single ``.mcap``, ``.db3`` or ROS 1 ``.bag`` file. Time is that of the
    messages' headers, of the log where these are empty, and starts at zero. Joints are numbered in the order of the
    first message; their names stand in the metadata under ``joints``. The topic is ``/joint_states``, or the only one
    of its type.

    Raises InputError for no bag, one that unfolds to far more than its size, no joint states in it, or messages that
    name other joints.
    """
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    try:
        if path.is_dir() and (path / _WORDS).is_file():
            BAG_WORDS.check((path / _WORDS).stat().st_size, path / _WORDS)
        for file in [entry for entry in path.iterdir() if entry.is_file()] if path.is_dir() else [path]:
            _check_unfolding(file)
        with AnyReader([path], default_typestore=get_typestore(Stores.LATEST)) as reader:
            connections = [c for c in reader.connections if c.msgtype == _TYPE]
            topics = sorted({c.topic for c in connections})
            if not topics:
                types = ", ".join(sorted({c.msgtype for c in reader.connections})) or "nothing"
                raise InputError(f"no {_TYPE} messages; the bag holds {types}", file=path)
            topic = "/joint_states" if "/joint_states" in topics else topics[0]
            if len(topics) > 1 and topic != "/joint_states":
                raise InputError(f"several topics of joint states ({', '.join(topics)}) and none is /joint_states",
                                 file=path)

            def messages() -> Iterator[tuple[int, Any]]:
                for connection, stamp, raw in reader.messages([c for c in connections if c.topic == topic]):
                    BAG_MESSAGE.check(len(raw), path)
                    yield stamp, reader.deserialize(raw, connection.msgtype)

            return _columns(messages(), path, topic)
    except InputError:
        raise
    except Exception as error:  # a damaged bag can fail anywhere in the reader
        raise InputError(f"not a readable bag ({error})", file=path) from error


def _columns(messages: Iterator[tuple[int, Any]], path: Path, topic: str) -> tuple[dict[str, Array], dict[str, Any]]:
    begun = next(messages, None)
    if begun is None:
        raise InputError(f"no messages on {topic}; record them while the arm moves", file=path)
    first = begun[1]
    names = list(first.name)
    if not names or len(set(names)) < len(names):
        raise InputError(f"no joints, or joints of the same name ({', '.join(names)[:200]})", file=path, field="name")
    TABLE_COLUMNS.check(1 + 3 * len(names), path)
    keys = [(key, attribute) for key, attribute in (("q", "position"), ("qd", "velocity"), ("tau", "effort"))
            if len(getattr(first, attribute)) == len(names)]
    order = {name: i for i, name in enumerate(names)}
    logged, headed, values = array("q"), array("q"), [array("d") for _ in keys]
    for stamp, message in chain([begun], messages):
        logged.append(stamp)
        headed.append(message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec)
        TABLE_VALUES.check(len(logged) * (1 + len(keys) * len(names)), path, "cut it into pieces")
        for (_, attribute), column in zip(keys, values, strict=True):
            numbers = getattr(message, attribute)
            if len(numbers) != len(names) or set(message.name) != set(names):
                raise InputError(f"message {len(logged)} on {topic} names other joints than the first "
                                 f"({', '.join(message.name)[:200]})", file=path, field=attribute)
            row = dict(zip((order[name] for name in message.name), numbers, strict=True))
            column.extend(row[i] for i in range(len(names)))
    stamps = np.array(headed if any(headed) else logged)
    columns: dict[str, Array] = {"t": (stamps - stamps[0]) * 1e-9}
    for (key, _), column in zip(keys, values, strict=True):
        table = np.frombuffer(column).reshape(-1, len(names))
        columns.update({f"{key}_{i + 1}": np.array(table[:, i]) for i in range(len(names))})
    return columns, {"joints": names, "topic": topic, "stamp_0": int(stamps[0])}


# How much a bag unpacks to, without unpacking it. Readers go by indices: these have to agree with what is there.

def _check_unfolding(file: Path, folded: int = 0) -> None:
    """Refuses a file that unfolds to far more than its size, or to records that cannot be; one of no bag passes.

    What it is is told by its first bytes, not by its name. The size that counts is ``folded`` [bytes], its own if 0. A
    damaged one raises ValueError, struct.error, EOFError …
    """
    with file.open("rb") as stream:
        begin = stream.read(16)
    size, total = folded or file.stat().st_size, 0
    for magic, counted in _COUNTED.items():
        if begin.startswith(magic):
            for unpacked in counted(file):
                total += unpacked
                check_unfolding(BAG_UNFOLDING, total, size, file)


def _in_mcap(file: Path) -> Iterator[int]:
    """Bytes of each piece that chunks unpack to; their index has to name each once, as it is."""
    chunks: dict[int, tuple[str, int]] = {}
    with file.open("rb") as stream:
        stream.seek(-37, 2)
        summary, = struct.unpack_from("<Q", stream.read(), 9)
        stream.seek(len(_MCAP))
        while len(head := stream.read(9)) == 9:
            kind, length = struct.unpack("<BQ", head)
            begin = stream.tell()
            summary = 0 if begin - 9 == summary else summary
            if kind in (_SCHEMA, _CHANNEL):
                BAG_MESSAGE.check(length, file)
            elif kind == _CHUNK:
                stream.seek(28, 1)
                compression, records = _word(stream), struct.unpack("<Q", stream.read(8))[0]
                chunks[begin - 9] = compression, records
                yield from _in_records(_unpacked(_read(stream, records), compression))
            elif kind == _CHUNK_INDEX:
                start = struct.unpack_from("<Q", stream.read(32), 16)[0]
                stream.seek(struct.unpack("<I", stream.read(4))[0] + 8, 1)
                if chunks.pop(start, None) != (_word(stream), struct.unpack("<Q", stream.read(8))[0]):
                    raise ValueError("its index names a chunk that is not there, or one twice")
            stream.seek(begin + length)
    if summary:
        raise ValueError("its summary begins within a record")


def _in_records(pieces: Iterable[bytes]) -> Iterator[int]:
    """Bytes of each piece of a chunk, whose records are looked at."""
    waiting, skipped = b"", 0
    for piece in pieces:
        yield len(piece)
        waiting += piece
        offset = skipped
        while offset + 9 <= len(waiting):
            kind, length = struct.unpack_from("<BQ", waiting, offset)
            if length < _IN_CHUNK.get(kind, 1 << 64):
                raise ValueError(f"a record of kind {kind} and {length} bytes in a chunk")
            offset += 9 + length
        skipped = max(offset - len(waiting), 0)
        waiting = waiting[offset:]


def _in_bag(file: Path) -> Iterator[int]:
    """Bytes of each piece that is unpacked of the chunks of a ROS 1 bag."""
    with file.open("rb") as stream:
        stream.readline(64)
        while len(word := stream.read(4)) == 4:
            length, = struct.unpack("<I", word)
            if length > _PIECE:
                raise ValueError(f"a record's header of {length} bytes")
            head = stream.read(length)
            length, = struct.unpack("<I", stream.read(4))
            begin = stream.tell()
            if b"op=\x05" in head:
                kinds = [kind for kind in ("bz2", "lz4") if b"compression=" + kind.encode() in head]
                yield from map(len, _unpacked(_read(stream, length), "".join(kinds)))
            stream.seek(begin + length)


def _in_db3(file: Path) -> Iterator[int]:
    """Bytes of the messages of an SQLite bag; a view or a computed column could tell any number."""
    with closing(sqlite3.connect(f"{file.resolve().as_uri()}?mode=ro", uri=True)) as base:
        names = ("topics", "messages", "message_definitions", "schema", "metadata")
        tables = base.execute("SELECT name, type, sql FROM sqlite_master WHERE lower(name) IN (?, ?, ?, ?, ?)", names)
        for name, kind, sql in tables.fetchall():
            columns = base.execute(f"PRAGMA table_xinfo({name})").fetchall()
            if kind != "table" or not sql.upper().startswith("CREATE TABLE") or any(column[6] for column in columns):
                raise ValueError(f"{name} is computed, not stored")
        packed = "CASE WHEN substr(data, 1, 4) = x'28b52ffd' THEN data END"
        for length, message in base.execute(f"SELECT length(data), {packed} FROM messages"):
            yield int(length or 0)
            if message is not None:
                yield from map(len, _unpacked(iter([message]), "zstd"))


def _in_zstd(file: Path) -> Iterator[int]:
    """Bytes of each piece that a packed file of a bag unpacks to, and of what that unpacks to."""
    with file.open("rb") as stream, NamedTemporaryFile(suffix=file.stem) as whole:
        for piece in _unpacked(_read(stream, file.stat().st_size), "zstd"):
            yield len(piece)
            whole.write(piece)
        whole.flush()
        _check_unfolding(Path(whole.name), file.stat().st_size)


_COUNTED = {_MCAP: _in_mcap, b"#ROSBAG": _in_bag, b"SQLite format 3": _in_db3, b"\x28\xb5\x2f\xfd": _in_zstd}
"""How each kind is counted, by its first bytes."""


def _word(stream: IO[bytes]) -> str:
    return stream.read(min(struct.unpack("<I", stream.read(4))[0], _PIECE)).decode()


def _read(stream: IO[bytes], length: int) -> Iterator[bytes]:
    while length > 0 and (piece := stream.read(min(length, _PIECE))):
        length -= len(piece)
        yield piece


def _unpacked(packed: Iterator[bytes], compression: str) -> Iterator[bytes]:
    """What pieces unpack to, in pieces of a megabyte at most."""
    if not compression:
        yield from packed
        return
    unpacker: Any = None
    for piece in packed:
        while piece or (unpacker is not None and not unpacker.needs_input and not unpacker.eof):
            unpacker = _unpacker(compression) if unpacker is None or unpacker.eof else unpacker
            yield unpacker.decompress(piece, max_length=_PIECE)
            piece = (unpacker.unused_data or b"") if unpacker.eof else b""


def _unpacker(compression: str) -> Any:
    if compression == "bz2":
        return BZ2Decompressor()
    if compression == "lz4":
        from lz4.frame import LZ4FrameDecompressor

        return LZ4FrameDecompressor()
    if compression == "zstd":
        from rosbags.rosbag2.storage_mcap import zstd

        return zstd.ZstdDecompressor()
    raise ValueError(f"unknown compression {compression[:20]!a}")
