"""Text of users' files on its way to a terminal: shown as it is written, never obeyed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Column

from scenes import result


def shown(text: object) -> str:
    """The text on one line, with whatever a terminal would act on (escapes, bells, direction marks) spelt out."""
    return "".join(c if c.isprintable() else " " if c in "\n\t" else c.encode("unicode_escape").decode()
                   for c in str(text))


# The progress bar of the command line.

@contextmanager
def progress_bar(title: str, rate: float = 10.0) -> Iterator[result.Progress]:
    """A bar on standard error while the block runs; yields the function that moves it.

    Args:
        title: before the bar.
        rate: how often it is drawn, by a thread that takes Python's lock for it [Hz].
    """
    # Where there is no room for all, the text is cut; never the numbers.
    def fixed(width: int) -> Column:
        return Column(min_width=width, width=width, no_wrap=True)

    console = Console(stderr=True)
    bar_width = min(40, max(6, console.width // 4))
    text = Column(no_wrap=True, overflow="ellipsis", max_width=max(8, console.width - bar_width - 26))
    columns = (TextColumn("{task.description}", markup=False, table_column=text),
               BarColumn(bar_width, table_column=fixed(bar_width)),
               TextColumn("{task.percentage:>3.0f} %", table_column=fixed(5)),
               TimeElapsedColumn(table_column=fixed(7)), TimeRemainingColumn(table_column=fixed(7)))
    with Progress(*columns, console=console, transient=True, refresh_per_second=rate) as bar:
        task = bar.add_task(shown(title), total=1.0)

        def move(fraction: float, text: str) -> None:
            bar.update(task, completed=min(max(fraction, 0.0), 1.0),
                       description=shown(f"{title}: {text}" if text else title))

        yield move
