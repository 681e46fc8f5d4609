"""The whole model of an arm from recordings: rigid body, friction, controllers, stiffness, closed loop."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.command.law import require_law
from ideal_robot.command.recorded import moving_at_start, with_commands
from ideal_robot.command.words import described
from ideal_robot.errors import InputError
from ideal_robot.friction import CubeRoot
from ideal_robot.identification.cascade_fit import fit_controller
from ideal_robot.identification.checks import checked
from ideal_robot.identification.command import identify_command, judged
from ideal_robot.identification.controller import ControllerIdentification, identify_controller
from ideal_robot.identification.friction_choice import WarmUp, fit_warm_up
from ideal_robot.identification.idim import Identification, identify
from ideal_robot.identification.joint_fit import stiffness_from_arm
from ideal_robot.identification.linear_loop_fit import LinearLoopFit, identify_linear_loop
from ideal_robot.identification.two_step import TwoStep, identify_two_step
from ideal_robot.identification.verdict import JointVerdict, joint_verdicts
from ideal_robot.loop.from_model import sheet_rotors
from ideal_robot.model.cascade import given_controller
from ideal_robot.model.model import Model
from ideal_robot.model.model_file import require_controller
from ideal_robot.model.parametrisation import joined
from ideal_robot.progress import Progress, Steps, silent
from ideal_robot.results import Figure, Summarised, listed, over_time, plain
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.preprocess import preprocess
from ideal_robot.signals.recording import Recording, expect, recordings_of, short_names
from ideal_robot.signals.sampling import stretches

METHODS = ("joint", "two-step")

SHARES = {"friction and rigid body": 0.8, "controller": 0.2}
"""Measured shares of the time without the controllers' own cycles."""
SHARES_WITH_CASCADE = {"friction and rigid body": 0.12, "controller": 0.7, "command": 0.18}
"""With them."""

_WARMTH = 3.0
"""A gear has to warm up by this before its warm-up can be fitted [K]."""


@dataclass(frozen=True, repr=False)
class IdentificationResult(Summarised):
    """The identified model with all intermediate results.

    Attributes:
        model: the identified model, controller and stiffness included where the recordings show them.
        result: the identification behind it.
        controller: identification of the controllers at the interpolation cycle, or None.
        two_step: the measured operating points, for the two-step method.
        estimation, validation: the recordings.
        warnings: named warnings, each ``name: sentence``.
        missing: parts that the recordings do not determine, each ``part: what is needed``.
        linear_loop: impulse responses of the closed loop, [G] (7), where there are commands; or None.
        warm_up: per joint how friction falls with gear temperature, where that was logged and rose; or None.
        verdicts: quality of the model, joint by joint.
    """

    model: Model
    result: Identification
    controller: ControllerIdentification | None
    two_step: TwoStep | None
    estimation: tuple[Recording, ...]
    validation: tuple[Recording, ...]
    warnings: tuple[str, ...]
    missing: tuple[str, ...] = ()
    linear_loop: LinearLoopFit | None = None
    warm_up: tuple[WarmUp | None, ...] = ()
    verdicts: tuple[JointVerdict, ...] = ()

    def summary(self) -> list[tuple[str, str]]:
        """Identified parts with their quality, and missing parts, as rows of label and value."""
        errors = listed(joined(self.result.estimation).residual_std_percent, "%")
        return [("model", f"{self.model.arm.name!r}: std(residual)/std(torque) {errors} by joint"),
                ("verdicts", ", ".join(f"{verdict.joint} {verdict.verdict}" for verdict in self.verdicts)),
                ("warnings", str(len(self.warnings))),
                ("not in the recordings", ", ".join(text.partition(":")[0] for text in self.missing) or "nothing")]

    def plot(self) -> Figure:
        """Figure of the first recording's torque, measured and predicted, joint by joint."""
        first = self.result.estimation[0]
        return over_time(first.t, [(f"tau_{j + 1} [{unit}]", [("measured", first.measured[:, j]),
                                                              ("model", first.tau[:, j])])
                                   for j, unit in enumerate(self.model.units("N m"))],
                         f"identified model of {self.model.arm.name}")

    def to_dict(self) -> dict[str, Any]:
        """The figures as plain values."""
        model = self.model
        names = iter(short_names([r.source for r in (*self.estimation, *self.validation)]))
        return plain({
            "robot": {"name": model.arm.name, "urdf_hash": model.arm.urdf_hash, "joints": model.n},
            "method": model.provenance["method"],
            "verdicts": [verdict.to_dict() for verdict in self.verdicts],
            "parameters": [parameter.to_dict() for parameter in model.parameters],
            **{name: {"estimation": getattr(joined(self.result.estimation), name),
                      "validation": getattr(joined(self.result.validation), name) if self.validation else []}
               for name in ("relative_error_percent", "residual_std_percent")},
            "recordings": [
                {"source": next(names), "role": role, "relative_error_percent": p.relative_error_percent,
                 "residual_std_percent": p.residual_std_percent}
                for role, predictions in (("estimation", self.result.estimation),
                                          ("validation", self.result.validation))
                for p in predictions
            ],
            "condition_number": self.result.solution.condition_number,
            "condition_number_scaled": self.result.solution.condition_number_scaled,
            "filters": model.provenance["filters"],
            "friction": [law.label for law in model.friction.laws],
            "controller": None if self.controller is None else {
                **self.controller.model.to_dict(), "error_percent": self.controller.error_percent},
            "linear_loop": None if self.linear_loop is None else {
                "relative_degree": self.linear_loop.relative_degree, "g": self.linear_loop.loop.g.T,
                "std": self.linear_loop.std.T, "error_percent": self.linear_loop.error_percent},
            "warm_up": [None if w is None else {"surplus_per_10_K": w.surplus, "std": w.surplus_std,
                                                "reference_degC": w.reference} for w in self.warm_up],
            "command": None if model.command is None else command_figures(model),
            "stiffness": None if model.gears is None else model.gears.stiffness,
            "consistent": {"was": self.result.consistency.was_consistent,
                           "largest_deviation_in_std": float(np.max(np.abs(self.result.consistency.deviation)))},
            "warnings": self.warnings,
            "missing": self.missing,
        })


def identify_model(recordings: Recording | Sequence[Recording], robot: Robot, *,
                   validation: Recording | Sequence[Recording] = (), method: str = "joint", friction: str = "auto",
                   cutoff: float | None = None, cutoff_decimation: float | None = None,
                   without_integrator: Recording | Sequence[Recording] = (), cascade: bool = True,
                   progress: Progress = silent) -> IdentificationResult:
    """Identifies rigid body, friction, offsets and, where the recordings permit it, controller and stiffness.

    Parts that the recordings do not determine are in ``missing`` of the result, poorly determined ones in ``warnings``.

    Args:
        recordings: one or several of free motion, with ``t`` [s], ``q_i`` [rad] and ``tau_i`` [N m] or
            ``current_i`` [A]; ``q_c_i`` [rad] for the controllers, ``qa_i`` [rad] for stiffness and damping.
        robot: the arm.
        validation: recordings the model is compared with and never fitted to.
        method: ``joint`` (whole motions at once) or ``two-step`` ([G] 3.1.2, recordings of the planned program).
        friction: key of a friction law for all joints; ``auto`` chooses law and refinements per joint.
        cutoff: position filter [Hz]; chosen from the data if None.
        cutoff_decimation: decimation filter [Hz]; half of the position filter if None.
        without_integrator: recordings with the controllers' integrators off, for [G] (16).
        cascade: fit the controllers at their own cycles too, which precorrection is better with; takes half a minute.
        progress: called with the share done and the present step.

    Raises:
        InputError: recordings that cannot be used, an unknown method.
    """
    if method not in METHODS:
        raise InputError(f"expected one of {', '.join(METHODS)}", field="method", value=method)
    expect(robot, Robot, "robot", "load one by Robot.load")
    recordings, validation, without_integrator = (
        recordings_of(runs, name) for runs, name in ((recordings, "recordings"), (validation, "validation"),
                                                     (without_integrator, "without_integrator")))
    (recordings, shortened), (validation, _) = stretches(recordings), stretches(validation)
    recordings, validation = (tuple(with_commands(r) for r in some) for some in (recordings, validation))
    pd_only, of_pd = checked(without_integrator, robot, commands=True)
    steps = Steps(progress, SHARES_WITH_CASCADE if cascade else SHARES)
    steps.begin("friction and rigid body")
    two_step = None
    if method == "joint":
        result = identify(recordings, robot, validation=validation, friction=friction, cutoff=cutoff,
                          cutoff_decimation=cutoff_decimation)
    else:
        result, two_step = identify_two_step(recordings, robot, validation=validation, friction=friction)
    warnings = [*shortened, *result.warnings, *of_pd]
    steps.begin("controller")
    commanded = [r for r in result.recordings if r.has("q_c")]
    controller, model = _with_controller(commanded, pd_only, robot, result.model, warnings, cascade)
    loop = _linear_loop(commanded, robot, warnings)
    missing = _missing_of_the_loop(controller, loop, commanded, robot)
    model, more = _with_stiffness(model, [r for r in result.recordings if r.has("qa")])
    if cascade and commanded:
        model = _with_command(commanded, robot, model, warnings, steps.begin("command"))
    return IdentificationResult(model, result, controller, two_step, result.recordings, result.unseen, tuple(warnings),
                                (*missing, *more), loop, _warm_up(model, result), joint_verdicts(model, result, robot))


def with_given_controller(analysis: IdentificationResult, wanted: str | Path, robot: Robot) -> IdentificationResult:
    """The result with a given controller, where the recordings do not determine one.

    Args:
        analysis, robot: the identification result, and the arm.
        wanted: see ``ideal_robot.model.cascade.given_controller``, which raises InputError.
    """
    controller = given_controller(wanted, analysis.model.dynamics, robot)
    if analysis.model.controller is not None:
        return dataclasses.replace(analysis, warnings=(*analysis.warnings, "controller-given: the recordings tell the "
                                                       "controller; --controller was not needed"))
    model = dataclasses.replace(analysis.model, controller=controller, command=None)
    missing = tuple("linear loop: commands are needed; the controller is a given one" if text.startswith("controller")
                    else text for text in analysis.missing)
    return dataclasses.replace(analysis, model=model, missing=missing)


def with_controllers(model: Model, recording: Recording, robot: Robot) -> Model | None:
    """The model with joint controllers identified from a recording instead of its own; None where there are none.

    Args:
        model: of the arm; its bodies, friction and gears stay.
        recording: of a motion, with commands and torques.
        robot: the arm.
    """
    warnings: list[str] = []
    # The old law of the command belongs to other controllers.
    bare = dataclasses.replace(model, controller=None, command=None)
    _, found = _with_controller([recording], (), robot, bare, warnings, True)
    found = _with_command([recording], robot, found, warnings, silent)
    return None if found.controller is None and found.command is None else found


def command_figures(model: Model) -> list[dict[str, Any]]:
    """One row per joint: its controller, the law's held-out residual of ``q_c - q``, and ``q_c - q`` itself."""
    law = model.command
    if law is None:
        return []
    return [{"joint": j + 1, "found": described(own, unit), "left": own.residual, "of": own.deviation,
             "cascade_left": None if law.cascade is None else float(law.cascade[j]), "law_leads": law.leads}
            for j, (own, unit) in enumerate(zip(law.joints, model.units("N m/rad"), strict=True))]


class FrictionPoints(NamedTuple):
    """Friction as measured on the estimation data, ``(M, n)`` each.

    Attributes:
        speed: [rad/s or m/s].
        torque: measured torque less everything but friction [N m or N].
        modelled: the model's friction there, load and reversals included [N m or N].
        temperature: of the gears [°C], or None where a recording has none.
    """

    speed: Array
    torque: Array
    modelled: Array
    temperature: Array | None


def friction_points(model: Model, result: Identification) -> FrictionPoints:
    """Friction on the estimation data, as measured and as modelled."""
    filters = model.provenance["filters"]
    speeds, torques, modelled, warmth = [], [], [], []
    for recording, prediction in zip(result.recordings, result.estimation, strict=True):
        s = preprocess(recording, cutoff=filters["cutoff"], cutoff_decimation=filters["cutoff_decimation"])
        friction = s.decimate(model.friction.torque(s.qd, model.rigid_body(s.q, s.qd, s.qdd), s.q))
        speeds.append(s.decimate(s.qd))
        torques.append(prediction.measured - prediction.tau + friction)
        modelled.append(friction)
        if recording.has("temp"):
            warmth.append(s.decimate(np.column_stack([s.columns[f"temp_{j + 1}"] for j in range(model.n)])))
    temperature = np.concatenate(warmth) if len(warmth) == len(speeds) else None
    return FrictionPoints(np.concatenate(speeds), np.concatenate(torques), np.concatenate(modelled), temperature)


def _warm_up(model: Model, result: Identification) -> tuple[WarmUp | None, ...]:
    """How friction falls with temperature, for joints that warmed up by at least ``_WARMTH``."""
    speed, torque, _, temperature = friction_points(model, result)
    if temperature is None:
        return ()
    warm_ups: list[WarmUp | None] = []
    for j in range(model.n):
        sliding = np.abs(speed[:, j]) > 0.05 * np.max(np.abs(speed[:, j]))
        warmed = np.ptp(temperature[sliding, j]) >= _WARMTH if sliding.sum() > 50 else False
        warm_ups.append(fit_warm_up(CubeRoot, speed[sliding, j], torque[sliding, j], temperature[sliding, j])
                        if warmed else None)
    return tuple(warm_ups)


def _missing_of_the_loop(controller: ControllerIdentification | None, loop: LinearLoopFit | None,
                         commanded: Sequence[Recording], robot: Robot) -> list[str]:
    """Yields warnings on what recordings with commands do not determine of controllers and closed loop."""
    if not commanded:
        return [f"controller, linear loop: commands q_c_1 to q_c_{robot.n} are needed; without a controller the model "
                "cannot correct a path"]
    return [f"{what}: the commands do not determine it, see the warning no-{what.replace(' ', '-')}"
            for what, fit in (("controller", controller), ("linear loop", loop)) if fit is None]


def _with_stiffness(model: Model, recordings: Sequence[Recording]) -> tuple[Model, list[str]]:
    """The model with stiffness and damping from measured arm angles; without recordings of them, what is missing."""
    if not recordings:
        return model, [f"stiffness, damping: measured arm angles qa_1 to qa_{model.n} are needed, or recordings of the "
                       "clamped arm (analyse_stiffness); gears count as rigid"]
    return dataclasses.replace(model, gears=stiffness_from_arm(recordings, model)), []


def _linear_loop(recordings: Sequence[Recording], robot: Robot, warnings: list[str]) -> LinearLoopFit | None:
    if not recordings:
        return None
    try:
        return identify_linear_loop(recordings, robot.t_ipo)
    except InputError as error:
        warnings.append(f"no-linear-loop: {error}")
        return None


def _with_command(recordings: Sequence[Recording], robot: Robot, model: Model, warnings: list[str],
                  progress: Progress) -> Model:
    """The model with the law of its commands, and which of law and [G]'s loop predicts them better."""
    try:
        law = identify_command(recordings, model, torque=True, progress=progress)
        require_law(law, model.n, recordings[0].source)
    except InputError as error:
        warnings.append(f"no-command-law: {error}")
        return model
    for recording in recordings:
        if (j := moving_at_start(recording.t, recording.joints("q"))) is not None:
            warnings.append(f"starts-in-motion: joint {j + 1} moves in the first row already, and what its controller "
                            "remembers is not in the log: the first second says nothing of the controller "
                            f"[{recording.source}]")
    if model.controller is not None:
        law = judged(law, recordings, model, robot)
    return dataclasses.replace(model, command=law)


def _with_controller(recordings: Sequence[Recording], without_integrator: Sequence[Recording], robot: Robot,
                     model: Model, warnings: list[str], cascade: bool,
                     ) -> tuple[ControllerIdentification | None, Model]:
    """The controllers at the interpolation cycle, and for the model, where wanted, those at their own cycles."""
    if not recordings:
        return None, model
    try:
        result = identify_controller(recordings, robot.t_ipo, without_integrator)
        require_controller(result.model, robot.n, recordings[0].source)
    except InputError as error:
        warnings.append(f"no-controller: {error}")
        return None, model
    controller = result.model
    if cascade:
        try:
            cascades = fit_controller(recordings[0], robot, sheet_rotors(model, robot)).controller
            require_controller(cascades, robot.n, recordings[0].source)
            controller = cascades
        except InputError as error:
            warnings.append(f"controller-at-interpolation-cycle: the model has the controller at {1e3 * robot.t_ipo:g} "
                            f"ms only; {error}")
    return result, dataclasses.replace(model, controller=controller)
