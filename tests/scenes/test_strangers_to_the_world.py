"""Who follows is given what is known alone: a play goes on when everything else of its cell raises."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

import scenes.force.play as force_play
import scenes.line.play as line_play
from scenes import load_scene
from scenes.online.force_task import ForceTask
from scenes.online.force_task import Known as KnownSurface
from scenes.online.line_known import Known as KnownLine
from scenes.online.line_task import LineTask

OF_THE_WORLD = frozenset({"world", "arm_world", "displacement", "wear", "light", "tip", "sensor", "surface"})
"""Tables of a scene that a real cell's file need not have."""


class Guard:
    """An object whose attributes beyond a list raise.

    Args:
        inner: the object.
        named: what may be asked for; everything if None.
        refused: what may not.
    """

    def __init__(self, inner: Any, named: set[str] | None, refused: frozenset[str] = frozenset()) -> None:
        self._inner, self._named, self._refused = inner, named, refused

    def __getattr__(self, name: str) -> Any:
        if name in self._refused or (self._named is not None and name not in self._named):
            raise AssertionError(f"the task asked for {name}, which is of the world")
        return getattr(self._inner, name)


def attributes(known: type) -> set[str]:
    return {field.name for field in dataclasses.fields(known)} | {
        name for name in vars(known) if not name.startswith("_")}


@pytest.mark.parametrize(("name", "changes", "module", "task", "known"), [
    ("straight", {"world": "bench"}, line_play, LineTask, KnownLine),
    ("force_wave", {"line": {"length": 0.1}}, force_play, ForceTask, KnownSurface),
])
def test_the_task_asks_for_nothing_of_the_world(name: str, changes: dict[str, Any], module: Any, task: type,
                                                known: type, monkeypatch: pytest.MonkeyPatch) -> None:
    """The commands are the same bit by bit, so the guard was in force and changed nothing."""
    scene = load_scene(name).changed(**changes)
    free = module.play(scene, "ideal")
    guarded: list[Any] = []

    def made(cell: Any, *arguments: Any, **options: Any) -> Any:
        assert type(cell) is known
        inner = dataclasses.replace(cell, scene=Guard(cell.scene, None, OF_THE_WORLD))
        guarded.append(inner)
        return task(Guard(inner, attributes(known)), *arguments, **options)

    monkeypatch.setattr(module, task.__name__, made)
    played = module.play(scene, "ideal")
    assert len(guarded) == 1
    for column in ("q_c_1", "q_1"):
        np.testing.assert_array_equal(played.recording.columns[column], free.recording.columns[column])
    values = [getattr(guarded[0], field.name) for field in dataclasses.fields(known) if field.name != "scene"]
    assert not [value for value in values if type(value).__module__.partition(".")[0] == "sim"]
