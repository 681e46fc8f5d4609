"""What of a recording a diagnosis does not use, and why: nothing that was measured is left out without a word."""

from __future__ import annotations

import numpy as np

from ideal_robot.diagnosis.channels.regression import Regression
from ideal_robot.effects import SENSOR
from ideal_robot.signals.recording import Recording

_FORCE, _MOMENT = ("fx", "fy", "fz"), ("mx", "my", "mz")
_GAPS = "it holds gaps"


def unused_columns(recording: Recording, searched: tuple[Regression, ...]) -> dict[str, str]:
    """Columns that measure something but took no part, with the reason.

    Args:
        recording: checked, with ``tau_i``.
        searched: the regressions of all domains that were searched, that of the motor torques first.
    """
    torque, result = searched[0], {}
    for prefix in ("qa", "temp"):
        for j, there in enumerate(recording.having(prefix)):
            name = f"{prefix}_{j + 1}"
            if name in recording.columns and not there:
                result[name] = _GAPS
            elif there and prefix == "qa" and j + 1 in torque.undecided:
                result[name] = f"joint {j + 1} is left out"
    for name in ("x", "y", "z"):
        if name in recording.columns and not np.all(np.isfinite(recording.columns[name])):
            result[name] = _GAPS
    _together(recording, ("qx", "qy", "qz", "qw"), "the tool's orientation is not looked at", result)
    if recording.has("tau") and recording.has("current") and not _made_of_current(recording):
        _together(recording, tuple(f"current_{j + 1}" for j in range(recording.n)), "torques are there", result)
    sensors = {name for made in searched if made.domain == SENSOR for name in made.channels}
    wrench = tuple(name for name in (*_FORCE, *_MOMENT) if name in recording.columns)
    if wrench and wrench not in (_FORCE, (*_FORCE, *_MOMENT)):
        _together(recording, wrench, "fx fy fz are needed, and mx my mz all or none", result)
    elif wrench and not any(name.startswith(("f", "m", "contact")) for name in sensors):
        _together(recording, wrench, "too little of it, free or in contact, to tell anything", result)
    if "cam_t" in recording.columns and not any(name.startswith("line") for name in sensors):
        result["cam_t, line_x_i, line_y_i, line_z_i"] = "too few fields in which the line was seen"
    for name, values in torque.signals.extra.items():
        if not np.all(np.isfinite(values)):
            result[name] = _GAPS
        elif np.ptp(values) == 0.0:
            result[name] = "it never changes"
    return result


def _together(recording: Recording, names: tuple[str, ...], why: str, result: dict[str, str]) -> None:
    there = [name for name in names if name in recording.columns]
    if there:
        result[", ".join(there)] = why


def _made_of_current(recording: Recording) -> bool:
    """Whether the torques are nothing but the currents times a factor each."""
    tau, current = recording.joints("tau"), recording.joints("current")
    with np.errstate(invalid="ignore", divide="ignore"):
        factor = np.nansum(tau * current, axis=0) / np.nansum(current**2, axis=0)
    return bool(np.allclose(tau, factor * current, rtol=1e-6, atol=1e-9, equal_nan=True))
