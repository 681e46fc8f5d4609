"""How results of scenes are shown: three lines at the prompt, a small table in a notebook, plain values for JSON."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

from ideal_robot.plain import plain
from ideal_robot.summary import Summarised, html_table, in_lines, shown_cell


class ShownRun(Summarised):
    """Base of results of a scene that was played once; ``scene``, ``failure`` and ``json`` are the subclass's."""

    scene: Any
    failure: str | None

    @abstractmethod
    def json(self) -> dict[str, Any]:
        """The content of ``--json``."""

    def __repr__(self) -> str:
        early = f", ended early: {self.failure}" if self.failure else ""
        return in_lines(type(self).__name__, f"{self.scene.name!r}{early}",
                        [f"{label} {value}" for label, value in self.summary()[:8]])

    def to_dict(self) -> dict[str, Any]:
        """The content of ``--json`` as plain values."""
        values: dict[str, Any] = plain(self.json())
        return values


class ShownTable(ABC):
    """Base of results of a scene that was played several times; ``scene`` and ``json`` are the subclass's."""

    scene: Any

    @abstractmethod
    def json(self) -> dict[str, Any]:
        """The content of ``--json``."""

    @abstractmethod
    def rows(self) -> tuple[tuple[str, ...], list[list[Any]]]:
        """Column titles and rows, one a method or model, whose name stands first."""

    def __repr__(self) -> str:
        (_, first, *_), rows = self.rows()
        figures = [f"{row[0]} {shown_cell(row[1])}" for row in rows]
        return in_lines(type(self).__name__, f"{self.scene.name!r}: {len(rows)} plays",
                        [f"{first}: {figures[0]}", *figures[1:]] if figures else [])

    def _repr_html_(self) -> str:
        return html_table(*self.rows())

    def to_dict(self) -> dict[str, Any]:
        """The content of ``--json`` as plain values."""
        values: dict[str, Any] = plain(self.json())
        return values
