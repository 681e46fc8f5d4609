"""The picture of the architecture is what its generator draws from today's imports."""

from __future__ import annotations

import re

import pytest

from docs.draw_architecture import PICTURE, layers, picture, reduced, structure


def drawn(svg: str) -> tuple[set[str], set[tuple[str, str]]]:
    """Rooms and arrows of a picture."""
    boxes = re.findall(r'class="room" data-name="([\w.]+)"', svg)
    arrows = re.findall(r'data-from="([\w.]+)" data-to="([\w.]+)"', svg)
    assert len(boxes) == len(set(boxes))
    return set(boxes), set(arrows)


def test_the_committed_picture_is_up_to_date() -> None:
    """Where this fails: ``python docs/draw_architecture.py``."""
    assert drawn(PICTURE.read_text(encoding="utf-8")) == drawn(picture()) == structure()


def test_circles_are_named() -> None:
    with pytest.raises(ValueError, match="a → b → a"):
        layers({"a": {"b"}, "b": {"a"}})


def test_what_follows_from_other_arrows_is_left_out() -> None:
    assert reduced({"a": {"b", "c"}, "b": {"c"}, "c": set()}) == {"a": {"b"}, "b": {"c"}, "c": set()}
