"""Pages of the documentation site that are made: what a user imports, all modules, keys of scenes, the notebooks.

A hook of MkDocs (``mkdocs.yml``); nothing is written into the source folder. The environment variable ``SITE_ROOMS``
names the rooms whose API is made, parted by commas; without it all are.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

import griffe
import nbformat
from mkdocs.structure.files import File, Files
from nbconvert import MarkdownExporter

import ideal_robot
import scenes
from docs.effects_table import with_table
from docs.execute_notebooks import NOTEBOOKS, outputs_of
from scenes.schema import keys_pages

ROOT = Path(__file__).resolve().parents[1]

PACKAGES = ("ideal_robot", "sensing", "planning", "sim", "scenes")
DOORS = (
    ("ir", "import ideal_robot as ir", "Robots, recordings, models, diagnoses and corrected paths.",
     {name: f"ideal_robot.{place.replace(':', '.')}" for name, place in ideal_robot._PLACES.items()}),
    ("scenes", "from scenes import load_scene, run_scene", "Scenes from Python, for scripts and regression tests.",
     {name: f"{module}.{name}" for name, module in scenes._WHERE.items()}),
)
"""Prefix, import, summary, and names at the door with the place behind each."""
FIRST = ("Robot", "Recording", "identify", "diagnose", "precorrect", "load_scene", "run_scene")
"""What most scripts begin with."""

_TOGETHER = re.compile(r"^ +\w+(?:, \w+)+: ", flags=re.MULTILINE)
"""Names that share a description in a docstring."""


class NamedTogether(griffe.Extension):
    """Keeps ``q_min, q_max: limits`` in one cell of a table; what follows a space would be taken for a type."""

    def on_object(self, *, obj: griffe.Object, **kept: Any) -> None:
        """Parts the names by spaces that are not taken for one."""
        if obj.docstring is not None:
            obj.docstring.value = _TOGETHER.sub(lambda match: match[0].replace(", ", ",\N{NO-BREAK SPACE}"),
                                                obj.docstring.value)


def on_files(files: Files, config: Any) -> Files:
    """Adds the generated pages."""
    files.append(File.generated(config, "api/index.md", content=doors()))
    listed: list[str] = []
    for room, modules in rooms().items():
        summary = (ROOT / room.replace(".", "/") / "__init__.py").read_text(encoding="utf-8").strip("\"\n ")
        first = summary.partition("\n")[0].strip('"') if summary.startswith(tuple("ABCDEFGHIJKLMNOPQRSTUVWXYZ")) else ""
        text = "\n\n".join([f"# {room}", first, *(f"::: {module}" for module in modules)])
        files.append(File.generated(config, f"api/modules/{room}.md", content=text))
        listed.append(f"- [{room}]({room}.md): {first}")
    content = "\n".join(["# Modules, room by room", "", *listed])
    files.append(File.generated(config, "api/modules/index.md", content=content))
    for name, text in keys_pages().items():
        files.append(File.generated(config, name, content=text))
    for file in notebook_files(config):
        files.append(file)
    return files


def on_page_markdown(markdown: str, page: Any, **kept: Any) -> str:
    """Puts in the table of effects, and leads links to notebooks to the pages made of them."""
    markdown = with_table(markdown)
    return markdown if page.file.src_uri.startswith("notebooks/") else linked(markdown)


def doors() -> str:
    """The page of what a user imports, those that most scripts begin with first."""
    parts = ["# What scripts use", "Everything here is public and keeps its name. Results print themselves, and have "
             "`to_dict()` and `plot()`. `examples/` has scripts of ten lines; *Modules* has what is behind them."]
    for prefix, statement, summary, places in DOORS:
        parts += [f"## {statement}", summary]
        for name in sorted(places, key=lambda name: (FIRST.index(name) if name in FIRST else len(FIRST), name.lower())):
            heading = f"{prefix}.{name}" if prefix == "ir" else name
            parts.append(f"::: {places[name]}\n    options:\n      heading: {heading}\n      "
                         f"toc_label: {heading}\n      heading_level: 3")
    return "\n\n".join(parts)


def rooms() -> dict[str, list[str]]:
    """Rooms of all packages, and the public modules in each."""
    by_room: dict[str, list[str]] = {}
    for package in PACKAGES:
        for folder in sorted({path.parent for path in (ROOT / package).rglob("*.py")}):
            room = ".".join(folder.relative_to(ROOT).parts)
            modules = [f"{room}.{path.stem}" for path in sorted(folder.glob("*.py")) if not path.stem.startswith("_")]
            if modules and room != "scenes.commands":
                by_room[room] = modules
    chosen = os.environ.get("SITE_ROOMS")
    return by_room if chosen is None else {room: by_room[room] for room in chosen.split(",")}


# Pages of the site made of the notebooks, with the outputs that ``docs/execute_notebooks.py`` keeps.

WIDGET = "application/vnd.jupyter.widget-view+json"
NO_OUTPUTS = "!!! note\n\n    This page was made without outputs: `make docs-notebooks` plays the notebooks first.\n\n"


def notebook_files(config: Any) -> list[File]:
    """A page for each notebook, and its pictures."""
    files = []
    for path in NOTEBOOKS:
        text, pictures = page_of(path)
        files.append(File.generated(config, f"notebooks/{path.stem}.md", content=text))
        files += [File.generated(config, f"notebooks/{name}", content=content) for name, content in pictures.items()]
    return files


def page_of(path: Path) -> tuple[str, dict[str, bytes]]:
    """Markdown of a notebook, and its pictures by their path from the page."""
    played = outputs_of(path)
    book = played if played is not None else nbformat.read(path, as_version=4)
    for cell in book.cells:
        cell.outputs = [shown(output) for output in cell.get("outputs", []) if output.get("name") != "stderr"]
    folder = f"{path.stem}_outputs"
    body, resources = MarkdownExporter().from_notebook_node(
        book, resources={"unique_key": path.stem, "output_files_dir": folder})
    title, _, rest = body.strip().partition("\n")
    opened = f"*[This page as a notebook]({path.name}): `jupyter lab docs/notebooks/{path.name}`.*\n\n"
    return f"{title}\n\n{opened}{'' if played is not None else NO_OUTPUTS}{rest}", resources["outputs"]


def shown(output: Any) -> Any:
    """An output as a page without a kernel can show it."""
    if WIDGET in output.get("data", {}):
        output.data = {"text/markdown": "*Here is a slider in Jupyter.*"}
    return output


def linked(markdown: str) -> str:
    """A page's links to notebooks, led to their pages."""
    return re.sub(r"\]\(((?:\.\./)*notebooks/\w+)\.ipynb\)", r"](\1.md)", markdown)
