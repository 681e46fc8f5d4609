"""What closings of an arm share: what the arm measures, a motion at several speeds, and where the tool is by that."""

from __future__ import annotations

from itertools import pairwise
from typing import Literal, cast

import numpy as np

from ideal_robot.arrays import Array, eased
from ideal_robot.effects import FittedEffect
from ideal_robot.elasticity.observer import GearDeflection
from ideal_robot.errors import InputError
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from scenes.metrics import path_errors

_STEPS = 80
"""Cycles of the way from the end of one speed to the start of the next."""


def at_speeds(motion: Array, slownesses: tuple[float, ...]) -> Array:
    """A joint motion ``(N, n)`` [rad] at several speeds, one after the other ``(M, n)`` [rad]."""
    rows = np.arange(len(motion))
    parts = [np.column_stack([np.interp(np.arange(0.0, len(motion) - 1, 1.0 / slowness), rows, q) for q in motion.T])
             for slowness in slownesses]
    s = np.linspace(0.0, 1.0, _STEPS)[:, None]
    ease = eased(s)
    return np.concatenate([parts[0], *[np.concatenate([a[-1] + (b[0] - a[-1]) * ease, b]) for a, b in pairwise(parts)]])


def tool_deviation(recording: Recording, wanted: tuple[Array, Array, Array], robot: Robot, known: Model,
                   loads: tuple[FittedEffect, ...] = (), doubt: float = 0.0) -> Array:
    """Deviation of the tool from where it was to be, aligned, as the arm itself measures it ``(N,)`` [m].

    The tool's place where it is recorded, else that of the arm angles. Motor angles alone are brought behind the gears
    by what was known of these before, so that a changed stiffness cannot confirm itself; what the gears carry, which
    currents show, counts.

    Args:
        recording: of what is measured.
        wanted: instants ``(M,)`` [s] one cycle apart, joint angles at them ``(M, n)`` [rad], and which count ``(M,)``.
        robot: kinematics as drawn.
        known: the model of before.
        loads: that the model which is tried puts on the gears beyond the known one.
        doubt: share by which what these bend is taken to be more.
    """
    t, q_d, counts = wanted
    if all(axis in recording.columns for axis in "xyz"):
        x: Array = np.column_stack([recording.columns[axis] for axis in "xyz"])
    elif recording.has("qa"):
        x = tool(robot, recording.joints("qa"))
    else:
        bent = _deflections(known, t, q_d, recording.t)
        if loads:
            bent = bent + (1.0 + doubt) * (_deflections(known.with_effects(loads), t, q_d, recording.t) - bent)
        x = tool(robot, recording.joints("q") - bent)
    return path_errors(t[counts], tool(robot, q_d[counts]), recording.t, x).aligned.deviation


def tool(robot: Robot, q: Array) -> Array:
    """Places of the tool ``(N, 3)`` [m] at joint angles ``(N, n)`` [rad]."""
    pose = robot.fk()
    return np.array([pose(row).translation for row in q])


def _deflections(model: Model, t: Array, q_d: Array, at: Array) -> Array:
    """Deflection of the gears ``(M, n)`` [rad] at times ``(M,)`` [s], as a model expects it along a motion."""
    gears = GearDeflection(model, float(t[1] - t[0]))
    at_cycles = gears.along(np.concatenate([q_d[:1], q_d, q_d[-1:]]))[1:-1]
    return np.column_stack([np.interp(at, t, column) for column in at_cycles.T])


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
