"""The diagnosis: residual, search, extended model, and errors before and after on data that took no part."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ideal_robot.diagnosis import stages
from ideal_robot.diagnosis.case import Case
from ideal_robot.diagnosis.report import diagnosis_of, undecided
from ideal_robot.diagnosis.search.choice import Options
from ideal_robot.diagnosis.search.forward_selection import Only
from ideal_robot.diagnosis.validation.comparable import unlike
from ideal_robot.diagnosis.validation.result import Diagnosis
from ideal_robot.identification.checks import checked
from ideal_robot.model.model import Model
from ideal_robot.progress import Progress, Steps, silent
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.channels import channel_findings, dead_joints
from ideal_robot.signals.given import expect
from ideal_robot.signals.recording import Recording
from ideal_robot.signals.stretches import shortened

_READING = "Reading"
SHARES = {_READING: 0.03, "Baseline": 0.02, "Effects of the motor torque": 0.55, "Found, but not added": 0.02,
          "Joint fit": 0.04, "Effects of other channels": 0.23, "Error before and after, on held-out data": 0.11}
"""Measured shares of the time, an arm of six joints."""
STAGES = {
    "Baseline": stages.baseline,
    "Effects of the motor torque": stages.effects_of_motor_torque,
    "Found, but not added": stages.found_but_not_added,
    "Joint fit": stages.joint_fit,
    "Effects of other channels": stages.effects_of_other_channels,
    "Error before and after, on held-out data": stages.errors_before_and_after,
}
"""Heading, and what is done: a function of the case and of what was found before."""


def diagnose(recording: Recording, robot: Robot, *, model: Model | None = None, validate: Recording | None = None,
             options: Options | None = None, seed: int = 0, progress: Progress = silent,
             only: Only | None = None, cutoff: float | None = None) -> Diagnosis:
    """Says which physical effect a model misses in a recording, in which joint, and what it is worth.

    Args:
        recording: what was measured.
        robot: the arm it was measured on.
        model: what was known before; without it a rigid body with Coulomb and viscous friction, rotors and offsets is
            identified from the recording first.
        validate: another recording of the same arm on which errors are reported; without it every fourth block of
            time of ``recording`` is kept apart for that.
        options: thresholds.
        seed: of the null distributions.
        progress: called with the share done and a word.
        only: names and joints of the effects that may be looked for, for an oracle; then nothing is learned either.
        cutoff: of the position filter [Hz]; 20 Hz if None, or a quarter of a slower sampling rate. The band in which
            torques are looked at and the time left out around reversals follow it.

    Raises:
        InputError: a recording that cannot be used, or a model of another arm.
    """
    steps = Steps(progress, SHARES)
    steps.begin(_READING)
    if model is not None:
        model.require_arm(robot)
    # Torques made of currents without known gains are in amperes: then joints must not share inertias.
    amperes = not recording.has("tau") and bool(np.all(robot.drive_gain == 1.0)) and robot.n > 1
    recording, shorter = shortened(recording)
    (recording,), warnings = checked([recording], robot)
    warnings = shorter + warnings
    if validate is not None:
        expect(validate, Recording, "validate", "give one recording; diagnose once for each where there are several")
        validate, shorter = shortened(validate)
        (validate,), more = checked([validate], robot)
        warnings += shorter + more
    known = [finding for one in (recording, validate) if one is not None for finding in channel_findings(one)]
    warnings += [finding.warning for finding in known]
    case = Case(recording, robot, model, validate, options or Options(), np.random.default_rng(seed), progress,
                shared=model is not None or not amperes, only=only, dead=tuple(dead_joints(tuple(known))),
                cutoff=cutoff)
    found = stages.prepared(case, tuple(warnings))
    if validate is not None and model is None:
        missed = unlike(case, found, validate)
        if missed:
            warnings.append("validation-not-predicted: with the parameters of the recording alone the error of the "
                            f"other one is larger than what it varies by in {', '.join(missed)}; it decides and "
                            "reports nothing, blocks of the recording kept apart do (give --model, or a recording "
                            "that moves as widely as the other)")
            case = replace(case, validate=None)
            found = stages.prepared(case, tuple(warnings))
    if len(found.problem.regression.undecided) == robot.n:
        return undecided(case, stages.sensors_alone(case, found))
    for heading, stage in STAGES.items():
        found = stage(replace(case, progress=steps.begin(heading)), found)
    return diagnosis_of(case, found)
