"""A command's recording, robot and model as they were typed, for the commands that a page proposes next."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import NamedTuple


class Call(NamedTuple):
    """What a command was given; placeholders where it is not known.

    Attributes:
        recording, robot: as typed.
        model: that was given, or None.
    """

    recording: str | Path = "RECORDING"
    robot: str = "ROBOT"
    model: str | Path | None = None

    @property
    def of_robot(self) -> str:
        """The robot's option, quoted for a shell."""
        return shlex.join(["--robot", self.robot])

    def __str__(self) -> str:
        given = [] if self.model is None else ["--model", str(self.model)]
        return " ".join(filter(None, (shlex.quote(str(self.recording)), self.of_robot, shlex.join(given))))


UNKNOWN = Call()
"""Of a page whose maker does not know how it was called."""
