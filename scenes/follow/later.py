"""Progress that is shown when no answer waits for it: drawing a bar takes a lock and writes to a terminal."""

from __future__ import annotations

from scenes.result import Progress


class Later:
    """A ``scenes.result.Progress`` that keeps the newest until ``catch_up`` shows it.

    Args:
        progress: shows it.
    """

    def __init__(self, progress: Progress) -> None:
        self._progress = progress
        self._newest: tuple[float, str] | None = None

    def __call__(self, done: float, text: str) -> None:
        """Keeps a share of the whole and what is being done."""
        self._newest = done, text

    def catch_up(self) -> None:
        """Shows what has not been shown yet."""
        newest, self._newest = self._newest, None
        if newest is not None:
            self._progress(*newest)
