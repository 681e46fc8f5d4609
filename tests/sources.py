"""The project's folders and its files as syntax trees, each read once."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
DATA = ROOT.parent / "shared" / "data"
"""Public data sets, where they lie beside the checkout."""
MODELS = ROOT / "scenes" / "models"
"""Shipped models."""


@cache
def trees(folder: str) -> dict[Path, ast.Module]:
    """Files of a folder and what is in them."""
    return {path: ast.parse(path.read_text(encoding="utf-8")) for path in sorted((ROOT / folder).rglob("*.py"))}
