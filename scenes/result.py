"""What playing a scene returns, whatever its kind: enough for the command line, sweeps and scripts."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from ideal_robot.progress import Progress, part_of, silent

if TYPE_CHECKING:
    from ideal_robot.diagnosis import Diagnosis

__all__ = ["CompareResult", "LoopResult", "Progress", "RunResult", "part_of", "silent"]


class RunResult(Protocol):
    """One scene played with one method."""

    @property
    def failure(self) -> str | None:
        """Why the run ended early, or None; what was done until then is kept."""
        ...

    @property
    def report(self) -> Path | None:
        """The HTML page, where one was asked for."""
        ...

    def json(self) -> dict[str, Any]:
        """The content of ``--json``."""
        ...

    def summary(self) -> list[tuple[str, str]]:
        """The few figures a person wants first: label and value with unit."""
        ...


class CompareResult(Protocol):
    """One scene played with several methods."""

    @property
    def report(self) -> Path | None:
        """The HTML page, where one was asked for."""
        ...

    def json(self) -> dict[str, Any]:
        """The content of ``--json``; the runs stand under ``methods``."""
        ...

    def table(self) -> tuple[list[str], list[list[Any]]]:
        """Column titles and rows, one row a method."""
        ...


class LoopResult(Protocol):
    """One turn of run, diagnose, extend, run again."""

    @property
    def report(self) -> Path | None:
        """The HTML page, where one was asked for."""
        ...

    @property
    def columns(self) -> tuple[str, ...]:
        """Titles of the table's columns."""
        ...

    @property
    def tried_by(self) -> str:
        """Title of the ladder's error: by which figure, with unit, a change of the model is judged."""
        ...

    @property
    def diagnosis(self) -> Diagnosis | None:
        """What was found; None where what is missing was known."""
        ...

    def json(self) -> dict[str, Any]:
        """The content of ``--json``."""
        ...

    def table(self) -> list[list[Any]]:
        """One row a model: before, after, and with the truth."""
        ...

    def ladder(self) -> list[list[Any]]:
        """One row a change of the model that was tried: round, what, stays, measured error in mm, why not."""
        ...
