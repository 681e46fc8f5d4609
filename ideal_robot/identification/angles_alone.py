"""Identification from commands and angles alone: the command's law, without torques."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from ideal_robot.command.recorded import commands_of, first_rest, moving_at_start, with_commands
from ideal_robot.errors import InputError
from ideal_robot.identification.command import identify_command
from ideal_robot.identification.whole_model import IdentificationResult, command_figures, identify_model
from ideal_robot.model.model import Model
from ideal_robot.progress import Progress, silent
from ideal_robot.results import Figure, Summarised, listed, one_unit, over_time, plain
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.clean import NO_CONTROLLER, cleaned
from ideal_robot.signals.recording import Recording, expect, recordings_of


@dataclass(frozen=True, repr=False)
class CommandIdentification(Summarised):
    """A model from commands and angles alone: data sheet, and the command's law.

    Attributes:
        model: rigid bodies by the URDF, and ``model.command``; ``precorrect``, ``play`` and followers use it.
        recordings: the recordings that it was identified from.
        warnings: named warnings, each ``name: sentence``.
        missing: parts that the recordings do not determine, each ``part: what is needed``.
    """

    model: Model
    recordings: tuple[Recording, ...]
    warnings: tuple[str, ...]
    missing: tuple[str, ...]

    def summary(self) -> list[tuple[str, str]]:
        """Rows of label and value: each joint's controller, and its residual."""
        law, unit = self.model.command, one_unit(self.model.units("mrad"))
        assert law is not None
        return [("model", f"{self.model.arm.name!r}: commands of {self.model.n} joints; no torques"),
                ("command minus angle", listed(1e3 * law.deviation, unit)),
                ("left on held-out data", listed(1e3 * law.residual, unit)),
                ("not in the recordings", ", ".join(text.partition(":")[0] for text in self.missing))]

    def plot(self) -> Figure:
        """Command minus angle of the first recording, joint by joint."""
        first = self.recordings[0]
        off = 1e3 * (first.joints(commands_of(first)) - first.joints("q"))
        return over_time(first.t, [(f"joint {j + 1} [{unit}]", [("command minus angle", off[:, j])])
                                   for j, unit in enumerate(self.model.units("mrad"))], self.model.arm.name)

    def to_dict(self) -> dict[str, Any]:
        """The figures as plain values."""
        model = self.model
        return plain({"robot": {"name": model.arm.name, "urdf_hash": model.arm.urdf_hash, "joints": model.n},
                      "method": model.provenance["method"], "command": command_figures(model),
                      "recordings": model.provenance["recordings"], "warnings": self.warnings,
                      "missing": self.missing})


def identify_arm(recordings: Recording | Sequence[Recording], robot: Robot, *, progress: Progress = silent,
                 **options: Any) -> IdentificationResult | CommandIdentification:
    """Identifies all that the recordings permit: the whole model with torques, the command's law without.

    Args:
        recordings: with ``t`` [s], ``q_i`` [rad], and ``tau_i`` [N m] or ``current_i`` [A] or commands ``q_c_i`` [rad].
        robot: the arm.
        progress: called with the share done and the present step.
        options: of ``identify_model``, which identifies the whole model.

    Raises:
        InputError: recordings that cannot be used, an unknown method.
    """
    given = recordings_of(recordings, "recordings")
    if not without_torque(given):
        return identify_model(given, robot, progress=progress, **options)
    return identify_from_commands(given, robot, progress=progress)


def without_torque(recordings: Sequence[Recording]) -> bool:
    """Whether the recordings have commands and angles but no torques."""
    return bool(recordings) and all(
        commands_of(r) and not any(name.startswith(("tau_", "current_")) for name in r.columns) for r in recordings)


def identify_from_commands(recordings: Recording | Sequence[Recording], robot: Robot, *,
                           progress: Progress = silent) -> CommandIdentification:
    """The command's law from commands and angles, with the URDF's bodies as far as they help.

    Args:
        recordings: with ``t`` [s], ``q_i`` and ``q_c_i`` (or ``q_d_i``) [rad], at any rate.
        robot: the arm.
        progress: called with the share done.

    Raises:
        InputError: another number of joints, degrees, commands that the joints do not follow, too short, in motion
            when it starts.
    """
    expect(robot, Robot, "robot", "load one by Robot.load")
    used, warnings = [], []
    for recording in recordings_of(recordings, "recordings"):
        own, texts = _checked(recording, robot)
        used.append(own)
        warnings += [f"{text} [{recording.source}]" for text in texts]
    model = Model.nominal(robot)
    law = identify_command(used, model, torque=False, progress=progress)
    model = dataclasses.replace(model, command=law, provenance={
        "method": "commands and angles alone",
        "recordings": [{"source": r.source, "hash": r.hash} for r in used]})
    missing = (f"friction, rigid body: torques tau_1 to tau_{robot.n} or currents are needed; diagnosis needs them too",
               "stiffness, damping: measured arm angles and torques are needed; gears count as rigid")
    return CommandIdentification(model, tuple(used), tuple(warnings), missing)


def _checked(recording: Recording, robot: Robot) -> tuple[Recording, list[str]]:
    """The recording without what cannot be, and what was wrong; raises InputError for what cannot be mended."""
    done = cleaned(with_commands(recording), robot, torques=False, commands=True)
    recording, source = done.recording, done.recording.source
    if not recording.has("q_c"):
        why = next((text.partition(": ")[2] for text in done.acts if text.startswith(NO_CONTROLLER)), "no commands")
        raise InputError(why, file=source, field="q_c_1")
    if (j := moving_at_start(recording.t, recording.joints("q"))) is not None:
        rest = first_rest(recording.t, recording.joints("q"))
        cut = f", or cut this one at t = {rest:.3f} s, where all joints rest" if rest is not None else ""
        raise InputError("the log starts in motion, and what its controller remembers of the time before is not in "
                         f"it; begin logging before the arm moves{cut}", file=source, field=f"q_{j + 1}")
    return recording, list(done.acts)
