"""Small files that unfold are refused by what they claim, before memory is taken for it."""

from __future__ import annotations

import pickle
import resource
import sqlite3
import struct
import sys
from collections.abc import Callable
from pathlib import Path

import lz4.frame
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from rosbags.rosbag2.storage_mcap import zstd

from ideal_robot import row_log
from ideal_robot.bounded_values import checked, parsed_json
from ideal_robot.errors import IdealRobotError, InputError
from ideal_robot.row_log import KEPT, RowLog, file_of, in_new_file, let_go, new_array
from ideal_robot.signals.recording import Recording
from scenes.scene_files.shape import first_path
from tests.ideal_robot.signals.test_recording import write_bag
from tests.sources import files_of_at_most

MAGIC = b"\x89MCAP0\r\n"


def record(kind: int, content: bytes) -> bytes:
    return bytes([kind]) + struct.pack("<Q", len(content)) + content


def word(text: str) -> bytes:
    return struct.pack("<I", len(text)) + text.encode()


def chunk(records: bytes, packed: bytes, compression: str, claims: int | None = None) -> bytes:
    head = struct.pack("<QQQI", 0, 1, len(records) if claims is None else claims, 0)
    return record(6, head + word(compression) + struct.pack("<Q", len(packed)) + packed)


def mcap(path: Path, *chunks: bytes) -> Path:
    path.write_bytes(MAGIC + record(1, word("ros2") + word("")) + b"".join(chunks) + record(15, bytes(4))
                     + record(2, bytes(20)) + MAGIC)
    return path


PACKERS: dict[str, Callable[[bytes], bytes]] = {"zstd": zstd.compress, "lz4": lz4.frame.compress, "": bytes}


@pytest.mark.parametrize("compression", PACKERS)
@pytest.mark.parametrize("claims", [None, 1000])
def test_a_chunk_of_zeros_is_no_chunk(tmp_path: Path, compression: str, claims: int | None) -> None:
    zeros = bytes(30_000_000)
    path = mcap(tmp_path / "z.mcap", chunk(zeros, PACKERS[compression](zeros), compression, claims))
    with pytest.raises(InputError, match="a record of kind 0 in a chunk has only 0 bytes"):
        Recording.read(path)


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
def test_a_bag_of_many_equal_messages_unfolds_to_too_much(tmp_path: Path, compression: str) -> None:
    message = record(5, struct.pack("<HIQQ", 1, 0, 1, 1) + bytes(200))
    records = message * (100_000_000 // len(message))
    path = mcap(tmp_path / "m.mcap", chunk(records, PACKERS[compression](records), compression))
    with pytest.raises(InputError, match="unfolds to more than 64 MB and 20 times its size"):
        Recording.read(path)


def joint_states(folder: Path, compression: str = "", plugin: str = "SQLITE3") -> Path:
    """A bag that is sound."""
    positions = np.column_stack([np.full(200, 0.1), np.arange(200) / 100])
    return write_bag(folder, plugin, ["b", "a"], positions, np.zeros((200, 0)), compression=compression)


@pytest.mark.parametrize("compression", ["", "FILE", "MESSAGE"])
def test_a_sound_bag_is_read_however_it_is_packed(tmp_path: Path, compression: str) -> None:
    recording = Recording.read(joint_states(tmp_path / "bag", compression))
    np.testing.assert_array_equal(recording.columns["q_2"], np.arange(200) / 100)
    assert "tau_1" not in recording.columns
    assert recording.meta["joints"] == ["b", "a"]


def test_an_index_that_names_a_chunk_twice_or_another_way_is_refused(tmp_path: Path) -> None:
    folder = joint_states(tmp_path / "bag", plugin="MCAP")
    file, = folder.glob("*.mcap")
    sound = file.read_bytes()
    begin = sound.index(b"\x08", struct.unpack_from("<Q", sound, len(sound) - 28)[0])
    index = sound[begin : begin + 9 + struct.unpack_from("<Q", sound, begin + 1)[0]]
    assert len(Recording.read(folder).t) == 200
    for damaged in (sound[:begin] + index + sound[begin:],
                    sound[:begin] + index[:-16] + struct.pack("<Q", 10**6) + sound[begin + len(index) - 8 :]):
        file.write_bytes(damaged)
        with pytest.raises(InputError, match="not a readable bag"):
            Recording.read(folder)


@pytest.mark.parametrize("share", [0.5, 0.6, 0.75, 0.9])
def test_of_a_bag_that_was_cut_short_what_is_whole_is_read(tmp_path: Path, share: float) -> None:
    rows = 3000
    positions = np.column_stack([np.full(rows, 0.1), np.arange(rows) / 100])
    folder = write_bag(tmp_path / "bag", "SQLITE3", ["b", "a"], positions, np.zeros((rows, 0)))
    file, = folder.glob("*.db3")
    sound = file.read_bytes()
    # Pages of messages lie before those of the index, which takes some tenths.
    file.write_bytes(sound[: int(share * len(sound))])
    for path in (folder, file):
        recording = Recording.read(path)
        read = len(recording.t)
        assert 0.5 * share * rows < read <= rows
        np.testing.assert_array_equal(recording.columns["q_2"], np.arange(read) / 100)
        assert any(text.startswith("cut: ") for text in recording.meta["reading"])


def test_a_bag_of_which_hardly_anything_is_there_is_refused(tmp_path: Path) -> None:
    file, = joint_states(tmp_path / "bag").glob("*.db3")
    for size in (50, 100, 5000):
        file.write_bytes(file.read_bytes()[:size])
        with pytest.raises(InputError, match=r"not a readable bag|before its first message"):
            Recording.read(file)


@pytest.mark.parametrize("made", [
    "CREATE VIEW messages(id, topic_id, timestamp, data) AS WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x + 1 "
    "FROM c) SELECT x, 1, x, zeroblob(1000) FROM c",
    "CREATE TABLE messages(id INTEGER, topic_id INTEGER, timestamp INTEGER, data BLOB AS (zeroblob(900000000)))"])
def test_messages_that_are_computed_are_refused(tmp_path: Path, made: str) -> None:
    folder = joint_states(tmp_path / "bag")
    file, = folder.glob("*.db3")
    with sqlite3.connect(file) as base:
        base.execute("DROP TABLE messages")
        base.execute(made)
    base.close()
    with pytest.raises(InputError, match="messages is computed, not stored"):
        Recording.read(folder)


LONG = "bytes of a line of a CSV file; at most 1000000 are read"
OPEN = "has a quote that does not end in it"


@pytest.mark.parametrize(("text", "says"), [
    ("t,q_1\n" + "1," * 700_000 + "1\n", LONG), ("t,q_1\n0,1\n" + "1," * 700_000 + "1\n", LONG),
    ("a," * 700_000 + "\n1\n", LONG), ("t,q_1\n" + "1" * 1_500_000 + ",1\n", LONG),
    ('t,q_1\n' + '"\n",' * 1000 + "1\n", OPEN), ('t,q_1\n0,"1\n1,2\n', OPEN), ('t,"q\n_1"\n0,1\n', OPEN)])
def test_a_line_that_no_table_has_is_refused(tmp_path: Path, text: str, says: str) -> None:
    path = tmp_path / "r.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=says):
        Recording.read(path)


def test_quotes_and_ends_of_lines_of_other_systems_are_read(tmp_path: Path) -> None:
    path = tmp_path / "r.csv"
    for end in ("\n", "\r\n", "\r"):
        path.write_bytes(end.join(['"t","q_1"', '"0.0","1.5"', "0.1,", ""]).encode())
        np.testing.assert_array_equal(Recording.read(path).columns["q_1"], [1.5, np.nan])


def test_columns_of_one_value_and_of_long_words_are_refused_unread(tmp_path: Path) -> None:
    path = tmp_path / "r.parquet"
    pd.DataFrame({"t": np.zeros(30_000_000)}).to_parquet(path, compression="zstd")
    with pytest.raises(InputError, match="unfolds to more than 160 MB and 50 times its size"):
        Recording.read(path)
    long = pa.DictionaryArray.from_arrays(pa.array(np.zeros(1000, dtype=np.int32)), pa.array(["x" * 1_000_000]))
    for words in (long, pa.array(["1.5"] * 9), pa.array([b"1"] * 9)):
        pq.write_table(pa.table({"t": words}), path)
        with pytest.raises(InputError, match="column is not numeric"):
            Recording.read(path)
    sound = pa.DictionaryArray.from_arrays(pa.array(np.arange(9, dtype=np.int32)), pa.array(np.arange(9.0)))
    pq.write_table(pa.table({"t": sound}), path)
    np.testing.assert_array_equal(Recording.read(path).t, np.arange(9.0))


@pytest.mark.parametrize("text", ["[" + "[]," * 2_000_001 + "1]", "[" + "{}," * 2_000_001 + "1]",
                                  "[" + "1," * 2_000_001 + "1]", '{"a": [' + '"",' * 2_000_001 + "1]}"])
def test_too_many_values_are_counted_before_they_are_made(text: str) -> None:
    with pytest.raises(InputError, match="values of a JSON or TOML file; at most 2000000 are read"):
        parsed_json(text, None, "a model file")


def test_many_values_under_a_long_key_take_no_more_room_than_the_text() -> None:
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    parsed_json('{"' + "k" * 5_000_000 + '": [' + "1," * 300_000 + "1]}", None, "a model file")
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 300_000
    with pytest.raises(InputError, match=r"a\.b\.1: expected a finite number"):
        checked({"a": {"b": [1.0, float("nan")]}})


def test_commas_within_words_are_no_values() -> None:
    assert parsed_json('{"a": "' + "," * 2_500_000 + '"}', None, "a model file")["a"][0] == ","


def test_a_drawing_of_groups_alone_is_refused(tmp_path: Path) -> None:
    (tmp_path / "g.svg").write_text("<svg>" + "<g/>" * 60_000 + "</svg>")
    with pytest.raises(InputError, match="elements of an SVG file"):
        first_path("g.svg", tmp_path)


# Large arrays lie in files and are arrays like any other.

@pytest.mark.parametrize("most", [10, 10_000])
def test_an_array_holds_what_is_written_wherever_it_lies(monkeypatch: pytest.MonkeyPatch, most: int) -> None:
    monkeypatch.setattr(row_log, "IN_MEMORY", most)
    values = new_array(1000, 3)
    assert (file_of(values) is None) == (most > 3000)
    expected = np.random.default_rng(0).standard_normal((1000, 3))
    for first in range(0, 1000, 100):
        values[first : first + 100] = expected[first : first + 100]
        let_go(values)
    np.testing.assert_array_equal(values, expected)
    assert (file_of(values[5:, 1]) is None) == (file_of(values) is None)


def test_letting_go_does_nothing_to_arrays_in_memory() -> None:
    values = np.arange(5.0)
    let_go(values, np.empty(0))
    np.testing.assert_array_equal(values, np.arange(5.0))


@pytest.mark.skipif(sys.platform != "linux", reason="limits the size of files as Linux does")
def test_no_room_for_a_temporary_file_is_said_before_anything_is_written() -> None:
    rows = np.arange(2.0 * KEPT + 2).reshape(-1, 2)
    log = RowLog()
    with files_of_at_most(4096):
        for row in rows:
            log.append(row)
        with pytest.raises(IdealRobotError, match="set TMPDIR to another folder"):
            in_new_file(10_000)
    # An arm that moves must not wait for it: what no file takes stays.
    np.testing.assert_array_equal(np.array(log), rows)
    assert "set TMPDIR to another folder" in str(log.refused)


# A log of any length keeps a bounded number of rows in memory and loses none.

def test_numbers_and_rows_read_like_lists() -> None:
    numbers, rows = RowLog(), RowLog()
    for i in range(3):
        numbers.append(0.5 * i)
        rows.append((i, 10.0 * i))
    assert list(numbers) == [0.0, 0.5, 1.0]
    assert numbers[-1] == 1.0
    assert isinstance(numbers[-1], float)
    assert len(rows) == 3
    assert rows
    assert not RowLog()
    np.testing.assert_array_equal(np.array(rows), [[0, 0], [1, 10], [2, 20]])
    np.testing.assert_array_equal(numbers[:2], [0.0, 0.5])
    np.testing.assert_array_equal(np.array(numbers, dtype=bool), [False, True, True])
    assert np.array(RowLog()).shape == (0,)


def test_no_row_of_a_long_log_waits_for_more_than_a_piece(monkeypatch: pytest.MonkeyPatch) -> None:
    """All rows of the simulated arm at once took 35 ms, in which its controller stood still."""
    written = list[int]()
    monkeypatch.setattr(row_log, "_write", lambda descriptor, rows, place: written.append(len(rows)))
    log = RowLog(3)
    for _ in range(2 * KEPT):
        before = len(written)
        log.append(np.zeros(3))
        assert len(written) <= before + 1
    assert written
    assert max(written) <= KEPT // 64


def test_a_long_log_keeps_few_rows_and_loses_none() -> None:
    log, count = RowLog(), 2 * KEPT + 700
    for i in range(count):
        log.append(np.array([i, -i]))
        assert log.kept <= KEPT
    expected = np.arange(count)[:, None] * [1.0, -1.0]
    np.testing.assert_array_equal(np.array(log), expected)
    assert all(len(rows) <= KEPT for _, rows in log.blocks())
    np.testing.assert_array_equal(log[5], [5, -5])
    np.testing.assert_array_equal(log[-1], [count - 1, 1 - count])
    np.testing.assert_array_equal(np.array(pickle.loads(pickle.dumps(log))), expected)
    np.testing.assert_array_equal(log.mapped(), expected)
    log.reserve(1)
    assert not log.next_row.any()
