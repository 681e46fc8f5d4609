"""``ideal-robot fetch``: public recordings of real arms, for those who have internet."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def command(
    name: Annotated[str | None, typer.Argument(help="Which data set; without it they are listed.")] = None,
    file: Annotated[Path | None, typer.Option(help="The original file, where it was downloaded by hand.")] = None,
    out: Annotated[Path, typer.Option(help="Folder of the recording.")] = Path("data"),
    json: Annotated[Path | None, typer.Option(help="Write what was fetched, or the list, as JSON to this file.",
                                              )] = None,
) -> None:
    """Gets a public data set by its address, compares it with a checksum, and writes it as a recording.

    None of them is part of this package: each has its own licence, which is written beside the recording.

    Example: `ideal-robot fetch ur10e_ptp`
    """
    from scenes.commands.common import show_table
    from scenes.data_sets import data_sets, fetch
    from scenes.outputs import check_outputs
    from scenes.report.page import write_json

    if name is None:
        rows = [[one.name, one.title, one.licence, one.page] for one in data_sets().values()]
        show_table("public data sets", ["name", "what", "licence", "page"], rows)
        if json is not None:
            write_json(json, {"data_sets": [dict(zip(("name", "title", "licence", "page"), row, strict=True))
                                            for row in rows]})
        return
    check_outputs({"--out": out}, json=json)
    path = fetch(name, out, file=file)
    one = data_sets()[name]
    if json is not None:
        write_json(json, {"name": name, "recording": path, "licence": one.licence, "cite": one.cite, "page": one.page})
    typer.echo(f"{one.title}\nlicence: {one.licence}\ncite: {one.cite}\nrecording: {path}")
