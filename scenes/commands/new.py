"""``ideal-robot new``: a commented scene file to start from."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def command(
    name: Annotated[str, typer.Argument(help="Name of the scene; the file is NAME.toml in this folder.")],
    kind: Annotated[str, typer.Option(help="Kind of scene: line, path, force, clamped or close_clamped.")] = "line",
    force: Annotated[bool, typer.Option("--force", help="Replace a file of that name.")] = False,
) -> None:
    """Writes a scene file that can be played at once and says in comments which keys there are besides.

    Example: `ideal-robot new weld_seam --kind line`
    """
    from ideal_robot.errors import InputError
    from ideal_robot.whole_file import write_text
    from scenes.kind import KINDS
    from scenes.scene_file import library, load_scene
    from scenes.scene_files.scene import NAME
    from scenes.schema import commented_scene

    if not NAME.fullmatch(name):
        raise InputError("expected letters, digits and _ - + . ( ) or spaces", field="NAME", value=name)
    KINDS.get(kind)
    path = Path(f"{name}.toml")
    if path.exists() and not force:
        raise InputError("there is such a file already; take another name, or --force", file=path)
    examples = {"line": "line", "path": "iso9283_1", "force": "force_wave", "clamped": "clamped_kr500_1",
                "close_clamped": "close_clamped"}
    found = examples.get(kind)
    if found is None:
        raise InputError("no shipped scene is of that kind; see the documentation of the package that added it",
                         field="--kind", value=kind)
    write_text(path, commented_scene(name, kind, (library() / f"{found}.toml").read_text(encoding="utf-8")))
    load_scene(f"./{path}")
    typer.echo(f"written: {path}")
    typer.echo(f"play it: ideal-robot run ./{path}")
