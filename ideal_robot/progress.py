"""Reporting the progress of long work."""

from __future__ import annotations

from collections.abc import Callable, Mapping

Progress = Callable[[float, str], None]
"""Told the share that is done and a word for what is being done."""


def silent(fraction: float, text: str) -> None:
    """A progress callback that does nothing."""


def part_of(progress: Progress, start: float, share: float, key: str = "") -> Progress:
    """A progress callback for a part of a task, which reports to that of the whole.

    Args:
        progress: of the whole job.
        start: fraction of the job done before the part.
        share: the part's share of the job.
        key: name of the part, shown before its present step.
    """
    def move(fraction: float, text: str) -> None:
        progress(start + share * fraction, text if key in ("", text) else f"{key}: {text}")

    return move


class Steps:
    """Progress of a task in steps with given shares of its time, which sum to 1; it never falls."""

    def __init__(self, progress: Progress, shares: Mapping[str, float]) -> None:
        self._progress, self._shares = progress, shares
        self._done = 0.0

    def begin(self, step: str, text: str = "") -> Progress:
        """Starts a step (a key of ``shares``), shown as ``text`` or by its name; returns its progress callback."""
        part = self.part(step)
        part(0.0, text or step)
        return part

    def part(self, step: str) -> Progress:
        """The progress callback of a step that reports its own beginning."""
        keys = list(self._shares)
        return part_of(self._forward, sum(self._shares[key] for key in keys[: keys.index(step)]), self._shares[step])

    def _forward(self, fraction: float, text: str) -> None:
        self._done = max(self._done, fraction)
        self._progress(self._done, text)
