"""Very long recordings are read piece by piece, and stretches of them are used."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ideal_robot.errors import InputError
from ideal_robot.signals import stretches as module
from ideal_robot.signals import table_file
from ideal_robot.signals.column_store import in_file
from ideal_robot.signals.preprocess import uniform_time
from ideal_robot.signals.recording import Recording
from ideal_robot.signals.stretches import shortened, stretches


def long_recording(length: int, source: str = "a") -> Recording:
    rows = np.arange(length)
    return Recording.from_arrays(0.002 * rows, q=np.sin(rows)[:, None], source=source,
                                 tau=np.where(rows % 7 == 0, np.nan, rows)[:, None], meta={"robot": "kr15"})


def test_recordings_of_normal_length_are_used_as_they_are() -> None:
    given = (long_recording(1000), long_recording(10))
    used, warnings = stretches(given)
    assert all(one is other for one, other in zip(used, given, strict=True))
    assert not warnings


def test_of_long_ones_stretches_from_begin_to_end_are_used(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MOST", 10_000)
    monkeypatch.setattr(module, "STRETCH", 1000)
    monkeypatch.setattr(module, "FEWEST", 200)
    used, (warning,) = stretches([long_recording(50_000), long_recording(100, "short")])
    assert warning.startswith("long-recording: of 50100 samples")
    long, short = used[:-1], used[-1]
    assert len(long) == 9
    assert all(len(one.t) == 1000 for one in long)
    assert long[0].t[0] == 0.0
    assert long[-1].t[-1] == pytest.approx(0.002 * 49_999)
    assert len(short.t) == 100
    assert short.source.startswith("short")
    np.testing.assert_array_equal(long[3].columns["q_1"], np.sin(np.rint(long[3].t / 0.002)))


@pytest.mark.parametrize("ending", [".parquet", ".csv"])
def test_a_table_read_piece_by_piece_is_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ending: str) -> None:
    place = long_recording(40_000).write(tmp_path / f"r{ending}")
    whole = Recording.read(place)
    monkeypatch.setattr(table_file, "AT_ONCE", 1000)
    monkeypatch.setattr(table_file, "PIECE", 7000)
    pieces = Recording.read(place)
    assert not in_file(whole.t)
    assert in_file(pieces.t)
    assert pieces.hash == whole.hash
    assert pieces.meta == whole.meta


def test_a_word_far_down_a_long_table_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(table_file, "AT_ONCE", 100)
    monkeypatch.setattr(table_file, "PIECE", 50)
    lines = [f"{0.002 * i},{i}" for i in range(500)]
    lines[444] = "0.888,broken"
    place = tmp_path / "r.csv"
    place.write_text("t,q_1\n" + "\n".join(lines) + "\n")
    with pytest.raises(InputError, match="not numeric"):
        Recording.read(place)


def test_stretches_of_one_recording_follow_each_other_after_a_pause(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a diagnosis works on; the camera's stamps stay with their samples."""
    monkeypatch.setattr(module, "MOST", 10_000)
    monkeypatch.setattr(module, "STRETCH", 1000)
    given = long_recording(50_000)
    assert shortened(long_recording(9_000))[1] == []
    given = replace(given, columns={**given.columns, "cam_t": given.t - 0.04})
    used, (warning,) = shortened(given)
    assert warning.startswith("long-recording: of 50000 samples 10000 are used")
    assert len(used.t) == 10_000
    steps = np.diff(used.t)
    assert np.count_nonzero(steps > 0.01) == 9
    np.testing.assert_allclose(steps[steps > 0.01], 0.9)
    np.testing.assert_allclose(used.t - used.columns["cam_t"], 0.04)
    np.testing.assert_array_equal(used.columns["q_1"][-1000:], given.columns["q_1"][-1000:])
    uniform, hole = uniform_time(used)
    assert len(uniform) < 15_000
    assert np.count_nonzero(np.diff(hole.astype(int)) == 1) == 9
