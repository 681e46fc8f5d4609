"""From recordings to a model, its figures and its JSON: what ``ideal-robot identify`` does."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ideal_robot.errors import InputError
from ideal_robot.identification.closed_loop_fit import fit_controller
from ideal_robot.identification.controller import ControllerIdentification, identify_controller
from ideal_robot.identification.idim import Identification, identify, relative_error
from ideal_robot.identification.stiffness_from_arm import stiffness_from_arm
from ideal_robot.identification.two_step import TwoStep, identify_two_step
from ideal_robot.model import Model, Prediction
from ideal_robot.recording import Recording
from ideal_robot.robot import Robot

METHODS = ("joint", "two-step")


@dataclass(frozen=True)
class Analysis:
    """Everything the report shows.

    Attributes:
        model: the identified model, controller and stiffness included where the recordings show them.
        result: the identification behind it.
        controller: identification of the controllers at the interpolation cycle, or None.
        two_step: the measured operating points, for the two-step method.
        estimation, validation: the recordings.
        warnings: all named warnings.
    """

    model: Model
    result: Identification
    controller: ControllerIdentification | None
    two_step: TwoStep | None
    estimation: tuple[Recording, ...]
    validation: tuple[Recording, ...]
    warnings: tuple[str, ...]

    def json(self) -> dict[str, Any]:
        """The figures for machines."""
        model = self.model
        return {
            "robot": {"name": model.robot_name, "urdf_hash": model.urdf_hash, "joints": model.n},
            "method": model.provenance["method"],
            "parameters": [
                {"name": p.name, "joint": p.joint, "value": p.value, "std": p.std, "std_percent": p.std_percent,
                 "unit": p.unit, "meaning": p.meaning} for p in model.parameters
            ],
            "relative_error_percent": {
                "estimation": relative_error(self.result.estimation),
                "validation": relative_error(self.result.validation) if self.validation else [],
            },
            "residual_std_percent": {
                "estimation": residual_std(self.result.estimation),
                "validation": residual_std(self.result.validation) if self.validation else [],
            },
            "recordings": [
                {"source": Path(r.source).name, "role": role, "relative_error_percent": p.relative_error_percent,
                 "residual_std_percent": p.residual_std_percent}
                for role, recordings, predictions in (("estimation", self.estimation, self.result.estimation),
                                                      ("validation", self.validation, self.result.validation))
                for r, p in zip(recordings, predictions, strict=True)
            ],
            "condition_number": self.result.solution.condition_number,
            "condition_number_scaled": self.result.solution.condition_number_scaled,
            "filters": model.provenance["filters"],
            "friction": [law.label for law in model.friction.laws],
            "controller": None if self.controller is None else {
                **self.controller.model.to_dict(), "error_percent": self.controller.error_percent},
            "stiffness": model.stiffness,
            "consistent": {"was": self.result.consistency.was_consistent,
                           "largest_deviation_in_std": float(np.max(np.abs(self.result.consistency.deviation)))},
            "warnings": list(self.warnings),
        }


def residual_std(predictions: Sequence[Prediction]) -> np.ndarray:
    """Standard deviation of the residual over that of the torque, per joint over several recordings [%]."""
    y = np.concatenate([p.measured for p in predictions])
    e = y - np.concatenate([p.tau for p in predictions])
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(100.0 * np.std(e, axis=0) / np.std(y, axis=0))


def analyse(recordings: Sequence[Recording], robot: Robot, *, validation: Sequence[Recording] = (),
            method: str = "joint", friction: str = "auto", cutoff: float | None = None,
            cutoff_decimation: float | None = None, without_integrator: Sequence[Recording] = (),
            cascade: bool = True, progress: Callable[[float, str], None] = lambda fraction, text: None) -> Analysis:
    """Identifies rigid body, friction, offsets and, where the recordings hold what is needed, controller and stiffness.

    Args:
        recordings, validation: to identify from, and to compare with.
        robot: the arm.
        method: ``joint`` (whole motions at once) or ``two-step`` ([G] 3.1.2, recordings of the planned program).
        friction, cutoff, cutoff_decimation: as for ``ideal_robot.identification.idim.identify``.
        without_integrator: recordings with the controllers' integrators off, for [G] (16).
        cascade: fit the controllers at their own cycles too, which precorrection is better with; takes half a minute.
        progress: called with the share done and what is being done.

    Raises:
        InputError: recordings that cannot be used, an unknown method.
    """
    if method not in METHODS:
        raise InputError(f"expected one of {', '.join(METHODS)}", field="method", value=method)
    progress(0.05, "friction and rigid body")
    two_step = None
    if method == "joint":
        result = identify(recordings, robot, validation=validation, friction=friction, cutoff=cutoff,
                          cutoff_decimation=cutoff_decimation)
    else:
        result, two_step = identify_two_step(recordings, robot, validation=validation, friction=friction)
    warnings = list(result.warnings)
    progress(0.6, "controller")
    controller, model = None, result.model
    with_command = [r for r in result.recordings if r.has("q_c")]
    if with_command:
        controller, model = _with_controller(with_command, without_integrator, robot, model, warnings, cascade)
    with_arm = [r for r in result.recordings if r.has("qa")]
    if with_arm:
        stiffness, damping = stiffness_from_arm(with_arm, model)
        model = dataclasses.replace(model, stiffness=stiffness, damping=damping)
    return Analysis(model, result, controller, two_step, result.recordings, result.unseen, tuple(warnings))


def _with_controller(recordings: Sequence[Recording], without_integrator: Sequence[Recording], robot: Robot,
                     model: Model, warnings: list[str], cascade: bool,
                     ) -> tuple[ControllerIdentification | None, Model]:
    """The controllers at the interpolation cycle, and for the model, where wanted, those at their own cycles."""
    try:
        found = identify_controller(recordings, robot.t_ipo, without_integrator)
    except InputError as error:
        warnings.append(f"no-controller: {error}")
        return None, model
    controller = found.model
    if cascade:
        try:
            controller = fit_controller(recordings[0], robot).controller
        except InputError as error:
            warnings.append(f"controller-at-interpolation-cycle: the model has the controller at {1e3 * robot.t_ipo:g} "
                            f"ms only; {error}")
    return found, dataclasses.replace(model, controller=controller)
