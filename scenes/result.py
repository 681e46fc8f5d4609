"""What playing a scene returns, whatever its kind: enough for the command line, sweeps and scripts."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Protocol

from ideal_robot.progress import Progress, silent

__all__ = ["Progress", "RunResult", "silent"]


class RunResult(Protocol):
    """One scene played with one method."""

    failure: str | None
    """Why the run ended early, or None; what was done until then is kept."""
    report: Path | None
    """The HTML page, where one was asked for."""

    def json(self) -> dict[str, Any]:
        """The content of ``--json``."""
        ...

    def summary(self) -> list[tuple[str, str]]:
        """The few figures a person wants first: label and value with unit."""
        ...


class CompareResult(Protocol):
    """One scene played with several methods."""

    report: Path | None

    def json(self) -> dict[str, Any]:
        """The content of ``--json``; the runs stand under ``methods``."""
        ...

    def table(self) -> tuple[list[str], list[list[Any]]]:
        """Column titles and rows, one row a method."""
        ...
