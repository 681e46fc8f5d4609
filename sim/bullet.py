"""PyBullet, imported without the build banner that it writes past Python's streams."""

from __future__ import annotations

import os
import sys

sys.stdout.flush()
sys.stderr.flush()
_saved = [os.dup(1), os.dup(2)]
_nowhere = os.open(os.devnull, os.O_WRONLY)
try:
    os.dup2(_nowhere, 1)
    os.dup2(_nowhere, 2)
    import pybullet
finally:
    for _stream, _copy in zip((1, 2), _saved, strict=True):
        os.dup2(_copy, _stream)
        os.close(_copy)
    os.close(_nowhere)

__all__ = ["pybullet"]
