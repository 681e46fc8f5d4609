"""The page of a validation: a model's torques against the measured ones, and the effects it lacks."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from ideal_robot.diagnosis.validation.result import Diagnosis
from ideal_robot.identification.verdict import GOOD, POOR, UNUSABLE, USABLE, WEAK
from ideal_robot.model.parametrisation import Prediction
from scenes.diagnosis.page import add_diagnosis, summary
from scenes.report.call import Call
from scenes.report.page import Report
from scenes.result import extremes
from scenes.verdict import Verdict

COLUMNS = ["joint", "residual % of the torque", "of its scatter %", "standard deviation", "unit", "verdict"]


def validation_page(model: str, recording: str | Path, prediction: Prediction, units: Sequence[str],
                    diagnosis: Diagnosis) -> Report:
    """The page of a validation: residual of each joint, where it is largest, next steps, and the diagnosis folded.

    Args:
        model: its file's name.
        recording: as typed.
        prediction: of the recording by the model.
        units: of each joint's torque.
        diagnosis: of the recording about the model.
    """
    errors, left = prediction.relative_error_percent, np.std(prediction.measured - prediction.tau, axis=0)
    worst = int(np.argmax(left))
    page = Report(f"{model} on {Path(recording).name}",
                  f"{model} leaves {np.nanmin(errors):.0f} to {np.nanmax(errors):.0f} % of the measured torques; the "
                  f"largest residual is {left[worst]:.3g} {units[worst]}, of joint {worst + 1}. {summary(diagnosis)}")
    page.figure(_figure(prediction, worst, units[worst]), f"Left: what the model leaves of each joint's torque. Right: "
                f"measured (gray) and predicted torque (orange) of joint {worst + 1}.")
    page.next(("Identify this arm from the recording, and export the model to MuJoCo.",
               f"ideal-robot identify {Call(recording, 'ARM.urdf')} --model model.json\n"
               "ideal-robot export model.json --mjcf arm.xml"))
    page.table(COLUMNS, rows(prediction, units), "Usable: what is left holds at most a tenth of the torque's power "
               f"({GOOD:.0f} % of its scatter); unusable: half of it and more ({POOR:.0f} %).")
    add_diagnosis(page, diagnosis)
    return page


def rows(prediction: Prediction, units: Sequence[str]) -> list[list[Any]]:
    """The table's rows, one per joint."""
    left = np.std(prediction.measured - prediction.tau, axis=0)
    return [[j + 1, float(error), float(share), float(left[j]), units[j],
             Verdict(USABLE if share <= GOOD else WEAK if share < POOR else UNUSABLE)]
            for j, (error, share) in enumerate(zip(prediction.relative_error_percent, prediction.residual_std_percent,
                                                   strict=True))]


def _figure(prediction: Prediction, worst: int, unit: str) -> Figure:
    figure = Figure(figsize=(9.0, 3.2), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1, 2))
    errors = prediction.relative_error_percent
    left.barh([f"joint {j + 1}" for j in range(len(errors))], errors, color="#2f6690")
    left.invert_yaxis()
    left.set_xlabel("residual [% of the torque]")
    for values, colour in ((prediction.measured, "0.6"), (prediction.tau, "#e06000")):
        shown = extremes(np.ascontiguousarray(values[:, worst]))
        right.plot(prediction.t[shown], values[shown, worst], color=colour, lw=0.8)
    right.set(xlabel="t [s]", ylabel=f"torque of joint {worst + 1} [{unit}]")
    return figure
