"""The stream's parser: any cut of the bytes gives the same packages, and nothing makes it grow or raise else."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sensing.stream.package import HEADER, LARGEST, Kind, Reader, StreamError, packed


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 255), st.binary(max_size=60)), max_size=8), st.integers(1, 50))
def test_any_cut_gives_the_same_packages(sent: list[tuple[int, bytes]], size: int) -> None:
    wire = b"".join(HEADER.pack(b"IR", 1, kind, len(load), 0.5) + load for kind, load in sent)
    reader, found = Reader(), []
    for i in range(0, len(wire), size):
        found += reader.feed(wire[i : i + size])
    assert [(one.kind, one.payload) for one in found] == sent


@pytest.mark.parametrize("wire", [b"GET / HTTP/1.1\r\n\r\n", HEADER.pack(b"IR", 2, 1, 0, 0.0),
                                  HEADER.pack(b"IR", 1, 2, LARGEST + 1, 0.0)])
def test_another_protocol_another_version_and_what_is_too_large_are_refused(wire: bytes) -> None:
    with pytest.raises(StreamError):
        list(Reader().feed(wire))


def test_the_documented_bytes() -> None:
    assert packed(Kind.ASK, 1.5, struct.pack(">d", 2.0)).hex() == (
        "4952" "01" "05" "00000008" "3ff8000000000000" "4000000000000000")


def test_twenty_thousand_mutated_packages_raise_nothing_else_and_hold_nothing() -> None:
    rng = np.random.default_rng(3)
    sound = packed(Kind.WRENCH, 1.0, struct.pack(">I6d", 1, *range(6)))
    for _ in range(20_000):
        wire = bytearray(sound)
        for place in rng.integers(0, len(wire), rng.integers(1, 4)):
            wire[place] = rng.integers(0, 256)
        reader = Reader()
        try:
            list(reader.feed(bytes(wire)))
        except StreamError:
            continue
        assert len(reader._waiting) <= len(wire)
