"""How long work tells how far it is."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[float, str], None]
"""Told the share that is done and a word for what is being done."""


def silent(fraction: float, text: str) -> None:
    """A progress that nobody looks at."""
