"""What closing a path is made of: what an arm believes, what is suggested, foreseen, and moved to be diagnosed."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from ideal_robot.diagnosis import Diagnosis
from ideal_robot.effects import FittedEffect
from ideal_robot.model.model import Model
from scenes.closing.loop import Form, Group
from scenes.closing.measured import tool_deviation, visible
from scenes.path.candidates import Candidates
from scenes.path.cell import PathCell, training_path
from scenes.path.close_loop import _Path, left_unexplained
from scenes.path.diagnostic_motion import covering, diagnostic_motion
from sim.arm.world import World
from tests.scenes.path import kind_arm as arm
from tests.scenes.path.effect_cases import CASES, friction_of


def seen(played: arm.Play, known: Model, *loads: Any) -> float:
    """Error as motor angles tell it."""
    path = arm.path()
    deviation = tool_deviation(visible(played.recording, "motor"), (path.t, path.q_d, path.counts), arm.ROBOT, known,
                               loads)
    return float(np.sqrt(np.mean(deviation**2)))


def test_a_load_that_currents_show_counts_behind_the_gears() -> None:
    """A payload bends the gears; a model that makes up for it must not look worse to motor angles than one without."""
    case = CASES["payload/tau"]()
    known = arm.model()
    before, after = (arm.played(case.world, model, of=case.individual)
                     for model in (known, known.with_effects((case.true,))))
    assert seen(after, known, case.true) < 0.5 * seen(before, known, case.true)
    # Without the load behind the gears the better play looks worse.
    assert seen(after, known) > seen(after, known, case.true)


def test_a_softer_gear_does_not_confirm_itself() -> None:
    """Motor angles are brought behind the gears as they were known: what follows a changed stiffness looks wrong."""
    case = CASES["joint_elasticity/qa"]()
    known = arm.model()
    before, after = (arm.played(case.world, model, of=case.individual)
                     for model in (known, known.with_effects((case.true,))))
    assert seen(after, known) > seen(before, known)


@pytest.mark.parametrize(("worse", "playable"), [(0.005, True), (0.5, False)])
def test_a_change_that_hardly_shows_on_the_loop_is_played(worse: float, playable: bool,
                                                          monkeypatch: pytest.MonkeyPatch) -> None:
    """A payload under stiff control leaves as much of its joints unexplained and bends the path all the same."""
    rng = np.random.default_rng(1)
    subject = _Path(PathCell(arm.ROBOT, arm.WORLD, arm.model(), arm.path(), "motor", 1), "tcp", False)
    changed = arm.model().with_effects((CASES["payload/tau"]().true,))
    monkeypatch.setattr(subject, "_left", lambda model, run: (1.0 + worse * bool(model.effects)) * (
        1.0 + 0.1 * rng.normal(size=(200, 3))))
    order, reason = subject.foreseen((Form("payload", lambda model, run: changed),), [changed], arm.model(), None)
    assert (order == [0]) is playable
    assert "explains less" in reason


def test_what_explains_a_recording_with_the_model_as_it_was_is_tried_too() -> None:
    """Where parameters were fitted anew, a body hides in them, and all that has a name then may be what cannot act."""
    case = CASES["payload/tau"]()
    moved = arm.recording(case.world, of=case.individual)
    offset = FittedEffect("current_offset", 1, "tau_1", (1.0,))
    found = Diagnosis("unknown", (), (), (), "", 0.0, beside_known=((case.true, offset),))
    (of_arm, of_tool), refused = Candidates(arm.model(), found, moved, moved, arm.ROBOT, "tcp").groups()
    (together,), (alone, of_offset) = of_arm.together, of_arm.apart
    assert of_tool == Group((), ())
    assert together.places == (("payload", 0), ("current_offset", 1))
    for form in (together, *alone):
        added = form.change(arm.model(), None).effects
        assert added[0].coefficients[0] == pytest.approx(case.true.coefficients[0], rel=0.05)
    assert [form.places for form in alone] == [(("payload", 0),)] * 2
    assert [form.places for form in of_offset] == [(("current_offset", 1),)] * 2
    assert not refused


def cell(robot=arm.ROBOT) -> PathCell:
    return PathCell(robot, World.from_table(robot.name, {}), arm.model(), arm.path(), "motor", 1)


def test_it_reaches_both_ends_of_the_path_in_every_joint() -> None:
    """By itself the motion that training learns from stops up to a third short of one end."""
    path = arm.path().q_d
    short = training_path(arm.path(), arm.ROBOT.t_ipo).q_d
    q = diagnostic_motion(cell()).q_d
    assert np.any(short.max(axis=0) < path.max(axis=0))
    assert np.all(q.max(axis=0) >= path.max(axis=0))
    assert np.all(q.min(axis=0) <= path.min(axis=0))


def test_it_keeps_to_the_limits_of_joints_and_speeds() -> None:
    path = arm.path().q_d
    wide = diagnostic_motion(cell()).q_d
    speed = np.max(np.abs(np.diff(wide, axis=0)), axis=0) / arm.ROBOT.t_ipo
    tight = dataclasses.replace(arm.ROBOT, q_min=path.min(axis=0) - 1e-3, q_max=path.max(axis=0) + 1e-3,
                                v_max=0.5 * speed)
    q = covering(training_path(arm.path(), tight.t_ipo).q_d, path, tight)
    moving = np.ptp(path, axis=0) > np.radians(8.0)
    assert moving.any()
    assert np.all((q >= tight.q_min - 1e-9) & (q <= tight.q_max + 1e-9), axis=0)[moving].all()
    slow = diagnostic_motion(cell(dataclasses.replace(arm.ROBOT, v_max=0.5 * speed))).q_d
    assert np.all(np.abs(np.diff(slow, axis=0)) / arm.ROBOT.t_ipo <= 0.5 * speed * (1.0 + 1e-6))
    assert len(slow) > 1.9 * len(wide)


@pytest.mark.parametrize(("key", "measured"), [("stribeck/tau", "motor"), ("payload/tau", "motor"),
                                               ("joint_elasticity/qa", "tcp")])
def test_true_change_explains_the_play_and_its_opposite_does_not(key: str, measured: str) -> None:
    case = CASES[key]()
    known = dataclasses.replace(arm.model(), friction=friction_of(case))
    played = arm.played(case.world, known, of=case.individual)
    opposite = dataclasses.replace(case.true, coefficients=tuple(-0.5 * value for value in case.true.coefficients))
    cell = PathCell(arm.ROBOT, case.world, known, arm.path(), "motor", 1)
    before, right, wrong = (float(np.linalg.norm(left_unexplained(cell, model, played, measured))) for model in (
        known, known.with_effects((case.true,)), known.with_effects((opposite,))))
    # What two programs that simulate the same arm differ by, about 20 µm, is in all three.
    assert right < 0.9 * before
    assert wrong > 0.999 * before
