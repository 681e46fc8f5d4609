"""Pages of the site made of the notebooks, with the outputs that ``docs/execute_notebooks.py`` keeps."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import nbformat
from mkdocs.structure.files import File
from nbconvert import MarkdownExporter

from docs.execute_notebooks import NOTEBOOKS, outputs_of

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
