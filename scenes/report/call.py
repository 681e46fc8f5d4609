"""A command's recording, robot and model as they were typed, for the next commands that a page proposes."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import NamedTuple


class Call(NamedTuple):
    """Arguments of a command; placeholders where they are unknown.

    Attributes:
        recording, robot: as typed.
        model: the model that was given, or None.
        reading: options that say how the recording is read, as typed.
    """

    recording: str | Path = "RECORDING"
    robot: str = "ROBOT"
    model: str | Path | None = None
    reading: tuple[str, ...] = ()

    @property
    def of_robot(self) -> str:
        """The option that names the robot, quoted for a shell."""
        return shlex.join(["--robot", self.robot])

    @property
    def recorded(self) -> str:
        """The arguments for the recording, its robot and its reading, quoted for a shell."""
        return shlex.join([str(self.recording), "--robot", self.robot, *self.reading])

    def __str__(self) -> str:
        return self.recorded + ("" if self.model is None else " " + shlex.join(["--model", str(self.model)]))


UNKNOWN = Call()
"""Of a page whose maker does not know how it was called."""
