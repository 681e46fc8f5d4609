"""Checks recordings before they are used.

Errors stop; warnings have a name, so that people and programs can look for them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ideal_robot.errors import InputError
from ideal_robot.identification.weighted_least_squares import Solution
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.clean import STILL, cleaned
from ideal_robot.signals.recording import Recording

_NAMED = 8
"""Parameters that a warning names; a line on the screen holds no more."""


def checked(recordings: Sequence[Recording], robot: Robot, *, commands: bool = False
            ) -> tuple[list[Recording], list[str]]:
    """Recordings ready for identification, with ``tau_i``, and named warnings; see ``ideal_robot.signals.clean``.

    Args:
        recordings: as they were read.
        robot: joints, limits, drive gains.
        commands: whether the commands ``q_c_i``, where there are any, are used too.
    """
    done = [cleaned(recording, robot, commands=commands) for recording in recordings]
    return ([one.recording for one in done],
            [f"{text} [{one.recording.source}]" for one in done for text in one.acts])


def require_distinct(recordings: Sequence[Recording]) -> None:
    """Raises InputError for duplicate recordings, which would be weighted twice, or serve as their own validation."""
    known: dict[str, Recording] = {}
    for recording in recordings:
        if (other := known.setdefault(recording.hash, recording)) is not recording:
            raise InputError(f"holds the same samples as {other.source}; give each recording once, and another one to "
                             "validate with", file=recording.source, field="recording")


def require_motion(recordings: Sequence[Recording]) -> None:
    """Raises InputError where no joint moves in any of the recordings."""
    if recordings and all((np.ptp(recording.joints("q"), axis=0) < STILL).all() for recording in recordings):
        raise InputError(f"no joint moves (none by {STILL:g} rad or m); record a motion, e.g. that of "
                         "plan-identification", file=recordings[0].source, field="q_i")


def _some(names: Sequence[str]) -> str:
    """The first names, and how many more there are: each parameter has its standard deviation beside it anyway."""
    more = len(names) - _NAMED
    return ", ".join(names[:_NAMED]) + (f" and {more} more" if more > 0 else "")


def excitation_warnings(model: Model, solution: Solution) -> list[str]:
    """Warnings about parameters that the data do not determine, from the solution's statistics.

    Args:
        model, solution: the identified model, and its least-squares solution.
    """
    warnings = []
    parameters = model.parameters
    within_friction = {f"offset_{j + 1}" for j, law in enumerate(model.friction.laws) if law.holds_offset}
    silent = [p.name for p, dark in zip(parameters, solution.unexcited, strict=False)
              if dark and p.name not in within_friction]
    if silent:
        warnings.append(f"not-excited: the motion says nothing about {_some(silent)}; nominal values are kept")
    vague = [p.name for p, dark in zip(parameters, solution.unexcited, strict=False)
             if not dark and p.std > 0.3 * abs(p.value)]
    if vague:
        warnings.append(f"poorly-excited: standard deviation above 30 % of the value for {_some(vague)}")
    if solution.condition_number_scaled > 200.0:
        warnings.append(f"ill-conditioned: condition number {solution.condition_number_scaled:.3g} with scaled "
                        "columns; a motion from plan-identification excites better")
    bounds = [p.name for p, held in zip(parameters, solution.at_bound, strict=False) if held]
    if bounds:
        warnings.append(f"friction-at-bound: {', '.join(bounds)} would be negative and is held at zero; the motion has "
                        "too few speeds to distinguish the parts of friction, or something else acts like friction")
    return warnings
