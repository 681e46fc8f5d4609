"""How results of scenes are shown: three lines at the prompt, a small table in a notebook, plain values for JSON."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

from ideal_robot.plain import plain
from ideal_robot.summary import Summarised, html_table


class ShownRun(Summarised):
    """Base of results of a scene that was played once; ``scene``, ``failure`` and ``json`` are the subclass's."""

    scene: Any
    failure: str | None

    @abstractmethod
    def json(self) -> dict[str, Any]:
        """The content of ``--json``."""

    def __repr__(self) -> str:
        figures = "; ".join(f"{label} {value}" for label, value in self.summary()[:8])
        early = f", ended early: {self.failure}" if self.failure else ""
        return f"{type(self).__name__}({self.scene.name!r}{early})\n  {figures}"

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
        figures = "; ".join(f"{row[0]} {row[1]:.4g}" for row in rows)
        return f"{type(self).__name__}({self.scene.name!r}: {len(rows)} plays)\n  {first}: {figures}"

    def _repr_html_(self) -> str:
        return html_table(*self.rows())

    def to_dict(self) -> dict[str, Any]:
        """The content of ``--json`` as plain values."""
        values: dict[str, Any] = plain(self.json())
        return values
