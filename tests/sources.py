"""The project's folders, and a disk that is full."""

from __future__ import annotations

import resource
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
DATA = ROOT.parent / "shared" / "data"
"""Public data sets, where they lie beside the checkout."""
MODELS = ROOT / "scenes" / "models"
"""Shipped models."""


@contextmanager
def files_of_at_most(size: int) -> Iterator[None]:
    """No file may become larger [bytes]; Python ignores the signal, so that write(2) fails as on a full disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
