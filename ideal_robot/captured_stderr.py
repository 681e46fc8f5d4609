"""What libraries written in C say on standard error while they read a file, which our one line stands for."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from typing import IO


@contextmanager
def kept_words() -> Iterator[IO[bytes]]:
    """Yields the file that gets what is written to standard error, below Python, while the block runs."""
    sys.stderr.flush()
    with tempfile.TemporaryFile() as said:
        before = os.dup(2)
        os.dup2(said.fileno(), 2)
        try:
            yield said
        finally:
            os.dup2(before, 2)
            os.close(before)
