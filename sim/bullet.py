"""Imports and uses PyBullet without the banners and warnings that it writes past Python's streams."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def output_dropped() -> Iterator[None]:
    """Drops what C++ code writes to the standard streams within the block; exceptions pass."""
    sys.stdout.flush()
    sys.stderr.flush()
    saved = [os.dup(1), os.dup(2)]
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 1)
        os.dup2(nowhere, 2)
        yield
    finally:
        for stream, copy in zip((1, 2), saved, strict=True):
            os.dup2(copy, stream)
            os.close(copy)
        os.close(nowhere)


with output_dropped():
    import pybullet

__all__ = ["output_dropped", "pybullet"]
