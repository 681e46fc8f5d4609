"""The progress bar of the command line."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from scenes import result
from scenes.terminal import shown


@contextmanager
def progress_bar(title: str) -> Iterator[result.Progress]:
    """A bar on standard error while the block runs; yields the function that moves it."""
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), TextColumn("{task.percentage:>3.0f} %"),
               TimeElapsedColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(shown(title), total=1.0)

        def move(fraction: float, text: str) -> None:
            bar.update(task, completed=min(max(fraction, 0.0), 1.0),
                       description=shown(f"{title}: {text}" if text else title))

        yield move
