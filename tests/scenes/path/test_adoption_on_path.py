"""What an arm that measures motor angles alone may believe of its tool, and which changes it plays."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from ideal_robot.model.model import Model
from scenes.closing.arm import tool_deviation
from scenes.closing.loop import Form
from scenes.measured import visible
from scenes.path.cell import PathCell
from scenes.path.close_loop import _Path
from tests.scenes.path import kind_arm as arm
from tests.scenes.path.effect_cases import CASES


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
