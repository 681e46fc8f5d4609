"""Joint states, commands, wrenches and poses out of ROS bags and MCAP files, through ``rosbags``; no ROS needed.

``rosbags`` unpacks what a bag claims to hold as a whole; its size is therefore counted before, piece by piece. Of a
truncated file, as of a killed recorder, the complete records are read.
"""

from __future__ import annotations

import shutil
import sqlite3
import struct
from array import array
from bz2 import BZ2Decompressor
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import NamedTemporaryFile, TemporaryDirectory
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
from ideal_robot.signals.column_map import with_reading

SUFFIXES = (".mcap", ".db3", ".bag")
_STATE, _LOOP = "sensor_msgs/msg/JointState", "control_msgs/msg/JointTrajectoryControllerState"
_FORCE, _POSE = "geometry_msgs/msg/WrenchStamped", "geometry_msgs/msg/PoseStamped"
_LEADING = {"joint_commands": "q_c", "joint_desired": "q_d", "arm_states": "qa"}
"""Joint states that are not measured ones, by the last part of their topic, as ``signals/export.py`` writes them."""
_WRENCH, _TCP = ("fx", "fy", "fz", "mx", "my", "mz"), ("x", "y", "z", "qx", "qy", "qz", "qw")
_ENOUGH = 100
"""Messages without which a group of joints is no recording: identification takes no fewer."""
_LISTED = 8
"""Names that a sentence lists."""
_WORDS = "metadata.yaml"
_PIECE = 1 << 20  # bytes read and unpacked at a time
_MCAP = b"\x89MCAP0\r\n"
_SQLITE = b"SQLite format 3"
_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _CHUNK_INDEX = 3, 4, 5, 6, 8  # op codes of MCAP's specification
_IN_DATA = (*range(1, 2), *range(3, 7), 9, 12)
"""Op codes of what stands before a file's summary but indices: header, schemas, channels, messages, chunks, …"""
_IN_CHUNK = {_SCHEMA: 14, _CHANNEL: 16, _MESSAGE: 22}
"""Records that a chunk may hold, and their least lengths [bytes]."""


def read_bag(path: Path, topic: str | None = None, joints: Sequence[str] | None = None
             ) -> tuple[dict[str, Array], dict[str, Any]]:
    """Columns ``t``, ``q_i`` and, where given, ``qd_i``, ``tau_i`` (effort), ``q_c_i``, wrench and pose of a bag.

    It is the folder of a ROS 2 bag, or a single ``.mcap``, ``.db3`` or ROS 1 ``.bag`` file. Time is that of the
    messages' headers and starts at zero; a message without a stamp gets the log's time, less the usual difference.
    Joints are numbered in the order of the first message of theirs; their names stand in the metadata under ``joints``,
    omissions and their reasons under ``reading``.

    Args:
        path: the bag.
        topic: of the joint states; ``/joint_states``, or the only one of its type, if None.
        joints: names of the joints to read; by default those of the most frequent messages with the most joints.

    Raises:
        InputError: no bag, one that unfolds to far more than its size, no joint states in it, several topics of them,
            or no message that holds the joints.
    """
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    with TemporaryDirectory(prefix="ideal_robot_bag_") as folder:
        try:
            if path.is_dir() and (path / _WORDS).is_file():
                BAG_WORDS.check((path / _WORDS).stat().st_size, path / _WORDS)
            paths, said = _whole(path, Path(folder))
            for file in [entry for place in paths for entry in (place.iterdir() if place.is_dir() else [place])]:
                if file.is_file():
                    _check_unfolding(file)
            with AnyReader(paths, default_typestore=get_typestore(Stores.LATEST)) as reader:
                return _Reading(reader, path, topic, joints, said).columns()
        except InputError:
            raise
        except Exception as error:  # a damaged bag can fail anywhere in the reader
            raise InputError(f"not a readable bag ({error}); {_remedy(path)}", file=path) from error


def _remedy(path: Path) -> str:
    """What may save some of a damaged bag, by the first bytes of its files."""
    for file in sorted(path.iterdir()) if path.is_dir() else [path]:
        if file.is_file():
            with file.open("rb") as stream:
                begin = stream.read(16)
            for magic, remedy in _REMEDIES.items():
                if begin.startswith(magic):
                    return remedy.format(file=file.name)
    return "record it anew, or give the columns as a table (.csv, .parquet)"


@dataclass
class _Joints:
    """Messages of the same joints: stamps [ns] and one value a joint, NaN where a message gives none."""

    names: list[str]
    logged: array[int] = field(default_factory=lambda: array("q"))
    headed: array[int] = field(default_factory=lambda: array("q"))
    values: dict[str, array[float]] = field(default_factory=dict)

    def add(self, stamp: int, message: Any, names: Sequence[str], **values: Any) -> None:
        """Takes a message's values, in whatever order it names the joints."""
        self.logged.append(stamp)
        self.headed.append(_stamp(message))
        order = None if list(names) == self.names else [list(names).index(name) for name in self.names]
        for key, given in values.items():
            row = np.full(len(self.names), np.nan)
            if len(given) == len(self.names):
                row = np.asarray(given, dtype=float) if order is None else np.asarray(given, dtype=float)[order]
            self.values.setdefault(key, array("d")).extend(row.tolist())

    def table(self, key: str) -> Array:
        """Values ``(N, joints)``."""
        return np.frombuffer(self.values[key]).reshape(-1, len(self.names))

    def stamps(self) -> tuple[Array, int]:
        """Times of the messages ``(N,)`` [ns], and how many had no stamp of their own."""
        logged, headed = np.array(self.logged), np.array(self.headed)
        bare = headed == 0
        if bare.all():
            return logged, 0
        # The log's time is later than the header's by the transmission delay.
        late = int(np.median(logged[~bare] - headed[~bare]))
        return np.where(bare, logged - late, headed), int(bare.sum())


class _Reading:
    """What a bag's topics hold, read in one pass."""

    def __init__(self, reader: Any, path: Path, topic: str | None, joints: Sequence[str] | None, said: list[str]):
        self._reader, self._path, self._joints, self._said = reader, path, joints, said
        self._topic = self._chosen(topic)
        self._groups: dict[tuple[str, frozenset[str]], _Joints] = {}
        self._vectors: dict[str, tuple[array[int], array[int], array[float]]] = {}
        self._topics: dict[str, set[str]] = {}
        self._count = 0

    def _chosen(self, wanted: str | None) -> str:
        """The topic of the joint states."""
        kinds = {c.topic: c.msgtype for c in self._reader.connections if c.msgtype in (_STATE, _LOOP)}
        states = sorted(t for t, kind in kinds.items() if kind == _STATE and t.rpartition("/")[2] not in _LEADING)
        topics = states or sorted(kinds)
        if not topics:
            types = ", ".join(sorted({c.msgtype for c in self._reader.connections})) or "nothing"
            raise InputError(f"no {_STATE} messages; the bag holds {types}: record /joint_states", file=self._path)
        if wanted is not None:
            fitting = [t for t in sorted(kinds) if t == wanted] or [t for t in topics if wanted.strip("/") in t]
            if len(fitting) != 1:
                raise InputError(f"expected one of {', '.join(sorted(kinds))}", file=self._path, field="--topic",
                                 value=wanted)
            return fitting[0]
        if len(topics) > 1 and "/joint_states" not in topics:
            raise InputError(f"several topics of joint states ({', '.join(topics)}) and none is /joint_states; name "
                             "one with --topic", file=self._path)
        chosen = "/joint_states" if "/joint_states" in topics else topics[0]
        if others := [t for t in states if t != chosen]:
            self._said.append(f"other-topics: {_some(others)} hold joint states, too, and are left out (--topic)")
        return chosen

    def columns(self) -> tuple[dict[str, Array], dict[str, Any]]:
        """The columns and what is known of them."""
        read = [c for c in self._reader.connections if c.msgtype in (_LOOP, _FORCE, _POSE) or c.topic == self._topic
                or (c.msgtype == _STATE and c.topic.rpartition("/")[2] in _LEADING)]
        unread: dict[str, int] = {}
        for connection, stamp, raw in self._reader.messages(read):
            if connection.topic in unread:
                unread[connection.topic] += 1
                continue
            BAG_MESSAGE.check(len(raw), self._path)
            try:
                message = self._reader.deserialize(raw, connection.msgtype)
            except Exception:
                if connection.topic == self._topic:
                    raise
                # The bag does not hold the definition of this message type.
                unread[connection.topic] = 1
                continue
            self._take(connection, stamp, message)
        self._said += [f"left-out: {count} messages on {topic} cannot be read" for topic, count in unread.items()]
        return self._table()

    def _take(self, connection: Any, stamp: int, message: Any) -> None:
        topic, kind = connection.topic, connection.msgtype
        stream = {_FORCE: "wrench", _POSE: "tcp", _LOOP: "q_c"}.get(kind, _LEADING.get(topic.rpartition("/")[2]))
        if stream is not None and topic != self._topic:
            self._topics.setdefault(stream, set()).add(topic)
        if kind == _STATE:
            if topic == self._topic:
                self._add(topic, stamp, message, message.name, q=message.position, qd=message.velocity,
                          tau=message.effort)
            else:
                self._add(_LEADING[topic.rpartition("/")[2]], stamp, message, message.name, q=message.position)
        elif kind == _LOOP:
            led = getattr(message, "reference", None) or getattr(message, "desired", None)
            been = getattr(message, "feedback", None) or getattr(message, "actual", None)
            if led is not None and len(led.positions):
                self._add("q_c", stamp, message, message.joint_names, q=led.positions)
            if topic == self._topic and been is not None:
                self._add(topic, stamp, message, message.joint_names, q=been.positions, qd=been.velocities,
                          tau=getattr(been, "effort", ()))
        elif kind == _FORCE:
            force, torque = message.wrench.force, message.wrench.torque
            self._vector("wrench", stamp, message, (force.x, force.y, force.z, torque.x, torque.y, torque.z))
        else:
            at, turn = message.pose.position, message.pose.orientation
            self._vector("tcp", stamp, message, (at.x, at.y, at.z, turn.x, turn.y, turn.z, turn.w))

    def _add(self, stream: str, stamp: int, message: Any, names: Sequence[str], **values: Any) -> None:
        names = list(names)
        if not names and len(values["q"]):
            names = [f"joint_{i + 1}" for i in range(len(values["q"]))]
        if not names or len(set(names)) < len(names):
            if stream != self._topic:
                return
            raise InputError(f"no joints, or joints of the same name ({', '.join(names)[:200]})", file=self._path,
                             field="name")
        TABLE_COLUMNS.check(1 + 3 * len(names), self._path)
        self._count += 1 + len(values) * len(names)
        TABLE_VALUES.check(self._count, self._path, "cut it into pieces")
        key = stream, frozenset(names)
        if key not in self._groups:
            TABLE_COLUMNS.check(len(self._groups), self._path)
            self._groups[key] = _Joints(names)
        self._groups[key].add(stamp, message, names, **values)

    def _vector(self, stream: str, stamp: int, message: Any, values: tuple[float, ...]) -> None:
        logged, headed, rows = self._vectors.setdefault(stream, (array("q"), array("q"), array("d")))
        self._count += len(values)
        TABLE_VALUES.check(self._count, self._path, "cut it into pieces")
        logged.append(stamp)
        headed.append(_stamp(message))
        rows.extend(values)

    def _table(self) -> tuple[dict[str, Array], dict[str, Any]]:
        group = self._measured()
        stamps, bare = group.stamps()
        if bare:
            self._said.append(f"unstamped: {bare} of {len(stamps)} messages on {self._topic} bear no stamp; that of "
                              "the log is taken for them, less the usual difference")
        use: np.ndarray = np.ones(len(stamps), dtype=bool)
        driven = np.asarray(np.isfinite(group.table("tau")).any(axis=1))
        if 0.5 <= driven.mean() < 1.0:
            use = driven
            self._said.append(f"left-out: {int((~driven).sum())} messages on {self._topic} without efforts")
        standing = np.asarray(np.isfinite(group.table("q")).any(axis=1))
        if not standing[use].all():
            self._said.append(f"left-out: {int((use & ~standing).sum())} messages on {self._topic} without positions")
            use &= standing
        if not use.any():
            raise InputError(f"no message on {self._topic} holds positions", file=self._path, field="position")
        stamps = stamps[use]
        columns: dict[str, Array] = {"t": (stamps - stamps[0]) * 1e-9}
        for key in ("q", "qd", "tau"):
            table = group.table(key)[use]
            if np.isfinite(table).any():
                columns.update({f"{key}_{i + 1}": np.array(table[:, i]) for i in range(len(group.names))})
        columns.update(self._beside(group, stamps))
        meta = {"joints": group.names, "topic": self._topic, "stamp_0": int(stamps[0])}
        return columns, with_reading(meta, self._said)

    def _measured(self) -> _Joints:
        """The messages of the joints that are wanted, or of most joints; the others are counted and named."""
        groups = [group for (stream, _), group in self._groups.items() if stream == self._topic]
        if not groups:
            raise InputError(f"no messages on {self._topic}; record them while the arm moves", file=self._path)
        fitting = groups
        if self._joints is not None:
            fitting = [group for group in groups if set(self._joints) <= set(group.names)]
            if not fitting:
                names = sorted({name for group in groups for name in group.names})
                raise InputError(f"no message on {self._topic} holds them; joints there are {_some(names, 40)}",
                                 file=self._path, field="--joints", value=",".join(self._joints))
        enough = [group for group in fitting if len(group.logged) >= _ENOUGH] or fitting
        chosen = max(enough, key=lambda group: (len(group.names), len(group.logged)))
        for group in groups:
            if group is not chosen:
                self._said.append(f"left-out: {len(group.logged)} messages on {self._topic} of other joints "
                                  f"({_some(group.names)})")
        return chosen

    def _beside(self, group: _Joints, stamps: Array) -> dict[str, Array]:
        """Commands, arm angles, wrench and pose at the instants of the joint states; NaN where there are none."""
        columns: dict[str, Array] = {}
        for (stream, names), other in self._groups.items():
            if stream == self._topic or not set(group.names) & names:
                continue
            at, table = other.stamps()[0], other.table("q")
            for name in sorted(names):
                if name in group.names:
                    column = f"{stream}_{group.names.index(name) + 1}"
                    values = _at(stamps, at, table[:, other.names.index(name)])
                    # Several controllers have each their own joints, or times.
                    columns[column] = np.where(np.isnan(columns[column]), values, columns[column]) \
                        if column in columns else values
        for stream, names_of in (("wrench", _WRENCH), ("tcp", _TCP)):
            if stream in self._vectors:
                logged, headed, rows = self._vectors[stream]
                at = np.array(headed if any(headed) else logged)
                values_of = np.frombuffer(rows).reshape(-1, len(names_of))
                columns.update({name: _nearest(stamps, at, values_of[:, k]) for k, name in enumerate(names_of)})
        kinds = {"wrench": "fx to mz", "tcp": "x to qw", **{kind: f"{kind}_i" for kind in _LEADING.values()}}
        beside = [f"{kinds[stream]} from {_some(sorted(topics))}" for stream, topics in self._topics.items()
                  if stream in self._vectors or any(name.startswith(f"{stream}_") for name in columns)]
        self._said += [f"beside: {', '.join(beside)}"] * bool(beside)
        return columns


def _at(stamps: Array, at: Array, values: Array) -> Array:
    """Values ``(M,)`` given at some instants, between them at others ``(N,)``; NaN beyond their ends."""
    order = np.argsort(at, kind="stable")
    start = int(at[order[0]])
    return np.interp(stamps - start, at[order] - start, values[order], left=np.nan, right=np.nan)


def _nearest(stamps: Array, at: Array, values: Array) -> Array:
    """Values ``(M,)`` at the rows ``(N,)`` next to which they were measured; NaN at rows next to none."""
    order = np.argsort(at, kind="stable")
    at, values = at[order], values[order]
    place = np.clip(np.searchsorted(at, stamps), 1, max(len(at) - 1, 1))
    before, after = np.minimum(place - 1, len(at) - 1), np.minimum(place, len(at) - 1)
    near = np.where(np.abs(stamps - at[before]) <= np.abs(at[after] - stamps), before, after)
    step = float(np.median(np.diff(stamps))) if len(stamps) > 1 else 0.0
    return np.where(np.abs(at[near] - stamps) <= 0.5 * step + 1.0, values[near], np.nan)


def _stamp(message: Any) -> int:
    return int(message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec)


def _some(names: Sequence[str], most: int = _LISTED) -> str:
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


# Repairs files of killed recorders.

def _whole(path: Path, folder: Path) -> tuple[list[Path], list[str]]:
    """The bag's files as readers can open them, those that end within a record mended; and what there is to say."""
    if path.is_file():
        files = [path]
    else:
        files = sorted(file for file in path.iterdir() if file.suffix in SUFFIXES)
    cut = [file for file in files if _is_cut(file)]
    said = _renamed(path, files)
    if not cut:
        return ([path] if path.is_file() or ((path / _WORDS).is_file() and not said) or not files else files), said
    for file in cut:
        mended = folder / file.name
        lost = _mend(file, mended) if file.suffix == ".mcap" else _mend_db3(file, mended)
        files[files.index(file)] = mended
        said.append(f"cut: {file.name} ends within a record, as a killed recorder or a copy that was broken off leaves "
                    "it; what is whole is read" + (f", {100.0 * lost:.2g} % of its bytes are left out" if lost else ""))
    return files, said


def _renamed(path: Path, files: Sequence[Path]) -> list[str]:
    """What there is to say of files that a folder's ``metadata.yaml`` does not name, as of a bag that was renamed."""
    if not (path / _WORDS).is_file():
        return []
    words = (path / _WORDS).read_text(errors="replace")
    others = [file.name for file in files if file.name not in words]
    return [f"renamed: {_WORDS} does not name {_some(others)}; the files themselves are read"] if others else []


def _is_cut(file: Path) -> bool:
    """Whether an MCAP file begins as one and does not end as one, or SQLite's has fewer pages than it says."""
    with file.open("rb") as stream:
        begin = stream.read(100)
        if begin.startswith(_SQLITE) and len(begin) == 100:
            size, count = _pages(begin)
            return file.stat().st_size < size * count
        if not begin.startswith(_MCAP):
            return False
        stream.seek(-min(len(_MCAP), file.stat().st_size), 2)
        return stream.read() != _MCAP


def _mend(file: Path, mended: Path) -> float:
    """Writes the whole records of an MCAP file as one that ends as it should; returns the share left out.

    Of a chunk that was begun the records that can be unpacked stand by themselves, as the specification allows.
    """
    size, kept, messages = file.stat().st_size, len(_MCAP), 0
    with file.open("rb") as stream, mended.open("wb") as out:
        out.write(stream.read(len(_MCAP)))
        while len(head := stream.read(9)) == 9:
            kind, length = struct.unpack("<BQ", head)
            begin = stream.tell()
            if begin + length > size:
                if kind == _CHUNK:
                    for record in _records_of_begun_chunk(stream, size, file):
                        out.write(record)
                        messages += record[0] == _MESSAGE
                    kept = size
                break
            if kind in _IN_DATA:
                out.write(head)
                for piece in _read(stream, length):
                    out.write(piece)
                messages += kind in (_MESSAGE, _CHUNK)
            stream.seek(begin + length)
            kept = begin + length
        out.write(struct.pack("<BQI", 0x0F, 4, 0) + struct.pack("<BQQQI", 0x02, 20, 0, 0, 0) + _MCAP)
    if not messages:
        raise InputError("ends before its first message; record it again", file=file)
    return 1.0 - kept / size


def _pages(header: bytes) -> tuple[int, int]:
    """Size [bytes] and number of the pages that an SQLite file has by its header, which has 100 bytes."""
    size, = struct.unpack_from(">H", header, 16)
    return 65536 if size == 1 else size, struct.unpack_from(">I", header, 28)[0]


def _mend_db3(file: Path, mended: Path) -> float:
    """Writes the messages of an SQLite bag that come before its end; returns the share of its bytes left out."""
    raw = mended.with_suffix(".cut")
    shutil.copyfile(file, raw)
    with raw.open("r+b") as stream:
        size, said = _pages(stream.read(100))
        there = raw.stat().st_size // max(size, 1)
        # The number of pages in the header would keep the library from reading the existing ones.
        stream.seek(28)
        stream.write(struct.pack(">I", there))
    messages = 0
    with closing(sqlite3.connect(f"{raw.resolve().as_uri()}?mode=ro", uri=True)) as old, closing(
            sqlite3.connect(mended)) as new:
        for name, sql in _stored(old):
            new.execute(sql)
            with suppress(sqlite3.DatabaseError):  # the first incomplete page ends the data
                for row in old.execute(f"SELECT * FROM {name}"):
                    new.execute(f"INSERT INTO {name} VALUES ({', '.join('?' * len(row))})", row)
                    messages += name == "messages"
        new.commit()
    raw.unlink()
    if not messages:
        raise InputError("ends before its first message; record it again", file=file)
    return 1.0 - there / said


def _records_of_begun_chunk(stream: IO[bytes], size: int, file: Path) -> Iterator[bytes]:
    """Whole records of a chunk that the file ends in, as far as they can be unpacked."""
    stream.seek(28, 1)
    compression = _word(stream)
    stream.seek(8, 1)
    waiting, total = b"", 0
    pieces = _unpacked(_read(stream, size), compression)
    while True:
        try:
            piece = next(pieces, None)
        except Exception:  # at the truncated end each library raises its own exception
            return
        if piece is None:
            return
        total += len(piece)
        check_unfolding(BAG_UNFOLDING, total, size, file)
        waiting += piece
        while len(waiting) >= 9:
            kind, length = struct.unpack_from("<BQ", waiting)
            if length < _IN_CHUNK.get(kind, 1 << 64):
                return
            if len(waiting) < 9 + length:
                BAG_MESSAGE.check(length, file)
                break
            yield waiting[: 9 + length]
            waiting = waiting[9 + length :]


# Counts the unpacked size of a bag without unpacking it. Readers use indices, which have to agree with the content.

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
    """Yields the size of each piece of a chunk [bytes].

    Raises ValueError for a record in it that is shorter than its kind can be.
    """
    waiting, skipped = b"", 0
    for piece in pieces:
        yield len(piece)
        waiting += piece
        offset = skipped
        while offset + 9 <= len(waiting):
            kind, length = struct.unpack_from("<BQ", waiting, offset)
            if length < _IN_CHUNK.get(kind, 1 << 64):
                raise ValueError(f"a record of kind {kind} in a chunk has only {length} bytes")
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
                raise ValueError(f"a record's header has {length} bytes, more than {_PIECE}")
            head = stream.read(length)
            length, = struct.unpack("<I", stream.read(4))
            begin = stream.tell()
            if b"op=\x05" in head:
                kinds = [kind for kind in ("bz2", "lz4") if b"compression=" + kind.encode() in head]
                yield from map(len, _unpacked(_read(stream, length), "".join(kinds)))
            stream.seek(begin + length)


def _in_db3(file: Path) -> Iterator[int]:
    """Yields the sizes of an SQLite bag's messages [bytes], from stored columns only."""
    with closing(sqlite3.connect(f"{file.resolve().as_uri()}?mode=ro", uri=True)) as base:
        _stored(base)
        packed = "CASE WHEN substr(data, 1, 4) = x'28b52ffd' THEN data END"
        for length, message in base.execute(f"SELECT length(data), {packed} FROM messages"):
            yield int(length or 0)
            if message is not None:
                yield from map(len, _unpacked(iter([message]), "zstd"))


def _stored(base: sqlite3.Connection) -> list[tuple[str, str]]:
    """Names of a bag's tables and what creates them; raises ValueError for one that is computed."""
    names = ("topics", "messages", "message_definitions", "schema", "metadata")
    tables = base.execute("SELECT name, type, sql FROM sqlite_master WHERE lower(name) IN (?, ?, ?, ?, ?)",
                          names).fetchall()
    for name, kind, sql in tables:
        columns = base.execute(f"PRAGMA table_xinfo({name})").fetchall()
        if kind != "table" or not sql.upper().startswith("CREATE TABLE") or any(column[6] for column in columns):
            raise ValueError(f"{name} is computed, not stored")
    return [(name, sql) for name, _, sql in tables]


def _in_zstd(file: Path) -> Iterator[int]:
    """Bytes of each piece that a packed file of a bag unpacks to, and of what that unpacks to."""
    with file.open("rb") as stream, NamedTemporaryFile(suffix=file.stem) as whole:
        for piece in _unpacked(_read(stream, file.stat().st_size), "zstd"):
            yield len(piece)
            whole.write(piece)
        whole.flush()
        _check_unfolding(Path(whole.name), file.stat().st_size)


_COUNTED = {_MCAP: _in_mcap, b"#ROSBAG": _in_bag, _SQLITE: _in_db3, b"\x28\xb5\x2f\xfd": _in_zstd}
"""How each kind is counted, by its first bytes."""


_REMEDIES = {_MCAP: "mcap recover {file} -o whole.mcap saves the whole chunks",
             b"#ROSBAG": "rosbag reindex {file} saves the whole chunks",
             _SQLITE: "sqlite3 {file} .dump shows what of it is whole",
             b"\x28\xb5\x2f\xfd": "unpack it with zstd -d {file} to see how much of it is whole"}
"""What may be done about a damaged bag, by its first bytes."""


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
