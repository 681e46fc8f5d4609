"""How long work tells how far it is."""

from __future__ import annotations

from collections.abc import Callable, Mapping

Progress = Callable[[float, str], None]
"""Told the share that is done and a word for what is being done."""


def silent(fraction: float, text: str) -> None:
    """A progress that nobody looks at."""


def part_of(progress: Progress, start: float, share: float, key: str = "") -> Progress:
    """Progress of a part of a job.

    Args:
        progress: of the whole job.
        start: fraction of the job done before the part.
        share: the part's share of the job.
        key: what the part is about; shown in front of what is being done.
    """
    def move(fraction: float, text: str) -> None:
        progress(start + share * fraction, text if key in ("", text) else f"{key}: {text}")

    return move


class Steps:
    """Steps of a job, each with its measured share of the time, together 1; reported progress never falls."""

    def __init__(self, progress: Progress, shares: Mapping[str, float]) -> None:
        self._progress, self._shares = progress, shares
        self._done = 0.0

    def begin(self, step: str, text: str = "") -> Progress:
        """Says that a step (a key of ``shares``) begins, by ``text`` or by its name; returns its progress."""
        part = self.part(step)
        part(0.0, text or step)
        return part

    def part(self, step: str) -> Progress:
        """The progress of a step that says itself when it begins."""
        keys = list(self._shares)
        return part_of(self._forward, sum(self._shares[key] for key in keys[: keys.index(step)]), self._shares[step])

    def _forward(self, fraction: float, text: str) -> None:
        self._done = max(self._done, fraction)
        self._progress(self._done, text)
