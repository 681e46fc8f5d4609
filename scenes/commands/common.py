"""Shared parts of the verbs: options, numbers, tables, the progress bar, and how a run ends."""

from __future__ import annotations

import math
import os
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer

from ideal_robot.errors import InputError
from ideal_robot.progress import Progress as Told
from scenes.verdict import COLOURS, Verdict

if TYPE_CHECKING:
    from rich.console import Console

    from ideal_robot.signals.recording import Recording
    from scenes.result import RunResult


def shown(text: object) -> str:
    """The text on one line, with whatever a terminal would act on (escapes, bells, direction marks) spelt out."""
    return "".join(c if c.isprintable() else " " if c in "\n\t" else c.encode("unicode_escape").decode()
                   for c in str(text))


@contextmanager
def progress_bar(title: str, rate: float = 10.0) -> Iterator[Told]:
    """A bar on standard error while the block runs; yields the function that moves it.

    A thread draws it ``rate`` times a second, and takes Python's lock for that.
    """
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
    from rich.table import Column

    # Where the width does not suffice, text is cut, never a number.
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


N = TypeVar("N", int, float)
_MOST_NUMBERS = 100_000  # seeds of a command; 1-10⁹ is a typing error
_NO_EDGE = 10_000
"""Columns of an output that is no terminal."""


def show_table(title: str, columns: list[str], rows: list[list[Any]]) -> None:
    """Prints a table; floats with three significant digits.

    In a pipe the table is as wide as it needs to be. In a terminal long texts are folded between words; where the
    longest words do not fit beside each other between borders, there are none; where they do not fit at all, every row
    becomes a block of lines.

    Args:
        title: above the table; empty for none.
        columns, rows: titles and cells.
    """
    from rich.box import HEAVY_HEAD
    from rich.cells import cell_len
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    console = Console(width=None if sys.stdout.isatty() or os.environ.get("COLUMNS") else _NO_EDGE)
    names = [shown(column) for column in columns]
    cells = [[shown(_cell(cell)) for cell in row] for row in rows]
    styles = [[COLOURS[cell.kind] if isinstance(cell, Verdict) else "" for cell in row] for row in rows]
    texts = [[name, *(row[i] for row in cells)] for i, name in enumerate(names)]
    least = [max(cell_len(word) for text in column for word in (*text.split(), "")) for column in texts]
    # Text, not str, as rich would read a name such as [/red] as markup.
    if sum(least) + len(least) > console.width:
        _show_blocks(console, title, names, cells, styles)
        return
    bordered = sum(least) + 3 * len(least) + 1 <= console.width
    room = console.width - (3 * len(least) + 1 if bordered else len(least))
    table = Table(title=Text(shown(title)) if title else None, title_justify="left",
                  box=HEAVY_HEAD if bordered else None, padding=(0, 1) if bordered else (0, 1, 0, 0))
    for name, width in zip(names, _widths(least, [max(map(cell_len, column)) for column in texts], room), strict=True):
        table.add_column(Text(name), overflow="fold", width=width)
    for row, colours in zip(cells, styles, strict=True):
        table.add_row(*map(Text, row, colours))
    console.print(table)


def _widths(least: list[int], wanted: list[int], room: int) -> list[int]:
    """Widths of a table's columns: their longest words at least, the rest of the room to those that lack most of it."""
    widths = list(least)
    for _ in range(min(room, sum(wanted)) - sum(least)):
        lacking = [want - width for want, width in zip(wanted, widths, strict=True)]
        widths[lacking.index(max(lacking))] += 1
    return widths


def _cell(cell: Any) -> str:
    if isinstance(cell, float):
        return "–" if math.isnan(cell) else f"{cell:.3g}"
    return "–" if cell is None else str(cell)


def _show_blocks(console: Console, title: str, names: list[str], cells: list[list[str]],
                 styles: list[list[str]]) -> None:
    """Rows one below the other, each cell on a line of its own: for terminals too narrow for a table."""
    from rich.text import Text

    if title:
        console.print(Text(shown(title), style="italic"), overflow="fold")
    for row, colours in zip(cells, styles, strict=True):
        console.print(Text(row[0] or "–", style="bold"), overflow="fold")
        for name, cell, colour in zip(names[1:], row[1:], colours[1:], strict=True):
            console.print(Text(f"  {name}: ").append(cell, colour), overflow="fold")


def write_signed(path: Path | None, content: dict[str, Any]) -> None:
    """Writes the figures as JSON with the version that made them, where a file is given."""
    from scenes.program import signed
    from scenes.report.page import write_json

    if path is not None:
        write_json(path, signed(content))


def closed(run: RunResult) -> None:
    """Prints the result of a run; exit code 1 where it ended early."""
    show_table("", ["figure", "value"], [list(pair) for pair in run.summary()])
    if run.report is not None:
        typer.echo(f"report: {run.report}")
    for sentence, command in run.next_steps()[:1]:
        typer.echo(f"next: {sentence} {command}")
    if run.failure is not None:
        typer.echo(f"ideal-robot: {run.failure}", err=True)
        raise typer.Exit(1)


def length(text: str, option: str) -> float:
    """A length in metres from ``0.2mm``, ``200um`` or ``0.0002``.

    >>> length("2.5mm", "--tolerance")
    0.0025
    """
    match = re.fullmatch(r"\s*([0-9.eE+-]+)\s*(mm|um|µm|m|)\s*", text)
    value = _number(match[1], float, option, text) if match else math.nan
    if match is None or not (math.isfinite(value) and value > 0):
        raise InputError("expected a positive length such as 0.2mm", field=option, value=text[:60])
    return value * {"mm": 1e-3, "um": 1e-6, "µm": 1e-6}.get(match[2], 1.0)


def numbers(text: str, option: str) -> list[float]:
    """Finite numbers from ``1,2,5``; empty text gives none."""
    values = [_number(piece.strip(), float, option, text) for piece in text.split(",") if piece.strip()]
    if not all(map(math.isfinite, values)):
        raise InputError("expected finite numbers separated by commas", field=option, value=text[:60])
    return values


def whole_numbers(text: str, option: str) -> list[int]:
    """Numbers of 0 and above from ``1,2,5`` or ``1-10`` (both ends included); empty text gives none.

    >>> whole_numbers("1-3,7", "--seeds")
    [1, 2, 3, 7]
    """
    values: list[int] = []
    for piece in (piece.strip() for piece in text.split(",") if piece.strip()):
        first, dash, last = piece.partition("-")
        low = _number(first, int, option, text)
        high = _number(last, int, option, text) if dash else low
        if not 0 <= low <= high < 2**63 or high - low >= _MOST_NUMBERS:
            raise InputError(f"expected whole numbers from 0 up, at most {_MOST_NUMBERS}, or a range such as 1-10",
                             field=option, value=text[:60])
        values.extend(range(low, high + 1))
    return values


def _number(piece: str, kind: type[N], option: str, text: str) -> N:
    try:
        return kind(piece)
    except ValueError as error:
        whole = kind is int
        raise InputError(f"expected {'whole ' if whole else ''}numbers separated by commas"
                         + (" or a range such as 1-10" if whole else ""), field=option, value=text[:60]) from error


def recording_of(path: Path, columns: Path | None, topic: str | None, joints: str | None) -> Recording:
    """A recording read as the options ``--columns``, ``--topic`` and ``--joints`` say.

    Args:
        path, columns: of the recording, and of a map of its columns.
        topic, joints: the ROS topic of its joint states, and names of joints separated by commas.
    """
    from ideal_robot.signals.recording import Recording

    names = None if joints is None else [name.strip() for name in joints.split(",") if name.strip()]
    return Recording.read(path, columns=columns, topic=topic, joints=names)


def reading_options(columns: Path | None, topic: str | None, joints: str | None, drive_data: Path | None = None
                    ) -> tuple[str, ...]:
    """The words of the options by which a recording is read, for the command proposed next.

    Args:
        columns, topic, joints, drive_data: as typed; None where they were not given.
    """
    given = {"--columns": columns, "--topic": topic, "--joints": joints, "--drive-data": drive_data}
    return tuple(word for option, value in given.items() if value is not None for word in (option, str(value)))


def scenes_there(given: Any) -> Any:
    """Returns scenes unchanged, or raises InputError for none or two of that name, before slow imports."""
    from scenes.scene_file import find_scene

    for scene in given if isinstance(given, (list, tuple)) else [given]:
        find_scene(scene)
    return given


def arm_there(given: Any) -> Any:
    """Returns a robot's name or file unchanged; raises InputError where it is neither. None is returned as it is."""
    from ideal_robot.robots import urdf_of

    if given is not None:
        urdf_of(given)
    return given


Bridge = Annotated[float, typer.Option(help="How long packets may be lost in a row [s].", min=0.0, max=1.0)]
ControllerAddress = Annotated[str | None, typer.Option(help="Listen to this address only.")]
ColumnsMap = Annotated[Path | None, typer.Option("--columns", help="Map of a table's columns (TOML, see "
                                                 "docs/files.md); default: recognised by their titles.")]
Core = Annotated[int | None, typer.Option(help="Processor core to keep to.", min=0)]
Cycle = Annotated[float | None, typer.Option(help="Interpolation cycle [s], e.g. 0.004; default: robot's.")]
DriveData = Annotated[Path | None, typer.Option(help="Drive data of the arm (TOML): gains, rotor inertias, cycles; "
                                                "default: beside the URDF.")]
Individual = Annotated[int | None, typer.Option(help="Arm of the type, with a model of its own (see prepare).", min=0)]
JsonFigures = Annotated[Path | None, typer.Option(help="Write the figures as JSON to this file.")]
JsonPlan = Annotated[Path | None, typer.Option(help="Write the plan and its figures as JSON to this file.")]
JsonResults = Annotated[Path | None, typer.Option(help="Write the results as JSON to this file.")]
JointNames = Annotated[str | None, typer.Option("--joints", help="Joints to read, by their names in the file, "
                                                "in the arm's order, separated by commas.")]
ModelsRobot = Annotated[str | None, typer.Option("--robot", "--urdf", help="Arm: name of a shipped robot, or path of a "
                                                 "URDF; default: the one the model names.",
                                                 callback=arm_there)]
PlannerDelay = Annotated[bool, typer.Option(help="The standard path planner's delay of one cycle is in force.")]
ReportFolder = Annotated[Path, typer.Option(help="Folder of the report.")]
Rest = Annotated[float, typer.Option(help="Rest added before the path [s], for the gears' deflection.")]
RobotName = Annotated[str, typer.Option("--robot", "--urdf", help="Arm: name of a shipped robot, or path of a URDF.",
                                        callback=arm_there)]
SceneName = Annotated[str, typer.Argument(help="Name of a shipped scene, or path of a scene file (.toml).",
                                          callback=scenes_there)]
SearchSeed = Annotated[int, typer.Option(help="Seed of the search.", min=0)]
Seed = Annotated[int | None, typer.Option(help="Seed instead of the scene's.", min=0)]
Speed = Annotated[float | None, typer.Option(help="Path speed [m/s] instead of the scene's.")]
StatesTopic = Annotated[str | None, typer.Option("--topic", help="Topic of the joint states in a bag, or part of the "
                                                 "titles' path in a table; default: /joint_states, or the only one.")]
TimeLimit = Annotated[float, typer.Option(help="How long a run may take [s]; one that takes longer is ended, begun "
                                               "once more, and then not played.", min=0.001)]


def methods_of(verb: str) -> tuple[str, ...]:
    """Methods of ``rsi`` (no runs beforehand) or ``precorrect`` (no runs at all), other packages' included."""
    from ideal_robot.feedforward.method import Needs
    from ideal_robot.feedforward.registry import methods, settings

    if verb == "rsi":
        from scenes.rsi.server import methods as played

        return played()
    return (*methods(Needs.PATH), *settings(Needs.PATH))


def completed(verb: str, incomplete: str) -> list[str]:
    """Methods of a verb that begin with the typed letters, for completion."""
    return [key for key in methods_of(verb) if key.startswith(incomplete)]
