"""Searches in what is measured beside motor torques: arm angles, TCP positions, force sensor, camera."""

from __future__ import annotations

from collections.abc import Iterator

from ideal_robot.diagnosis.case import Case, Findings
from ideal_robot.diagnosis.channels.arm_angle import arm_angle_regression, with_loose_weights
from ideal_robot.diagnosis.channels.blocks import Blocks, time_blocks
from ideal_robot.diagnosis.channels.force import blocks_of, force_regressions
from ideal_robot.diagnosis.channels.line import line_blocks, line_regression
from ideal_robot.diagnosis.channels.motor_torque import in_position_band
from ideal_robot.diagnosis.channels.regression import Regression, without_known
from ideal_robot.diagnosis.channels.tool_position import tool_regression
from ideal_robot.diagnosis.search.equivalents import with_equivalents
from ideal_robot.diagnosis.search.forward_selection import Search
from ideal_robot.diagnosis.statistics.problem import Problem
from ideal_robot.diagnosis.validation.domain_diagnosis import DomainDiagnosis
from ideal_robot.effects import ARM_POSITION, SENSOR, TCP_POSITION, library
from ideal_robot.effects.backlash import Backlash


def diagnosed_channels(case: Case, found: Findings) -> Iterator[DomainDiagnosis]:
    """The domains that the recording has beside the motor torque, after their search."""
    torque, validation = _in_position_band(case, found)
    for build in (arm_angle_regression, tool_regression):
        made = build(case.recording, case.robot, torque, case.stiffness)
        if made is None:
            continue
        made = without_known(made, found.start.effects)
        if made.domain == ARM_POSITION:
            made = with_loose_weights(made, [choice.candidate for choice in found.choices])
        other = None if validation is None or case.validate is None else \
            build(case.validate, case.robot, validation, case.stiffness)
        other = None if other is None else without_known(other, found.start.effects)
        blocks = time_blocks(len(made.t), float(made.t[1] - made.t[0]), held_out=other is None)
        yield _diagnosed(case, made, other, blocks)
    yield from diagnosed_sensors(case, found)


def diagnosed_sensors(case: Case, found: Findings) -> Iterator[DomainDiagnosis]:
    """The domains of a force sensor and of a camera, as far as the recording has them, after their search."""
    torque, validation = _in_position_band(case, found)
    for made, other in force_regressions(case.recording, case.validate, case.robot, torque, validation,
                                         case.stiffness):
        yield _diagnosed(case, made, other, blocks_of(made, held_out=other is None))
    # The curve of another recording's line would say nothing here.
    line = line_regression(case.recording, case.robot, torque, case.stiffness)
    if line is not None:
        yield _diagnosed(case, line, None, line_blocks(line, held_out=True))


def _in_position_band(case: Case, found: Findings) -> tuple[Regression, Regression | None]:
    validation = None if found.validation is None or case.validate is None else \
        in_position_band(found.validation, case.validate)
    return in_position_band(found.problem.regression, case.recording), validation


def _diagnosed(case: Case, made: Regression, validation: Regression | None, blocks: Blocks) -> DomainDiagnosis:
    """The search in one regression; of a sensor nothing is learned, and what is reported as before is refitted."""
    effects = [effect for effect in library() if effect.domain == made.domain]
    sensor, only = made.domain == SENSOR, case.only
    if made.domain == TCP_POSITION and made.absent:
        # Two axes of three do not tell a length of the arm from an angle, nor a curve from either; play is one over
        # the load.
        only = tuple((e.name, j) for e in effects if not e.geometric and e.name != Backlash.name
                     for j in range(case.robot.n + 1) if only is None or (e.name, j) in only)
    if sensor:
        only = tuple((e.name, 0) for e in effects if only is None or (e.name, 0) in only)
    problem = Problem(made, blocks)
    choices = Search(problem, effects, case.options.finer(), case.rng, absorbed=True, only=only).run()
    choices = with_equivalents(problem, choices)
    final = problem.on_all_blocks().fit([c.candidate for c in choices], uncertainty=True)
    return DomainDiagnosis(problem, choices, final, validation, not sensor, case.recording.hash)
