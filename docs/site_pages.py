"""Pages of the documentation site that are made from the code: the API, room by room.

A hook of MkDocs (``mkdocs.yml``); nothing is written into the source folder.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("ideal_robot", "sensing", "planning", "sim", "scenes")


def on_files(files: Files, config: Any) -> Files:
    """Adds the generated pages."""
    for room, modules in rooms().items():
        summary = (ROOT / room.replace(".", "/") / "__init__.py").read_text(encoding="utf-8").strip("\"\n ")
        first = summary.partition("\n")[0].strip('"') if summary.startswith(tuple("ABCDEFGHIJKLMNOPQRSTUVWXYZ")) else ""
        text = "\n\n".join([f"# {room}", first, *(f"::: {module}" for module in modules)])
        files.append(File.generated(config, f"api/{room}.md", content=text))
    return files


def rooms() -> dict[str, list[str]]:
    """Rooms of all packages, and the public modules in each."""
    found: dict[str, list[str]] = {}
    for package in PACKAGES:
        for folder in sorted({path.parent for path in (ROOT / package).rglob("*.py")}):
            room = ".".join(folder.relative_to(ROOT).parts)
            modules = [f"{room}.{path.stem}" for path in sorted(folder.glob("*.py")) if not path.stem.startswith("_")]
            if modules and room != "scenes.commands":
                found[room] = modules
    return found
