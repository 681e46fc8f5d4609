"""What an arm measures beside its motor angles and currents: nothing, its arm angles, or the place of its tool too."""

from __future__ import annotations

from typing import Literal, cast

from ideal_robot.errors import InputError
from ideal_robot.signals.recording import Recording

Measured = Literal["motor", "arm", "tcp"]
"""Motor angles and currents only; arm angles too; the tool's place too."""
_PLACE = ("x", "y", "z", "qx", "qy", "qz", "qw")
_HIDDEN = {"motor": _PLACE, "arm": _PLACE, "tcp": ()}


def visible(recording: Recording, measured: Measured) -> Recording:
    """The recording with what such an arm measures.

    Args:
        recording: with everything.
        measured: what is measured.
    """
    kept = {name: values for name, values in recording.columns.items()
            if name not in _HIDDEN[measured] and not (measured == "motor" and name.startswith("qa_"))}
    return Recording(kept, recording.meta, recording.source)


def checked_measured(value: str) -> Measured:
    """What the arm measures, as given on the command line.

    Raises:
        InputError: another word than motor, arm and tcp.
    """
    if value not in _HIDDEN:
        raise InputError("expected motor, arm or tcp", field="--measured", value=value)
    return cast(Measured, value)
