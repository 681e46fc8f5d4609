"""What a fuzzed call of the command line is: a verb, its words, and the files it is given."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np


@dataclass(frozen=True)
class Case:
    """What is called with what.

    Attributes:
        name: kind of the case: verb and format.
        words: of the command line.
        files: name → bytes, in the working folder.
        must_fail: whether exit code 0 would be wrong: a required column is lost.
        interrupted: time by the clock after which Ctrl-C is pressed [s]; None for never.
    """

    name: str
    words: list[str]
    files: dict[str, bytes] = field(default_factory=dict)
    must_fail: bool = False
    interrupted: float | None = None


Maker = Callable[[np.random.Generator, Path], Case]
"""Makes a case from a generator and a folder that lasts, for the sound files."""
